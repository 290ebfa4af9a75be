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

    Rows follow each other in one long row, on which a neighbour is a step: what a step takes over an end of a row lies in the halo.
    """
    height, width = chart.shape
    variance = noise.sum(axis=0)
    inside = (chart >= 0).astype(np.float32)
    around = [np.pad(image, _VARIANCE_RADIUS) for image in (variance * inside, inside)]
    sums, counts = (_box_sum(image.ravel(), image.shape[1], _VARIANCE_RADIUS) for image in around)
    variance = _unroll(sums / np.maximum(counts, 1), around[0].shape, _VARIANCE_RADIUS).ravel()
    light, noise = light.reshape(*light.shape[:2], -1), noise.reshape(len(noise), -1)
    total = np.minimum(light.sum(axis=0), _BRIGHTEST)
    floor = _LEAST_DOUBT2 * ((total * total).sum(axis=0) + 1)
    one_chart = chart.min() == chart.max() >= 0
    others = chart.ravel()
    owners = np.where(others < 0, -2, others)  # like nobody

    first, last = _HALO * (width + 1), (height - _HALO) * width - _HALO
    patch = _PATCH * (width + 1)
    core, middle = slice(first, last), slice(first - patch, last + patch)
    own_total, own, own_chart = total[:, middle], variance[middle], owners[middle]
    doubt = np.float32(_STRICTNESS**2) * variance
    own_doubt = doubt[middle] + floor[middle]
    mean, weight = np.zeros_like(light[..., core]), np.zeros(last - first, np.float32)
    noise_left = np.zeros_like(noise[:, core])
    gap, share = np.empty_like(own_total), np.empty_like(mean)
    for dy, dx in product(range(-RADIUS, RADIUS + 1), repeat=2):
        step = dy * width + dx
        near, there = slice(first - patch + step, last + patch + step), slice(first + step, last + step)
        np.subtract(own_total, total[:, near], out=gap)
        gap *= gap
        distance = gap.sum(axis=0)
        distance -= own + np.minimum(own, variance[near])
        distance /= own_doubt + doubt[near]
        np.minimum(distance, _UNLIKE, out=distance)
        if one_chart:  # most of a large page
            alike = _box_sum(distance, width, _PATCH)
            alike /= np.float32((2 * _PATCH + 1) ** 2)
        else:
            same = (own_chart == others[near]).astype(np.float32)
            distance *= same
            alike = _box_sum(distance, width, _PATCH)
            alike /= np.maximum(_box_sum(same, width, _PATCH), 1)
        np.maximum(alike, 0, out=alike)
        np.negative(alike, out=alike)
        np.exp(alike, out=alike)
        if not one_chart:
            alike *= same[patch:-patch]
        np.multiply(alike, light[..., there], out=share)
        mean += share
        weight += alike
        if tell:
            alike *= alike
            noise_left += alike * noise[:, there]
    np.maximum(weight, _LEAST_WEIGHT, out=weight)
    found = mean / weight, noise_left / (weight * weight), 1 / weight
    return tuple(_unroll(values, chart.shape, _HALO) for values in found)  # type: ignore[return-value]  # as many as go in


def _unroll(values: _Image, shape: tuple[int, ...], border: int) -> _Image:
    """The inside of images of a shape (h, w), of all but their first and last border * (w + 1) texels, row after row."""
    image = np.zeros((*values.shape[:-1], *shape), np.float32)
    skipped = border * (shape[1] + 1)
    image.reshape(*values.shape[:-1], -1)[..., skipped:-skipped] = values
    return image[..., border:-border, border:-border]


def _box_sum(image: _Image, width: int, radius: int) -> _Image:
    """Sums over squares of side 2 * radius + 1 about all but the first and the last radius * (width + 1) texels; rows follow each other."""
    for stride in (width, 1):
        count = len(image) - 2 * radius * stride
        total = image[:count] + image[stride : count + stride]
        for i in range(2, 2 * radius + 1):
            total += image[i * stride : count + i * stride]
        image = total
    return image
