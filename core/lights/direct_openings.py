"""The sky through openings: where little of it is seen, rays go to where those of neighbours saw it.

In a room with a small window few of a texel's plain rays, cosine-distributed, find the sky, and each of them brings many times the
light that is there. So the hemisphere is cut into cells of equal irradiance, and neighbouring texels learn together which are open.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..scene.shadow_rays import ShadowRays, Sight
from ..texels.texel_grid import interleave_bits, part_bits
from ..util.arrays import Float32, Float64, IntArray
from ..util.brightness import weigh_channels
from ..util.geometry import take_rows
from .direct_choice import BLOCK_TEXELS, Demand, Int64, Span, choose_by_strata, cumulate, gather_until_sure, in_order
from .direct_lights import WorldSource
from .direct_points import STAGES, TexelChunk, light_points, random_shift, row_pieces

_SIDE = 16  # cells of a hemisphere along each coordinate of what is mapped to it
_CELLS = _SIDE**2
_REGIONS_BLOCKS = (16, 4, 1)  # blocks of texels that tell together which cells are open: far around, near, and a block by itself
_AROUND_RAYS = 4.0  # what those farther around tell counts, in rays to a cell
_MOST_SEEN = 1 / 16  # share of the sky; where more is seen plain rays do as well beside other light
_ANYWHERE = 0.3  # share of the rays that go to all cells alike: no ray brings more than one to an open sky divided by that
# Of that of a block's texels, and of what is foreseen: else who saw nothing by chance would be sure of it, and the only one who is not
# shot again. Measured: all of a block's takes twice the rays, none leaves a fourth of the light of dim walls out.
_LEAST_VARIANCE, _LEAST_FORESEEN = 1 / 8, 1 / 64
# How many times too much all plain rays of a texel may err, which smoothing takes. With 10 walls far from a window had blots.
_SMOOTHED = 4.0
_LOOKS = 4  # rays of a texel that tell where to look, and no more
# Each learns where to look by those before. Longer first ones, or more looks in place of them, leave up to two fifths more squared noise
# for the same time; more rays than these bring no more than another pass would.
_STAGES = (0, 8), (8, 16), (16, 48)
_NOISIER = 2.5  # than that of lamps: it is alike in neighbours and without specks, so that smoothing takes it

Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Looks:
    """Rays that have been sent to a light.

    texel   (n,) int64        of a chunk
    to      (n, 2) float32    in [0, 1), as Source.aim takes them
    seen    (n,) bool, or float32 in [0, 1]: they met nothing, or what share of the light passes what they met
    """

    texel: Int64
    to: Float32
    seen: Bools | Float32


class Openings:
    """Texels of a chunk to which little of the sky comes.

    rows       (n,) int64, ascending   each BLOCK_TEXELS of them are a block
    known      of the blocks
    rays       that were sent to find that
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
        looks: Looks,
        beside: Float64,
        demand: Demand,
        rng: np.random.Generator,
    ) -> Openings:
        """Those among the texels `rows` (n,), ascending, that err too much by plain rays; a ray goes from each of which there are no looks.

        beside   (n_texel,) W/m^2: other light

        Whether a texel is one, and where its rays go, is told by rays that count for nothing else, which biases no light.
        """
        place = np.full(len(chunk), -1)
        place[rows] = np.arange(len(rows))
        known = _Known.none(len(rows))
        told = place[looks.texel] >= 0
        known.add(place[looks.texel[told]], _cell_at(looks.to[told]), looks.seen[told])
        place[looks.texel[told]] = -1
        sky = math.pi * float(weigh_channels(source.rgb)[0])
        level = _means(beside[rows], BLOCK_TEXELS * _REGIONS_BLOCKS[0])
        limit = demand.tolerance * np.maximum(level, demand.dark) / sky
        n_ray, asked = 0, place[rows] >= 0
        asked &= np.repeat(known.may_see_little(limit), BLOCK_TEXELS)[: len(rows)]
        for piece in row_pieces(rows[asked], 1):
            to = rng.random((len(piece), 2), np.float32)
            seen, _ = _look(rays, chunk, source, piece, to, (0, 1))
            known.add(place[piece], _cell_at(to), seen.share)
            n_ray += seen.rays
        known = known.tell_share()
        few = known.see_little(limit)
        rows, known = rows[np.repeat(few, BLOCK_TEXELS)[: len(rows)]], known.of(few)
        for _ in range(_LOOKS):
            end = known.share_out()[0]
            for piece in row_pieces(np.arange(len(rows)), 1):
                cell, to, _, _ = _choose(end, piece // BLOCK_TEXELS, random_shift(rng, len(piece)), rng, (0, 1))
                seen, _ = _look(rays, chunk, source, rows[piece], to, (0, 1))
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
            if span[0] != learned:  # rays that come later may go to where earlier ones saw the sky: all are right on average
                end, learned = known.share_out()[0], span[0]
            cell, to, chance, step = _choose(end, place[rows] // BLOCK_TEXELS, take_rows(shift, rows), rng, span)
            seen, share = _look(rays, chunk, self._source, rows, to, span)
            known.add(np.tile(place[rows], span[1] - span[0]), cell, seen.share)
            return in_order(step, seen.times((share / (chance * _CELLS))[:, None] * self._source.rgb)), seen.rays

        sky = math.pi * float(weigh_channels(self._source.rgb)[0])
        foreseen = np.zeros((2, len(chunk)))
        foreseen[:, self.rows] = sky * mean[own], sky**2 * (square - mean**2)[own]
        base_rgb = base_rgb + np.maximum(demand.dark - weigh_channels(base_rgb) - foreseen[0], 0.0)[:, None]
        allowed = demand.tolerance * (weigh_channels(base_rgb) + foreseen[0])[self.rows]
        sure = sky**2 * square[own] <= STAGES[0][1] * allowed**2
        for rows, stages in ((self.rows[sure], STAGES), (self.rows[~sure], _STAGES)):
            by_some, error, traced = gather_until_sure(gather, rows, demand, base_rgb, stages, foreseen=(foreseen[0], foreseen[1]))
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
    """What blocks of texels know of their cells.

    shot, lit   (n_block, n_cell) float64   rays that were sent to each, and those that met nothing
    share       of the rays of all texels around that met nothing before any was aimed
    """

    shot: Float64
    lit: Float64
    share: float = 0.0

    @classmethod
    def none(cls, n_texel: int) -> _Known:
        return cls(*np.zeros((2, -(-n_texel // BLOCK_TEXELS), _CELLS)))

    def add(self, place: Int64, cell: Int64, seen: Bools | Float32) -> None:
        """Rays of texels (n,), numbered through all blocks."""
        at = place // BLOCK_TEXELS * _CELLS + cell
        for counts, weight in ((self.shot, None), (self.lit, seen)):
            counts += np.bincount(at, weight, counts.size).reshape(counts.shape)

    def of(self, blocks: NDArray[np.bool_]) -> _Known:
        """What some of the blocks know."""
        return _Known(self.shot[blocks], self.lit[blocks], self.share)

    def copy(self) -> _Known:
        """The same, to learn more."""
        return _Known(self.shot.copy(), self.lit.copy(), self.share)

    def tell_share(self) -> _Known:
        """The same, with its share."""
        return _Known(self.shot, self.lit, float(self.lit.sum() / max(self.shot.sum(), 1.0)))

    def see_little(self, allowed: Float64) -> NDArray[np.bool_]:
        """(n_block,) bool: of the region around few rays saw the sky, all of them before any was aimed; or none, but some elsewhere.

        allowed   (n_region,) float64: standard error, of an open sky
        """
        shot, lit, size = self._of_regions()
        noisy = (lit + self.share) > _SMOOTHED**2 * STAGES[-1][1] * allowed**2 * (shot + 1)
        return np.repeat((lit + self.share > 0) & (lit < _MOST_SEEN * shot) & noisy, size)

    def may_see_little(self, allowed: Float64) -> NDArray[np.bool_]:
        """(n_block,) bool: what is known so far does not tell that they will not see_little."""
        shot, lit, size = self._of_regions()
        open_ = (shot >= BLOCK_TEXELS) & (lit >= _MOST_SEEN * shot)
        return np.repeat(~open_ & (_SMOOTHED**2 * STAGES[-1][1] * allowed**2 < _MOST_SEEN), size)

    def _of_regions(self) -> tuple[Float64, Float64, Int64]:
        """Rays of each region that were sent, and that met nothing; and its blocks."""
        first, size = _cut(len(self.shot), _REGIONS_BLOCKS[0])
        shot, lit = (np.add.reduceat(counts.sum(axis=1), first) for counts in (self.shot, self.lit))
        return shot, lit, size

    def share_out(self) -> tuple[Float64, Float64, Float64]:
        """Where rays should go, (n_block, n_cell), of direct_choice.cumulate; then (n_block,) what such a ray brings of an open sky,
        and the square of that."""
        if not len(self.shot):
            return self.shot, np.zeros(0), np.zeros(0)
        rate = np.zeros_like(self.shot)
        for n_block in _REGIONS_BLOCKS:
            first, size = _cut(len(self.shot), n_block)
            shot, lit = (np.add.reduceat(counts, first, axis=0) for counts in (self.shot, self.lit))
            if n_block == _REGIONS_BLOCKS[0]:
                rate = (_blur(lit) + self.share) / (_blur(shot) + 1)  # an opening moves over the cells as one moves
            else:
                rate = (lit + _AROUND_RAYS * rate[first]) / (shot + _AROUND_RAYS)
            rate = np.repeat(rate, size, axis=0)
        chance = np.sqrt(rate)  # which makes the variance least
        chance *= (1 - _ANYWHERE) / np.maximum(chance.sum(axis=1, keepdims=True), 1e-300)
        chance += _ANYWHERE / _CELLS
        end = np.empty_like(chance)
        cumulate(chance, 0, end)
        return end, rate.mean(axis=1), (rate / chance).sum(axis=1) / _CELLS**2


def _cut(count: int, size: int) -> tuple[Int64, Int64]:
    """Firsts and sizes of pieces of so many of them."""
    first = np.arange(0, count, size)
    return first, np.diff(np.append(first, count))


def _means(values: Float64, size: int) -> Float64:
    """Of pieces of so many values."""
    first, sizes = _cut(len(values), size)
    out: Float64 = np.add.reduceat(values, first) / sizes
    return out


def _look(rays: ShadowRays, chunk: TexelChunk, source: WorldSource, rows: IntArray, to: Float32, span: Span) -> tuple[Sight, Float32]:
    """What a span of rays from each row sees, and what each brings."""
    receivers = chunk.receivers(rows, *span)
    aim = source.aim(receivers.position, receivers.normal, to)
    return receivers.see(rays, aim), aim.weight


def _choose(
    end: Float64, block: Int64, shift: NDArray[np.uint32], rng: np.random.Generator, span: Span
) -> tuple[Int64, Float32, Float64, Int64]:
    """Cells of a span of rays from each of some texels of blocks (n,), places in them (.., 2), their chances, and the rays' strata."""
    first, last = span
    step, cell, chance, _ = choose_by_strata(end, block, shift[:, 0], last - first, rng)
    to = (np.stack(part_bits(cell), axis=1) + light_points(shift, first, last)) / _SIDE
    return cell, to.astype(np.float32), chance, step


def _cell_at(to: Float32) -> Int64:
    """(n,) int64: cells, in Morton order, of places (n, 2) in [0, 1)."""
    x, y = np.minimum(to * _SIDE, _SIDE - 1).astype(np.int64).T
    out: Int64 = interleave_bits(x, y)
    return out


def _blur(values: Float64) -> Float64:
    """Cells (n, n_cell) with a part of those beside them."""
    x, y = part_bits(np.arange(_CELLS))
    grid = np.pad(np.empty((len(values), _SIDE, _SIDE)), ((0, 0), (1, 1), (1, 1)))
    grid[:, y + 1, x + 1] = values
    grid[:, :, 1:-1] = (grid[:, :, :-2] + 2 * grid[:, :, 1:-1] + grid[:, :, 2:]) / 4
    grid[:, 1:-1] = (grid[:, :-2] + 2 * grid[:, 1:-1] + grid[:, 2:]) / 4
    out: Float64 = grid[:, y + 1, x + 1]
    return out
