"""Non-local means of texels, each of which knows its standard error: planes through what like neighbours have.

Two texels are alike when the patches around them differ by no more than their noise. Along an edge of light the neighbours on the same
side are alike, which no square leaf of the tree can say; a gradient's are, until they are not. Where they lie on one side only, as at a
chart's border, their mean would be another place's light: so a plane is fitted to it, and read at the texel.

Source: Rousselle, Knaus & Zwicker 2012, "Adaptive rendering with non-local means filtering", eq. 2-4; Cleveland 1979, "Robust locally
weighted regression and smoothing scatterplots", of degree 1.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

RADIUS = 4  # texels, of the window
_PATCH = 2  # texels, radius of the patches compared
_VARIANCE_RADIUS = 2  # texels; a texel that no photon reached by chance has no variance of its own
# ... but one with a dark sample by chance, among texels without, holds nearly all the variance around it: the mean there is too small,
# and it would stay as a dent. So at least this share of its own variance counts. Measured on direct light of the samples: nrmse falls by 0
# to 10 %; with all of it edges are blurred.
_OWN_VARIANCE = np.float32(0.5)
# Standard errors of a difference within which texels are similar. Measured with the radius of the patches: with 1 and 1.0 similar noise
# passes for similar light, and a textured emitter's light errs twice as much as now and as stated; 3 leaves no less error on the samples.
_STRICTNESS = 0.5
HALO = RADIUS + _PATCH
# Prior of an even plane, in similar neighbours times texels^2: with few neighbours on one side a slope is mostly noise. Measured on
# gathered light: with 2 up to 4 % less error, with 60 4 to 6 % more; over even light 2 leaves a twentieth more noise.
_EVEN = np.float32(20.0)
_LEAST_DOUBT2 = np.float32(1e-6)  # squared, relative to the texel and to the mean: keeps a quotient of exact values finite
_UNLIKE = np.float32(1e4)  # a distance beyond any weight
_BRIGHTEST = np.float32(1e12)  # over the mean: its square is still finite

_Image = NDArray[np.float32]


def smooth_alike(light: _Image, noise: _Image, chart: NDArray[np.int32], with_variance: bool) -> tuple[_Image, _Image, _Image]:
    """Light smoothed, the variance that is left (3, h, w) if `with_variance`, and the share of each texel in its own; all without the halo.

    light   (k, 3, h, w), never negative, relative to its mean: its sum over k decides who is alike
    noise   (3, h, w) variance of that sum, 0 where there is no chart
    chart   (h, w), -1 outside of charts

    Rows follow each other in one long row, on which a neighbour is a step: what a step takes over an end of a row lies in the halo.
    Two texels are as alike one way as the other, so that a step tells of the one back too.
    """
    height, width = chart.shape
    light, noise = light.reshape(*light.shape[:2], -1), noise.reshape(len(noise), -1)
    first, last = HALO * (width + 1), (height - HALO) * width - HALO
    core = slice(first, last)
    planes = _Planes.of(light[..., core], (chart.ravel()[core] >= 0).astype(np.float32))
    noise_left: _Image = noise[:, core] * planes.weight
    row = -1
    for dx, dy, alike in _compare(light, noise, chart):
        if dy != row:
            planes.end_row(row)
            row = dy
        step = dy * width + dx
        there, back = slice(first + step, last + step), slice(first - step, last - step)
        planes.add(alike[step:], alike[: last - first], light[..., there], light[..., back], dx)
        if with_variance:
            alike *= alike
            noise_left += alike[step:] * noise[:, there]
            noise_left += alike[: last - first] * noise[:, back]
    planes.end_row(row)
    fitted, own_share, squares = planes.solve()
    noise_left *= squares / np.maximum(planes.weight, 1)
    found = fitted, noise_left, own_share
    return tuple(_unroll(values, chart.shape, HALO) for values in found)  # type: ignore[return-value]  # as many as go in


def _compare(light: _Image, noise: _Image, chart: NDArray[np.int32]) -> Iterator[tuple[int, int, _Image]]:
    """Columns, rows to half of all neighbours, row by row, and how alike they are: (n,) of all texels from `step` before the first within
    the halo; light (k, 3, h * w) and noise (3, h * w) as of smooth_alike.
    """
    height, width = chart.shape
    own = noise.sum(axis=0).reshape(chart.shape)
    around = [np.pad(image, _VARIANCE_RADIUS) for image in (own, (chart >= 0).astype(np.float32))]
    sums, counts = (_box_sum(image.ravel(), image.shape[1], _VARIANCE_RADIUS) for image in around)
    nearby = _unroll(sums / np.maximum(counts, 1), around[0].shape, _VARIANCE_RADIUS)
    variance = np.maximum(nearby, _OWN_VARIANCE * own).ravel()
    total = np.minimum(light.sum(axis=0), _BRIGHTEST)
    twice = 2 * variance
    doubt = np.float32(_STRICTNESS**2) * variance + _LEAST_DOUBT2 / 2 * ((total * total).sum(axis=0) + 1)
    one_chart = chart.min() == chart.max() >= 0
    others = chart.ravel()
    owners = np.where(others < 0, -2, others)  # similar to none
    patch = _PATCH * (width + 1)
    first, last = HALO * (width + 1) - patch, (height - HALO) * width - HALO + patch
    # A row of one number: numpy finds the lesser of rows three times as fast as that of a row and a number.
    unlike, nothing = np.full(others.shape, _UNLIKE), np.zeros(others.shape, np.float32)
    for dy in range(RADIUS + 1):
        for dx in range(-RADIUS if dy else 1, RADIUS + 1):
            step = dy * width + dx
            one, other = slice(first - step, last), slice(first, last + step)
            gap = total[:, one] - total[:, other]
            distance = np.einsum("ij,ij->j", gap, gap)
            expected = np.minimum(twice[one], twice[other])
            distance -= expected
            np.add(doubt[one], doubt[other], out=expected)
            distance /= expected
            np.minimum(distance, unlike[: len(distance)], out=distance)
            if one_chart:  # most of a large page
                alike = _box_sum(distance, width, _PATCH)
                alike /= np.float32(-((2 * _PATCH + 1) ** 2))
            else:
                same = (owners[one] == others[other]).view(np.uint8)
                distance *= same
                alike = _box_sum(distance, width, _PATCH)
                count = _box_sum(same, width, _PATCH)  # 25 at most
                np.maximum(count, np.uint8(1), out=count)
                alike /= -count.astype(np.float32)
            np.minimum(alike, nothing[: len(alike)], out=alike)
            np.exp(alike, out=alike)
            if not one_chart:
                alike *= same[patch:-patch]
            yield dx, dy, alike


@dataclass
class _Planes:
    """Sums over the like neighbours of n texels, by which planes through their light are found.

    A neighbour counts by how alike it is, w, at columns x and rows y from the texel; those of a row of neighbours are added up first.

    weight       (n,) float32                 sum of w, the texel's own 1 among them; 0 where there is no texel
    light        (k, 3, n) float32            of w * light
    tilt         (2, k, 3, n) float32         of w * x * light and w * y * light
    shift        (2, n) float32               of w * x and w * y
    spread       (3, n) float32               of w * x^2, w * x * y and w * y^2
    """

    weight: _Image
    light: _Image
    tilt: _Image
    shift: _Image
    spread: _Image

    @classmethod
    def of(cls, light: _Image, inside: _Image) -> _Planes:
        """Start with texels (n,) of light (k, 3, n) without neighbours; inside is 1 where there is one."""
        shape = inside.shape
        tilt, shift, spread = np.zeros((2, *light.shape), np.float32), np.zeros((2, *shape), np.float32), np.zeros((3, *shape), np.float32)
        return cls(inside, light * inside, tilt, shift, spread)

    def __post_init__(self) -> None:
        self._ahead, self._behind = np.empty_like(self.light), np.empty_like(self.light)
        self._row_tilt, self._row = np.zeros_like(self.light), np.zeros_like(self.spread)

    def add(self, ahead: _Image, behind: _Image, light_ahead: _Image, light_behind: _Image, dx: int) -> None:
        """Add a neighbour dx columns on in the current row, and the opposite one: their similarity and their light."""
        np.multiply(ahead, light_ahead, out=self._ahead)
        np.multiply(behind, light_behind, out=self._behind)
        self.light += self._ahead
        self.light += self._behind
        self._ahead -= self._behind
        self._row_tilt += self._ahead
        both, odd = ahead + behind, ahead - behind
        row_weight, row_x, row_shift = self._row
        self.weight += both
        row_weight += both
        row_shift += odd
        if dx:  # else it adds nothing
            x = np.float32(dx)
            self._ahead *= x
            self.tilt[0] += self._ahead
            odd *= x
            self.shift[0] += odd
            both *= x
            row_x += both
            both *= x
            self.spread[0] += both

    def end_row(self, dy: int) -> None:
        """End a row of neighbours, dy rows on."""
        y, (row_weight, row_x, row_shift) = np.float32(dy), self._row
        self._row_tilt *= y
        self.tilt[1] += self._row_tilt
        self.shift[1] += y * row_shift
        self.spread[1] += y * row_x
        self.spread[2] += y * y * row_weight
        self._row_tilt.fill(0)
        self._row.fill(0)

    def solve(self) -> tuple[_Image, _Image, _Image]:
        """Light of the planes at the texels, (k, 3, n), the share (n,) of each in its own, and (n,) the sum of all shares squared over w.

        A neighbour's share is w times what is linear in x and y. Noise is taken as if the last were alike for all w.
        """
        (shift_x, shift_y), (xx, xy, yy) = self.shift, self.spread
        xx, yy = xx + _EVEN, yy + _EVEN
        area = xx * yy - xy * xy
        lean_x, lean_y = (yy * shift_x - xy * shift_y) / area, (xx * shift_y - xy * shift_x) / area
        own_share = 1 / np.maximum(self.weight - (shift_x * lean_x + shift_y * lean_y), 1)  # its own weight is 1, at no distance
        fitted = self.light - lean_x * self.tilt[0]
        fitted -= lean_y * self.tilt[1]
        fitted *= own_share
        np.maximum(fitted, 0, out=fitted)  # a plane may dip below zero where light is little
        return fitted, own_share, own_share - _EVEN * own_share**2 * (lean_x * lean_x + lean_y * lean_y)


def _unroll(values: _Image, shape: tuple[int, ...], border: int) -> _Image:
    """The inside of images of a shape (h, w), of all but their first and last border * (w + 1) texels, row after row."""
    image = np.zeros((*values.shape[:-1], *shape), np.float32)
    skipped = border * (shape[1] + 1)
    image.reshape(*values.shape[:-1], -1)[..., skipped:-skipped] = values
    return image[..., border:-border, border:-border]


def _box_sum(image: NDArray[Any], width: int, radius: int) -> NDArray[Any]:
    """Sums over squares of side 2 * radius + 1 about all but the first and the last radius * (width + 1) texels; rows follow each other."""
    for stride in (width, 1):
        count = len(image) - 2 * radius * stride
        pairs = image[:-stride] + image[stride:]
        total = image[2 * radius * stride :] + pairs[:count]
        for i in range(1, radius):
            total += pairs[2 * i * stride :][:count]
        image = total
    return image
