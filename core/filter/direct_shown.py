"""Light by rays from texels as it is shown: its grain smoothed, and how far it may then be off."""

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

# Relative noise that is worth smoothing, and that of it which is more than a share of the error asked for. Measured at 0.6 %, gathered
# light of three samples: by the first alone bakes take 1.1 to 2.6 times as long, for errors of 0.95 to 1.04 times.
GRAIN, _GRAIN_SHARE = 0.005, 0.25
# Neighbours are chosen by their noise too, and those alike in it smooth less. Measured over even light, ramps, edges and ripples with
# noise of 2 to 30 %, and where few texels are noisy at all: with this factor and the blur the stated error is 0.7 to 1.4 of the real one.
_CHOSEN_BY_NOISE = 1.8
# ... and a texel keeps more of its own noise than its share in the mean, by so much of it, or of its neighbours' where they have less to
# choose by. Measured as what makes the blur of even light nothing over twenty pages, to 0.0005; a test does so again. Another window,
# patch or strictness of denoise wants another number.
_KEPT_BY_CHOICE = 0.0303
_LEAST_NOISE_SHARE = 0.25  # measured: 0.4 to 0.7 of gathered light's on the samples; less would be texels that err alike
_CHUNK = 1 << 16  # texels at a time: what lies between stays in the cache


def find_grain(error: float) -> float:
    """Relative noise from which on texels are smoothed where a relative error is asked for."""
    return min(GRAIN, _GRAIN_SHARE * error)


@dataclass(frozen=True)
class ShownDirect:
    """Direct light at the texel entries as it was found, and apart from that where its grain was smoothed: little of a large page.

    found       (n, 3) float32, W/m^2
    noise       (n, 3) float32, (W/m^2)^2: its variance
    entry       (m,) int32, ascending: where grain was smoothed
    smooth      (m, 3) float32, W/m^2: the light there
    left        (m, 3) float32, (W/m^2)^2: noise that is left there
    blur2       (m, 3) float32, (W/m^2)^2: what smoothing changed beyond the noise that it took; counts in sum, where that is not negative
    """

    found: NDArray[np.float32]
    noise: NDArray[np.float32]
    entry: NDArray[np.int32]
    smooth: NDArray[np.float32]
    left: NDArray[np.float32]
    blur2: NDArray[np.float32]

    @classmethod
    def plain(cls, irradiance: NDArray[np.float32], variance: NDArray[np.float32]) -> ShownDirect:
        """Light as it was found; arguments as the first fields."""
        return cls(irradiance, variance, np.zeros(0, np.int32), *np.zeros((3, 0, 3), np.float32))

    @classmethod
    def begin_smoothing(
        cls,
        irradiance: NDArray[np.float32],
        variance: NDArray[np.float32],
        texels: TexelMap,
        spread: Spread = starmap,
        by_quads: NDArray[np.bool_] | None = None,
        least: float = GRAIN,
    ) -> Callable[[], ShownDirect]:
        """What gives light without its grain, called once; until then the arrays must not change. Arguments as the first fields.

        by_quads   (n,) bool: texels that were told by one of quads; None is none
        least      relative noise of texels that are smoothed, of find_grain
        """
        level = irradiance.mean() + 1e-30
        grainy = np.empty(len(irradiance), bool)
        for start in range(0, len(grainy), _CHUNK):
            part = slice(start, start + _CHUNK)
            grainy[part] = _add_channels(variance[part]) > (least * (_add_channels(irradiance[part]) + level)) ** 2
        if not grainy.any():
            return partial(cls.plain, irradiance, variance)
        smoothing = begin_denoising(irradiance[None], variance, grainy, texels, spread, True, by_quads)
        return lambda: cls._find_left(irradiance, variance, smoothing.finish())

    @classmethod
    def _find_left(cls, irradiance: NDArray[np.float32], variance: NDArray[np.float32], found: Smoothed) -> ShownDirect:
        told = np.flatnonzero(found.own_share < 1.0)
        told = told[np.argsort(found.entry[told], kind="stable")]
        entry, smooth = found.entry.take(told), found.light[0].take(told, axis=0)
        left, blur2 = np.empty((2, len(told), 3), np.float32)
        for start in range(0, len(told), _CHUNK):
            part = slice(start, start + _CHUNK)
            # Rows of three as one long row, which numpy is several times faster at.
            noise, light = (values.take(entry[part], axis=0).ravel() for values in (variance, irradiance))
            noise_left, own_share = found.variance.take(told[part], axis=0).ravel(), np.repeat(found.own_share.take(told[part]), 3)
            nearby = noise_left / own_share  # of the neighbours it was averaged with
            kept = np.minimum(own_share * noise + _KEPT_BY_CHOICE * np.minimum(noise, nearby), noise)
            # Of the squared change, noise alone explains what the texel had and has now, less what it kept of its own.
            blur2[part].reshape(-1)[:] = (smooth[part].ravel() - light) ** 2 - (noise - 2.0 * kept) - noise_left
            left[part].reshape(-1)[:] = noise_left + (_CHOSEN_BY_NOISE - 1.0) * np.maximum(noise_left - own_share**2 * noise, 0.0)
        return cls(irradiance, variance, entry, smooth, left, blur2)

    def __len__(self) -> int:
        return len(self.found)

    @property
    def irradiance(self) -> NDArray[np.float32]:
        """(n, 3) float32, W/m^2: of all entries."""
        if not len(self.entry):
            return self.found
        out = self.found.copy()
        out[self.entry] = self.smooth
        return out

    @cached_property
    def total_light(self) -> float:
        """Of all entries and channels, W/m^2."""
        change = self.smooth - self.found[self.entry]
        return float(self.found.sum(dtype=np.float64)) + float(change.sum(dtype=np.float64))

    def irradiance_at(self, rows: IntArray) -> NDArray[np.float32]:
        """(k, 3) float32, W/m^2: at some entries (k,)."""
        return self._take(self.found[rows], self.smooth, rows)

    def variance_at(self, rows: IntArray) -> NDArray[np.float32]:
        """(k, 3) float32, (W/m^2)^2: noise that is left there."""
        return self._take(self.noise[rows], self.left, rows)

    def blur2_at(self, rows: IntArray) -> NDArray[np.float32]:
        """(k, 3) float32, (W/m^2)^2: the field blur2 there, and 0 elsewhere."""
        return self._take(np.zeros((len(rows), 3), np.float32), self.blur2, rows)

    def tell_smoothing(self, rows: IntArray) -> SmoothedAt:
        """At some entries (k,)."""
        told = self._take(np.zeros((len(rows), 1), np.float32), np.ones((len(self.entry), 1), np.float32), rows)[:, 0] > 0
        return SmoothedAt(self.irradiance_at(rows) - self.found[rows], self.blur2_at(rows), told)

    def _take(self, plain: NDArray[np.float32], changed: NDArray[np.float32], rows: IntArray) -> NDArray[np.float32]:
        """Values `plain` (k, c) of entries `rows` with those of `changed` (m, c) where grain was smoothed, in place."""
        if len(self.entry):
            place = np.searchsorted(self.entry, rows.astype(np.int32, copy=False))  # else all entries would be converted
            smoothed = np.flatnonzero(self.entry.take(place, mode="clip") == rows)
            plain[smoothed] = changed[place[smoothed]]
        return plain


@dataclass(frozen=True)
class SmoothedAt:
    """What smoothing did at some texels (k,).

    change        (k, 3) float32, W/m^2
    blur2         (k, 3) float32, (W/m^2)^2: of ShownDirect
    is_smoothed   (k,) bool
    """

    change: NDArray[np.float32]
    blur2: NDArray[np.float32]
    is_smoothed: NDArray[np.bool_]

    def take(self, rows: IntArray) -> SmoothedAt:
        """At some of them."""
        return SmoothedAt(self.change[rows], self.blur2[rows], self.is_smoothed[rows])

    def find_noise_share(self, weight: NDArray[np.float32]) -> float:
        """How much of the noise that is stated there was, squared: what smoothing changed tells. 1 at most, for more of it is blur.

        By how few rays of a texel differ more noise is stated than strata leave.

        weight   (k, 3) float32, of squares
        """
        changed2 = float((weight * self.change**2).sum(dtype=np.float64))
        expected2 = changed2 - float((weight * self.blur2).sum(dtype=np.float64))
        return min(max(changed2 / expected2, _LEAST_NOISE_SHARE), 1.0) if expected2 > 0.0 else 1.0


def _add_channels(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """(n,) float32: sums of (n, 3), which numpy's own takes three times as long for."""
    total: NDArray[np.float32] = values[:, 0] + values[:, 1] + values[:, 2]
    return total


@dataclass(frozen=True)
class ShownGathered:
    """Gathered light at the texel entries, as it is shown.

    light      its irradiance and how far it may be off by the choice of rays
    doubt2     (n,) float32, (W/m^2)^2: by the photons whose light was gathered
    told       (n,) bool: where it is all indirect light
    carried2   relative, squared: by what the leaves whose light was gathered do not hold
    """

    light: ShownDirect
    doubt2: NDArray[np.float32]
    told: NDArray[np.bool_]
    carried2: float = 0.0
