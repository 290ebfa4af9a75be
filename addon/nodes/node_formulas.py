"""What shader nodes make of colours, as arithmetic on arrays: Cycles' own formulas.

Colours are (..., 3) arrays in linear Rec.709; a number is a colour of three equal channels. Source: Blender, intern/cycles/kernel/svm.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...core.util.brightness import LUMINANCE

Array: TypeAlias = NDArray[Any]


_FIRST_NM, _STEP_NM = 380.0, 10.0
# Response of the standard observer to light of 380, 390, ... 830 nm: CIE 1931, ISO/CIE 11664-1, every second row.
_OBSERVER_X = (
    *(0.001368, 0.004243, 0.01431, 0.04351, 0.13438, 0.2839, 0.34828, 0.3362, 0.2908, 0.19536, 0.09564, 0.03201, 0.0049, 0.0093, 0.06327),
    *(0.1655, 0.2904, 0.43345, 0.5945, 0.7621, 0.9163, 1.0263, 1.0622, 1.0026, 0.85445, 0.6424, 0.4479, 0.2835, 0.1649, 0.0874, 0.04677),
    *(0.0227, 0.011359, 0.00579, 0.002899, 0.00144, 0.00069, 0.000332, 0.000166, 8.3e-5, 4.2e-5, 2.1e-5, 1e-5, 5e-6, 3e-6, 1e-6),
)
_OBSERVER_Y = (
    *(3.9e-5, 0.00012, 0.000396, 0.00121, 0.004, 0.0116, 0.023, 0.038, 0.06, 0.09098, 0.13902, 0.20802, 0.323, 0.503, 0.71, 0.862, 0.954),
    *(0.99495, 0.995, 0.952, 0.87, 0.757, 0.631, 0.503, 0.381, 0.265, 0.175, 0.107, 0.061, 0.032, 0.017, 0.00821, 0.004102, 0.002091),
    *(0.001047, 0.00052, 0.000249, 0.00012, 6e-5, 3e-5, 1.5e-5, 7e-6, 4e-6, 2e-6, 1e-6, 0.0),
)
_OBSERVER_Z = (
    *(0.00645, 0.02005, 0.06785, 0.2074, 0.6456, 1.3856, 1.74706, 1.77211, 1.6692, 1.28764, 0.81295, 0.46518, 0.272, 0.1582, 0.07825),
    *(0.04216, 0.0203, 0.00875, 0.0039, 0.0021, 0.00165, 0.0011, 0.0008, 0.00034, 0.00019, 5e-5, 2e-5, *(0.0,) * 19),
)
_FROM_XYZ = ((3.2404542, -1.5371385, -0.4985314), (-0.969266, 1.8760108, 0.041556), (0.0556434, -0.2040259, 1.0572252))  # IEC 61966-2-1
_SECOND_RADIATION_NM_K = 1.438777e7  # h c / k of Planck's law
_COLDEST_K, _HOTTEST_K = 800.0, 12000.0  # beyond them Cycles shows no other colours


def find_blackbody(kelvin: float) -> tuple[float, float, float]:
    """Colour of a black body, of luminance 1."""
    wavelength = _FIRST_NM + _STEP_NM * np.arange(len(_OBSERVER_X))
    emitted = wavelength**-5.0 / np.expm1(_SECOND_RADIATION_NM_K / (wavelength * min(max(kelvin, _COLDEST_K), _HOTTEST_K)))
    xyz = np.array((_OBSERVER_X, _OBSERVER_Y, _OBSERVER_Z)) @ emitted
    red, green, blue = np.maximum(np.array(_FROM_XYZ) @ (xyz / xyz[1]), 0.0).tolist()
    return red, green, blue


def dim_rough(color: Array, roughness: Array) -> Array:
    """Share of even light that a rough diffuse surface of a colour reflects.

    Source: Oren & Nayar 1994 in the form of Fujii, "A tiny improvement of Oren-Nayar reflectance model", with the energy that facets pass
    to each other given back as in OpenPBR; Blender, intern/cycles/kernel/closure/bsdf_oren_nayar.h.
    """
    sigma, color = np.clip(roughness, 0.0, 1.0), np.clip(color, 0.0, 1.0)
    a = 1.0 / (np.pi + sigma * (np.pi / 2.0 - 2.0 / 3.0))
    single = a * np.pi + (2.0 * np.pi - 5.6) / 3.0 * (sigma * a)
    lost = 1.0 - single
    return color * (single + color**2 * single * lost / (1.0 - color * lost))


def to_grey(color: Array) -> Array:
    """Luminance in all channels."""
    return np.repeat((color @ LUMINANCE.astype(color.dtype))[..., None], 3, axis=-1)


def to_hsv(color: Array) -> Array:
    """Hue, saturation and value of colours."""
    high, low = color.max(axis=-1), color.min(axis=-1)
    chroma = high - low
    safe = np.where(chroma > 0.0, chroma, 1.0)
    red, green, blue = np.moveaxis((high[..., None] - color) / safe[..., None], -1, 0)
    hue = np.where(color[..., 0] == high, blue - green, np.where(color[..., 1] == high, 2.0 + red - blue, 4.0 + green - red)) / 6.0
    saturation = np.where(high != 0.0, chroma / np.where(high != 0.0, high, 1.0), 0.0)
    return np.stack([np.where(chroma > 0.0, hue % 1.0, 0.0), saturation, high], axis=-1)


def from_hsv(hsv: Array) -> Array:
    """Colours of hue, saturation and value."""
    hue, saturation, value = np.moveaxis(hsv, -1, 0)
    ramp = np.abs(((hue % 1.0) * 6.0)[..., None] - np.array((3.0, 2.0, 4.0), hsv.dtype))
    pure = np.clip(ramp * np.array((1.0, -1.0, -1.0), hsv.dtype) + np.array((-1.0, 2.0, 2.0), hsv.dtype), 0.0, 1.0)
    return ((pure - 1.0) * saturation[..., None] + 1.0) * value[..., None]


def shift_hsv(color: Array, hue: Array, saturation: Array, value: Array, fraction: Array) -> Array:
    """The Hue/Saturation/Value node."""
    hsv = to_hsv(color)
    moved = [hsv[..., 0] + hue[..., 0] + 0.5, np.clip(hsv[..., 1] * saturation[..., 0], 0.0, 1.0), hsv[..., 2] * value[..., 0]]
    return np.maximum(lerp(color, from_hsv(np.stack(np.broadcast_arrays(*moved), axis=-1)), fraction), 0.0)


def lerp(a: Array, b: Array, t: Array) -> Array:
    return a + (b - a) * t


def _raise(a: Array, b: Array) -> Array:
    return np.nan_to_num(np.power(a, b), nan=0.0, posinf=0.0, neginf=0.0)


def _divide(a: Array, b: Array) -> Array:
    return np.where(b != 0.0, a / np.where(b != 0.0, b, 1.0), 0.0)


def _logarithm(a: Array, b: Array) -> Array:
    return np.where((a > 0.0) & (b > 0.0), _divide(np.log(np.maximum(a, 1e-30)), np.log(np.maximum(b, 1e-30))), 0.0)


def _overlay(a: Array, b: Array, t: Array) -> Array:
    return np.where(a < 0.5, a * (1.0 - t + 2.0 * t * b), 1.0 - (1.0 - t + 2.0 * t * (1.0 - b)) * (1.0 - a))


def _dodge(a: Array, b: Array, t: Array) -> Array:
    rest = 1.0 - t * b
    lit = np.where(rest <= 0.0, 1.0, np.minimum(a / np.where(rest > 0.0, rest, 1.0), 1.0))
    return np.where(a != 0.0, lit, a)


def _burn(a: Array, b: Array, t: Array) -> Array:
    rest = 1.0 - t + t * b
    return np.where(rest <= 0.0, 0.0, np.clip(1.0 - (1.0 - a) / np.where(rest > 0.0, rest, 1.0), 0.0, 1.0))


def _soften(a: Array, b: Array, t: Array) -> Array:
    return (1.0 - t) * a + t * ((1.0 - a) * b * a + a * (1.0 - (1.0 - b) * (1.0 - a)))


def _take_hsv(*taken: int) -> Callable[[Array, Array, Array], Array]:
    """A blend that takes these of hue, saturation and value from the second colour."""

    def blend(a: Array, b: Array, t: Array) -> Array:
        a, b = np.broadcast_arrays(a, b)
        first, second = to_hsv(a), to_hsv(b)
        mixed = first.copy()
        if 0 in taken:  # a grey has no hue to give
            mixed[..., 0] = second[..., 0]
            if 1 in taken:
                mixed[..., 1] = second[..., 1]
            return np.where((second[..., 1] != 0.0)[..., None], lerp(a, from_hsv(mixed), t), a)
        mixed[..., taken[0]] = lerp(first, second, t)[..., taken[0]]
        kept = (first[..., 1] == 0.0)[..., None] & (taken[0] == 1)
        return np.where(kept, a, from_hsv(mixed))

    return blend


BLEND: dict[str, Callable[[Array, Array, Array], Array]] = {  # by the blend type of a Mix node: two colours, and how much of the second
    "MIX": lerp,
    "ADD": lambda a, b, t: a + b * t,
    "SUBTRACT": lambda a, b, t: a - b * t,
    "MULTIPLY": lambda a, b, t: a * (1.0 - t + t * b),
    "DIVIDE": lambda a, b, t: np.where(b != 0.0, (1.0 - t) * a + t * a / np.where(b != 0.0, b, 1.0), a),
    "DIFFERENCE": lambda a, b, t: lerp(a, np.abs(a - b), t),
    "EXCLUSION": lambda a, b, t: np.maximum(lerp(a, a + b - 2.0 * a * b, t), 0.0),
    "DARKEN": lambda a, b, t: lerp(a, np.minimum(a, b), t),
    "LIGHTEN": lambda a, b, t: lerp(a, np.maximum(a, b), t),
    "SCREEN": lambda a, b, t: 1.0 - (1.0 - t + t * (1.0 - b)) * (1.0 - a),
    "OVERLAY": _overlay,
    "DODGE": _dodge,
    "BURN": _burn,
    "SOFT_LIGHT": _soften,
    "LINEAR_LIGHT": lambda a, b, t: a + t * (2.0 * b - 1.0),
    "HUE": _take_hsv(0),
    "SATURATION": _take_hsv(1),
    "VALUE": _take_hsv(2),
    "COLOR": _take_hsv(0, 1),
}

MATH: dict[str, Callable[..., Array]] = {  # by the operation of a Math node: as many numbers as it has inputs
    "ADD": np.add,
    "SUBTRACT": np.subtract,
    "MULTIPLY": np.multiply,
    "DIVIDE": _divide,
    "MULTIPLY_ADD": lambda a, b, c: a * b + c,
    "POWER": _raise,
    "LOGARITHM": _logarithm,
    "SQRT": lambda a: np.sqrt(np.maximum(a, 0.0)),
    "INVERSE_SQRT": lambda a: np.where(a > 0.0, 1.0 / np.sqrt(np.maximum(a, 1e-30)), 0.0),
    "ABSOLUTE": np.abs,
    "EXPONENT": np.exp,
    "MINIMUM": np.minimum,
    "MAXIMUM": np.maximum,
    "LESS_THAN": lambda a, b: (a < b) * np.ones_like(a),
    "GREATER_THAN": lambda a, b: (a > b) * np.ones_like(a),
    "SIGN": np.sign,
    "ROUND": lambda a: np.floor(a + 0.5),
    "FLOOR": np.floor,
    "CEIL": np.ceil,
    "TRUNC": np.trunc,
    "FRACT": lambda a: a - np.floor(a),
    "MODULO": lambda a, b: np.where(b != 0.0, np.fmod(a, np.where(b != 0.0, b, 1.0)), 0.0),
    "SNAP": lambda a, b: np.floor(_divide(a, b)) * b,
    "SINE": np.sin,
    "COSINE": np.cos,
    "TANGENT": np.tan,
    "RADIANS": np.radians,
    "DEGREES": np.degrees,
}
