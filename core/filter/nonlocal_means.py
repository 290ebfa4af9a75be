"""Non-local means of texels with known variances: a plane is fitted to the light of similar neighbours and evaluated at the texel.

Two texels are similar if the patches around them differ by no more than their noise. Along an edge of light the neighbours on the same side
are similar, whatever the leaves' squares; along a gradient, those nearby. If they lie on one side of the texel only, as at a chart's
border, their mean would be the light at another place, which is why a plane is fitted.

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
# Variance is averaged over this radius, texels, since a texel that no photon reached by chance has a sample variance of 0. But a texel with
# a dark sample by chance may have nearly all the variance around it; the mean is then too small, and it would stay as a dent. So the
# variance is at least _OWN_VARIANCE times the texel's own. Measured on direct light of the samples: nrmse falls by 0 to 10 %; with a factor
# of 1 edges are blurred.
_VARIANCE_RADIUS = 2
_OWN_VARIANCE = np.float32(0.5)
# Standard errors of a difference within which texels are similar. Measured together with the radius of the patches: with 1.0 and a radius
# of 1, similar noise passes for similar light, and the light of a textured emitter has twice the error of now and of the stated one; a
# radius of 3 leaves no less error on the samples.
_STRICTNESS = 0.5
HALO = RADIUS + _PATCH
# Ridge prior towards a plane without slope, in similar neighbours times texels^2: with few neighbours on one side, a slope is mostly noise.
# Measured on gathered light: with 2 up to 4 % less error, with 60 4 to 6 % more; on even light 2 leaves a twentieth more noise.
_EVEN = np.float32(20.0)
_LEAST_DOUBT2 = np.float32(1e-6)  # squared, relative to the texel and to the mean: avoids division by zero for exact values
_UNLIKE = np.float32(1e4)  # largest distance; its weight is 0
_BRIGHTEST = np.float32(1e12)  # relative to the mean; its square is still finite

_Image = NDArray[np.float32]


def smooth_alike(light: _Image, noise: _Image, chart: NDArray[np.int32], with_variance: bool) -> tuple[_Image, _Image, _Image]:
    """Filtered light, its residual variance (3, h, w) if `with_variance`, and the weight of each texel in its own value; without the halo.

    light   (k, 3, h, w), not negative, relative to its mean: similarity is measured on the sum over k
    noise   (3, h, w): variance of that sum, 0 where there is no chart
    chart   (h, w), -1 outside of charts

    Images are processed as one long row, in which a neighbour is at a constant offset; offsets that pass the end of a row stay in the halo.
    Similarity is symmetric, so each is computed once for both directions.
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
    return tuple(_unroll(values, chart.shape, HALO) for values in found)  # type: ignore[return-value]  # a tuple of the length of `found`


def _compare(light: _Image, noise: _Image, chart: NDArray[np.int32]) -> Iterator[tuple[int, int, _Image]]:
    """Offsets in columns and rows to half of all neighbours, row by row, each with the similarity (n,), from `step` texels before the first
    one within the halo on; light (k, 3, h * w) and noise (3, h * w) are as for smooth_alike.
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
    owners = np.where(others < 0, -2, others)  # -2 equals no chart: empty texels are similar to none
    patch = _PATCH * (width + 1)
    first, last = HALO * (width + 1) - patch, (height - HALO) * width - HALO + patch
    # Arrays of one value: numpy's minimum of two arrays is three times as fast as that of an array and a number.
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
            if one_chart:  # the common case on a large page
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
    """Sums over the neighbours of n texels, for weighted least-squares planes through their light.

    A neighbour at columns x and rows y from the texel has its similarity as weight w; rows of neighbours are summed first.

    weight       (n,) float32                 sum of w, including 1 for the texel itself; 0 where there is no texel
    light        (k, 3, n) float32            sum of w * light
    tilt         (2, k, 3, n) float32         sums of w * x * light and w * y * light
    shift        (2, n) float32               sums of w * x and w * y
    spread       (3, n) float32               sums of w * x^2, w * x * y and w * y^2
    """

    weight: _Image
    light: _Image
    tilt: _Image
    shift: _Image
    spread: _Image

    @classmethod
    def of(cls, light: _Image, inside: _Image) -> _Planes:
        """Sums without neighbours, for texels with light (k, 3, n); inside (n,) is 1 for a texel, else 0."""
        shape = inside.shape
        tilt, shift, spread = np.zeros((2, *light.shape), np.float32), np.zeros((2, *shape), np.float32), np.zeros((3, *shape), np.float32)
        return cls(inside, light * inside, tilt, shift, spread)

    def __post_init__(self) -> None:
        self._ahead, self._behind = np.empty_like(self.light), np.empty_like(self.light)
        self._row_tilt, self._row = np.zeros_like(self.light), np.zeros_like(self.spread)

    def add(self, ahead: _Image, behind: _Image, light_ahead: _Image, light_behind: _Image, dx: int) -> None:
        """Add the neighbour dx columns ahead in the current row and the opposite one, given their similarities and light."""
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
        if dx:  # for dx = 0 these terms are 0
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
        """Add the sums of a row of neighbours, dy rows ahead."""
        y, (row_weight, row_x, row_shift) = np.float32(dy), self._row
        self._row_tilt *= y
        self.tilt[1] += self._row_tilt
        self.shift[1] += y * row_shift
        self.spread[1] += y * row_x
        self.spread[2] += y * y * row_weight
        self._row_tilt.fill(0)
        self._row.fill(0)

    def solve(self) -> tuple[_Image, _Image, _Image]:
        """Light (k, 3, n) of the planes at the texels; weight (n,) of each texel in its own value; sum (n,) of squared weights over w.

        A neighbour's weight in the value is w times a linear function of x and y. The residual variance treats that function as constant.
        """
        (shift_x, shift_y), (xx, xy, yy) = self.shift, self.spread
        xx, yy = xx + _EVEN, yy + _EVEN
        area = xx * yy - xy * xy
        lean_x, lean_y = (yy * shift_x - xy * shift_y) / area, (xx * shift_y - xy * shift_x) / area
        own_share = 1 / np.maximum(self.weight - (shift_x * lean_x + shift_y * lean_y), 1)  # its own w is 1, at distance 0
        fitted = self.light - lean_x * self.tilt[0]
        fitted -= lean_y * self.tilt[1]
        fitted *= own_share
        np.maximum(fitted, 0, out=fitted)  # a plane may dip below zero in the dark
        return fitted, own_share, own_share - _EVEN * own_share**2 * (lean_x * lean_x + lean_y * lean_y)


def _unroll(values: _Image, shape: tuple[int, ...], border: int) -> _Image:
    """The interior, without a border, of images of shape (h, w); values (..., n) lack the first and last border * (w + 1) texels."""
    image = np.zeros((*values.shape[:-1], *shape), np.float32)
    skipped = border * (shape[1] + 1)
    image.reshape(*values.shape[:-1], -1)[..., skipped:-skipped] = values
    return image[..., border:-border, border:-border]


def _box_sum(image: NDArray[Any], width: int, radius: int) -> NDArray[Any]:
    """Sums over squares of side 2 * radius + 1 about the texels of a flat image, except the first and last radius * (width + 1)."""
    for stride in (width, 1):
        count = len(image) - 2 * radius * stride
        pairs = image[:-stride] + image[stride:]
        total = image[2 * radius * stride :] + pairs[:count]
        for i in range(1, radius):
            total += pairs[2 * i * stride :][:count]
        image = total
    return image
