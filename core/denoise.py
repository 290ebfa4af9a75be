"""Light at texels, averaged over like neighbours: a non-local mean that knows each texel's standard error.

Two texels are alike when the patches around them differ by no more than their noise. Along an edge of light the
neighbours on the same side are alike, which no square leaf of the tree can say; a gradient's are, until they are not.
Only texels of one chart are compared, and only where leaves are smaller than the window: within a leaf neighbours err together.

Source: Rousselle, Knaus & Zwicker 2012, "Adaptive rendering with non-local means filtering", eq. 2-4.
"""

from __future__ import annotations

from collections import deque
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
# Standard errors of a difference that count as alike. Measured with the radius of the patches: with 1 and 1.0 neighbours pass for like
# whose noise is alike, and a textured emitter's light is off by twice what it is now and says; 3 leaves no less error on the samples.
_STRICTNESS = 0.5
_HALO = RADIUS + _PATCH
_WIDTHS = (16, 32, 64)  # texels, of the strips that a page may be cut into: narrow ones for contacts, wide ones for all of a page
_HEIGHT = 128  # texels, of the largest
_TOGETHER = 1 << 13  # texels of strips that are worked on at once: what lies between fits a core's cache
_LEAST_DOUBT2 = np.float32(1e-6)  # squared, relative to the texel and to the mean: keeps a quotient of exact values finite
_UNLIKE = np.float32(1e4)  # a distance beyond any weight
_BRIGHTEST = np.float32(1e12)  # over the mean: its square is still finite
_DARKEST = 1e-30  # W/m^2
_LEAST_WEIGHT = np.float32(1e-12)  # a covered texel weighs one itself

_Image = NDArray[np.float32]
# What gives a function's results for the arguments of each call, in their order, wherever it is run.
Spread: TypeAlias = Callable[[Callable[..., Any], Iterable[tuple[Any, ...]]], Iterable[Any]]


def denoise(
    light: NDArray[np.float32],
    variance: NDArray[np.float32],
    grainy: NDArray[np.bool_],
    texels: TexelMap,
    page: NDArray[np.int32],
    spread: Spread = starmap,
    left: NDArray[np.float32] | None = None,
) -> NDArray[np.float32]:
    """The light with its grain smoothed, around grainy texels and nowhere else.

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
    if not grainy.any():
        return out
    light, variance = np.ascontiguousarray(light), np.ascontiguousarray(variance)
    # Squares of tiny and huge light stay finite.
    brightness, noise = float(light.sum(axis=0).mean(dtype=np.float64)), float(np.sqrt(variance.mean(dtype=np.float64)))
    scale = np.float32(1 / max(brightness, noise, _DARKEST))

    asked: deque[tuple[NDArray[np.int32], NDArray[np.bool_]]] = deque()  # entries that each answer is of, and where in it they are

    def ask() -> Iterator[tuple[_Image, _Image, NDArray[np.int32], bool]]:
        for number in range(texels.page_count):
            strips = _Strips.of(np.flatnonzero(texels.shown & (page == number)), grainy, texels)
            for some in strips.groups():
                entry, wanted = strips.stack(some)
                asked.append((entry[_HALO:-_HALO, _HALO:-_HALO][wanted], wanted))
                covered = entry >= 0
                chart = np.where(covered, texels.texel_chart.take(entry, mode="wrap"), -1)
                noise = np.where(covered, variance.take(entry, axis=1, mode="wrap") * scale * scale, 0)
                yield light.take(entry, axis=2, mode="wrap") * scale, noise, chart, left is not None

    for smoothed, noise_left, own_share in spread(_average_alike, ask()):
        kept, wanted = asked.popleft()
        out[..., kept] = smoothed[..., wanted] / scale
        if left is not None:
            left[:3, kept] = noise_left[:, wanted] / scale**2
            left[3, kept] = own_share[wanted]
    return out


@dataclass(frozen=True)
class _Strips:
    """Strips of a page that hold all texels to smooth, each with a halo.

    entry_at         (h, w) int32, -1 where no chart covers the texel; the page with a halo
    wanted           (h, w) bool: what is smoothed
    left, low        (m,) int64: the corner of each strip
    height, width    (m,) int64, and of all
    """

    entry_at: NDArray[np.int32]
    wanted: NDArray[np.bool_]
    left: NDArray[np.int64]
    low: NDArray[np.int64]
    height: NDArray[np.int64]
    width: int

    @classmethod
    def of(cls, entries: NDArray[np.int64], grainy: NDArray[np.bool_], texels: TexelMap) -> _Strips:
        """Those around texels near a grainy one, whose own variance may be small by chance.

        entries   (m,) int64: those that the page shows
        """
        side = -(-texels.page_size // max(_WIDTHS)) * max(_WIDTHS)
        place = tuple(texels.texel_xy[entries].T[::-1] + _HALO)
        entry_at = np.full((side + 2 * _HALO, side + 2 * _HALO), -1, np.int32)
        entry_at[place] = entries
        wanted = np.zeros(entry_at.shape, bool)
        wanted[place] = grainy[entries]
        _widen(wanted, _VARIANCE_RADIUS)
        wanted &= entry_at >= 0
        cuts = (cls(entry_at, wanted, *_find_strips(wanted, width), width + 2 * _HALO) for width in _WIDTHS)
        return min(cuts, key=lambda strips: strips.width * int(strips.height.sum()))

    def groups(self) -> list[NDArray[np.int64]]:
        """Strips that are worked on together."""
        together = np.cumsum(self.height) * self.width // _TOGETHER
        return np.split(np.arange(len(self.height)), np.flatnonzero(np.diff(together)) + 1) if len(together) else []

    def stack(self, some: NDArray[np.int64]) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
        """Entries of some strips above each other, and what of them is wanted, without a halo around all."""
        height = self.height[some]
        owner, step = expand_ranges(np.zeros_like(height), height)
        cells = (self.low[some][owner] + step)[:, None], self.left[some][owner][:, None] + np.arange(self.width)
        inner = (step >= _HALO) & (step < height[owner] - _HALO)
        return self.entry_at[cells], (self.wanted[cells] & inner[:, None])[_HALO:-_HALO, _HALO:-_HALO]


def _find_strips(wanted: NDArray[np.bool_], width: int) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Left and low ends of strips, and heights: all that is wanted (h, w) within a halo lies in one; ends and heights with a halo."""
    side = len(wanted) - 2 * _HALO
    strip, row = np.nonzero(wanted[_HALO:-_HALO, _HALO:-_HALO].reshape(side, -1, width).any(axis=2).T)
    # Rows that are apart by less than two halos are cheaper in one strip.
    apart = (np.diff(strip) > 0) | (np.diff(row) > 2 * _HALO) | (np.diff(row // _HEIGHT) > 0)
    first = np.flatnonzero(np.append(True, apart)[: len(row)])
    last = np.append(first[1:], len(row))[: len(first)] - 1
    return strip[first] * width, row[first], row[last] - row[first] + 1 + 2 * _HALO


def _widen(image: NDArray[np.bool_], radius: int) -> None:
    """Sets what lies within a square of side 2 * radius + 1 about what is set."""
    for lines in (image, image.T):
        narrow = lines.copy()
        for step in range(1, radius + 1):
            lines[step:] |= narrow[:-step]
            lines[:-step] |= narrow[step:]


def _average_alike(light: _Image, noise: _Image, chart: NDArray[np.int32], tell: bool) -> tuple[_Image, _Image, _Image]:
    """Means, the variance that is left (3, h, w) if `tell`, and the share of each texel in its own mean; all without the halo.

    light (k, 3, h, w), noise (3, h, w) variance, chart (h, w), -1 outside of charts

    Rows follow each other in one long row, on which a neighbour is a step: what a step takes over an end of a row lies in the halo.
    Two texels are as alike one way as the other, so that a step tells of the one back too.
    """
    height, width = chart.shape
    inside = (chart >= 0).astype(np.float32)
    around = [np.pad(image, _VARIANCE_RADIUS) for image in (noise.sum(axis=0) * inside, inside)]
    sums, counts = (_box_sum(image.ravel(), image.shape[1], _VARIANCE_RADIUS) for image in around)
    variance = _unroll(sums / np.maximum(counts, 1), around[0].shape, _VARIANCE_RADIUS).ravel()
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
