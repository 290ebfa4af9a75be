"""How far baked light is from a reference that is noisy itself: two renderings with independent noise.

With a the bake and r, s the two renderings, (a - r)(a - s) has the expectation of the bake's own squared error: the noise of r
and that of s are independent of each other, so that they cancel in the mean.
"""

from dataclasses import dataclass

import numpy as np

BEST_TEXELS = 0.99  # on a hard edge of light, whether a texel is its centre or its mean decides its error
DARK_FLOOR = 0.1  # of the mean, against which darker texels are judged


@dataclass(frozen=True)
class LightmapErrors:
    """Over the lit texels of the reference, with m the reference's mean brightness.

    texels   how many these are
    rel      root mean square relative to local brightness, sqrt(r^2 + (0.1 m)^2), over the best 99 % of them
    nrmse    root mean square over all of them, relative to m
    p99      of the texels' differences, relative to r + 0.1 m, the 99th percentile; contains the reference's noise
    bias     mean difference, relative to m
    """

    texels: int
    rel: float
    nrmse: float
    p99: float
    bias: float


def find_lit(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(n,) bool: texels with light in both renderings, (n, 3) each; what one of them left black has no value to be held against."""
    return (first.sum(-1) > 0.0) & (second.sum(-1) > 0.0)


def local_differences(value: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(n,) differences to the mean of both renderings, relative to its brightness; channels summed. All texels must be lit."""
    mean = (first + second) / 2.0
    return np.abs(value - mean).sum(-1) / (mean + DARK_FLOOR * mean.mean()).sum(-1)


def measure_errors(value: np.ndarray, first: np.ndarray, second: np.ndarray, noisy: bool = False) -> LightmapErrors:
    """Errors of a bake.

    value           (n, 3) float, of any unit; texels that the bake left black count
    first, second   (n, 3) float: the renderings
    noisy           their noise is not far below the error: choose the best texels by their differences to both. Those nearest to the
                    mean are those where its noise is small, but not half the difference of both, so that too much is taken off for it
    """
    lit = find_lit(first, second)
    value, first, second = (light[lit].astype(np.float64) for light in (value, first, second))
    mean = (first + second) / 2.0
    level = mean.mean()
    square = (value - first) * (value - second)
    local = local_differences(value, first, second)
    p99 = np.quantile(local, BEST_TEXELS)
    spread = local
    if noisy:
        half = np.abs(first - second).sum(-1) / 2.0 / (mean + DARK_FLOOR * level).sum(-1)
        spread = np.hypot(local, half)
    relative = (square / (mean**2 + (DARK_FLOOR * level) ** 2))[spread <= np.quantile(spread, BEST_TEXELS)]
    return LightmapErrors(
        texels=len(value),
        rel=_root(relative.mean()),
        nrmse=_root(square.mean()) / float(level),
        p99=float(p99),
        bias=float((value - mean).mean() / level),
    )


def reference_noise(first: np.ndarray, second: np.ndarray) -> float:
    """The `rel` that the mean of both renderings has of its own noise. Raises ValueError where nothing is lit."""
    lit = find_lit(first, second)
    if not lit.any():
        raise ValueError("No texel of the renderings is lit: give the scene a light, or leave it out.")
    first, second = (light[lit].astype(np.float64) for light in (first, second))
    mean, half = (first + second) / 2.0, (first - second) / 2.0
    local = local_differences(first, first, second)
    best = local <= np.quantile(local, BEST_TEXELS)
    return _root((half**2 / (mean**2 + (DARK_FLOOR * mean.mean()) ** 2))[best].mean())


def _root(square: float) -> float:
    return float(np.sqrt(max(square, 0.0)))  # a bake as good as the reference may come out below zero
