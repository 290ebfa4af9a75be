"""Light by rays from texels as it is shown: its grain smoothed, and how far it may then be off."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import starmap

import numpy as np
from numpy.typing import NDArray

from .denoise import Spread, denoise
from .texel_map import TexelMap

_GRAIN = 0.005  # relative noise that is worth smoothing
# Neighbours are chosen by their noise too, and those alike in it smooth less. Measured over even light, ramps, edges and ripples with
# noise of 2 to 30 %: with this factor and the blur the stated error is 0.7 to 1.4 of the real one.
_CHOSEN_BY_NOISE = 1.8
# ... and a texel keeps more of its own noise than its share in the mean, by so much of it. Measured as what makes the blur of even light
# nothing over twenty pages, to 0.0005; a test does so again. Another window, patch or strictness of denoise wants another number.
_KEPT_BY_CHOICE = 0.026
_CHUNK = 1 << 16  # texels at a time: what lies between stays in the cache


@dataclass(frozen=True)
class ShownDirect:
    """Direct light at the texel entries.

    irradiance   (n, 3) float32, W/m^2
    variance     (n, 3) float32, (W/m^2)^2: noise that is left
    blur2        (n, 3) float32, (W/m^2)^2: what smoothing changed beyond the noise that it took; counts in sum, where that is not negative
    """

    irradiance: NDArray[np.float32]
    variance: NDArray[np.float32]
    blur2: NDArray[np.float32]

    @classmethod
    def plain(cls, irradiance: NDArray[np.float32], variance: NDArray[np.float32]) -> ShownDirect:
        """Light as it was found; arguments as the fields."""
        return cls(irradiance, variance, np.zeros(irradiance.shape, np.float32))

    @classmethod
    def smoothed(
        cls,
        irradiance: NDArray[np.float32],
        variance: NDArray[np.float32],
        texels: TexelMap,
        entry_at: NDArray[np.int32],
        spread: Spread = starmap,
    ) -> ShownDirect:
        """Light without its grain.

        entry_at   (n_page, size, size) int32: the entry that a page shows at each texel, -1 for none
        """
        level = irradiance.mean() + 1e-30
        grainy = np.empty(len(irradiance), bool)
        for start in range(0, len(grainy), _CHUNK):
            part = slice(start, start + _CHUNK)
            grainy[part] = _add_channels(variance[part]) > (_GRAIN * (_add_channels(irradiance[part]) + level)) ** 2
        if not grainy.any():
            return cls.plain(irradiance, variance)
        with ThreadPoolExecutor(1) as pool:  # beside what is prepared for smoothing
            copies = pool.submit(lambda: (irradiance.copy(), variance.copy()))
            found = denoise(irradiance[None], variance, grainy, texels, entry_at, spread, tell=True)
            shown = cls(*copies.result(), np.zeros(irradiance.shape, np.float32))
        every = np.flatnonzero(found.own_share < 1.0)
        for start in range(0, len(every), _CHUNK):
            told = every[start : start + _CHUNK]
            rows, smooth = found.entry[told], found.light[0, told]
            noise, noise_left, own_share = variance[rows], found.variance[told], found.own_share[told, None]
            shown.irradiance[rows] = smooth
            kept = np.minimum(own_share + _KEPT_BY_CHOICE, 1.0)
            # Of the squared change, noise alone explains what the texel had and has now, less what it kept of its own.
            shown.blur2[rows] = (smooth - irradiance[rows]) ** 2 - noise * (1.0 - 2.0 * kept) - noise_left
            shown.variance[rows] = noise_left + (_CHOSEN_BY_NOISE - 1.0) * np.maximum(noise_left - own_share**2 * noise, 0.0)
        return shown


def _add_channels(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """(n,) float32: sums of (n, 3), which numpy's own takes three times as long for."""
    total: NDArray[np.float32] = values[:, 0] + values[:, 1] + values[:, 2]
    return total


@dataclass(frozen=True)
class ShownGathered:
    """Gathered light at the texel entries, as it is shown.

    light     its irradiance and how far it may be off by the choice of rays
    doubt2    (n,) float32, (W/m^2)^2: by the photons whose light was gathered
    told      (n,) bool: where it is all indirect light
    """

    light: ShownDirect
    doubt2: NDArray[np.float32]
    told: NDArray[np.bool_]
