"""Direct irradiance of texels: from lights that are sampled one by one, and from crowds of lights of which a few are chosen at random."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ..lights.direct_environment import EnvironmentLight
from ..lights.direct_lights import Source, WorldSource, make_lamps, make_suns, make_triangle_sources, make_world
from ..lights.direct_points import GAUSS_POINTS, MOST_TEXELS, STAGES, ReceivingSurfaces, TexelChunk, each_chunk, random_shift, row_pieces
from ..lights.emitter_pool import EmitterPool
from ..lights.emitters import EmittingMeshes, usable_environment
from ..lights.emitting_cells import EmittingCells
from ..lights.environment import Environment, EnvironmentTable
from ..lights.lamp_crowd import LampCrowd, RestOfCrowd
from ..lights.light_links import LightLinks
from ..lights.stratified_choice import Demand, Span
from ..scene.materials import SurfaceMaterials
from ..scene.rays import RayScene
from ..scene.scene import DIFFUSE, SceneSnapshot
from ..scene.shadow_rays import ShadowRays, collapse
from ..texels.texel_footprint import TexelFootprints
from ..texels.tiles import Tiles
from ..util.ablation import uses
from ..util.arrays import Float64, FloatArray, Int64, IntArray
from ..util.brightness import weigh_channels
from ..util.coverage import as_slice
from ..util.geometry import UnitBox
from .direct_tiles import sample_tiles
from .visibility_estimator import Tally

_MOST_TRIANGLE_SOURCES = 12  # up to so many emitting triangles are sampled one by one
_FEW_LAMPS = 16  # up to so many lamps are sampled one by one
_COUNTERS = ("rays", "pairs", "out_of_reach", "settled", "shared", "sampled")  # DirectLight.counters


@dataclass(frozen=True)
class DirectScene:
    """A scene prepared for direct light.

    sky_rays      rays that find what hides the sky
    sources       one light each, a uniform sky among them
    sky           the sky by its directions; None if it is black
    environment   the same if it is not uniform; else None
    linked        those of the sources and pools that have light linking
    """

    rays: ShadowRays
    sky_rays: ShadowRays
    surfaces: ReceivingSurfaces
    sources: tuple[Source, ...]
    crowd: LampCrowd | None
    pools: tuple[EmitterPool, ...]
    tri_two_sided: NDArray[np.bool_]
    sky: EnvironmentTable | None = None
    environment: EnvironmentTable | None = None
    linked: tuple[_LinkedSource, ...] = ()

    @classmethod
    def of(
        cls, rays: ShadowRays, snapshot: SceneSnapshot, unit_box: UnitBox, surfaces: SurfaceMaterials, meshes: EmittingMeshes
    ) -> DirectScene:
        receiving = ReceivingSurfaces.of(snapshot, unit_box, surfaces)
        links = LightLinks.of(snapshot)
        plain = [light for light, row in zip(snapshot.lights, links.of_light, strict=True) if row < 0]
        lamps, suns, world = make_lamps(plain, unit_box, snapshot.profiles), make_suns(plain), make_world(snapshot)
        crowd = LampCrowd.of(lamps) if len(lamps) > _FEW_LAMPS and uses("lamp_crowd") else None
        sources = [*(lamps if crowd is None else []), *suns, *world]
        seen = links.seen_rgb[DIFFUSE].any(axis=0)
        whole = {-1, *np.flatnonzero(seen & links.lit.all(axis=1) & links.blocks.all(axis=1)).tolist()}
        groups = [cells for _, cells in meshes.by_material if cells.link in whole]
        pool, glowing = None, _turn(receiving, meshes)
        textured = any(snapshot.materials[index].emission_image >= 0 for index, _ in meshes.by_material)
        few = sum(len(np.unique(cells.tri)) for cells in groups) <= _MOST_TRIANGLE_SOURCES or not uses("emitter_pool")
        if few and not textured:
            for cells in groups:
                sources += make_triangle_sources(cells, glowing.corner_unit, glowing.normal, meshes.tri_sealed)
        else:
            pool = EmitterPool.of(groups, glowing, unit_box.scale, surfaces, meshes.tri_sealed)
        two_sided = np.array([scene_object.two_sided for scene_object in snapshot.objects], bool)
        # In Cycles diffuse rays find a uniform sky, shadow rays one that varies with direction.
        seen_sky, sky_rays = usable_environment(snapshot), rays
        if world:
            seen_sky, sky_rays = Environment(world[0].rgb[None].astype(np.float32)), rays.between_surfaces
        sky = None if seen_sky is None else EnvironmentTable.of(seen_sky)
        environment = None if world else sky
        apart = [cells for _, cells in meshes.by_material if cells.link not in whole and seen[cells.link]]
        linked = tuple(_link_sources(rays, snapshot, unit_box, surfaces, receiving, links, apart, meshes))
        sources += [one.source for one in linked if not isinstance(one.source, EmitterPool)]
        pools = (*([pool] if pool else []), *(one.source for one in linked if isinstance(one.source, EmitterPool)))
        tri_two_sided = two_sided[snapshot.tri_object] | surfaces.tri_both
        return cls(rays, sky_rays, receiving, tuple(sources), crowd, pools, tri_two_sided, sky, environment, linked)

    def rays_to(self, source: object) -> ShadowRays:
        """The rays that find what hides a source."""
        own = next((one.rays for one in self.linked if one.source is source), self.rays)
        return self.sky_rays if isinstance(source, (WorldSource, EnvironmentLight)) else own

    def find_unlit(self, source: object, tri: IntArray) -> NDArray[np.bool_] | None:
        """(n,) bool: triangles (n,) that light linking excludes from a source; None where it lights all."""
        own = next((one.tri_lit for one in self.linked if one.source is source), None)
        return None if own is None else ~own[tri]


@dataclass(frozen=True)
class _LinkedSource:
    """A lamp or emitting meshes with light linking, the shadow rays that find what hides them, and the triangles (n_tri,) they light."""

    source: Source | EmitterPool
    rays: ShadowRays
    tri_lit: NDArray[np.bool_]


def _link_sources(
    rays: ShadowRays,
    snapshot: SceneSnapshot,
    unit_box: UnitBox,
    surfaces: SurfaceMaterials,
    receiving: ReceivingSurfaces,
    links: LightLinks,
    glows: Sequence[EmittingCells],
    meshes: EmittingMeshes,
) -> Iterator[_LinkedSource]:
    """Sources with light linking that diffuse surfaces see; `glows` are the emitting meshes among them."""
    for row in np.flatnonzero(links.seen_rgb[DIFFUSE].any(axis=0)):
        lights = [light for light, own in zip(snapshot.lights, links.of_light, strict=True) if own == row]
        blocks, own_rays = links.blocks[row], rays
        if not blocks.all():
            left = collapse(receiving.corner_unit, blocks)
            own_rays = ShadowRays.of(RayScene(left), surfaces, left, np.ascontiguousarray(receiving.normal.T))
        for source in (*make_lamps(lights, unit_box, snapshot.profiles), *make_suns(lights)):
            yield _LinkedSource(source, own_rays, links.lit[row])
        cells = [one for one in glows if one.link == row]
        if cells:
            pool = EmitterPool.of(cells, _turn(receiving, meshes), unit_box.scale, surfaces, meshes.tri_sealed)
            yield _LinkedSource(pool, own_rays, links.lit[row])


def _turn(receiving: ReceivingSurfaces, meshes: EmittingMeshes) -> ReceivingSurfaces:
    """With the normals of the sides that glow."""
    return replace(receiving, normal=np.where(meshes.tri_turned[:, None], -receiving.normal, receiving.normal))


@dataclass(frozen=True)
class DirectLight:
    """Direct light of texels.

    irradiance_rgb   (n, 3) float64, W/m^2, float32 as shards send it: light on the front, and on the back of a two-sided object
    variance_rgb     the same shape, (W/m^2)^2: variance of the estimates
    counters         rays: traced; pairs: of texel and light sampled one by one; of these, out_of_reach: behind the horizon or beyond a
                     cone, settled: by the first rays, shared: by the rays of a tile or a leader; sampled: pairs with lamps that give
                     little, of which a few are chosen at random
    by_openings      (n,) bool: texels that sampled the sky through openings; () for none
    """

    irradiance_rgb: FloatArray
    variance_rgb: FloatArray
    counters: dict[str, int]
    by_openings: NDArray[np.bool_] = field(default_factory=lambda: np.zeros((), bool))

    def count(self, counters: dict[str, int], **others: int) -> None:
        """Add the counters of a part."""
        for name, count in (counters | others).items():
            self.counters[name] = self.counters.get(name, 0) + count


def direct_irradiance(
    scene: DirectScene,
    footprints_at: Callable[[IntArray], TexelFootprints],
    texel: IntArray,
    rng: np.random.Generator,
    tolerance: float = 0.01,
    tiles: Tiles | None = None,
    crossed: NDArray[np.bool_] | None = None,
) -> DirectLight:
    """Direct light at texels, averaged over the covered part of each.

    footprints_at   TexelMap.footprints_at, or a function like it
    texel           (n,) int: arguments of footprints_at; neighbours in space should be neighbours here (Morton order)
    tolerance       standard error, relative to the texel's light, at which a light gets no more rays
    tiles           tiles of the texels, which then share their first samples of lights
    crossed         (n,) bool: texels whose footprint reaches past the foot of an object on them, and so differs from their neighbours'
    """
    irradiance, variance, by_openings = np.zeros((len(texel), 3)), np.zeros((len(texel), 3)), np.zeros(len(texel), bool)
    out = DirectLight(irradiance, variance, dict.fromkeys(_COUNTERS, 0), by_openings=by_openings)
    crossed = np.zeros(len(texel), bool) if crossed is None else crossed
    has_many, every = scene.crowd is not None or bool(scene.pools), np.arange(len(texel))
    # Estimates for each pair of texel and light take memory; and the choice among many lights rests on what neighbours see.
    most, apart = (MOST_TEXELS // 2, crossed) if has_many else (MOST_TEXELS, np.zeros_like(crossed))
    for group in (every[~apart], every[apart]):
        for part, chunk in each_chunk(scene.surfaces, footprints_at, texel[group], scene.tri_two_sided, rng, most):
            rows = group[part]
            alone = crossed[rows]
            whole = (tiles or Tiles.none()).within(rows).without(alone)
            smooth = whole.without(chunk.have_bumps(np.arange(len(chunk))))
            demand = Demand(tolerance, smooth.on_one_triangle(chunk.tri), alone)
            sampler = _ChunkSampler(scene, chunk, demand, rng)
            value, error = sampler.find_light()
            share = chunk.find_side_share()
            if share is not None:
                value, error = value * share, error * share**2
            into = as_slice(rows)
            irradiance[into] += value
            variance[into] += error
            if sampler.sky is not None:
                by_openings[rows[sampler.sky.few]] = True
            out.count(sampler.counters)
    return out


class _ChunkSampler:
    """Direct light of one chunk of texels, while it is computed.

    counters   DirectLight.counters
    sky        the light of an environment, once it is sampled; of a uniform one where it is seen through openings
    """

    def __init__(self, scene: DirectScene, chunk: TexelChunk, demand: Demand, rng: np.random.Generator) -> None:
        self._scene, self._chunk, self._demand, self._rng = scene, chunk, demand, rng
        # Light settled by flat tiles; and the variance, first of this light, in the end of all light.
        self._shared, self._variance = np.zeros((2, len(chunk), 3))
        self._tallies: list[Tally] = []
        self.sky: EnvironmentLight | None = None
        self.counters = dict.fromkeys(_COUNTERS, 0)

    def find_light(self) -> tuple[Float64, Float64]:
        """Irradiance (n, 3), W/m^2, and its variance; may be called once."""
        for source in self._scene.sources:
            self._sample_first(source)
        for tally in self._tallies:
            leads = np.flatnonzero(tally.leads)
            bumped = self._chunk.have_bumps(tally.rows[leads])
            self._send(tally, leads[~bumped], STAGES[0], GAUSS_POINTS)
            self._send(tally, leads[bumped], STAGES[0])  # not from a grid of points, which could alias with a regular normal map
        rest = self._tell_lamps_apart()
        light = self._shared.copy()
        for tally in self._tallies:
            self.counters["pairs"] += len(tally.rows)
            self.counters["out_of_reach"] += int((~tally.in_reach).sum())
            light += tally.light(len(self._chunk))
        found = np.zeros_like(light)
        if self._scene.environment is not None:
            self._look_at_sky(np.arange(len(self._chunk)))
        for many in (rest, *self._scene.pools, self.sky):
            if many is not None:
                base = light + found
                rays, unlit = self._scene.rays_to(many), self._scene.find_unlit(many, self._chunk.tri)
                by_many, error, traced = many.irradiance(rays, self._chunk, self._demand, base, self._rng)
                if unlit is not None:
                    by_many[unlit], error[unlit] = 0, 0
                found += by_many
                self._variance += error
                self.counters["rays"] += traced
        self._settle(weigh_channels(light + found))
        for tally in self._tallies:
            found += tally.light(len(self._chunk))
            self._variance += tally.variance(len(self._chunk))
        return found + self._shared, self._variance

    def _sample_first(self, source: Source) -> None:
        """Add a source's light where flat tiles settle it, and prepare a tally, or openings, for texels that sample it themselves."""
        chunk, demand, rng = self._chunk, self._demand, self._rng
        first = sample_tiles(self._scene.rays_to(source), chunk, demand.flat, source, random_shift(rng, len(demand.flat)))
        unlit = self._scene.find_unlit(source, chunk.tri)
        unlit = np.zeros(len(chunk), bool) if unlit is None else unlit
        lit, off = (np.where(first.lit & ~unlit, values, 0.0) for values in (first.closed, first.off))
        for channel, power in enumerate(source.rgb[0]):  # several times faster than (n, 3) at once
            self._shared[:, channel] += lit * power
            self._variance[:, channel] += (off * power) ** 2
        without = first.closed == 0
        agreed, given, every = first.lit | first.dark | unlit, np.zeros(len(chunk), bool), np.arange(len(chunk))
        if isinstance(source, WorldSource):
            sky = self._look_at_sky(np.flatnonzero(~agreed))
            sky.rows = sky.few  # elsewhere the closed form of a uniform sky serves
            given[sky.few] = True
        is_left = ~(agreed | without | given)
        rows, place = np.flatnonzero(is_left), np.cumsum(is_left) - 1
        leads = np.where(given[first.leader], every, first.leader)
        known, shift = np.stack([first.closed[rows], first.off[rows]]), random_shift(rng, len(rows))
        tally = Tally(source, rows, None, shift, known, place[leads[rows]], demand.are_alone(rows))
        self._tallies.append(tally)
        self.counters["rays"] += first.rays
        self.counters["pairs"] += len(chunk) - len(rows)
        self.counters["out_of_reach"] += int(without.sum())
        self.counters["settled"] += int(agreed.sum())
        self.counters["shared"] += int(agreed.sum()) + int((leads != every).sum())

    def _look_at_sky(self, rows: Int64) -> EnvironmentLight:
        """Prepare the light of the sky at texels rows (m,), ascending."""
        assert self._scene.sky is not None
        self.sky = EnvironmentLight(self._scene.sky, self._scene.sky_rays, self._chunk, rows, self._rng)
        self.counters["rays"] += self.sky.rays
        return self.sky

    def _tell_lamps_apart(self) -> RestOfCrowd | None:
        """Sample the lamps of a crowd that give much one by one; returns the rest, of which a few are chosen at random."""
        if self._scene.crowd is None:
            return None
        chunk = self._chunk
        pairs, rest = self._scene.crowd.separate(chunk, chunk.receivers_at(np.arange(len(chunk)), GAUSS_POINTS))
        self.counters["sampled"] += rest.n_pair
        for source, rows, lamp in pairs:
            tally = Tally(source, rows, lamp, random_shift(self._rng, len(rows)), alone=self._demand.are_alone(rows))
            self._send(tally, np.arange(len(rows)), STAGES[0])
            self._tallies.append(tally)
        return rest

    def _settle(self, level: Float64) -> None:
        """Trace more rays where the standard error exceeds the tolerance relative to a level of light (n,), W/m^2."""
        allowed = [self._demand.tolerance * level[tally.rows] / weigh_channels(tally.rgb) for tally in self._tallies]
        for stage in STAGES[1:]:
            unsettled = [tally.unsettled(limit, stage) for tally, limit in zip(self._tallies, allowed, strict=True)]
            for tally, rows in zip(self._tallies, unsettled, strict=True):
                if stage == STAGES[1]:
                    self.counters["settled"] += int(tally.in_reach.sum()) - len(rows)
                self._send(tally, rows, stage)

    def _send(self, tally: Tally, rows: NDArray[np.int64], stage: Span, points: FloatArray | None = None) -> None:
        """Trace a stage's rays of a tally's pairs (m,), ascending; points as in Tally.add."""
        for piece in row_pieces(rows, stage[1] - stage[0]):
            self.counters["rays"] += tally.add(self._scene.rays_to(tally.source), self._chunk, piece, stage, points)
