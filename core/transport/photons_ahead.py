"""Results of photons that were traced before there were texels, kept in a folder; their places of splitting are found once there are."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..parallel import shared_arrays
from .photon_log import ShardHits
from .photons import SplitAt

_Rows = NDArray[np.float32]
_Ints = NDArray[np.int32]


@dataclass(frozen=True)
class Partings:
    """Where the groups of a shard were split, in order, as arguments of photons.SplitAt.

    tri    (g,) int32
    u, v   (g,) float32
    """

    tri: _Ints
    u: _Rows
    v: _Rows


@dataclass(frozen=True)
class AheadHits:
    """Hits whose groups, if there are any, have no places yet."""

    hits: ShardHits
    partings: Partings | None


class NotedPartings:
    """photons.SplitAt while nothing is known of places: as many part everywhere, and where they do is noted."""

    def __init__(self) -> None:
        none = np.zeros(0, np.float32)
        self._pieces = [(np.zeros(0, np.int32), none, none)]

    def __call__(self, tri: _Ints, u: _Rows, v: _Rows) -> tuple[_Ints, _Rows]:
        self._pieces.append((tri, u, v))
        return np.zeros(len(tri), np.int32), np.ones(len(tri), np.float32)

    def all(self) -> Partings:
        """Those of all calls so far."""
        return Partings(*(np.concatenate(pieces) for pieces in zip(*self._pieces, strict=True)))


def keep_hits(folder: Path, hits: ShardHits, noted: NotedPartings | None) -> None:
    """Write them to `folder`. Raises OSError where there is no room."""
    shared_arrays.save_struct(folder, AheadHits(hits, noted.all() if noted else None))


def fetch_hits(folder: Path, split_at: SplitAt | None) -> ShardHits:
    """Those of keep_hits, once: the folder is removed.

    split_at   returns the places of groups; None where they are not needed
    """
    kept = shared_arrays.load_struct(folder, AheadHits)
    shared_arrays.remove_struct(folder)
    hits, partings = kept.hits, kept.partings
    if hits.groups and partings and split_at:
        place, _ = split_at(partings.tri, partings.u, partings.v)
        hits = replace(hits, groups=replace(hits.groups, place=place))
    return hits
