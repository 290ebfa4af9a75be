"""Sheen: light that microfibres above a surface scatter, as a linearly transformed cosine lobe.

The lobe is a cosine lobe around the normal whose directions (x, y, z), with x toward the viewer, are mapped to
((x - b z) / a, y / a, z). a, b and its albedo r depend on the view cosine; they were fitted to Cycles' renders of white sheen.

Source: Zeltner, Burley & Chiang 2022, "Practical multiple-scattering sheen using linearly transformed cosines"; Heitz et al. 2016,
"Real-time polygonal-light shading with linearly transformed cosines".
"""

from functools import lru_cache

import numpy as np

from ..util.arrays import Float64, FloatArray

_COSINE = np.array([0.04, 0.1, 0.2, 0.35, 0.5, 0.7, 0.85, 1.0])
_ROUGHNESS = np.linspace(0.2, 1.0, 9)
# (3, roughness, cosine): a, b and r.
_FIT = np.array(
    [
        [
            [0.089, 0.112, 0.137, 0.160, 0.187, 0.240, 0.297, 0.370],
            [0.139, 0.180, 0.232, 0.267, 0.289, 0.323, 0.362, 0.422],
            [0.202, 0.245, 0.307, 0.355, 0.383, 0.415, 0.447, 0.491],
            [0.277, 0.322, 0.385, 0.441, 0.472, 0.506, 0.533, 0.566],
            [0.364, 0.411, 0.473, 0.533, 0.568, 0.601, 0.622, 0.645],
            [0.465, 0.513, 0.571, 0.624, 0.657, 0.688, 0.706, 0.722],
            [0.574, 0.619, 0.671, 0.714, 0.739, 0.761, 0.774, 0.786],
            [0.675, 0.713, 0.756, 0.790, 0.808, 0.823, 0.831, 0.838],
            [0.757, 0.787, 0.822, 0.849, 0.862, 0.872, 0.876, 0.880],
        ],
        [
            [-0.070, -0.006, -0.010, -0.016, -0.028, -0.040, -0.041, -0.005],
            [-0.137, -0.061, -0.023, -0.020, -0.026, -0.038, -0.045, -0.005],
            [-0.166, -0.123, -0.064, -0.035, -0.033, -0.037, -0.039, -0.004],
            [-0.172, -0.148, -0.110, -0.066, -0.048, -0.042, -0.038, -0.004],
            [-0.163, -0.150, -0.125, -0.094, -0.072, -0.050, -0.039, -0.003],
            [-0.143, -0.136, -0.119, -0.097, -0.080, -0.060, -0.043, -0.003],
            [-0.108, -0.104, -0.095, -0.081, -0.070, -0.053, -0.038, -0.003],
            [-0.059, -0.057, -0.054, -0.048, -0.043, -0.034, -0.024, -0.002],
            [0.000, 0.000, 0.000, 0.000, 0.000, 0.000, 0.000, 0.000],
        ],
        [
            [0.492, 0.310, 0.089, 0.010, 0.002, 0.000, 0.000, 0.000],
            [0.572, 0.442, 0.239, 0.075, 0.022, 0.005, 0.002, 0.001],
            [0.608, 0.511, 0.350, 0.173, 0.078, 0.025, 0.011, 0.005],
            [0.629, 0.554, 0.427, 0.266, 0.154, 0.069, 0.037, 0.019],
            [0.645, 0.586, 0.484, 0.345, 0.234, 0.133, 0.084, 0.051],
            [0.662, 0.615, 0.532, 0.413, 0.311, 0.206, 0.148, 0.105],
            [0.682, 0.642, 0.574, 0.473, 0.381, 0.282, 0.223, 0.177],
            [0.704, 0.670, 0.612, 0.524, 0.444, 0.355, 0.302, 0.259],
            [0.727, 0.698, 0.646, 0.568, 0.499, 0.423, 0.379, 0.343],
        ],
    ]
)
_SMOOTH_POWER = 2.5  # power of the roughness that scales r below the least tabulated roughness
_STEPS = 512


@lru_cache(maxsize=256)
def tabulate_sheen(roughness: float, entries: int) -> tuple[Float64, Float64, Float64]:
    """(entries,) each: a, b and r at even steps of the square root of the cosine."""
    cosine = np.linspace(0, 1, entries) ** 2
    place = (min(max(roughness, _ROUGHNESS[0]), 1.0) - _ROUGHNESS[0]) / (_ROUGHNESS[1] - _ROUGHNESS[0])
    low = min(int(place), len(_ROUGHNESS) - 2)
    fit = _FIT[:, low] + (_FIT[:, low + 1] - _FIT[:, low]) * (place - low)
    a, b, r = (np.interp(cosine, _COSINE, values) for values in fit)
    return a, b, r * min(max(roughness, 0.0) / _ROUGHNESS[0], 1.0) ** _SMOOTH_POWER


@lru_cache(maxsize=256)
def average_sheen(roughness: float) -> float:
    """Share of even light from all directions that white sheen reflects."""
    albedo = tabulate_sheen(roughness, _STEPS)[2]
    cosine = np.linspace(0, 1, _STEPS) ** 2
    return float((np.diff(cosine**2) * (albedo[1:] + albedo[:-1]) / 2).sum())


def sample_sheen(view: FloatArray, a: FloatArray, b: FloatArray, numbers: FloatArray) -> FloatArray:
    """(3, n): sampled directions for view (3, n), both around +Z, with density evaluate_sheen times the cosine.

    a, b      (n,) float, at the cosine of view
    numbers   (2, n) float, uniform in [0, 1)
    """
    radius, turn = np.sqrt(numbers[0]), 2 * np.pi * numbers[1]
    z = np.sqrt(np.maximum(1 - numbers[0], 1e-9))
    x, y = (radius * np.cos(turn) - b * z) / a, radius * np.sin(turn) / a
    toward_x, toward_y = _find_azimuth(view)
    out = np.stack([x * toward_x - y * toward_y, x * toward_y + y * toward_x, z])
    return out / np.sqrt((out * out).sum(axis=0))


def evaluate_sheen(view: FloatArray, out: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
    """(n,): density of directions out (3, n) for view (3, n), divided by the cosine of out; both are above the surface.

    Source: Heitz et al. 2016, eq. 3 and 4.
    """
    toward_x, toward_y = _find_azimuth(view)
    x, y = out[0] * toward_x + out[1] * toward_y, out[1] * toward_x - out[0] * toward_y
    length2 = (a * x + b * out[2]) ** 2 + (a * y) ** 2 + out[2] ** 2
    return (a / length2) ** 2 / np.pi


def _find_azimuth(view: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n,) each: x and y of the horizontal part of view (3, n), normalised."""
    length = np.sqrt(view[0] ** 2 + view[1] ** 2)
    upright = length < 1e-7
    length = np.where(upright, 1, length)
    return np.where(upright, 1, view[0] / length), np.where(upright, 0, view[1] / length)
