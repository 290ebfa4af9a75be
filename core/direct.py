"""Direct irradiance of texels, by lights that are looked at one by one, and by crowds of them that are sampled."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .brightness import weigh_channels
from .coverage import as_slice
from .direct_choice import Demand
from .direct_crowd import LampCrowd
from .direct_lights import Source, WorldSource
from .direct_openings import Openings
from .direct_points import (
    GAUSS_POINTS,
    MOST_TEXELS,
    STAGES,
    ReceivingSurfaces,
    TexelChunk,
    each_chunk,
    random_shift,
    row_pieces,
)
from .direct_pool import EmitterPool
from .direct_sources import make_lamps, make_suns, make_triangle_sources, make_world
from .direct_tally import Tally
from .direct_tiles import look_from_tiles
from .emitters import EmittingMeshes
from .geometry import UnitBox
from .lights import Float64
from .materials import SurfaceMaterials
from .rays import RayScene
from .scene import FloatArray, IntArray, SceneSnapshot
from .texel_looks import TexelLooks
from .tiles import Tiles

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
    def of(
        cls, rays: RayScene, snapshot: SceneSnapshot, unit_box: UnitBox, surfaces: SurfaceMaterials, meshes: EmittingMeshes
    ) -> DirectScene:
        receiving = ReceivingSurfaces.of(snapshot, unit_box)
        lamps, suns, world = make_lamps(snapshot, unit_box), make_suns(snapshot), make_world(snapshot)
        crowd = LampCrowd.of(lamps) if len(lamps) > _FEW_LAMPS else None
        sources = [*(lamps if crowd is None else []), *suns, *world]
        groups = [cells for _, cells in meshes.by_material]
        pool, sealed = None, meshes.tri_sealed
        textured = any(snapshot.materials[index].emission_image >= 0 for index, _ in meshes.by_material)
        if sum(len(np.unique(cells.tri)) for cells in groups) <= _MOST_TRIANGLE_SOURCES and not textured:
            for cells in groups:
                sources += make_triangle_sources(cells, receiving.corner_unit, receiving.normal, sealed)
        else:
            pool = EmitterPool.of(groups, receiving, unit_box.scale, surfaces, sealed)
        two_sided = np.array([scene_object.two_sided for scene_object in snapshot.objects], bool)
        return cls(rays, receiving, tuple(sources), crowd, pool, two_sided[snapshot.tri_object])


@dataclass(frozen=True)
class DirectLight:
    """Direct light of texels.

    irradiance_rgb   (n, 3) float64, as shards send it float32, W/m^2   on the front, and the back too where the object is two-sided
    variance_rgb     the same, (W/m^2)^2, of the estimates
    counters         rays; pairs (texel, light) looked at, out_of_reach behind the horizon or beyond a cone, settled by the first rays,
                     shared with all of a tile;
                     sampled, pairs of lamps that gave little and were sampled together
    by_quads         (n,) bool, texels that were told by one of quads; () where none is
    by_openings      (n,) bool, texels whose sky was looked for through openings; () where none is
    """

    irradiance_rgb: FloatArray
    variance_rgb: FloatArray
    counters: dict[str, int]
    by_quads: NDArray[np.bool_] = field(default_factory=lambda: np.zeros((), bool))
    by_openings: NDArray[np.bool_] = field(default_factory=lambda: np.zeros((), bool))

    def count(self, counters: dict[str, int], **others: int) -> None:
        """Adds up what was counted in parts."""
        for name, count in (counters | others).items():
            self.counters[name] = self.counters.get(name, 0) + count


def direct_irradiance(
    scene: DirectScene,
    look_at: Callable[[IntArray], TexelLooks],
    texel: IntArray,
    rng: np.random.Generator,
    tolerance: float = 0.01,
    max_rays: int = STAGES[-1][1],
    tiles: Tiles | None = None,
    smoothed: bool = False,
    crossed: NDArray[np.bool_] | None = None,
    beside: NDArray[np.float32] | None = None,
) -> DirectLight:
    """Direct light at texels, averaged over the covered part of each.

    look_at      TexelMap.look_at, or its like
    texel        (n,) int     as look_at knows them; neighbours in space should be neighbours here (Morton order)
    tolerance    standard error, relative to the texel's light, at which a light gets no more rays
    max_rays     per texel and light: 4, 16 or 64
    tiles        among the texels, which then share their first looks at lights
    smoothed     the light will be averaged over like neighbours: where it changes gently over a tile, more noise is left for that
    crossed      (n,) bool: texels that see past the foot of what stands on them, which tells nothing of their neighbours
    beside       (n,) float32, W/m^2: other light of the texels, of OtherLight; None is none
    """
    irradiance, variance, by_openings = np.zeros((len(texel), 3)), np.zeros((len(texel), 3)), np.zeros(len(texel), bool)
    counters = {"rays": 0, "pairs": 0, "out_of_reach": 0, "settled": 0, "shared": 0, "sampled": 0}
    beside = np.zeros(len(texel), np.float32) if beside is None else beside
    crossed = np.zeros(len(texel), bool) if crossed is None else crossed
    has_many, every = scene.crowd is not None or scene.pool is not None, np.arange(len(texel))
    # What is known of each texel and each of many lights takes memory; and who chooses among them does so by what neighbours see.
    most, apart = (MOST_TEXELS // 2, crossed) if has_many else (MOST_TEXELS, np.zeros_like(crossed))
    for group in (every[~apart], every[apart]):
        for part, chunk in each_chunk(scene.surfaces, look_at, texel[group], scene.tri_two_sided, rng, most):
            rows = group[part]
            alone = crossed[rows]
            whole = (tiles or Tiles.none()).within(rows).without(alone)
            calm = whole if smoothed else Tiles.none()
            demand = Demand(tolerance, max_rays, whole.on_one_triangle(chunk.tri), calm.texels(), alone)
            value, error, openings = _light_chunk(scene, chunk, demand, beside[rows], rng, counters)
            into = as_slice(rows)
            irradiance[into] += value
            variance[into] += error
            for few in openings:
                by_openings[rows[few.rows]] = True
    return DirectLight(irradiance, variance, counters, by_openings=by_openings)


def _light_chunk(
    scene: DirectScene,
    chunk: TexelChunk,
    demand: Demand,
    beside: NDArray[np.float32],
    rng: np.random.Generator,
    counters: dict[str, int],
) -> tuple[Float64, Float64, list[Openings]]:
    """Irradiance (n, 3) of a chunk's texels, its variance, and who saw the sky through openings; beside them is other light, (n,) W/m^2."""
    count = len(chunk)
    shared, variance, tallies, openings = _look_first(scene, chunk, demand, beside, rng, counters)
    for tally in tallies:
        for piece in row_pieces(np.flatnonzero(tally.leads), STAGES[0][1]):
            counters["rays"] += tally.add(scene.rays, chunk, piece, STAGES[0], GAUSS_POINTS)
    rest = None
    if scene.crowd is not None:
        pairs, rest = scene.crowd.tell_apart(chunk, chunk.receivers_at(np.arange(count), GAUSS_POINTS))
        counters["sampled"] += rest.n_pair
        for source, rows, lamp in pairs:
            tally = Tally(source, rows, lamp, random_shift(rng, len(rows)), alone=demand.are_alone(rows))
            for piece in row_pieces(np.arange(len(rows)), STAGES[0][1]):
                counters["rays"] += tally.add(scene.rays, chunk, piece, STAGES[0])
            tallies.append(tally)
    light = shared.copy()
    for tally in tallies:
        counters["pairs"] += len(tally.rows)
        counters["out_of_reach"] += int((~tally.in_reach).sum())
        light += tally.light(count)
    found = np.zeros((count, 3))
    for many in (rest, scene.pool, *openings):
        if many is not None:
            by_many, error, traced = many.irradiance(scene.rays, chunk, demand, light + found + beside[:, None], rng)
            found += by_many
            variance += error
            counters["rays"] += traced
    level = weigh_channels(light + found) + beside
    allowed = [demand.tolerance * level[tally.rows] / weigh_channels(tally.rgb) for tally in tallies]
    for stage in demand.spans(STAGES[1:]):
        unsettled = [tally.unsettled(limit, stage) for tally, limit in zip(tallies, allowed, strict=True)]
        if stage == STAGES[1]:
            counters["settled"] += sum(int(tally.in_reach.sum()) - len(rows) for tally, rows in zip(tallies, unsettled, strict=True))
        for tally, rows in zip(tallies, unsettled, strict=True):
            for piece in row_pieces(rows, stage[1] - stage[0]):
                counters["rays"] += tally.add(scene.rays, chunk, piece, stage)
    for tally in tallies:
        found += tally.light(count)
        variance += tally.variance(count)
    return found + shared, variance, openings


def _look_first(
    scene: DirectScene,
    chunk: TexelChunk,
    demand: Demand,
    beside: NDArray[np.float32],
    rng: np.random.Generator,
    counters: dict[str, int],
) -> tuple[Float64, Float64, list[Tally], list[Openings]]:
    """Light (n, 3) that flat tiles are sure of, its variance, for each source an empty tally of texels that look at it themselves, and
    openings by which others see it."""
    flat, smoothed = demand.flat, demand.smoothed
    (shared, variance), tallies, openings = np.zeros((2, len(chunk), 3)), [], []
    for source in scene.sources:
        look = look_from_tiles(scene.rays, chunk, flat, source, random_shift(rng, len(flat)))
        lit, off = (np.where(look.lit, values, 0.0) for values in (look.closed, look.off))
        for channel, power in enumerate(source.rgb[0]):  # several times faster than rows of three
            shared[:, channel] += lit * power
            variance[:, channel] += (off * power) ** 2
        without = look.closed == 0
        agreed, given, every = look.lit | look.dark, np.zeros(len(chunk), bool), np.arange(len(chunk))
        if isinstance(source, WorldSource):
            level = weigh_channels(shared) + beside
            few = Openings.find(scene.rays, chunk, source, np.flatnonzero(~agreed), look.looks, level, demand.tolerance, rng)
            openings.append(few)
            counters["rays"] += few.rays
            given[few.rows] = True
        rows = np.flatnonzero(~(agreed | without | given))
        leads = np.where(given[look.leader], every, look.leader)
        own = every == leads
        looks_on = ~(agreed | without | given) & own
        alone = smoothed[looks_on[smoothed].all(axis=1)]
        leader, index = np.searchsorted(rows, leads[rows]), np.searchsorted(rows, alone)
        known, shift = np.stack([look.closed[rows], look.off[rows]]), random_shift(rng, len(rows))
        tallies.append(Tally(source, rows, None, shift, known, index, leader, demand.are_alone(rows)))
        counters["rays"] += look.rays
        counters["pairs"] += len(chunk) - len(rows)
        counters["out_of_reach"] += int(without.sum())
        counters["settled"] += int(agreed.sum())
        counters["shared"] += int(agreed.sum()) + int((~own).sum())
    return shared, variance, tallies, openings
