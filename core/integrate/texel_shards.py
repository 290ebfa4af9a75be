"""Shards of rays from texels: shadow rays, and rays that gather the light of surfaces.

A result is a pure function of the shard and the folders it names; results are summed in the order of the shards, so that the same
seed gives the same bytes on one process, two, or a cluster.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..parallel import shared_arrays
from ..parallel.folders import keep_scene_open, keep_view_open
from ..texels.texel_map import FOOTPRINT_SIDE, TexelMap
from ..texels.tiles import Tiles
from ..transport.traced_scene import open_tracing
from ..util import sampling
from ..util.ablation import uses
from ..util.arrays import Float32, IntArray
from ..util.coverage import as_slice
from . import direct, gather
from .bright_places import PlacedSurfaces, Targets

DIRECT_ROUND = 2**31 - 1  # of the random numbers for shadow rays: no round of photons comes that far
GATHER_ROUND = 2**30  # the same, of rays that gather


@keep_view_open
def open_known_light(folder: str) -> gather.KnownLight:
    """The light that was written to `folder`; the same."""
    return shared_arrays.load_struct(Path(folder), gather.KnownLight)


@dataclass(frozen=True)
class TexelShard:
    """Rays from some texel entries."""

    tracing: str  # folder
    seed: int
    turn: int  # how many times such rays have been sent before in this bake
    start: int  # position of the shard in its turn
    texels: IntArray | range  # ascending; a range is sooner sent

    @property
    def entries(self) -> IntArray:
        """(m,) int: its texels."""
        return np.arange(self.texels.start, self.texels.stop) if isinstance(self.texels, range) else self.texels

    def rng(self, round_: int) -> np.random.Generator:
        """Its own random numbers; `round_` is that of the first turn, from which turns count down."""
        return sampling.shard_rng(self.seed, round_ - self.turn, self.start)


@dataclass(frozen=True)
class DirectShard(TexelShard):
    """Shadow rays; tolerance as of direct.direct_irradiance."""

    tolerance: float

    def tiles(self) -> Tiles:
        """Of its texels."""
        if not uses("tiles"):
            return Tiles.none()
        texels, rows = open_tracing(self.tracing).texels, as_slice(self.entries)
        return Tiles.of(texels.texel_chart[rows], texels.texel_code[rows])


def light_texels(shard: DirectShard) -> direct.DirectLight:
    """Direct light at the texels of a shard."""
    texels, scene = open_tracing(shard.tracing).texels, _open_direct_scene(shard.tracing)
    entry, rng = shard.entries, shard.rng(DIRECT_ROUND)
    crossed = texels.borders.see_beyond(entry, FOOTPRINT_SIDE)
    found = direct.direct_irradiance(scene, texels.footprints_at, entry, rng, shard.tolerance, shard.tiles(), crossed)
    return replace(found, irradiance_rgb=found.irradiance_rgb.astype(np.float32), variance_rgb=found.variance_rgb.astype(np.float32))


@dataclass(frozen=True)
class GatherShard(TexelShard):
    """Rays to the surfaces that the texels see; the view's folder holds gather.KnownLight."""

    n_ray: int  # of each texel
    view: str  # folder


def gather_texels(shard: GatherShard) -> gather.GatheredLight:
    """Light from surfaces at the texels of a shard."""
    scene, known, targets = _open_gather_scene(shard.tracing), open_known_light(shard.view), _open_targets(shard.tracing, shard.view)
    return gather.gather_light(scene, known, targets, shard.entries, shard.rng(GATHER_ROUND), shard.n_ray)


@keep_view_open
def _open_targets(tracing: str, view: str) -> Targets:
    return Targets(open_known_light(view).bright, open_surfaces(tracing))


@keep_scene_open
def open_surfaces(folder: str) -> PlacedSurfaces:
    """The surfaces of a scene that was written to `folder`."""
    tracing = open_tracing(folder)
    receiving = _open_direct_scene(folder).surfaces
    return PlacedSurfaces(tracing.texels, tracing.cells, tracing.scene.surfaces, receiving, tracing.unit_box.scale)


@keep_scene_open
def _open_direct_scene(folder: str) -> direct.DirectScene:
    tracing = open_tracing(folder)
    return direct.DirectScene.of(tracing.scene.shadows, tracing.snapshot, tracing.unit_box, tracing.scene.surfaces, tracing.meshes)


@keep_scene_open
def _open_gather_scene(folder: str) -> gather.GatherScene:
    tracing = open_tracing(folder)
    scene, direct_scene = tracing.scene, _open_direct_scene(folder)
    return gather.GatherScene(
        rays=scene.rays,
        coincident=scene.coincident,
        lights=direct_scene,
        passing=scene.passing,
        mirrors=scene if scene.has_caustics else None,
        receiving=direct_scene.surfaces,
        surfaces=scene.surfaces,
        texels=tracing.texels,
        cells=tracing.cells,
        texel_width=_find_texel_widths(tracing.texels, tracing.snapshot.tri_object, tracing.unit_box.scale),
        cell_width=(np.sqrt(tracing.cells.area_m2) * tracing.unit_box.scale).astype(np.float32),
        tri_two_sided=direct_scene.tri_two_sided,
        tri_mapped=scene.tri_lit_below == 0,
    )


def _find_texel_widths(texels: TexelMap, tri_object: IntArray, scale: float) -> Float32:
    """(n,) float32, unit box: sides of whole texels of each entry's object, the largest, for those at borders of charts are cut."""
    owner = tri_object[texels.texel_tri]
    area = np.zeros(int(owner.max(initial=-1)) + 1)
    np.maximum.at(area, owner, texels.texel_area)
    return (np.sqrt(area) * scale).astype(np.float32)[owner]
