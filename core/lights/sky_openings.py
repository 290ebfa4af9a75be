"""Guided sampling of the sky through openings: a pdf over cells of the hemisphere, learned from the rays of neighbouring texels.

In a room with a small window few cosine-distributed rays of a texel find the sky, so that their estimate has a high variance. The
hemisphere is divided into cells of equal irradiance, and blocks of texels share the measured visibility of each cell.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..scene.shadow_rays import ShadowRays, Sight
from ..texels.texel_grid import interleave_bits, part_bits
from ..util.arrays import BoolArray, Float32, Float64, Int64, IntArray
from ..util.brightness import weigh_channels
from ..util.geometry import take_rows
from .direct_lights import WorldSource
from .direct_points import STAGES, TexelChunk, light_points, random_shift, row_pieces
from .stratified_choice import BLOCK_TEXELS, Demand, Span, choose, cumulate, draw_strata, in_order, sample_adaptively, sum_regions

_SIDE = 16  # cells per side of the unit square that is mapped to the hemisphere
_CELLS = _SIDE**2
_REGIONS_BLOCKS = (16, 4, 1)  # blocks that share visibility: a large region, a small one, a single block; each is the next one's prior
_AROUND_RAYS = 4.0  # weight of the larger region's rate as a prior, in rays to a cell
_MOST_SEEN = 1 / 16  # visible share of the sky above which plain rays do as well, relative to the other light
_ANYWHERE = 0.3  # share of uniform sampling in the pdf: bounds a ray's weight to 1 / _ANYWHERE of that to an open sky
# Lower bounds of a texel's variance, as shares of its block's mean and of the predicted variance: a texel whose rays all missed has a
# sample variance of 0 and would get no more rays. Measured: 1 of the block's takes twice the rays; 0 loses a fourth of dim walls' light.
_LEAST_VARIANCE, _LEAST_FORESEEN = 1 / 8, 1 / 64
# Plain rays may exceed the tolerance by this factor, as the filter removes their noise. With 10, walls far from a window had blotches.
_SMOOTHED = 4.0
_LOOKS = 4  # pilot rays per texel: they shape the pdf and are no part of the estimate
# Each stage updates the pdf from the earlier ones. Longer first stages, or more pilot rays instead, give up to 40 % more variance in the
# same time; more rays gain no more than another pass does.
_STAGES = (0, 8), (8, 16), (16, 48)
_NOISIER = 2.5  # tolerance relative to that of lamps: neighbours have similar noise without outliers, which the filter removes


@dataclass(frozen=True)
class TracedRays:
    """Rays already traced to a light.

    texel   (n,) int64        row of a chunk
    to      (n, 2) float32    in [0, 1), as Source.aim takes them
    seen    (n,) bool, or float32 in [0, 1]: visibility, or transmittance of what they met
    """

    texel: Int64
    to: Float32
    seen: BoolArray | Float32


class Openings:
    """Texels of a chunk that see little of the sky.

    rows       (n,) int64, ascending   each BLOCK_TEXELS of them are a block
    known      visibility statistics of the blocks
    rays       number of pilot rays
    """

    def __init__(self, source: WorldSource, rows: Int64, known: _Known, rays: int) -> None:
        self._source, self.rows, self._known, self.rays = source, rows, known, rays

    @classmethod
    def find(
        cls,
        rays: ShadowRays,
        chunk: TexelChunk,
        source: WorldSource,
        rows: Int64,
        pilots: TracedRays,
        beside: Float64,
        demand: Demand,
        rng: np.random.Generator,
    ) -> Openings:
        """Those of the texels `rows` (n,), ascending, for which plain rays are too noisy; texels without pilots trace a pilot ray.

        beside   (n_texel,) W/m^2: other light

        Only pilot rays, which are no part of the estimate, decide this and shape the pdf, so the estimate stays unbiased.
        """
        place = np.full(len(chunk), -1)
        place[rows] = np.arange(len(rows))
        known = _Known.none(len(rows))
        held = place[pilots.texel] >= 0
        known.add(place[pilots.texel[held]], _cell_at(pilots.to[held]), pilots.seen[held])
        place[pilots.texel[held]] = -1
        sky = math.pi * float(weigh_channels(source.rgb)[0])
        region = BLOCK_TEXELS * _REGIONS_BLOCKS[0]
        level = (sum_regions(beside[rows], region) / sum_regions(np.ones(len(rows)), region))[::BLOCK_TEXELS]
        limit = demand.tolerance * np.maximum(level, demand.dark) / sky
        n_ray, asked = 0, place[rows] >= 0
        asked &= np.repeat(known.may_see_little(limit), BLOCK_TEXELS)[: len(rows)]
        for piece in row_pieces(rows[asked], 1):
            to = rng.random((len(piece), 2), np.float32)
            seen, _ = _trace(rays, chunk, source, piece, to, (0, 1))
            known.add(place[piece], _cell_at(to), seen.share)
            n_ray += seen.rays
        known = known.find_share()
        few = known.see_little(limit)
        rows, known = rows[np.repeat(few, BLOCK_TEXELS)[: len(rows)]], known.of(few)
        for _ in range(_LOOKS):
            end = known.share_out()[0]
            for piece in row_pieces(np.arange(len(rows)), 1):
                cell, to, _, _ = _choose(end, piece // BLOCK_TEXELS, random_shift(rng, len(piece)), rng, (0, 1))
                seen, _ = _trace(rays, chunk, source, rows[piece], to, (0, 1))
                known.add(piece, cell, seen.share)
                n_ray += seen.rays
        return cls(source, rows, known, n_ray)

    def irradiance(
        self, rays: ShadowRays, chunk: TexelChunk, demand: Demand, base_rgb: Float64, rng: np.random.Generator
    ) -> tuple[Float64, Float64, int]:
        """As EmitterPool.irradiance."""
        total, variance, n_ray = np.zeros_like(base_rgb), np.zeros_like(base_rgb), 0
        if not len(self.rows):
            return total, variance, n_ray
        demand = replace(demand, tolerance=_NOISIER * demand.tolerance)
        shift = random_shift(rng, len(chunk))
        place = np.zeros(len(chunk), np.int64)
        place[self.rows] = np.arange(len(self.rows))
        own, known, learned = place[self.rows] // BLOCK_TEXELS, self._known.copy(), 0
        end, mean, square = known.share_out()

        def gather(rows: IntArray, span: Span) -> tuple[Float64, int]:
            nonlocal end, learned
            if span[0] != learned:  # unbiased: the pdf of a stage depends on earlier rays only
                end, learned = known.share_out()[0], span[0]
            cell, to, chance, step = _choose(end, place[rows] // BLOCK_TEXELS, take_rows(shift, rows), rng, span)
            seen, share = _trace(rays, chunk, self._source, rows, to, span)
            known.add(np.tile(place[rows], span[1] - span[0]), cell, seen.share)
            return in_order(step, seen.times((share / (chance * _CELLS))[:, None] * self._source.rgb)), seen.rays

        sky = math.pi * float(weigh_channels(self._source.rgb)[0])
        foreseen = np.zeros((2, len(chunk)))
        foreseen[:, self.rows] = sky * mean[own], sky**2 * (square - mean**2)[own]
        base_rgb = base_rgb + np.maximum(demand.dark - weigh_channels(base_rgb) - foreseen[0], 0.0)[:, None]
        allowed = demand.tolerance * (weigh_channels(base_rgb) + foreseen[0])[self.rows]
        sure = sky**2 * square[own] <= STAGES[0][1] * allowed**2
        for rows, stages in ((self.rows[sure], STAGES), (self.rows[~sure], _STAGES)):
            by_some, error, traced = sample_adaptively(gather, rows, demand, base_rgb, stages, foreseen=(foreseen[0], foreseen[1]))
            total += by_some
            variance += error
            n_ray += traced
        for channel, radiance in zip(variance.T, self._source.rgb[0], strict=True):
            of_block = _LEAST_VARIANCE * np.bincount(own, channel[self.rows]) / np.bincount(own)
            of_ray = _LEAST_FORESEEN * (math.pi * radiance) ** 2 * (square - mean**2)
            channel[self.rows] = np.maximum(channel[self.rows], np.maximum(of_block, of_ray / STAGES[-1][1])[own])
        return total, variance, n_ray


@dataclass(frozen=True)
class _Known:
    """Visibility statistics of blocks of texels.

    shot, lit   (n_block, n_cell) float64   rays to each cell, and the sum of their visibilities
    share       visible share of all texels' rays before any was guided
    """

    shot: Float64
    lit: Float64
    share: float = 0.0

    @classmethod
    def none(cls, n_texel: int) -> _Known:
        return cls(*np.zeros((2, -(-n_texel // BLOCK_TEXELS), _CELLS)))

    def add(self, place: Int64, cell: Int64, seen: BoolArray | Float32) -> None:
        """Add rays of texels (n,), numbered through all blocks."""
        at = place // BLOCK_TEXELS * _CELLS + cell
        for counts, weight in ((self.shot, None), (self.lit, seen)):
            counts += np.bincount(at, weight, counts.size).reshape(counts.shape)

    def of(self, blocks: BoolArray) -> _Known:
        """Statistics of some of the blocks."""
        return _Known(self.shot[blocks], self.lit[blocks], self.share)

    def copy(self) -> _Known:
        """A copy whose counts may change."""
        return _Known(self.shot.copy(), self.lit.copy(), self.share)

    def find_share(self) -> _Known:
        """The same with `share` computed."""
        return _Known(self.shot, self.lit, float(self.lit.sum() / max(self.shot.sum(), 1.0)))

    def see_little(self, allowed: Float64) -> BoolArray:
        """(n_block,) bool: little of the sky is visible from the block's region, and plain rays would be too noisy there.

        allowed   (n_block,) float64: standard error, relative to an open sky
        """
        shot, lit = self._of_regions()
        noisy = (lit + self.share) > _SMOOTHED**2 * STAGES[-1][1] * allowed**2 * (shot + 1)
        return (lit + self.share > 0) & (lit < _MOST_SEEN * shot) & noisy

    def may_see_little(self, allowed: Float64) -> BoolArray:
        """(n_block,) bool: the rays so far do not rule out that see_little will hold."""
        shot, lit = self._of_regions()
        open_ = (shot >= BLOCK_TEXELS) & (lit >= _MOST_SEEN * shot)
        return ~open_ & (_SMOOTHED**2 * STAGES[-1][1] * allowed**2 < _MOST_SEEN)

    def _of_regions(self) -> tuple[Float64, Float64]:
        """(n_block,) each: shot and lit of each block's region."""
        shot, lit = (sum_regions(counts.sum(axis=1), _REGIONS_BLOCKS[0]) for counts in (self.shot, self.lit))
        return shot, lit

    def share_out(self) -> tuple[Float64, Float64, Float64]:
        """The pdf p ~ sqrt(visibility) over cells, cumulated (n_block, n_cell) by stratified_choice.cumulate; (n_block,) predicted mean
        and mean square of a ray, relative to an open sky."""
        if not len(self.shot):
            return self.shot, np.zeros(0), np.zeros(0)
        rate = np.zeros_like(self.shot)
        for n_block in _REGIONS_BLOCKS:
            shot, lit = (sum_regions(counts, n_block) for counts in (self.shot, self.lit))
            if n_block == _REGIONS_BLOCKS[0]:
                rate = (_blur(lit) + self.share) / (_blur(shot) + 1)  # blurred, since an opening's direction changes over a region
            else:
                rate = (lit + _AROUND_RAYS * rate) / (shot + _AROUND_RAYS)
        chance = np.sqrt(rate)  # minimizes the variance
        chance *= (1 - _ANYWHERE) / np.maximum(chance.sum(axis=1, keepdims=True), 1e-300)
        chance += _ANYWHERE / _CELLS
        end = np.empty_like(chance)
        cumulate(chance, 0, end)
        return end, rate.mean(axis=1), (rate / chance).sum(axis=1) / _CELLS**2


def _trace(rays: ShadowRays, chunk: TexelChunk, source: WorldSource, rows: IntArray, to: Float32, span: Span) -> tuple[Sight, Float32]:
    """Visibility and weight of a span of rays from each row."""
    receivers = chunk.receivers(rows, *span)
    aim = source.aim(receivers.position, receivers.normal, to)
    return receivers.see(rays, aim), aim.weight


def _choose(
    end: Float64, block: Int64, shift: NDArray[np.uint32], rng: np.random.Generator, span: Span
) -> tuple[Int64, Float32, Float64, Int64]:
    """Cells of a span of rays from texels of blocks (n,), points (.., 2) in the unit square, the cells' probabilities, the rays' strata."""
    first, last = span
    step, pick = draw_strata(shift[:, 0], last - first, rng)
    cell, chance, _ = choose(end, np.broadcast_to(block, pick.shape), pick)
    to = (np.stack(part_bits(cell), axis=1) + light_points(shift, first, last)) / _SIDE
    return cell, to.astype(np.float32), chance, step


def _cell_at(to: Float32) -> Int64:
    """(n,) int64: cells, in Morton order, of places (n, 2) in [0, 1)."""
    x, y = np.minimum(to * _SIDE, _SIDE - 1).astype(np.int64).T
    return interleave_bits(x, y)


def _blur(values: Float64) -> Float64:
    """Values (n, n_cell) filtered by the kernel (1, 2, 1) / 4 along both axes."""
    x, y = part_bits(np.arange(_CELLS))
    grid = np.pad(np.empty((len(values), _SIDE, _SIDE)), ((0, 0), (1, 1), (1, 1)))
    grid[:, y + 1, x + 1] = values
    grid[:, :, 1:-1] = (grid[:, :, :-2] + 2 * grid[:, :, 1:-1] + grid[:, :, 2:]) / 4
    grid[:, 1:-1] = (grid[:, :-2] + 2 * grid[:, 1:-1] + grid[:, 2:]) / 4
    return grid[:, y + 1, x + 1]
