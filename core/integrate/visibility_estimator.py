"""Light from single sources: closed form times the visible share, which shadow rays estimate where it is uncertain."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ..lights.direct_lights import Source
from ..lights.direct_points import GAUSS_POINTS, STAGES, Receivers, TexelChunk, light_points
from ..scene.shadow_rays import ShadowRays, Sight
from ..util.ablation import uses
from ..util.arrays import Float64, FloatArray, IntArray
from ..util.coverage import as_slice
from ..util.geometry import take_rows
from .near_field_quadrature import average_peaks, estimate_bend, find_peaks

_Scalar = TypeVar("_Scalar", bound=np.generic)

AGREE_TEXELS = 16  # neighbours in Morton order that share the stopping rule: their first rays must agree before any of them stops
_ALIKE = 0.01  # rays agree if their transmittance differs by less
# The variance of n stratified rays falls as 1 / n^(1 + gain); measured. The hard edge of a shadow crosses few of a texel's strata; a soft
# edge depends on the point in the texel and the point on the light together, which are stratified separately.
_SHARP_GAIN, _SOFT_GAIN = 0.9, 0.375


class Tally:
    """Estimates for pairs of texel and light by a ratio estimator: closed form * sum(weight * seen) / sum(share).

    rows    (n,) int64       texel of each pair, a row of the chunk: in spatial order, for one light after the other
    lamp    (n,) int64       light of each pair, a row of the source; None where the source is a single light
    known   (2, n) float64   closed form, nan where it must be computed, and its standard error; None where all must be computed
    leader  (n,) int64       pair whose rays estimate the visible share of this one, where closed forms are known; None: each its own
    alone   (n,) bool        pairs that do not share the stopping rule of their neighbours; None if there are none
    """

    def __init__(
        self,
        source: Source,
        rows: NDArray[np.int64],
        lamp: NDArray[np.int64] | None,
        shift: NDArray[np.uint32],
        known: Float64 | None = None,
        leader: NDArray[np.int64] | None = None,
        alone: NDArray[np.bool_] | None = None,
    ) -> None:
        self.source, self.rows, self._lamp, self._shift = source, rows, lamp, shift
        # Sums over ray origins of the closed form and of its square; error of the mean of the first four.
        self._reach, self._reach_squares, self._bend = np.zeros((3, len(rows)))
        self._peak, self._peak_mean, self._peak_variance = np.zeros(len(rows), bool), *np.zeros((2, len(rows)))
        self._starts, self._rays = np.zeros(len(rows)), np.zeros(len(rows))
        self._bumped = np.zeros(len(rows), bool)  # has a normal map
        # Caches: closed forms, None after a change; and squared errors, which are out of date for stale pairs.
        self._closed_form: Float64 | None = None
        self._error2, self._stale = np.zeros(len(rows)), np.ones(len(rows), bool)
        self._known = np.zeros(len(rows), bool)
        if known is not None:
            self._known = ~np.isnan(known[0])
            self._starts = self._known.astype(np.float64)
            self._reach, self._bend = np.where(self._known, known, 0.0)
            self._reach_squares = self._reach**2
        # Sums of share, share^2, weight * seen, (weight * seen)^2, share * weight * seen, where seen is the share of light that passes.
        self._sums = np.zeros((5, len(rows)))
        # The same sums by channel, once rays return colours; `_sums` then hold the mean of the channels.
        self._channel_sums: Float64 | None = None
        self._least, self._most = np.zeros((2, 0))  # range of the transmittance of each pair's rays, once rays return colours
        self._lit, self._dark = np.zeros(len(rows), bool), np.zeros(len(rows), bool)
        self._leader: NDArray[np.int64] | None = leader  # None while each pair leads itself, as most do
        if leader is not None and (leader == np.arange(len(rows))).all():
            self._leader = None
        if not uses("block_agreement"):
            self._block = np.arange(len(rows))
        else:
            self._block = _number_blocks(alone) if alone is not None and alone.any() else np.arange(len(rows)) // AGREE_TEXELS

    def add(self, rays: ShadowRays, chunk: TexelChunk, index: IntArray, stage: tuple[int, int], points: FloatArray | None = None) -> int:
        """Trace a stage's rays of the pairs `index` (m,), ascending; returns how many were traced.

        points   (rays, 1 or m, 2) float in [0, 1): origins of rays in a texel; None for the stage's own points
        """
        first, last = stage
        rows = self.rows[index]
        receivers = chunk.receivers(rows, first, last) if points is None else chunk.receivers_at(rows, points)
        lamp = None if self._lamp is None else np.tile(self._lamp[index], last - first)
        self._rays[index] += last - first
        self._stale[index] = True
        live = None
        if receivers.bumped is not None:
            self._bumped[index] = receivers.bumped[: len(index)]
        # After two stages the closed form is known at 16 points, which are enough unless a normal map gives each another normal.
        is_open = self._bumped[index] if stage == STAGES[2] else True
        asked = np.flatnonzero(~self._known[index] & is_open)
        if len(asked):
            own, own_lamp, at = receivers, lamp, index
            if len(asked) < len(index):
                places = (np.arange(last - first)[:, None] * len(index) + asked).ravel()
                own, own_lamp, at = receivers.rows(places), None if lamp is None else lamp[places], index[asked]
            closed = self._lamps(own_lamp).irradiance(own.position, own.normal).reshape(last - first, -1)
            self._closed_form = None
            self._reach[at] += closed.sum(axis=0)
            self._reach_squares[at] += (closed * closed).sum(axis=0)
            self._starts[at] += last - first
            if stage == STAGES[0]:
                self._bend[at] = estimate_bend(closed)
                self._average_peaks(chunk, at, own)
                if not closed.all():
                    reached = np.ones((last - first, len(index)), bool)
                    reached[:, asked] = closed > 0
                    live = np.flatnonzero(reached)
                    receivers, lamp = receivers.rows(live), None if lamp is None else lamp[live]
        return self._trace(rays, receivers, self._lamps(lamp), live, index, (first, last))

    def _average_peaks(self, chunk: TexelChunk, index: IntArray, starts: Receivers) -> None:
        """Average the closed form by a finer quadrature where the first ray origins (4, len(index)) are too few."""
        if not uses("near_field_quadrature"):
            return
        lamp = None if self._lamp is None else self._lamp[index]
        peak = find_peaks(self._lamps(lamp), starts, STAGES[0][1])
        if peak.any():
            at, lamp = index[peak], None if lamp is None else lamp[peak]
            self._peak[at] = True
            self._peak_mean[at], self._peak_variance[at] = average_peaks(self.source, lamp, chunk, self.rows[at])

    def _lamps(self, lamp: NDArray[np.int64] | None) -> Source:
        return self.source if lamp is None else self.source.rows(lamp)

    def _trace(
        self, rays: ShadowRays, receivers: Receivers, lamps: Source, live: IntArray | None, index: IntArray, stage: tuple[int, int]
    ) -> int:
        """Trace rays and add them to the sums; returns how many were traced.

        live   (m,) int: flat index of each receiver in (rays, len(index)); None where all rays have a receiver
        """
        if live is not None and not len(live):
            return 0
        points = light_points(take_rows(self._shift, index), *stage)
        aim = lamps.aim(receivers.position, receivers.normal, points if live is None else take_rows(points, live))
        shines = aim.weight > 0
        sight = receivers.see(rays, aim) if self.source.casts_shadow else Sight(shines, None, 0)
        seen = sight.share > 0
        shape = (stage[1] - stage[0], len(index))

        def spread(values: NDArray[_Scalar]) -> NDArray[_Scalar]:
            if live is None:
                return values.reshape(shape)
            out = np.zeros(shape, values.dtype)
            out.flat[live] = values
            return out

        own = slice(index[0], index[-1] + 1) if index[-1] - index[0] == len(index) - 1 else index
        share = spread(aim.share).astype(np.float64)
        _add_products(self._sums, own, share, spread(aim.weight * sight.share).astype(np.float64))
        if sight.rgb is not None:
            if self._channel_sums is None:
                self._channel_sums = np.zeros((3, 5, len(self.rows)))
                self._least, self._most = np.ones(len(self.rows)), np.zeros(len(self.rows))
            passes = np.where(spread(shines), spread(sight.share), np.nan)  # fmin and fmax leave out nan
            self._least[own] = np.fmin(self._least[own], np.fmin.reduce(passes, axis=0))
            self._most[own] = np.fmax(self._most[own], np.fmax.reduce(passes, axis=0))
            for sums, passed in zip(self._channel_sums, sight.rgb.T, strict=True):
                _add_products(sums, own, share, spread(aim.weight * passed).astype(np.float64))
        self._lit[own] |= spread(seen).any(axis=0)
        self._dark[own] |= spread(shines & ~seen).any(axis=0)
        return sight.rays

    @property
    def rgb(self) -> Float64:
        """(n or 1, 3) float64: rgb of each pair's light."""
        return self.source.rgb if self._lamp is None else self.source.rgb[self._lamp]

    def light(self, count: int) -> Float64:
        """(count, 3) float64: irradiance of the chunk's texels from these lights."""
        if self._channel_sums is None:
            return self._sum_texels(self.value(), self.rgb, count)
        return self._sum_texels(self._closed() * [_divide_seen(self._of_leaders(sums)) for sums in self._channel_sums], self.rgb, count)

    def variance(self, count: int) -> Float64:
        """(count, 3) float64: variance of `light`."""
        if self._channel_sums is None:
            return self._sum_texels(self._error_squared(), self.rgb**2, count)
        every = slice(0, len(self.rows))
        errors = np.stack([self._find_error_squared(every, sums) for sums in self._channel_sums])
        return self._sum_texels(errors, self.rgb**2, count)

    def _sum_texels(self, values: Float64, rgb: Float64, count: int) -> Float64:
        """(count, 3): sums of values (n,), or (3, n) by channel, times rgb (n or 1, 3)."""
        channels = np.broadcast_to(values, (3, len(self.rows)))
        if self._lamp is not None:
            return np.stack([np.bincount(self.rows, own * power, count) for own, power in zip(channels, rgb.T, strict=True)], axis=1)
        single, out = np.zeros(count), np.empty((count, 3))
        for channel, (own, power) in enumerate(zip(channels, rgb.T, strict=True)):  # several times faster than (count, 3) at once
            if channel == 0 or values.ndim == 2:
                single[as_slice(self.rows)] = own  # each texel occurs once
            np.multiply(single, power, out=out[:, channel])
        return out

    def value(self) -> Float64:
        """(n,) float64: irradiance for rgb = 1."""
        out: Float64 = self._closed() * self._ratio()
        return out

    def unsettled(self, allowed: Float64, stage: tuple[int, int]) -> NDArray[np.int64]:
        """Pairs that need the rays of a stage: their standard error, or that of their block, exceeds the allowed one (n,).

        Stopping each texel by its own rays alone would be biased: a texel would stop when its rays agree by chance.
        """
        error = self._error_squared()
        doubt = error > allowed**2
        block, n_block = self._block, int(self._block.max(initial=-1)) + 1
        if self._bumped.any():  # the normals of a map, too, may agree by chance
            shared = np.bincount(block, error, minlength=n_block) / np.maximum(np.bincount(block, minlength=n_block), 1)
            doubt |= self._bumped & (shared[block] > allowed**2)
        if stage == STAGES[1] or not self.source.is_sharp:
            lit = np.bincount(block, self._lit, minlength=n_block) > 0
            if self._channel_sums is None:
                differ = lit & (np.bincount(block, self._dark, minlength=n_block) > 0)
            else:  # rays agree where all have about the same transmittance
                least, most = np.ones(n_block), np.zeros(n_block)
                np.minimum.at(least, block, self._least)
                np.maximum.at(most, block, self._most)
                differ = most - least > _ALIKE
            mixed = np.pad(differ, 1)
            matters = 0.25 * self._closed() > allowed
            around = mixed[:-2] | mixed[1:-1] | mixed[2:]
            if stage == STAGES[1]:
                doubt |= around[block] & matters
                dark = ~lit[block]
            else:
                mean_error = np.bincount(block, error, minlength=n_block) / np.maximum(np.bincount(block, minlength=n_block), 1)
                doubt |= mean_error[block] > allowed**2
                dark = ~self._lit & (self._rays == STAGES[1][1])
            if not self.source.is_sharp and uses("dark_leaders"):
                doubt[self._lead(dark & matters & self.leads & ~doubt, stage)] = True
        return np.flatnonzero(doubt & self.in_reach & self.leads)

    def _lead(self, dark: NDArray[np.bool_], stage: tuple[int, int]) -> NDArray[np.int64]:
        """Choose one of the dark pairs of each block at random, which goes on sampling for all of them; dark (n,).

        Stopping wherever a whole block is dark would lose a little light systematically; a random leader keeps the estimate unbiased.
        """
        rows = np.flatnonzero(dark)
        rows = rows[np.argsort(self._block[rows], kind="stable")]
        _, first, size = np.unique(self._block[rows], return_index=True, return_counts=True)
        # Chosen by the low bits of the shift, which points on lights do not use.
        chance = self._shift[rows[first], STAGES.index(stage) - 1] & np.uint32(255)
        leader: NDArray[np.int64] = rows[first + (chance * size >> 8)]
        if len(leader) < len(rows):
            heir = np.arange(len(dark))
            heir[rows] = np.repeat(leader, size)
            self._stale[rows] = True
            self._leader = heir if self._leader is None else heir[self._leader]
        return leader

    def _of_leaders(self, values: Float64) -> Float64:
        """(..., n): for each pair, the value of its leader."""
        return values if self._leader is None else values.take(self._leader, axis=-1)

    @property
    def leads(self) -> NDArray[np.bool_]:
        """(n,) bool: pairs that estimate the visible share by their own rays."""
        return np.ones(len(self.rows), bool) if self._leader is None else self._leader == np.arange(len(self.rows))

    @property
    def in_reach(self) -> NDArray[np.bool_]:
        """(n,) bool: whether the unoccluded irradiance is above 0."""
        out: NDArray[np.bool_] = self._closed() > 0
        return out

    def _closed(self) -> Float64:
        if self._closed_form is None:
            self._closed_form = np.where(self._peak, self._peak_mean, self._reach / np.maximum(self._starts, 1))
        return self._closed_form

    def _ratio(self) -> Float64:
        return _divide_seen(self._of_leaders(self._sums[:3]))

    def _error_squared(self) -> Float64:
        """(n,): squared standard error of the ratio estimate."""
        stale = np.flatnonzero(self._stale | self._of_leaders(self._stale))
        if len(stale):
            self._error2[stale] = self._find_error_squared(as_slice(stale), self._sums)
            self._stale[:] = False
        return self._error2

    def _find_error_squared(self, rows: slice | NDArray[np.int64], sums: Float64) -> Float64:
        """Squared standard error of the pairs `rows`, from sums (5, n) of all pairs.

        Source: Cochran 1977, "Sampling Techniques", 6.3, for random rays.
        """
        source = rows if self._leader is None else self._leader[rows]
        sums = sums[:, source]
        ratio = _divide_seen(sums)
        residual = np.maximum(sums[3] - 2 * ratio * sums[4] + ratio**2 * sums[1], 0)
        square = np.divide(residual, sums[0] ** 2, out=np.ones(len(ratio)), where=sums[0] > 0)
        starts, closed, peak = np.maximum(self._starts[rows], 1), self._closed()[rows], self._peak[rows]
        # Stratification helps where light is smooth over a texel, but not against the normals of a map.
        gained = np.where(self._bumped[rows], np.maximum(starts - 1, 1), starts**2)
        spread = np.maximum(self._reach_squares[rows] / starts - closed**2, 0) / gained
        spread = np.where(self._bumped[rows] | (starts > len(GAUSS_POINTS)), spread, self._bend[rows] ** 2)
        spread = np.where(peak, self._peak_variance[rows], spread) * ratio**2
        # With few lit or few dark rays, hardly any two share a stratum, and stratification gains little.
        rarer = 2 * self._rays[source] * np.minimum(ratio, np.maximum(1 - ratio, 0))
        gain = np.maximum(rarer, 1) ** (_SHARP_GAIN if self.source.is_sharp else _SOFT_GAIN)
        out: Float64 = spread + closed**2 * square / gain
        return out


def _add_products(sums: Float64, own: slice | IntArray, share: Float64, weight: Float64) -> None:
    """Add rays (k, m) to the sums (5, n) of the pairs `own` (m,)."""
    for row, (one, other) in enumerate(((share, None), (share, share), (weight, None), (weight, weight), (share, weight))):
        sums[row, own] += one.sum(axis=0) if other is None else np.einsum("ij,ij->j", one, other)


def _divide_seen(sums: Float64) -> Float64:
    """(n,) float64: visible share of the light, from the sums of Tally (3 or more, n)."""
    out: Float64 = np.divide(sums[2], sums[0], out=np.zeros(sums.shape[1]), where=sums[0] > 0)
    return out


def _number_blocks(alone: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(n,) int64: number of each pair's block of neighbours. A pair of `alone` is a block by itself; no number is next to its own."""
    block, others, single = np.empty(len(alone), np.int64), np.flatnonzero(~alone), np.flatnonzero(alone)
    block[others] = np.arange(len(others)) // AGREE_TEXELS
    block[single] = len(others) // AGREE_TEXELS + 2 + 2 * np.arange(len(single))
    return block
