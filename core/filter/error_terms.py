"""Squared errors of the sampled texels relative to local brightness, by source, and their means over groups of texels."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..texels.error_metric import BEST_TEXELS, choose_lit, find_dark2
from .bias_estimate import Bias
from .filtered_field import FilteredGather, SmoothedAt
from .variance_estimate import PhotonNoise


@dataclass(frozen=True)
class Sum:
    """Mean squared relative errors over texels.

    missing2   squared discretisation bias
    doubt2     standard error of missing2, and noise that coefficient shrinkage may not have removed
    indirect   share of photons in the light
    """

    photons2: float
    direct2: float
    gathered2: float
    missing2: float
    doubt2: tuple[float, float]
    indirect: float

    @property
    def relative(self) -> float:
        return math.sqrt(self._square)

    @property
    def chosen(self) -> float:
        return math.sqrt(self._square + self.doubt2[0] + self.doubt2[1])

    @property
    def _square(self) -> float:
        return self.photons2 + self.direct2 + self.gathered2 + self.missing2


@dataclass(frozen=True)
class RayNoise:
    """Noise of light by rays at the texels of a sample (m,).

    smoothing   effect of the filter
    is_shown    (m,) bool: where light by rays is shown
    noise2      (m,): its relative variance
    """

    smoothing: SmoothedAt
    is_shown: NDArray[np.bool_]
    noise2: NDArray[np.floating[Any]]

    def take(self, rows: NDArray[np.int64], factor: NDArray[np.float64]) -> RayNoise:
        """The noise at the texels `rows` (k,), its squares scaled by `factor` (k,)."""
        return RayNoise(self.smoothing.take(rows), self.is_shown[rows], self.noise2[rows] * factor)

    def sum_up(self, weight: NDArray[np.float32], best: NDArray[np.int64]) -> float:
        """Mean over texels `best` of the sample: variance, scaled by find_noise_share of the filter's changes, plus squared blur.

        weight   (m, 3) from ReferenceLight.weigh
        """
        asked, noise2 = best[self.is_shown[best]], self.noise2[best]
        noise2[self.smoothing.is_smoothed[best]] *= self.smoothing.take(asked).find_noise_share(weight[asked])
        return _mean(noise2) + self._sum_up_blur(weight, best)

    def find_error(self, weight: NDArray[np.float32], rows: NDArray[np.int64]) -> float:
        """Root mean square over texels `rows` (k,) of the sample without the worst, for a bake without other light.

        The variance is not scaled by find_noise_share: measured, two_rooms would then state 0.75 of its error.
        """
        if not len(rows):
            return 0.0
        noise2 = self.noise2[rows]
        best = rows[np.argsort(noise2, kind="stable")[: math.ceil(BEST_TEXELS * len(rows))]]
        return math.sqrt(_mean(self.noise2[best]) + self._sum_up_blur(weight, best))

    def _sum_up_blur(self, weight: NDArray[np.float32], best: NDArray[np.int64]) -> float:
        blur2 = np.where(self.is_shown[best], (weight[best] * self.smoothing.blur2[best]).mean(1), 0.0)
        return max(_mean(blur2), 0.0)


@dataclass(frozen=True)
class Terms:
    """Squared relative errors of the texels of a sample (m,).

    light      (m, 3), from ReferenceLight.at
    dark       as in ReferenceLight
    weight     (m, 3), from ReferenceLight.weigh
    unseen2    (m,), from variance_estimate.find_unseen
    gathered   None without gathered light
    indirect   (m, 3): share of photons in the light
    """

    light: NDArray[np.float32]
    dark: float
    weight: NDArray[np.float32]
    noise: PhotonNoise
    unseen2: NDArray[np.float64]
    bias: Bias
    direct: RayNoise
    gathered: RayNoise | None
    indirect: NDArray[np.float32]

    def with_gathered(self, gathered: FilteredGather, sample: NDArray[np.int64]) -> Terms:
        """The terms with gathered light shown instead of the leaves'; changes the photons' noise in place.

        sample   (m,) int64: texel entries
        """
        shown, is_shown = gathered.light, gathered.is_shown[sample]
        noise2 = np.where(is_shown, (self.weight * shown.variance_at(sample)).mean(1), np.float64(0.0))
        self.noise.replace((self.weight.mean(1) * gathered.doubt2[sample])[is_shown], is_shown)
        by_rays = RayNoise(shown.smoothing_at(sample), is_shown, noise2)
        return replace(self, unseen2=np.where(is_shown, 0.0, self.unseen2), bias=self.bias.without(is_shown), gathered=by_rays)

    def sum_up(self, rows: NDArray[np.int64], unseen: bool = False) -> Sum:
        """Means over the lit texels among `rows` (k,), without the worst.

        unseen   whether texels count as lit whose light may have missed their object altogether, for errors by object
        """
        rows = choose_lit(rows, self.light.any(axis=1) | (unseen & (self.unseen2 > 0.0)))
        likely = self.noise.photons2[rows] + self.direct.noise2[rows] + self.bias.gap[rows]
        if self.gathered:
            likely += self.gathered.noise2[rows]
        count = math.ceil(BEST_TEXELS * len(rows))
        best = rows[np.argpartition(likely, count - 1)[:count]]
        missing2, missing_doubt2 = self.bias.sum_up(best)
        return Sum(
            photons2=_mean(self.noise.photons2[best]) + _mean(self.unseen2[best]),
            direct2=self.direct.sum_up(self.weight, best),
            gathered2=self.gathered.sum_up(self.weight, best) if self.gathered else 0.0,
            missing2=missing2,
            doubt2=(missing_doubt2, self.noise.find_doubt2(best)),
            indirect=_mean(self.indirect[rows]),
        )

    def find_error_alone(self, rows: NDArray[np.int64]) -> float:
        """Error of the texels `rows` (k,) relative to their own brightness only. Approximate, since channels keep their weights."""
        light = self.light[rows]
        own, factor = _weigh_alone(light, self.dark, self.weight[rows])
        direct, gathered = self.direct.take(rows, factor), self.gathered and self.gathered.take(rows, factor)
        noise, bias = self.noise.take(rows, factor), self.bias.take(rows, factor)
        alone = Terms(light, self.dark, own, noise, self.unseen2[rows] * factor, bias, direct, gathered, self.indirect[rows])
        return alone.sum_up(np.arange(len(rows)), unseen=True).relative


def _weigh_alone(light: NDArray[np.float32], dark: float, weight: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """(k, 3): as ReferenceLight.weigh, relative to the texels' own light (k, 3), W/m^2; and (k,): its mean over that of `weight` (k, 3).

    dark   as in ReferenceLight
    """
    scale2 = light**2 + find_dark2(light, dark)
    own = np.divide(np.float32(1.0), scale2, out=np.zeros_like(light), where=scale2 > 0.0)
    return own, np.divide(own.mean(1), weight.mean(1), out=np.zeros(len(light)), where=weight.any(1))


def find_ray_error_alone(
    light: NDArray[np.float32], dark: float, weight: NDArray[np.float32], rays: RayNoise, rows: NDArray[np.int64]
) -> float:
    """As Terms.find_error_alone without photons; arguments are as the fields of Terms, `rays` as its direct light."""
    own, factor = _weigh_alone(light[rows], dark, weight[rows])
    return rays.take(rows, factor).find_error(own, choose_lit(np.arange(len(rows)), light[rows].any(axis=1)))


def _mean(values: NDArray[np.floating[Any]]) -> float:
    return float(values.mean(dtype=np.float64))
