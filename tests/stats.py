"""Statistics that tests of light share: values beside their truths, judged by the errors that were stated for them."""

from __future__ import annotations

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

    def complaint(self, n_case: int) -> str:
        """What a z-test of every value and of all together has against them; "" for nothing.

        n_case   estimates that are judged in one file; all their tests together share floors.ALPHA
        """
        limit = sigma_limit(n_case * (len(self.value) + 1))
        sigmas = self.sigmas
        worst = int(np.argmax(np.abs(sigmas)))
        if not np.abs(sigmas[worst]) < limit:
            found = f"{self.value[worst]:.6g} for {self.truth[worst]:.6g}"
            return f"value {worst} of {len(sigmas)}: {found}, {sigmas[worst]:.2f} stated errors off, limit {limit:.2f}"
        bias, stderr = self.bias_and_stderr()
        return "" if abs(bias) < limit * stderr else f"all: off by {100 * bias:.3f} +- {100 * stderr:.3f} %, limit {limit:.2f} errors"


def fit_slope(x: np.ndarray, y: np.ndarray) -> float:
    """Slope of log y over log x by least squares: the rate of convergence."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])
