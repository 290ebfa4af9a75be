"""Shards of photons: tracing them, and summing their deposits over the nodes of the trees."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..parallel import shared_arrays
from ..parallel.folders import keep_view_open
from ..radiosity.cell_tally import CellFlux
from ..radiosity.quadtree import TreeView
from ..radiosity.tally import ShardTally, deposit
from ..transport import photons
from ..transport.photon_log import Counters, EnergyAudit, ShardHits
from ..transport.traced_scene import TracedScene, Tracing, open_scene, open_tracing
from ..util import sampling
from ..util.settings import Settings


@keep_view_open
def open_view(folder: str) -> TreeView:
    """The view that was written to `folder`; a process keeps the last one open."""
    return shared_arrays.load_struct(Path(folder), TreeView)


@dataclass(frozen=True)
class PhotonShard:
    """One shard of one round."""

    tracing: str  # folder
    view: str  # folder
    seed: int
    round: int
    shard: int
    photons: int
    max_depth: int
    degree: int
    skip_first: bool  # direct light comes from shadow rays
    hits: str = ""  # folder on this machine with hits that were traced ahead, see first_photons

    @classmethod
    def of_round(
        cls,
        folder: Path,
        settings: Settings,
        round_: int,
        shares: Sequence[int],
        view: str,
        degree: int,
    ) -> list[PhotonShard]:
        """Shards with `shares` photons each; the other arguments are as the fields."""
        by_rays = settings.direct == "rays"
        whole = cls(
            tracing=str(folder),
            view=view,
            seed=settings.seed,
            round=round_,
            shard=0,
            photons=0,
            max_depth=settings.max_depth - by_rays,  # the gather ray adds a bounce
            degree=degree,
            skip_first=by_rays,
        )
        return [replace(whole, shard=number, photons=share) for number, share in enumerate(shares)]


@dataclass(frozen=True)
class PhotonResult:
    """Sums and counts of one shard. Each of its photons carries the power of the whole scene.

    tally       sums over nodes
    elsewhere   photons on sides without a lightmap
    """

    tally: ShardTally
    audit: EnergyAudit
    counters: Counters
    elsewhere: CellFlux

    @classmethod
    def join(cls, pieces: Sequence[PhotonResult]) -> PhotonResult:
        """Add up the pieces of one shard."""
        if len(pieces) == 1:
            return pieces[0]
        return cls(
            tally=ShardTally.join([piece.tally for piece in pieces]),
            audit=EnergyAudit.join([piece.audit for piece in pieces]),
            counters=Counters.join([piece.counters for piece in pieces]),
            elsewhere=CellFlux.join([piece.elsewhere for piece in pieces]),
        )


def trace_photons(shard: PhotonShard) -> PhotonResult:
    """Trace the photons of a shard, unless that was done ahead, and sum them over nodes."""
    tracing, view = open_tracing(shard.tracing), open_view(shard.view)
    pieces = _fetch_hits(Path(shard.hits)) if shard.hits else _trace_hits(tracing, shard)
    return PhotonResult.join([_sum_up(tracing, view, shard, hits) for hits in pieces])


def _sum_up(tracing: Tracing, view: TreeView, shard: PhotonShard, hits: ShardHits) -> PhotonResult:
    x, y = tracing.texels.hit_texel_xy(hits.tri, hits.u, hits.v)
    entry = tracing.texels.entry_of(hits.tri, x, y)
    cells, on_sides = tracing.cells, hits.elsewhere
    cell, flux = cells.find(on_sides.tri, on_sides.is_front, on_sides.u, on_sides.v), on_sides.flux_rgb
    cell = cell + len(cells) * on_sides.straight
    if entry.min(initial=0) < 0:  # a face may have no texels, for instance if a UV layer folds it to a line
        lost = np.flatnonzero(entry < 0)
        tri, u, v = hits.tri.take(lost), hits.u.take(lost), hits.v.take(lost)
        cell = np.concatenate([cell, cells.find(tri, np.ones(len(lost), bool), u, v)])
        flux = np.concatenate([flux, hits.flux_rgb.take(lost, axis=1)], axis=1)
        placed = np.flatnonzero(entry >= 0)
        hits, x, y, entry = hits.only(placed), x.take(placed), y.take(placed), entry.take(placed)
    node, s, t = view.locate(tracing.texels.owner_of(entry, x, y), x, y)
    is_first = None if shard.skip_first and not tracing.scene.has_caustics else hits.is_first
    sums = deposit(node, s, t, hits.flux_rgb, is_first, len(view.centre), shard.degree)
    return PhotonResult(sums, hits.audit, hits.counters, CellFlux.of(cell, flux, 2 * len(cells)))


def trace_ahead(shard: PhotonShard) -> bool:
    """Trace a shard and keep its hits in the folder shard.hits, before texels and a view exist.

    Returns False if there are too many hits to keep; the shard is then traced again later. Raises OSError if the disk is full.
    """
    pieces = _trace_hits(open_scene(shard.tracing), shard)
    hits = next(pieces)
    is_all = next(pieces, None) is None
    if is_all:
        shared_arrays.save_struct(Path(shard.hits), hits)
    return is_all


def _fetch_hits(folder: Path) -> Iterator[ShardHits]:
    """The hits that trace_ahead kept; the folder is removed."""
    hits = shared_arrays.load_struct(folder, ShardHits)
    shared_arrays.remove_struct(folder)
    yield hits


def _trace_hits(opened: TracedScene, shard: PhotonShard) -> Iterator[ShardHits]:
    rng = sampling.shard_rng(shard.seed, shard.round, shard.shard)
    # The number of photons in the bake is not known yet: each carries all the power, and sums are divided by the number later.
    return photons.trace_shard(opened.scene, shard.photons, shard.photons, rng, shard.max_depth, shard.skip_first)
