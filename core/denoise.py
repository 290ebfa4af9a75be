"""Light at texels, averaged over like neighbours: a non-local mean that knows each texel's standard error.

Two texels are alike when the patches around them differ by no more than their noise. Along an edge of light the
neighbours on the same side are alike, which no square leaf of the tree can say; a gradient's are, until they are not.
Only texels of one piece of a chart are compared, and only where leaves are smaller than the window: within a leaf neighbours err together.

Source: Rousselle, Knaus & Zwicker 2012, "Adaptive rendering with non-local means filtering", eq. 2-4.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import product, starmap
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from .coverage import expand_ranges
from .texel_map import TexelMap

RADIUS = 4  # texels, of the window
# Side, texels, up to which a leaf's noise is averaged with its neighbours'. Measured on the samples: 4 leaves 0 to 4 % more error, 8 up
# to 1 % at 256^2 and 1.5 % at 1024^2; 32 would leave 1 to 2 % less there and takes longer.
SMALL_LEAF = 16
# Squared error that this leaves of the photons' noise there, what it blurs counted. Measured on the samples at 1, 4 and 16 M photons:
# 0.81 to 0.97, and 1.02 where light changes in every texel; what is stated is then within 5 % of what each sample's own factor would state.
GRAIN_LEFT = 0.89
_PATCH = 2  # texels, radius of the patches compared
_VARIANCE_RADIUS = 2  # texels; a texel that saw no photon by chance has no variance of its own
# ... but one that met darkness by chance, among texels that met none, holds nearly all the variance of its surroundings: the mean around it
# is too small, and it would stay as a dent. So it counts for so much of its own at least. Measured on direct light of the samples: nrmse
# falls by 0 to 10 %; with the whole of it edges are blurred.
_OWN_VARIANCE = np.float32(0.5)
# Standard errors of a difference that count as alike. Measured with the radius of the patches: with 1 and 1.0 neighbours pass for like
# whose noise is alike, and a textured emitter's light is off by twice what it is now and says; 3 leaves no less error on the samples.
_STRICTNESS = 0.5
_HALO = RADIUS + _PATCH
_WIDTHS = (16, 32, 64, 128, 256)  # texels, of the strips that a page may be cut into: narrow ones for contacts, wide ones for all of a page
_HEIGHT = 128  # texels, of the largest
# Texels of strips that are worked on at once. Of a quarter of them numpy's calls would take a third of the time; twice as many leave the
# cache, and are too few parts for two cores.
_TOGETHER = 1 << 15
_LEAST_DOUBT2 = np.float32(1e-6)  # squared, relative to the texel and to the mean: keeps a quotient of exact values finite
_UNLIKE = np.float32(1e4)  # a distance beyond any weight
_BRIGHTEST = np.float32(1e12)  # over the mean: its square is still finite
_DARKEST = 1e-30  # W/m^2
_LEAST_WEIGHT = np.float32(1e-12)  # a covered texel weighs one itself

_Image = NDArray[np.float32]
# What gives a function's results for the arguments of each call, in their order, wherever it is run.
Spread: TypeAlias = Callable[[Callable[..., Any], Iterable[tuple[Any, ...]]], Iterable[Any]]


@dataclass(frozen=True)
class Smoothed:
    """Light where its grain was smoothed.

    entry       (m,) int32
    light       (k, m, 3) float32, W/m^2
    variance    (m, 3) float32, (W/m^2)^2   that is left where texels err independently
    own_share   (m,) float32                of each texel in its mean
    """

    entry: NDArray[np.int32]
    light: NDArray[np.float32]
    variance: NDArray[np.float32]
    own_share: NDArray[np.float32]


def denoise(
    light: NDArray[np.float32],
    variance: NDArray[np.float32],
    grainy: NDArray[np.bool_],
    texels: TexelMap,
    spread: Spread = starmap,
    tell: bool = False,
) -> Smoothed:
    """The light with its grain smoothed, of texels around grainy ones and no others.

    light      (k, n, 3) float32: parts of the light at the texel entries; their sum decides who is alike
    variance   (n, 3) float32, of the sum
    grainy     (n,) bool: texels whose neighbours err by themselves
    tell       the variance that is left is wanted too; else it is 0
    """
    entries = np.flatnonzero(grainy)
    # Squares of tiny and huge light stay finite.
    brightness, noise = sum(float(part.mean(dtype=np.float64)) for part in light), float(np.sqrt(variance.mean(dtype=np.float64)))
    scale = np.float32(1 / max(brightness, noise, _DARKEST))
    asked: list[NDArray[np.int32]] = []  # entries that each answer is of

    def ask() -> Iterator[tuple[Any, ...]]:
        page = texels.page_of(entries)
        for number in range(texels.page_count if len(entries) else 0):
            strips = _Strips.of(entries[page == number], texels.entry_at[number], texels)
            for some in strips.groups():
                entry, wanted = strips.stack(some)
                asked.append(entry[_HALO:-_HALO, _HALO:-_HALO][wanted])
                chart = np.where(entry >= 0, texels.chart_piece.take(texels.texel_chart.take(entry, mode="wrap")), -1)
                yield light.take(entry, axis=1, mode="wrap"), variance.take(entry, axis=0, mode="wrap"), chart, wanted, scale, tell

    found = [
        (np.zeros((len(light), 0, 3), np.float32), np.zeros((0, 3), np.float32), np.zeros(0, np.float32)),
        *spread(_smooth_strips, ask()),
    ]
    smoothed, left, own_share = (np.concatenate(parts, axis=-1 if parts[0].ndim == 1 else -2) for parts in zip(*found, strict=True))
    return Smoothed(np.concatenate([np.zeros(0, np.int32), *asked]), smoothed, left, own_share)


@dataclass(frozen=True)
class _Strips:
    """Strips of a page that hold all texels to smooth, each with a halo.

    entry_at         (size, size) int32, -1 where no chart covers the texel
    wanted           (size, w) bool: what is smoothed; w >= size is a multiple of a strip's width
    left, low        (m,) int64: the corner of each strip within its halo
    height           (m,) int64, of each strip, and width of all, with their halo
    """

    entry_at: NDArray[np.int32]
    wanted: NDArray[np.bool_]
    left: NDArray[np.int64]
    low: NDArray[np.int64]
    height: NDArray[np.int64]
    width: int

    @classmethod
    def of(cls, grainy: NDArray[np.int64], entry_at: NDArray[np.int32], texels: TexelMap) -> _Strips:
        """Those around texels within a grainy one's window: their own variance may be small by chance, and as it takes from them they are
        to take from it, so that no light is lost.

        grainy   (m,) int64: entries of the page
        """
        size = texels.page_size
        x, y = texels.texel_xy[grainy].T
        shown = entry_at[y, x] == grainy
        wanted = np.zeros((size, -(-size // max(_WIDTHS)) * max(_WIDTHS)), bool)
        wanted[y[shown], x[shown]] = True
        _widen(wanted, RADIUS)
        wanted[:, :size] &= entry_at >= 0
        wanted[:, size:] = False
        cuts = (cls(entry_at, wanted, *_find_strips(wanted, width), width + 2 * _HALO) for width in _WIDTHS)
        return min(cuts, key=lambda strips: strips.width * int(strips.height.sum()))

    def groups(self) -> list[NDArray[np.int64]]:
        """Strips that are worked on together."""
        together = np.cumsum(self.height) * self.width // _TOGETHER
        return np.split(np.arange(len(self.height)), np.flatnonzero(np.diff(together)) + 1) if len(together) else []

    def stack(self, some: NDArray[np.int64]) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
        """Entries of some strips above each other, and what of them is wanted, without a halo around all."""
        size = len(self.entry_at)
        height = self.height[some]
        owner, step = expand_ranges(np.zeros_like(height), height)
        left = self.left[some][owner][:, None]
        row, column = (self.low[some][owner] + step - _HALO)[:, None], left + np.arange(-_HALO, self.width - _HALO)
        on_page = (row >= 0) & (row < size) & (column >= 0) & (column < size)
        row = np.clip(row, 0, size - 1)
        entry = np.where(on_page, self.entry_at[row, np.clip(column, 0, size - 1)], np.int32(-1))
        inner = (step >= _HALO) & (step < height[owner] - _HALO)
        wanted = self.wanted[row, left + np.arange(self.width - 2 * _HALO)] & inner[:, None]
        return entry, wanted[_HALO:-_HALO]


def _find_strips(wanted: NDArray[np.bool_], width: int) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Left and low ends of strips, and heights with a halo: all that is wanted (h, w) lies in one."""
    eight = wanted.view(np.uint64) != 0  # eight texels at once
    strip, row = np.nonzero(eight.reshape(len(wanted), -1, width // 8).any(axis=2).T)
    # Rows that are apart by less than two halos are cheaper in one strip.
    apart = (np.diff(strip) > 0) | (np.diff(row) > 2 * _HALO) | (np.diff(row // _HEIGHT) > 0)
    first = np.flatnonzero(np.append(True, apart)[: len(row)])
    last = np.append(first[1:], len(row))[: len(first)] - 1
    return strip[first] * width, row[first], row[last] - row[first] + 1 + 2 * _HALO


def _widen(image: NDArray[np.bool_], radius: int) -> None:
    """Sets what lies within a square of side 2 * radius + 1 about what is set."""
    for axis in (0, 1):
        narrow = image.copy()  # of both in the order in which they lie: along columns that is twenty times as fast
        for step in range(1, radius + 1):
            ahead, behind = ((slice(None),) * axis + (part,) for part in (slice(step, None), slice(None, -step)))
            image[ahead] |= narrow[behind]
            image[behind] |= narrow[ahead]


def _smooth_strips(
    light: _Image, variance: _Image, chart: NDArray[np.int32], wanted: NDArray[np.bool_], scale: np.float32, tell: bool
) -> tuple[_Image, _Image, _Image]:
    """Light (k, m, 3), its variance (m, 3), 0 unless `tell`, and own shares (m,) of the texels `wanted`, smoothed.

    light (k, h, w, 3), variance (h, w, 3), chart (h, w), -1 outside of charts; wanted (h, w) without the halo
    """
    planes = np.ascontiguousarray(light.transpose(0, 3, 1, 2)) * scale
    noise = np.where(chart >= 0, np.ascontiguousarray(variance.transpose(2, 0, 1)) * scale * scale, 0)
    mean, left, own_share = _average_alike(planes, noise, chart, tell)
    smoothed = (mean[..., wanted] / scale).transpose(0, 2, 1)
    kept = left[:, wanted].T / scale**2 if tell else np.zeros(smoothed.shape[1:], np.float32)
    return np.ascontiguousarray(smoothed), np.ascontiguousarray(kept), own_share[wanted]


def _average_alike(light: _Image, noise: _Image, chart: NDArray[np.int32], tell: bool) -> tuple[_Image, _Image, _Image]:
    """Means, the variance that is left (3, h, w) if `tell`, and the share of each texel in its own mean; all without the halo.

    light (k, 3, h, w), noise (3, h, w) variance, chart (h, w), -1 outside of charts

    Rows follow each other in one long row, on which a neighbour is a step: what a step takes over an end of a row lies in the halo.
    Two texels are as alike one way as the other, so that a step tells of the one back too.
    """
    height, width = chart.shape
    inside = (chart >= 0).astype(np.float32)
    own = noise.sum(axis=0)
    around = [np.pad(image, _VARIANCE_RADIUS) for image in (own, inside)]
    sums, counts = (_box_sum(image.ravel(), image.shape[1], _VARIANCE_RADIUS) for image in around)
    nearby = _unroll(sums / np.maximum(counts, 1), around[0].shape, _VARIANCE_RADIUS)
    variance = np.maximum(nearby, _OWN_VARIANCE * own).ravel()
    light, noise = light.reshape(*light.shape[:2], -1), noise.reshape(len(noise), -1)
    total = np.minimum(light.sum(axis=0), _BRIGHTEST)
    twice = 2 * variance
    doubt = np.float32(_STRICTNESS**2) * variance + _LEAST_DOUBT2 / 2 * ((total * total).sum(axis=0) + 1)
    one_chart = chart.min() == chart.max() >= 0
    others = chart.ravel()
    owners = np.where(others < 0, -2, others)  # like nobody

    first, last = _HALO * (width + 1), (height - _HALO) * width - _HALO
    patch, count = _PATCH * (width + 1), last - first
    core = slice(first, last)
    weight = inside.ravel()[core].copy()
    mean: _Image = light[..., core] * weight
    noise_left: _Image = noise[:, core] * weight
    share = np.empty_like(mean)
    for dy, dx in product(range(RADIUS + 1), range(-RADIUS, RADIUS + 1)):
        step = dy * width + dx
        if step <= 0:
            continue
        one, other = slice(first - patch - step, last + patch), slice(first - patch, last + patch + step)
        gap = total[:, one] - total[:, other]
        gap *= gap
        distance = gap.sum(axis=0)
        expected = np.minimum(twice[one], twice[other])
        distance -= expected
        np.add(doubt[one], doubt[other], out=expected)
        distance /= expected
        np.minimum(distance, _UNLIKE, out=distance)
        if one_chart:  # most of a large page
            alike = _box_sum(distance, width, _PATCH)
            alike /= np.float32(-((2 * _PATCH + 1) ** 2))
        else:
            same = owners[one] == others[other]
            distance *= same
            alike = _box_sum(distance, width, _PATCH)
            alike /= np.minimum(-_box_sum(same.astype(np.float32), width, _PATCH), -1)
        np.minimum(alike, 0, out=alike)
        np.exp(alike, out=alike)
        if not one_chart:
            alike *= same[patch:-patch]
        ways = (alike[step:], slice(first + step, last + step)), (alike[:count], slice(first - step, last - step))
        for likeness, there in ways:
            np.multiply(likeness, light[..., there], out=share)
            mean += share
            weight += likeness
        if tell:
            alike *= alike
            for likeness, there in ways:
                noise_left += likeness * noise[:, there]
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
