"""Shards of work as pure functions of (files, settings, round, shard), for any concurrent.futures executor.

A shard names its files; a process opens them once, mapped into memory, so that all processes share one copy. Results are
summed by the caller in the order of the shards: the same seed gives the same bytes on one process, two, or a cluster.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from . import direct, direct_quads, gather, photons, rays, sampling, shared_arrays
from .coverage import as_slice
from .emitters import EmittingMeshes, build_emitters
from .geometry import UnitBox
from .heap import keep_freed_memory
from .job import SNAPSHOT_FILE
from .materials import SurfaceMaterials
from .other_light import OtherLight
from .pruning import prune_scene
from .quads import Quads
from .scene import IntArray, SceneSnapshot
from .snapshot import load_snapshot
from .splitting import Splitting
from .texel_map import LOOK, TexelMap
from .tiles import Tiles
from .tree_view import TreeView

TEXELS_FOLDER = "texels"
SPLITTING_FOLDER = "splitting"  # in a view's
# A shard's fields that name folders, and what of each folder the shard reads, () all of it.
FOLDER_PARTS: dict[str, tuple[str, ...]] = {"tracing": (SNAPSHOT_FILE, TEXELS_FOLDER), "view": ()}
DIRECT_ROUND = 2**31 - 1  # of the random numbers for shadow rays: no round of photons comes that far
GATHER_ROUND = 2**30  # the same, of rays that gather


@dataclass(frozen=True)
class TracedScene:
    """A scene ready for rays."""

    snapshot: SceneSnapshot
    unit_box: UnitBox
    scene: photons.TraceScene
    meshes: EmittingMeshes
    warnings: tuple[tuple[str, str], ...]  # subject, sentence


@dataclass(frozen=True)
class Tracing(TracedScene):
    """What a process needs to trace: the scene, and where hits fall."""

    texels: TexelMap


def load_ahead() -> None:
    """Has all that shards need loaded or made, this module included, before there is one."""
    rays.load_ahead()
    sampling.load_ahead()


@lru_cache(maxsize=1)
def open_scene(folder: str) -> TracedScene:
    """The scene that was written to `folder`; a process keeps the last one open.

    Raises ValueError with a sentence when the scene has no light.
    """
    keep_freed_memory()
    snapshot, _ = prune_scene(load_snapshot(Path(folder) / SNAPSHOT_FILE))
    unit_box = UnitBox.from_points(snapshot.vertex_position)
    surfaces = SurfaceMaterials(snapshot)
    meshes = EmittingMeshes.of(snapshot, surfaces)
    emitters, warnings = build_emitters(snapshot, unit_box, surfaces, meshes)
    scene = photons.build_trace_scene(snapshot, unit_box, surfaces, emitters)
    return TracedScene(snapshot, unit_box, scene, meshes, tuple(warnings))


@lru_cache(maxsize=1)
def open_tracing(folder: str) -> Tracing:
    """The same with the texel map that was written there too."""
    opened = open_scene(folder)
    texels = shared_arrays.load_struct(Path(folder) / TEXELS_FOLDER, TexelMap)
    return Tracing(opened.snapshot, opened.unit_box, opened.scene, opened.meshes, opened.warnings, texels)


def open_ahead(folder: str) -> None:
    """Open the scene in `folder` before there is work; what is wrong with it is told when there is."""
    with contextlib.suppress(ValueError, OSError):
        open_scene(folder)


@lru_cache(maxsize=1)
def open_view(folder: str) -> TreeView:
    """The view that was written to `folder`; a process keeps the last one open."""
    return shared_arrays.load_struct(Path(folder), TreeView)


@lru_cache(maxsize=1)
def open_splitting(folder: str) -> Splitting:
    """What photons of a view are told; the same."""
    return shared_arrays.load_struct(Path(folder) / SPLITTING_FOLDER, Splitting)


@lru_cache(maxsize=1)
def open_known_light(folder: str) -> gather.KnownLight:
    """The light that was written to `folder`; the same."""
    return shared_arrays.load_struct(Path(folder), gather.KnownLight)


@lru_cache(maxsize=1)
def open_other_light(folder: str) -> OtherLight:
    """The same."""
    return shared_arrays.load_struct(Path(folder), OtherLight)


def forget_folders() -> None:
    """Close what this process keeps open, so that folders can be removed or written anew."""
    forget_views()
    for opened in (open_scene, open_tracing, _open_direct_scene, _open_gather_scene):
        opened.cache_clear()


def forget_views() -> None:
    """The same of views alone."""
    for opened in (open_view, open_splitting, open_known_light, open_other_light):
        opened.cache_clear()


@dataclass(frozen=True)
class TexelShard:
    """Rays from some texel entries."""

    tracing: str  # folder
    seed: int
    turn: int  # how many times such rays have been sent before in this bake
    start: int  # position of the shard in its turn
    texels: IntArray | range  # ascending; a range is sooner sent
    tolerance: float  # see direct.direct_irradiance and gather.gather_light
    smoothed: bool  # the same

    @property
    def entries(self) -> IntArray:
        """(m,) int: its texels."""
        return np.arange(self.texels.start, self.texels.stop) if isinstance(self.texels, range) else self.texels

    def tiles(self) -> Tiles:
        """Of its texels."""
        texels, rows = open_tracing(self.tracing).texels, as_slice(self.entries)
        return Tiles.of(texels.texel_chart[rows], texels.texel_code[rows])

    def rng(self, round_: int) -> np.random.Generator:
        """Its own random numbers; `round_` is that of the first turn, from which turns count down."""
        return sampling.shard_rng(self.seed, round_ - self.turn, self.start)


@dataclass(frozen=True)
class DirectShard(TexelShard):
    """Shadow rays; the view's folder holds other_light.OtherLight, "" where nothing is known of it; dark of direct_choice.Demand."""

    view: str = ""
    dark: float = 0.0


def light_texels(shard: DirectShard) -> direct.DirectLight:
    """Direct light at the texels of a shard."""
    texels, scene = open_tracing(shard.tracing).texels, _open_direct_scene(shard.tracing)
    entry, rng, tiles = shard.entries, shard.rng(DIRECT_ROUND), shard.tiles()
    crossed = texels.borders.see_beyond(entry, LOOK)
    beside = open_other_light(shard.view).at(entry) if shard.view else np.zeros(len(entry), np.float32)
    light = partial(direct.direct_irradiance, scene, rng=rng, tolerance=shard.tolerance, smoothed=shard.smoothed, dark=shard.dark)
    # Who is asked again was not sure enough.
    quads = Quads.none() if shard.turn else direct_quads.find_quads(texels, entry, tiles, crossed)
    return direct_quads.light_by_quads(light, texels, entry, shard.tolerance, tiles, crossed, beside, quads)


@dataclass(frozen=True)
class GatherShard(TexelShard):
    """Rays to the surfaces that the texels see; the view's folder holds gather.KnownLight."""

    view: str  # folder


def gather_texels(shard: GatherShard) -> gather.GatheredLight:
    """Light from surfaces at the texels of a shard."""
    scene, known = _open_gather_scene(shard.tracing), open_known_light(shard.view)
    return gather.gather_light(scene, known, shard.entries, shard.rng(GATHER_ROUND), shard.tolerance, shard.tiles(), shard.smoothed)


@lru_cache(maxsize=1)
def _open_direct_scene(folder: str) -> direct.DirectScene:
    tracing = open_tracing(folder)
    return direct.DirectScene.of(tracing.scene.rays, tracing.snapshot, tracing.unit_box, tracing.scene.surfaces, tracing.meshes)


@lru_cache(maxsize=1)
def _open_gather_scene(folder: str) -> gather.GatherScene:
    tracing = open_tracing(folder)
    scene, direct_scene = tracing.scene, _open_direct_scene(folder)
    return gather.GatherScene(
        rays=scene.rays,
        receiving=direct_scene.surfaces,
        surfaces=scene.surfaces,
        texels=tracing.texels,
        tri_object=tracing.snapshot.tri_object,
        tri_two_sided=direct_scene.tri_two_sided,
        tri_told=scene.tri_lit_below == 0,
    )
