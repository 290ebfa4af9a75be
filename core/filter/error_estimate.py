"""The stated error: an estimate of the bake's distance from the converged light, from the bake's own samples.

It has three parts: the residual variance and the blur of direct light by shadow rays after the filter, the same of gathered light, and the
error of photons: of the light that gather rays met, or of the leaves where these are shown. It is relative to local brightness, since the
eye sees relative differences in dark corners too.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..texels.error_metric import BEST_TEXELS, DARK_FLOOR, ErrorMetric, Parts, choose_lit, cut_entries, find_dark2
from ..util.arrays import Float32, FloatArray, Int64
from .filtered_field import FilteredField

# Returns values (k, 3) of some texel entries (k,).
ValuesAt: TypeAlias = Callable[[Int64], FloatArray]


def _no_light(entry: Int64) -> Float32:
    return np.zeros((len(entry), 3), np.float32)


@dataclass(frozen=True)
class PhotonLight:
    """Light that pages show beside direct light by rays.

    at         returns (k, 3) float32, W/m^2, at texel entries (k,)
    total      sum over all entries and channels, W/m^2
    error2_at  returns (k, 3) float, (W/m^2)^2: squared error from photons, whose means over many texels alone are meaningful
    by_rays    gathered light after the filter; None where leaves are shown
    caustics2_at   the part of error2_at that comes from light by mirrors and glass, which is not gathered
    """

    at: ValuesAt
    total: float
    error2_at: ValuesAt
    by_rays: FilteredField | None = None
    caustics2_at: ValuesAt = _no_light

    @classmethod
    def none(cls) -> PhotonLight:
        """No such light."""
        return cls(_no_light, 0.0, _no_light)

    def beside(self, caustics: PhotonLight) -> PhotonLight:
        """This gathered light, and that by mirrors and glass on leaves."""

        def at(entry: Int64) -> FloatArray:
            return self.at(entry) + caustics.at(entry)

        def error2_at(entry: Int64) -> FloatArray:
            return self.error2_at(entry) + caustics.error2_at(entry)

        return PhotonLight(at, self.total + caustics.total, error2_at, self.by_rays, caustics.error2_at)


@dataclass(frozen=True)
class StatedError:
    """The stated error relative to local brightness; if there are several groups of texels, that of the worst.

    relative          root mean square over the best texels and over channels
    direct            its part from direct light by rays, which more photons do not reduce
    gathered          its part from gather rays
    photons           its part from photons
    caustics          of that, the part from light by mirrors and glass beside gathered light
    texel_direct2     returns (n,) float32: squared error of direct light by rays at each texel, 0 where no error is measured
    texel_gathered2   the same of gathered light; None without
    parts             groups of texels with one error each
    of_parts          (p,) float64: `relative` of each group
    of_objects        returns `relative` of each object by its index, relative to its own brightness; without objects of few texels
    """

    relative: float
    direct: float
    gathered: float
    photons: float
    caustics: float
    texel_direct2: Callable[[], Float32]
    texel_gathered2: Callable[[], Float32] | None
    parts: Parts
    of_parts: NDArray[np.float64]
    of_objects: Callable[[], dict[int, float]]


def state_error(metric: ErrorMetric, direct: FilteredField, photons: PhotonLight) -> StatedError:
    """Error of the shown light: direct light by rays and the rest."""
    light = ReferenceLight.of(metric, direct, photons)
    terms = Terms.of(light, metric.entry)
    sums = [terms.sum_up(rows) for rows in light.parts.rows]
    worst = max(sums, key=lambda one: one.relative)
    return StatedError(
        relative=worst.relative,
        direct=math.sqrt(worst.direct2),
        gathered=math.sqrt(worst.gathered2),
        photons=math.sqrt(worst.photons2),
        caustics=math.sqrt(worst.caustics2),
        texel_direct2=partial(light.relate_all, direct.variance_at),
        texel_gathered2=partial(light.relate_all, photons.by_rays.variance_at) if photons.by_rays else None,
        parts=light.parts,
        of_parts=np.array([one.relative for one in sums]),
        of_objects=partial(metric.find_object_errors, terms.find_error_alone),
    )


@dataclass(frozen=True)
class ReferenceLight:
    """All light of texels: the level that errors are relative to.

    dark    W/m^2: floor of the reference level of a texel, for the bake as a whole
    parts   groups of texels with one error each
    """

    direct: FilteredField
    photons: PhotonLight
    dark: float
    parts: Parts

    @classmethod
    def of(cls, metric: ErrorMetric, direct: FilteredField, photons: PhotonLight) -> ReferenceLight:
        found = cls(direct, photons, 0.0, Parts.whole(len(metric.entry), 0.0))
        light = found.at(metric.entry)
        mean = (photons.total + direct.total_light) / max(direct.found.size, 1)
        dark = DARK_FLOOR * mean / metric.find_share(light.any(axis=1))
        parts = Parts.whole(len(light), dark) if metric.entry_group is None else metric.part(light, dark)
        return replace(found, dark=dark, parts=parts)

    def at(self, entry: Int64) -> Float32:
        """(k, 3) float32, W/m^2: the light at texel entries (k,)."""
        return np.maximum(self.photons.at(entry) + self.direct.irradiance_at(entry), np.float32(0.0)).astype(np.float32, copy=False)

    def weigh(self, entry: Int64) -> Float32:
        """(k, 3) float32: factor that makes squared errors at texel entries (k,) relative; 0 where no error is measured."""
        scale2 = self.at(entry) ** 2
        scale2 += self.parts.find_dark2(entry)
        return np.divide(np.float32(1.0), scale2, out=np.zeros_like(scale2), where=scale2 > 0.0)

    def relate_all(self, variance_at: ValuesAt) -> Float32:
        """(n,) float32: variances at all texel entries relative to the light there, mean of channels."""
        parts = (np.arange(part.start, part.stop) for part in cut_entries(len(self.direct)))
        found = [(self.weigh(part) * variance_at(part)).mean(axis=1, dtype=np.float32) for part in parts]
        return np.concatenate([np.zeros(0, np.float32), *found])


@dataclass(frozen=True)
class RayNoise:
    """Relative squared errors of light by rays at the texels of a sample (m,): its variance, and its blur by the filter."""

    noise2: FloatArray
    blur2: FloatArray

    @classmethod
    def of(cls, shown: FilteredField | None, entry: Int64, weight: Float32) -> RayNoise:
        """Those at texel entries (m,), where `weight` (m, 3) makes squares relative."""
        if shown is None:
            return cls(*np.zeros((2, len(entry)), np.float32))
        return cls(*((weight * values).mean(axis=1) for values in (shown.variance_at(entry), shown.blur2_at(entry))))

    def take(self, rows: Int64, factor: FloatArray) -> RayNoise:
        """Those of the texels `rows` (k,), scaled by `factor` (k,)."""
        return RayNoise(self.noise2[rows] * factor, self.blur2[rows] * factor)

    def sum_up(self, rows: Int64) -> float:
        """Mean over the texels `rows`; of the blur the mean alone is meaningful."""
        return _mean(self.noise2[rows]) + max(_mean(self.blur2[rows]), 0.0)


@dataclass(frozen=True)
class Sum:
    """Mean squared relative errors over texels."""

    direct2: float = 0.0
    gathered2: float = 0.0
    photons2: float = 0.0
    caustics2: float = 0.0

    @property
    def relative(self) -> float:
        return math.sqrt(self.direct2 + self.gathered2 + self.photons2)


@dataclass(frozen=True)
class Terms:
    """Squared relative errors of the texels of a sample (m,), and the light there (m, 3).

    dark     as in ReferenceLight
    weight   (m, 3), from ReferenceLight.weigh
    """

    light: Float32
    dark: float
    weight: Float32
    direct: RayNoise
    gathered: RayNoise
    photons2: FloatArray
    caustics2: FloatArray

    @classmethod
    def of(cls, light: ReferenceLight, entry: Int64) -> Terms:
        weight = light.weigh(entry)
        direct, gathered = (RayNoise.of(shown, entry, weight) for shown in (light.direct, light.photons.by_rays))
        by_photons = ((weight * at(entry)).mean(axis=1) for at in (light.photons.error2_at, light.photons.caustics2_at))
        return cls(light.at(entry), light.dark, weight, direct, gathered, *by_photons)

    def sum_up(self, rows: Int64) -> Sum:
        """Means over the lit texels among `rows` (k,), without the worst."""
        rows = choose_lit(rows, self.light.any(axis=1))
        if not len(rows):
            return Sum()
        likely = np.abs(self.photons2[rows]) + self.direct.noise2[rows] + self.gathered.noise2[rows]
        count = math.ceil(BEST_TEXELS * len(rows))
        best = rows[np.argpartition(likely, count - 1)[:count]]
        by_photons = (max(_mean(values[best]), 0.0) for values in (self.photons2, self.caustics2))
        return Sum(self.direct.sum_up(best), self.gathered.sum_up(best), *by_photons)

    def find_error_alone(self, rows: Int64) -> float:
        """Error of the texels `rows` (k,) relative to their own brightness only. Approximate, since channels keep their weights."""
        light = self.light[rows]
        scale2 = light**2 + find_dark2(light, self.dark)
        own = np.divide(np.float32(1.0), scale2, out=np.zeros_like(light), where=scale2 > 0.0)
        weight = self.weight[rows]
        factor = np.divide(own.mean(axis=1), weight.mean(axis=1), out=np.zeros(len(light)), where=weight.any(axis=1))
        direct, gathered = self.direct.take(rows, factor), self.gathered.take(rows, factor)
        alone = Terms(light, self.dark, own, direct, gathered, self.photons2[rows] * factor, self.caustics2[rows] * factor)
        return alone.sum_up(np.arange(len(rows))).relative


def _mean(values: FloatArray) -> float:
    return float(values.mean(dtype=np.float64))
