"""One number for the three channels of light, for comparisons of amounts of light."""

import numpy as np

from .arrays import Float64, FloatArray

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # of linear Rec.709. Source: ITU-R BT.709-6, 3.2.


def weigh_channels(rgb: FloatArray) -> Float64:
    """(n,) float64: mean of luminance and channel mean of (n, 3): by luminance alone, a blue light would get too few samples."""
    red, green, blue = np.asarray(rgb, np.float64).T * (0.5 * LUMINANCE + 0.5 / 3)[:, None]  # a matrix product would start threads
    return red + green + blue
