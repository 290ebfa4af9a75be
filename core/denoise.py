"""Light at texels, averaged over like neighbours: a non-local mean that knows each texel's standard error.

Two texels are alike when the patches around them differ by no more than their noise. Along an edge of light the
neighbours on the same side are alike, which no square leaf of the tree can say; a gradient's are, until they are not.
Only texels of one piece of a chart are compared, and only where leaves are smaller than the window: within a leaf neighbours err together.

Source: Rousselle, Knaus & Zwicker 2012, "Adaptive rendering with non-local means filtering", eq. 2-4.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import chain, product, starmap
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from .lattices import list_lattices
from .quads import QUAD_TEXELS
from .strips import Strips
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


@dataclass(frozen=True)
class Smoothing:
    """Grain that is being smoothed.

    light   (k, n, 3) float32, W/m^2: as it was
    asked   what entries each answer is of, and whether each stands for its quad, for all that have been asked for
    found   the answers, in their order
    """

    light: NDArray[np.float32]
    asked: list[tuple[NDArray[np.int32], bool]]
    found: Iterable[tuple[_Image, _Image, _Image]]

    def finish(self) -> Smoothed:
        """Once for all: what is not done yet is waited for."""
        found = list(self.found)
        parts = [
            (entry, *values) if not of_quads else self._spread(entry, *values)
            for (entry, of_quads), values in zip(self.asked, found, strict=True)
        ]
        entry, smoothed, left, own_share = (np.concatenate(of, axis=-1 if of[0].ndim == 1 else -2) for of in zip(*parts, strict=True))
        return Smoothed(entry, smoothed, left, own_share)

    def _spread(
        self, first: NDArray[np.int32], smoothed: _Image, left: _Image, own_share: _Image
    ) -> tuple[NDArray[np.int32], _Image, _Image, _Image]:
        """What was found at the first texels of quads, for all of theirs: by so much all of them change."""
        entry = (first[:, None] + np.arange(QUAD_TEXELS, dtype=np.int32)).ravel()
        change = np.repeat(smoothed - self.light[:, first], QUAD_TEXELS, axis=1)
        change += self.light[:, entry]
        return entry, change, np.repeat(left, QUAD_TEXELS, axis=0), np.repeat(own_share, QUAD_TEXELS)


def denoise(
    light: NDArray[np.float32],
    variance: NDArray[np.float32],
    grainy: NDArray[np.bool_],
    texels: TexelMap,
    spread: Spread = starmap,
    tell: bool = False,
    by_quads: NDArray[np.bool_] | None = None,
) -> Smoothed:
    """The light with its grain smoothed; arguments as of begin_denoising."""
    return begin_denoising(light, variance, grainy, texels, spread, tell, by_quads).finish()


def begin_denoising(
    light: NDArray[np.float32],
    variance: NDArray[np.float32],
    grainy: NDArray[np.bool_],
    texels: TexelMap,
    spread: Spread,
    tell: bool,
    by_quads: NDArray[np.bool_] | None = None,
) -> Smoothing:
    """Has grain smoothed, of texels around grainy ones and no others; the arrays must not change until it is finished.

    light      (k, n, 3) float32: parts of the light at the texel entries; their sum decides who is alike
    variance   (n, 3) float32, of the sum
    grainy     (n,) bool: texels whose neighbours err by themselves
    tell       the variance that is left is wanted too; else it is 0
    by_quads   (n,) bool: texels of a quad err as one; None where none do
    """
    # Squares of tiny and huge light stay finite.
    brightness, noise = sum(float(part.mean(dtype=np.float64)) for part in light), float(np.sqrt(variance.mean(dtype=np.float64)))
    scale = np.float32(1 / max(brightness, noise, _DARKEST))
    nothing = np.zeros((len(light), 0, 3), np.float32), np.zeros((0, 3), np.float32), np.zeros(0, np.float32)
    asked = [(np.zeros(0, np.int32), False)]

    def ask() -> Iterator[tuple[Any, ...]]:
        for lattice in list_lattices(grainy, texels, by_quads):
            strips = Strips.of(lattice.grainy, lattice.xy, lattice.entry_at, RADIUS, _HALO, lattice.may)
            for some in strips.groups():
                entry, wanted = strips.stack(some)
                asked.append((entry[_HALO:-_HALO, _HALO:-_HALO][wanted], lattice.of_quads))
                chart = np.where(entry >= 0, texels.chart_piece.take(texels.texel_chart.take(entry, mode="wrap")), -1)
                yield light.take(entry, axis=1, mode="wrap"), variance.take(entry, axis=0, mode="wrap"), chart, wanted, scale, tell

    return Smoothing(light, asked, chain([nothing], spread(_smooth_strips, ask())))


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
