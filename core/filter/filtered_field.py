"""Light by rays from texels after the filter, with its residual variance and blur."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import starmap

import numpy as np
from numpy.typing import NDArray

from ..texels.texel_map import TexelMap
from ..util.arrays import IntArray
from .denoise import Smoothed, Spread, begin_denoising

# Relative noise above which light is filtered: the smaller of GRAIN and a share of the requested error. Measured with gathered light of
# three samples at 0.6 %: with GRAIN alone bakes take 1.1 to 2.6 times as long, and their errors are 0.95 to 1.04 times as large.
GRAIN, _GRAIN_SHARE = 0.005, 0.25
# Factor on the neighbours' share of the residual variance. Weights depend on the noisy values and favour neighbours with similar noise, so
# the average reduces noise less. Measured on even light, ramps, edges and ripples with noise of 2 to 30 %, and with few noisy texels: with
# this factor and the blur the stated error is 0.7 to 1.4 of the real one.
_CHOSEN_BY_NOISE = 1.8
# For the same reason the filtered value correlates with the texel's own noise more than its weight says: additionally by this share of the
# texel's variance or of its neighbours', whichever is less. Calibrated to zero blur of even light over twenty pages, to 0.0005; a test
# repeats it. It depends on window, patch and strictness of nonlocal_means.
_KEPT_BY_CHOICE = 0.0303
_CHUNK = 1 << 16  # texels at a time, for the cache


def find_grain(error: float) -> float:
    """Least relative noise of texels that are filtered, for a requested relative error."""
    return min(GRAIN, _GRAIN_SHARE * error)


@dataclass(frozen=True)
class FilteredField:
    """Light at the texel entries. Filtered values are stored apart, since few texels of a large page are filtered.

    found       (n, 3) float32, W/m^2: light before the filter
    noise       (n, 3) float32, (W/m^2)^2: its variance
    entry       (m,) int32, ascending: filtered texels
    smooth      (m, 3) float32, W/m^2: filtered light there
    left        (m, 3) float32, (W/m^2)^2: its residual variance
    blur2       (m, 3) float32, (W/m^2)^2: squared change by the filter minus the change expected from noise. Only its mean is meaningful
    """

    found: NDArray[np.float32]
    noise: NDArray[np.float32]
    entry: NDArray[np.int32]
    smooth: NDArray[np.float32]
    left: NDArray[np.float32]
    blur2: NDArray[np.float32]

    @classmethod
    def plain(cls, irradiance: NDArray[np.float32], variance: NDArray[np.float32]) -> FilteredField:
        """Light without filter; arguments are as the first fields."""
        return cls(irradiance, variance, np.zeros(0, np.int32), *np.zeros((3, 0, 3), np.float32))

    @classmethod
    def begin_smoothing(
        cls,
        irradiance: NDArray[np.float32],
        variance: NDArray[np.float32],
        texels: TexelMap,
        spread: Spread = starmap,
        least: float = GRAIN,
    ) -> Callable[[], FilteredField]:
        """Start the filter. Calling the result, once, finishes it; until then the arrays must not change.

        irradiance, variance   as `found` and `noise`
        least                  relative noise above which texels are filtered, from find_grain
        """
        level = irradiance.mean() + 1e-30
        grainy = np.empty(len(irradiance), bool)
        for start in range(0, len(grainy), _CHUNK):
            part = slice(start, start + _CHUNK)
            grainy[part] = _add_channels(variance[part]) > (least * (_add_channels(irradiance[part]) + level)) ** 2
        if not grainy.any():
            return partial(cls.plain, irradiance, variance)
        smoothing = begin_denoising(irradiance[None], variance, grainy, texels, spread, True)
        return lambda: cls._find_left(irradiance, variance, smoothing.finish())

    @classmethod
    def _find_left(cls, irradiance: NDArray[np.float32], variance: NDArray[np.float32], found: Smoothed) -> FilteredField:
        changed = np.flatnonzero(found.own_share < 1.0)
        changed = changed[np.argsort(found.entry[changed], kind="stable")]
        entry, smooth = found.entry.take(changed), found.light[0].take(changed, axis=0)
        left, blur2 = np.empty((2, len(changed), 3), np.float32)
        for start in range(0, len(changed), _CHUNK):
            part = slice(start, start + _CHUNK)
            # numpy is several times faster on one long row than on rows of three.
            noise, light = (values.take(entry[part], axis=0).ravel() for values in (variance, irradiance))
            noise_left, own_share = found.variance.take(changed[part], axis=0).ravel(), np.repeat(found.own_share.take(changed[part]), 3)
            nearby = noise_left / own_share  # variance of the neighbours that were averaged
            kept = np.minimum(own_share * noise + _KEPT_BY_CHOICE * np.minimum(noise, nearby), noise)
            # For pure noise, E[change^2] = noise - 2 kept + noise_left.
            blur2[part].reshape(-1)[:] = (smooth[part].ravel() - light) ** 2 - (noise - 2.0 * kept) - noise_left
            left[part].reshape(-1)[:] = noise_left + (_CHOSEN_BY_NOISE - 1.0) * np.maximum(noise_left - own_share**2 * noise, 0.0)
        return cls(irradiance, variance, entry, smooth, left, blur2)

    def __len__(self) -> int:
        return len(self.found)

    @property
    def irradiance(self) -> NDArray[np.float32]:
        """(n, 3) float32, W/m^2: the shown light of all entries."""
        if not len(self.entry):
            return self.found
        out = self.found.copy()
        out[self.entry] = self.smooth
        return out

    @cached_property
    def total_light(self) -> float:
        """Sum over all entries and channels, W/m^2."""
        change = self.smooth - self.found[self.entry]
        return float(self.found.sum(dtype=np.float64)) + float(change.sum(dtype=np.float64))

    def irradiance_at(self, rows: IntArray) -> NDArray[np.float32]:
        """(k, 3) float32, W/m^2: the shown light at entries (k,)."""
        return self._take(self.found[rows], self.smooth, rows)

    def variance_at(self, rows: IntArray) -> NDArray[np.float32]:
        """(k, 3) float32, (W/m^2)^2: variance of the shown light at entries (k,)."""
        return self._take(self.noise[rows], self.left, rows)

    def blur2_at(self, rows: IntArray) -> NDArray[np.float32]:
        """(k, 3) float32, (W/m^2)^2: blur2 at filtered entries, 0 elsewhere."""
        return self._take(np.zeros((len(rows), 3), np.float32), self.blur2, rows)

    def _take(self, plain: NDArray[np.float32], changed: NDArray[np.float32], rows: IntArray) -> NDArray[np.float32]:
        """Values `plain` (k, c) at entries `rows`, replaced in place by those of `changed` (m, c) where light was filtered."""
        if len(self.entry):
            place = np.searchsorted(self.entry, rows.astype(np.int32, copy=False))  # with another type numpy would convert self.entry
            smoothed = np.flatnonzero(self.entry.take(place, mode="clip") == rows)
            plain[smoothed] = changed[place[smoothed]]
        return plain


def _add_channels(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """(n,) float32: sums over the last axis of (n, 3), three times as fast as numpy's sum."""
    total: NDArray[np.float32] = values[:, 0] + values[:, 1] + values[:, 2]
    return total
