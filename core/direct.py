"""Direct irradiance of texels, by lights that are looked at one by one, and by crowds of them that are sampled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .direct_crowd import LampCrowd
from .direct_lights import Source
from .direct_points import (
    GAUSS_POINTS,
    STAGES,
    ReceivingSurfaces,
    SubPoints,
    TexelChunk,
    random_shift,
    row_pieces,
)
from .direct_pool import EmitterPool
from .direct_sources import make_lamps, make_suns, make_triangle_sources, make_world
from .direct_tally import Tally
from .emitters import find_emitting_cells, weigh_channels
from .geometry import UnitBox
from .lights import Float64
from .materials import SurfaceMaterials
from .rays import RayScene
from .scene import IntArray, SceneSnapshot

_CHUNK_TEXELS = 2**14
_MOST_TRIANGLE_SOURCES = 12  # emitting triangles that are looked at one by one
_FEW_LAMPS = 16  # lamps that every texel looks at one by one


@dataclass(frozen=True)
class DirectScene:
    """A scene made ready for direct light."""

    rays: RayScene
    surfaces: ReceivingSurfaces
    sources: tuple[Source, ...]  # of one light each
    crowd: LampCrowd | None
    pool: EmitterPool | None
    tri_two_sided: NDArray[np.bool_]

    @classmethod
    def of(cls, rays: RayScene, snapshot: SceneSnapshot, unit_box: UnitBox, surfaces: SurfaceMaterials) -> DirectScene:
        receiving = ReceivingSurfaces.of(snapshot, unit_box)
        lamps, suns, world = make_lamps(snapshot, unit_box), make_suns(snapshot), make_world(snapshot)
        crowd = LampCrowd.of(lamps) if len(lamps) > _FEW_LAMPS else None
        sources = [*(lamps if crowd is None else []), *suns, *world]
        groups = [cells for _, cells in find_emitting_cells(snapshot, surfaces)]
        pool = None
        if sum(len(cells.tri) for cells in groups) <= _MOST_TRIANGLE_SOURCES and all(cells.constant for cells in groups):
            for cells in groups:
                sources += make_triangle_sources(cells, receiving.corner_unit, receiving.normal)
        else:
            pool = EmitterPool.of(groups, receiving, unit_box.scale, surfaces)
        two_sided = np.array([scene_object.two_sided for scene_object in snapshot.objects], bool)
        return cls(rays, receiving, tuple(sources), crowd, pool, two_sided[snapshot.tri_object])


@dataclass(frozen=True)
class DirectLight:
    """Direct light of texels.

    irradiance_rgb   (n, 3) float64, W/m^2   on the front, and the back too where the object is two-sided
    variance_rgb     (n, 3) float64, (W/m^2)^2, of the estimates
    counters         rays; pairs (texel, light) looked at, out_of_reach behind the horizon or beyond a cone, settled by the first rays;
                     sampled, pairs of lamps that gave little and were sampled together
    """

    irradiance_rgb: Float64
    variance_rgb: Float64
    counters: dict[str, int]


def direct_irradiance(
    scene: DirectScene,
    sub_points: SubPoints,
    texel: IntArray,
    rng: np.random.Generator,
    tolerance: float = 0.01,
    max_rays: int = STAGES[-1][1],
) -> DirectLight:
    """Direct light at texels, averaged over the covered part of each.

    sub_points   TexelMap.sub_points, or its like
    texel        (n,) int     as sub_points knows them; neighbours in space should be neighbours here (Morton order)
    tolerance    standard error, relative to the texel's direct light, at which a light gets no more rays
    max_rays     per texel and light: 4, 16 or 64
    """
    irradiance, variance = np.zeros((len(texel), 3)), np.zeros((len(texel), 3))
    counters = {"rays": 0, "pairs": 0, "out_of_reach": 0, "settled": 0, "sampled": 0}
    for start in range(0, len(texel), _CHUNK_TEXELS):
        rows = slice(start, start + _CHUNK_TEXELS)
        tri = sub_points(texel[rows], np.full((1, 1, 2), 0.5))[0][0]
        two_sided = np.flatnonzero(scene.tri_two_sided[tri])
        for flip in (False, True) if len(two_sided) else (False,):
            part = start + (two_sided if flip else np.arange(len(tri)))
            chunk = TexelChunk(texel[part], random_shift(rng, len(part)), sub_points, scene.surfaces, flip)
            value, error = _light_chunk(scene, chunk, rng, tolerance, max_rays, counters)
            irradiance[part] += value
            variance[part] += error
    return DirectLight(irradiance, variance, counters)


def _light_chunk(
    scene: DirectScene, chunk: TexelChunk, rng: np.random.Generator, tolerance: float, max_rays: int, counters: dict[str, int]
) -> tuple[Float64, Float64]:
    count = len(chunk.texel)
    everyone = np.arange(count)
    starts = chunk.receivers_at(everyone, GAUSS_POINTS)
    tallies = [Tally(source, everyone, None, random_shift(rng, count)) for source in scene.sources]
    for tally in tallies:
        counters["rays"] += tally.add(scene.rays, chunk, everyone, STAGES[0], starts)
    rest = None
    if scene.crowd is not None:
        pairs, rest = scene.crowd.tell_apart(chunk, starts)
        counters["sampled"] += rest.n_pair
        for source, rows, lamp in pairs:
            tally = Tally(source, rows, lamp, random_shift(rng, len(rows)))
            for piece in row_pieces(np.arange(len(rows)), STAGES[0][1]):
                counters["rays"] += tally.add(scene.rays, chunk, piece, STAGES[0], None)
            tallies.append(tally)
    light, variance = np.zeros((count, 3)), np.zeros((count, 3))
    for tally in tallies:
        counters["pairs"] += len(tally.rows)
        counters["out_of_reach"] += int((~tally.in_reach).sum())
        light += tally.light(count)
    found = np.zeros((count, 3))
    for many in (rest, scene.pool):
        if many is not None:
            by_many, error, traced = many.irradiance(scene.rays, chunk, light + found, tolerance, max_rays, rng)
            found += by_many
            variance += error
            counters["rays"] += traced
    level = weigh_channels(light + found)
    allowed = [tolerance * level[tally.rows] / weigh_channels(tally.rgb) for tally in tallies]
    for stage in STAGES[1:]:
        if stage[0] >= max_rays:
            break
        unsettled = [tally.unsettled(limit, stage) for tally, limit in zip(tallies, allowed, strict=True)]
        if stage == STAGES[1]:
            counters["settled"] += sum(int(tally.in_reach.sum()) - len(rows) for tally, rows in zip(tallies, unsettled, strict=True))
        n_source = len(scene.sources)
        counters["rays"] += _add_to_all(scene.rays, chunk, tallies[:n_source], unsettled[:n_source], stage)
        for tally, rows in zip(tallies[n_source:], unsettled[n_source:], strict=True):
            for piece in row_pieces(rows, stage[1] - stage[0]):
                counters["rays"] += tally.add(scene.rays, chunk, piece, stage, None)
    for tally in tallies:
        found += tally.light(count)
        variance += tally.variance(count)
    return found, variance


def _add_to_all(rays: RayScene, chunk: TexelChunk, tallies: Sequence[Tally], texels: Sequence[IntArray], stage: tuple[int, int]) -> int:
    """Sends a stage's rays of tallies of all texels, each from its own choice of them; gives how many were traced.

    The rays of a texel start at the same places for every light, so that these are found once.
    """
    wanted = np.zeros((len(tallies), len(chunk.texel)), bool)
    for row, own in zip(wanted, texels, strict=True):
        row[own] = True
    n_ray, traced = stage[1] - stage[0], 0
    for piece in row_pieces(np.flatnonzero(wanted.any(axis=0)), n_ray):
        starts = chunk.receivers(piece, *stage)
        for tally, row in zip(tallies, wanted, strict=True):
            own = row[piece]
            if own.any():
                looking = starts if own.all() else starts.rows(np.flatnonzero(np.tile(own, n_ray)))
                traced += tally.add(rays, chunk, piece[own], stage, looking)
    return traced
