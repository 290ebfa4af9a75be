"""Light at texels, averaged over like neighbours: a non-local mean that knows each texel's standard error.

Two texels are alike when the patches around them differ by no more than their noise. Along an edge of light the
neighbours on the same side are alike, which no square leaf of the tree can say; a gradient's are, until they are not.
Only texels of one chart are compared, and only where leaves are smaller than the window: within a leaf neighbours err together.

Source: Rousselle, Knaus & Zwicker 2012, "Adaptive rendering with non-local means filtering", eq. 2-4.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from itertools import product

import numpy as np
from numpy.typing import NDArray

from .texel_map import TexelMap

RADIUS = 4  # texels, of the window
SMALL_LEAF = 4  # side, texels, up to which a leaf's noise is seen as grain
_PATCH = 1  # texels, radius of the patches compared
_VARIANCE_RADIUS = 2  # texels; a texel that saw no photon by chance has no variance of its own
_STRICTNESS = 1.0  # standard errors of a difference that count as alike; measured: 0.45 leaves a tenth more error
_HALO = RADIUS + _PATCH
_TILE = 64
_LEAST_DOUBT2 = np.float32(1e-6)  # squared, relative to the texel and to the mean: keeps a quotient of exact values finite
_UNLIKE = np.float32(1e4)  # a distance beyond any weight
_BRIGHTEST = np.float32(1e12)  # over the mean: its square is still finite
_DARKEST = 1e-30  # W/m^2
_LEAST_WEIGHT = np.float32(1e-12)  # a covered texel weighs one itself

_Image = NDArray[np.float32]


def denoise(
    light: NDArray[np.float32],
    variance: NDArray[np.float32],
    grainy: NDArray[np.bool_],
    texels: TexelMap,
    page: NDArray[np.int32],
    threads: int = 1,
    left: NDArray[np.float32] | None = None,
) -> NDArray[np.float32]:
    """The light with its grain smoothed, where a tile of the page has any.

    light      (k, 3, n) float32: parts of the light at the texel entries; their sum decides who is alike
    variance   (3, n) float32, of the sum
    grainy     (n,) bool: texels whose neighbours err by themselves
    page       (n,) int32, of each entry
    left       (4, n) float32: if given, gets the variance that is left where texels err independently, and each texel's share in its mean
    out        (k, 3, n) float32
    """
    out = light.copy()
    if left is not None:
        left[:3], left[3] = variance, 1
    scale = np.float32(1 / max(float(light.sum(axis=0).mean(dtype=np.float64)), _DARKEST))  # squares of tiny and huge light stay finite
    side = -(-texels.page_size // _TILE) * _TILE
    for number in range(texels.page_count):
        entries = np.flatnonzero(texels.shown & (page == number))
        entry_at = np.full((side + 2 * _HALO, side + 2 * _HALO), -1, np.int32)
        entry_at[texels.texel_xy[entries, 1] + _HALO, texels.texel_xy[entries, 0] + _HALO] = entries

        def smooth(place: tuple[int, int], entry_at: NDArray[np.int32] = entry_at) -> None:
            row, column = place
            entry = entry_at[row : row + _TILE + 2 * _HALO, column : column + _TILE + 2 * _HALO]
            inner = entry[_HALO:-_HALO, _HALO:-_HALO]
            covered = inner >= 0
            if grainy[inner[covered]].any():
                chart = np.where(entry >= 0, texels.texel_chart[entry], -1)
                noise = np.where(entry >= 0, variance[:, entry] * scale * scale, 0)
                lit = np.ascontiguousarray(light[..., entry]) * scale  # else channels lie innermost
                smoothed, noise_left, own_share = _average_alike(lit, noise, chart, left is not None)
                out[..., inner[covered]] = smoothed[..., covered] / scale
                if left is not None:
                    left[:3, inner[covered]] = noise_left[:, covered] / scale**2
                    left[3, inner[covered]] = own_share[covered]

        with ThreadPoolExecutor(threads) as pool:
            for _ in pool.map(smooth, product(range(0, side, _TILE), repeat=2)):
                pass
    return out


def _average_alike(light: _Image, noise: _Image, chart: NDArray[np.int32], tell: bool) -> tuple[_Image, _Image, _Image]:
    """Means, the variance that is left (3, h, w) if `tell`, and the share of each texel in its own mean; all without the halo.

    light (k, 3, h, w), noise (3, h, w) variance, chart (h, w), -1 outside of charts
    """
    variance = noise.sum(axis=0)
    total = np.minimum(light.sum(axis=0), _BRIGHTEST)
    inside = (chart >= 0).astype(np.float32)
    around = [np.pad(image, _VARIANCE_RADIUS) for image in (variance * inside, inside)]
    variance = _box_sum(around[0], _VARIANCE_RADIUS) / np.maximum(_box_sum(around[1], _VARIANCE_RADIUS), 1)
    floor = _LEAST_DOUBT2 * ((total * total).sum(axis=0) + 1)
    middle, core = _window(0, 0, _PATCH), (slice(_PATCH, -_PATCH),) * 2
    own, own_floor, own_chart = variance[middle], floor[middle], chart[middle]
    one_chart = chart.min() == chart.max() >= 0
    mean = np.zeros_like(light[..., *_window(0, 0, 0)])
    weight = np.zeros(mean.shape[2:], np.float32)
    noise_left = np.zeros_like(noise[:, *_window(0, 0, 0)])
    gap, share = np.empty_like(total[..., *middle]), np.empty_like(mean)
    for dy, dx in product(range(-RADIUS, RADIUS + 1), repeat=2):
        there = _window(dy, dx, _PATCH)
        other = variance[there]
        np.subtract(total[..., *middle], total[..., *there], out=gap)
        gap *= gap
        distance = gap.sum(axis=0)
        distance -= own + np.minimum(own, other)
        distance /= np.float32(_STRICTNESS**2) * (own + other) + own_floor
        np.minimum(distance, _UNLIKE, out=distance)
        if one_chart:  # most of a large page
            patch = _box_sum(distance, _PATCH)
            patch /= np.float32((2 * _PATCH + 1) ** 2)
        else:
            same = ((own_chart == chart[there]) & (own_chart >= 0)).astype(np.float32)
            distance *= same
            patch = _box_sum(distance, _PATCH)
            patch /= np.maximum(_box_sum(same, _PATCH), 1)
        alike = np.exp(-np.maximum(patch, 0, out=patch))
        if not one_chart:
            alike *= same[core]
        np.multiply(alike, light[..., *_window(dy, dx, 0)], out=share)
        mean += share
        weight += alike
        if tell:
            alike *= alike
            noise_left += alike * noise[:, *_window(dy, dx, 0)]
    weight = np.maximum(weight, _LEAST_WEIGHT)
    return mean / weight, noise_left / (weight * weight), 1 / weight


def _window(dy: int, dx: int, grow: int) -> tuple[slice, slice]:
    """The part of an image with its halo that lies (dy, dx) from the part without, larger by `grow` on each side."""
    y, x = (slice(_HALO - grow + step, step + grow - _HALO or None) for step in (dy, dx))
    return y, x


def _box_sum(image: _Image, radius: int) -> _Image:
    """Sums over squares of side 2 * radius + 1, where these lie in the image: (h - 2 * radius, w - 2 * radius)."""
    height, width = (side - 2 * radius for side in image.shape)
    rows: _Image = sum(image[i : i + height] for i in range(2 * radius + 1))  # type: ignore[assignment]
    out: _Image = sum(rows[:, i : i + width] for i in range(2 * radius + 1))  # type: ignore[assignment]
    return out
