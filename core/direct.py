"""Direct irradiance of texels: closed forms times the visible share, found by shadow rays where it is in doubt."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .direct_lights import Source, make_sources, make_triangle_sources
from .direct_points import (
    GAUSS_POINTS,
    MIDDLE,
    STAGES,
    Receivers,
    ReceivingSurfaces,
    SubPoints,
    TexelChunk,
    light_points,
    random_shift,
    row_pieces,
)
from .direct_pool import BLOCK_TEXELS, EmitterPool
from .emitters import find_emitting_cells, weigh_channels
from .geometry import UnitBox
from .lights import Float64
from .materials import SurfaceMaterials
from .rays import RayScene
from .scene import IntArray, SceneSnapshot

_CHUNK_TEXELS = 2**14
_AGREE_TEXELS = 16  # neighbours in Morton order whose first rays must agree before any of them stops
_MOST_TRIANGLE_SOURCES = 12  # emitting triangles that are looked at one by one
_SOURCES_PER_TEXEL = 16.0  # lamps that a texel looks at, on average, when there are more
_LEAST_CHANCE = 0.02
# Powers of the number of rays by which strata lower the variance; measured. A hard edge crosses few cells of a texel; a soft one ties
# places in the texel to places on the light, which are stratified each by themselves.
_SHARP_GAIN, _SOFT_GAIN = 0.9, 0.375
_GENTLE = 0.5  # range of a closed form inside a texel, of its mean, up to which four points give its mean


@dataclass(frozen=True)
class DirectScene:
    """A scene made ready for direct light."""

    rays: RayScene
    surfaces: ReceivingSurfaces
    sources: tuple[Source, ...]
    pool: EmitterPool | None
    tri_two_sided: NDArray[np.bool_]

    @classmethod
    def of(cls, rays: RayScene, snapshot: SceneSnapshot, unit_box: UnitBox, surfaces: SurfaceMaterials) -> DirectScene:
        receiving = ReceivingSurfaces.of(snapshot, unit_box)
        sources = make_sources(snapshot, unit_box)
        groups = [cells for _, cells in find_emitting_cells(snapshot, surfaces)]
        pool = None
        if sum(len(cells.tri) for cells in groups) <= _MOST_TRIANGLE_SOURCES and all(cells.constant for cells in groups):
            for cells in groups:
                sources += make_triangle_sources(cells, receiving.corner_unit, receiving.normal)
        else:
            pool = EmitterPool.of(groups, receiving, unit_box.scale, surfaces)
        two_sided = np.array([scene_object.two_sided for scene_object in snapshot.objects], bool)
        return cls(rays, receiving, tuple(sources), pool, two_sided[snapshot.tri_object])


@dataclass(frozen=True)
class DirectLight:
    """Direct light of texels.

    irradiance_rgb   (n, 3) float64, W/m^2   on the front, and the back too where the object is two-sided
    variance_rgb     (n, 3) float64, (W/m^2)^2, of the estimates
    counters         rays; pairs (texel, light) looked at, out_of_reach behind the horizon or beyond a cone, settled by the first rays
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
    counters = {"rays": 0, "pairs": 0, "out_of_reach": 0, "settled": 0}
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
    starts = chunk.receivers_at(np.arange(count), GAUSS_POINTS)
    tallies = []
    for source, rows, chance in _choose_sources(scene.sources, chunk, rng):
        tally = _Tally(source, rows, chance, random_shift(rng, len(rows)))
        all_rows = len(rows) == count
        counters["rays"] += tally.add(scene.rays, chunk, np.arange(len(rows)), STAGES[0], starts if all_rows else None)
        counters["pairs"] += len(rows)
        counters["out_of_reach"] += int((tally.reach == 0).sum())
        tallies.append(tally)
    light = np.zeros((count, 3))
    for tally in tallies:
        light[tally.rows] += tally.value()[:, None] * tally.source.rgb
    variance = np.zeros((count, 3))
    pooled = np.zeros((count, 3))
    if scene.pool is not None:
        pooled, variance, traced = scene.pool.irradiance(scene.rays, chunk, light, tolerance, max_rays, rng)
        counters["rays"] += traced
    level = weigh_channels(light + pooled)
    for tally in tallies:
        weight = float(weigh_channels(tally.source.rgb))
        for stage in STAGES[1:]:
            if stage[0] >= max_rays:
                break
            unsettled = tally.unsettled(tolerance * level[tally.rows] / weight, stage)
            if stage == STAGES[1]:
                counters["settled"] += int((tally.reach > 0).sum()) - len(unsettled)
            for piece in row_pieces(unsettled, stage[1] - stage[0]):
                counters["rays"] += tally.add(scene.rays, chunk, piece, stage, None)
    for tally in tallies:
        pooled[tally.rows] += tally.value()[:, None] * tally.source.rgb
        variance[tally.rows] += tally.variance()[:, None] * tally.source.rgb**2
    return pooled, variance


def _choose_sources(
    sources: tuple[Source, ...], chunk: TexelChunk, rng: np.random.Generator
) -> list[tuple[Source, NDArray[np.int64], Float64]]:
    """Each source with the texels that look at it, and the chances that they do; all of them when the sources are few."""
    count = len(chunk.texel)
    everyone = np.arange(count)
    if len(sources) <= _SOURCES_PER_TEXEL:
        return [(source, everyone, np.ones(count)) for source in sources]
    scouts = chunk.receivers_at(everyone[_AGREE_TEXELS // 2 :: _AGREE_TEXELS] if count > _AGREE_TEXELS else everyone[:1], MIDDLE)
    promise = np.stack([source.irradiance(scouts.position, scouts.normal) * float(weigh_channels(source.rgb)) for source in sources])
    per_block = BLOCK_TEXELS // _AGREE_TEXELS
    padding = -promise.shape[1] % per_block
    promise = np.pad(promise, ((0, 0), (0, padding)), mode="edge").reshape(len(sources), -1, per_block).sum(axis=2)
    share = promise / np.maximum(promise.sum(axis=0), 1e-300)
    chances = np.clip(share * _SOURCES_PER_TEXEL + min(_LEAST_CHANCE, 4 / len(sources)), 0, 1)
    block = np.minimum(everyone // BLOCK_TEXELS, chances.shape[1] - 1)
    chosen = []
    for source, chance in zip(sources, chances, strict=True):
        rows = np.flatnonzero(rng.random(count) < chance[block])
        chosen.append((source, rows, chance[block[rows]]))
    return chosen


class _Tally:
    """What is known of one light at some texels: a ratio estimate, closed form * sum(weight * seen) / sum(share).

    reach   (n,) float64   sum of the closed form at the rays' starts
    """

    def __init__(self, source: Source, rows: NDArray[np.int64], chance: Float64, shift: NDArray[np.uint32]) -> None:
        self.source, self.rows, self.chance, self._shift = source, rows, chance, shift
        self.reach = np.zeros(len(rows))
        self._reach_squares, self._bend = np.zeros((2, len(rows)))
        self._starts, self._rays = np.zeros(len(rows)), np.zeros(len(rows))
        # Sums of share, share^2, weight * seen, (weight * seen)^2, share * weight * seen.
        self._sums = np.zeros((5, len(rows)))
        self._lit, self._dark = np.zeros(len(rows), bool), np.zeros(len(rows), bool)

    def add(self, rays: RayScene, chunk: TexelChunk, index: IntArray, stage: tuple[int, int], starts: Receivers | None) -> int:
        """Sends a stage's rays from some of the tally's texels; gives how many were traced."""
        first, last = stage
        receivers = chunk.receivers(self.rows[index], first, last) if starts is None else starts
        self._rays[index] += last - first
        if stage != STAGES[2]:  # by then the closed form is known at 16 points
            closed = self.source.irradiance(receivers.position, receivers.normal).reshape(last - first, -1)
            self.reach[index] += closed.sum(axis=0)
            self._reach_squares[index] += (closed * closed).sum(axis=0)
            self._starts[index] += last - first
            if stage == STAGES[0]:
                self._bend = _estimate_bend(closed)
            if stage == STAGES[0] and not closed.all():
                live = np.flatnonzero(closed.ravel() > 0)
                return self._trace(rays, receivers.rows(live), live, index, (first, last))
        return self._trace(rays, receivers, np.arange(len(receivers.position)), index, (first, last))

    def _trace(self, rays: RayScene, receivers: Receivers, live: IntArray, index: IntArray, stage: tuple[int, int]) -> int:
        """live (m,) int: place of each receiver in (rays, len(index))."""
        if not len(live):
            return 0
        aim = self.source.aim(receivers.position, receivers.normal, light_points(self._shift[index], *stage)[live])
        traced = 0
        if self.source.casts_shadow:
            seen, traced = receivers.see(rays, aim)
        else:
            seen = np.ones(len(live), bool)
        shape = (stage[1] - stage[0], len(index))
        share, weight, dark = np.zeros((3, *shape))
        share.flat[live], weight.flat[live] = aim.share, aim.weight * seen
        dark.flat[live] = (aim.weight > 0) & ~seen
        for row, values in enumerate((share, share * share, weight, weight * weight, share * weight)):
            self._sums[row, index] += values.sum(axis=0)
        self._lit[index] |= weight.any(axis=0)
        self._dark[index] |= dark.any(axis=0)
        return traced

    def value(self) -> Float64:
        """(n,) float64: irradiance for rgb = 1, over the chance that the texel looks."""
        out: Float64 = self._closed() * self._ratio() / self.chance
        return out

    def variance(self) -> Float64:
        """(n,) float64: of value."""
        by_choice: Float64 = self.value() ** 2 * (1 - self.chance)
        out: Float64 = by_choice + self._error_squared() / self.chance**2
        return out

    def unsettled(self, allowed: Float64, stage: tuple[int, int]) -> NDArray[np.int64]:
        """Texels that want the rays of a stage: whose standard error, or that of their neighbours, exceeds what is allowed (n,).

        A texel that stopped whenever its own rays agree would be too bright, or too dark, on average.
        """
        error = self._error_squared()
        doubt = error > (allowed * self.chance) ** 2
        if stage == STAGES[1] or not self.source.is_sharp:
            n_block = -(-len(self.rows) // _AGREE_TEXELS)
            block = np.arange(len(self.rows)) // _AGREE_TEXELS
            lit = np.bincount(block, self._lit, minlength=n_block) > 0
            mixed = np.pad(lit & (np.bincount(block, self._dark, minlength=n_block) > 0), 1)
            around = mixed[:-2] | mixed[1:-1] | mixed[2:]
            if stage == STAGES[1]:
                doubt |= around[block] & (0.25 * self._closed() > allowed * self.chance)
            else:
                mean_error = np.bincount(block, error, minlength=n_block) / np.bincount(block, minlength=n_block)
                doubt |= mean_error[block] > (allowed * self.chance) ** 2
        return np.flatnonzero(doubt & (self.reach > 0))

    def _closed(self) -> Float64:
        out: Float64 = self.reach / np.maximum(self._starts, 1)
        return out

    def _ratio(self) -> Float64:
        out: Float64 = np.divide(self._sums[2], self._sums[0], out=np.zeros(len(self.rows)), where=self._sums[0] > 0)
        return out

    def _error_squared(self) -> Float64:
        """Of the ratio estimate. Source: Cochran 1977, "Sampling Techniques", 6.3, for random rays."""
        ratio = self._ratio()
        residual = np.maximum(self._sums[3] - 2 * ratio * self._sums[4] + ratio**2 * self._sums[1], 0)
        square = np.divide(residual, self._sums[0] ** 2, out=np.ones(len(ratio)), where=self._sums[0] > 0)
        starts, closed = np.maximum(self._starts, 1), self._closed()
        spread = np.maximum(self._reach_squares / starts - closed**2, 0) / starts**2
        spread = np.where(starts > len(GAUSS_POINTS), spread, self._bend**2) * ratio**2
        # Of few lit rays, or few dark ones, hardly two are in strata that cover each other's noise.
        rarer = 2 * self._rays * np.minimum(ratio, np.maximum(1 - ratio, 0))
        gain = np.maximum(rarer, 1) ** (_SHARP_GAIN if self.source.is_sharp else _SOFT_GAIN)
        out: Float64 = spread + closed**2 * square / gain
        return out


def _estimate_bend(closed: Float64) -> Float64:
    """(n,) float64: how far the mean of values (4, n) at the Gauss points may be off: nothing where they lie in a gentle plane."""
    twist = np.abs(closed[0] - closed[1] - closed[2] + closed[3]) / 4
    reach = closed.max(axis=0) - closed.min(axis=0)
    out: Float64 = np.where(reach > _GENTLE * closed.mean(axis=0), reach / 4, twist)
    return out
