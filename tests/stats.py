"""Statistics that tests of light share: values beside their truths, judged by the errors that were stated for them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from floors import sigma_limit

PLANTED_BIAS = 1.03  # a test of light must reject a result that is brighter by so much
FLOOR = 1e-4  # of the truth: what rounding, and a truth averaged over few points, may be off


@dataclass(frozen=True)
class Estimates:
    """Values, their truths and their stated errors; each (m,) float64, of one unit.

    noise   standard error, independent from value to value
    doubt   standard error that values may share, such as that of an approximation
    weight  share of each value in the mean
    """

    value: np.ndarray
    truth: np.ndarray
    noise: np.ndarray
    doubt: np.ndarray
    weight: np.ndarray

    def times(self, factor: float) -> Estimates:
        """What a biased estimator would have found."""
        return replace(self, value=self.value * factor)

    @property
    def mean(self) -> float:
        return float((self.value * self.weight).sum() / self.weight.sum())

    @property
    def mean_bias(self) -> float:
        """Of the mean, relative to the true one."""
        return float(((self.value - self.truth) * self.weight).sum() / (self.truth * self.weight).sum())

    @property
    def sigmas(self) -> np.ndarray:
        """(m,) float64: how many stated errors each value is off."""
        return (self.value - self.truth) / np.hypot(self.noise, self._doubt())

    def _doubt(self) -> np.ndarray:
        """With what rounding may do, so that dark values are not judged by an error of 0."""
        return self.doubt + FLOOR * (self.truth + 0.2 * self.truth.mean())

    def bias_and_stderr(self) -> tuple[float, float]:
        """The factor, less 1, that best explains all values together, and its standard error. Source: generalised least squares."""
        doubt = self._doubt()
        pull = self.truth / (self.noise**2 + doubt**2)
        total = pull @ self.truth
        return float(pull @ (self.value - self.truth) / total), float(np.hypot(np.linalg.norm(pull * self.noise), pull @ doubt) / total)

    @property
    def worst_sigmas(self) -> float:
        """How many stated errors the farthest value is off."""
        return float(np.abs(self.sigmas).max())

    @property
    def bias_sigmas(self) -> float:
        """How many errors all values together are off."""
        bias, stderr = self.bias_and_stderr()
        return abs(bias) / stderr


def z_limit(found: Estimates, n_case: int) -> float:
    """Stated errors that neither a value nor all together exceed, in n_case estimates, but with chance floors.ALPHA."""
    return sigma_limit(n_case * (len(found.value) + 1))


def hold_unbiased(hold: Callable[..., None], subject: str, found: Estimates, n_case: int, mean_percent: float) -> None:
    """A z-test of every value and of all together; and what the mean may be off, or large errors would excuse anything.

    n_case   estimates that are judged in one file; all their tests together share floors.ALPHA
    """
    farthest = max(found.worst_sigmas, found.bias_sigmas)
    hold(f"{subject}: farthest off, of leaves and of all together", farthest, high=z_limit(found, n_case), unit="stated errors")
    hold(f"{subject}: bias of the mean", 100 * abs(found.mean_bias), high=mean_percent, unit="%")


def hold_bias_is_seen(hold: Callable[..., None], subject: str, found: Estimates, n_case: int) -> None:
    """The z-test rejects light that is 3 % too bright."""
    biased = found.times(PLANTED_BIAS)
    seen = max(biased.worst_sigmas, biased.bias_sigmas)
    hold(f"{subject}: farthest off with a planted bias of 3 %", seen, low=z_limit(found, n_case), unit="stated errors")


def hold_statement(hold: Callable[..., None], subject: str, errors: np.ndarray, direct: str) -> None:
    """What some bakes say of themselves together is how far they are off; rays alone may err less than they say.

    errors   (n, 2) float64: the stated and the real error of each
    """
    stated, real = np.sqrt((errors**2).mean(axis=0))
    name = f"{subject}: stated over real error of adaptive bakes"
    hold(name, stated / real, low=0.75, high=1.25 if direct == "photons" else math.inf)


def hold_stated_error(hold: Callable[..., None], subject: str, real: float, stated: float, most: float = 1.2) -> None:
    """What a bake says of itself covers how far it is off."""
    hold(f"{subject}: real over stated error of an adaptive bake", real / stated, high=most)


def fit_slope(x: np.ndarray, y: np.ndarray) -> float:
    """Slope of log y over log x by least squares: the rate of convergence."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])
