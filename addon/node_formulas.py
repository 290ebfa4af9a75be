"""What shader nodes make of colours, as arithmetic on arrays: Cycles' own formulas.

Colours are (..., 3) arrays in linear Rec.709; a number is a colour of three equal channels. Source: Blender, intern/cycles/kernel/svm.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[Any]

LUMINANCE = (0.2126, 0.7152, 0.0722)  # Rec.709

# Fits of a black body's colour: red and green are a / t + b t + c, blue is a cubic; from these temperatures on, kelvin.
_BODY_FROM = (800.0, 965.0, 1167.0, 1449.0, 1902.0, 3315.0, 6365.0, 12000.0)
_BODY_RED = (
    (1.61919106e03, -2.05010916e-03, 5.02995757e00),
    (2.48845471e03, -1.11330907e-03, 3.22621544e00),
    (3.34143193e03, -4.86551192e-04, 1.76486769e00),
    (4.09461742e03, -1.27446582e-04, 7.25731635e-01),
    (4.67028036e03, 2.91258199e-05, 1.26703442e-01),
    (4.59509185e03, 2.87495649e-05, 1.50345020e-01),
    (3.78717450e03, 9.35907826e-06, 3.99075871e-01),
)
_BODY_GREEN = (
    (-4.88999748e02, 6.04330754e-04, -7.55807526e-02),
    (-7.55994277e02, 3.16730098e-04, 4.78306139e-01),
    (-1.02363977e03, 1.20223470e-04, 9.36662319e-01),
    (-1.26571316e03, 4.87340896e-06, 1.27054498e00),
    (-1.42529332e03, -4.01150431e-05, 1.43972784e00),
    (-1.17554822e03, -2.16378048e-05, 1.30408023e00),
    (-5.00799571e02, -4.59832026e-06, 1.09098763e00),
)
_BODY_BLUE = (
    (5.96945309e-11, -4.85742887e-08, -9.70622247e-05, -4.07936148e-03),
    (2.40430366e-11, 5.55021075e-08, -1.98503712e-04, 2.89312858e-02),
    (-1.40949732e-11, 1.89878968e-07, -3.56632824e-04, 9.10767778e-02),
    (-3.61460868e-11, 2.84822009e-07, -4.93211319e-04, 1.56723440e-01),
    (-1.97075738e-11, 1.75359352e-07, -2.50542825e-04, -2.22783266e-02),
    (-1.61997957e-13, -1.64216008e-08, 3.86216271e-04, -7.38077418e-01),
    (6.72650283e-13, -2.73078809e-08, 4.24098264e-04, -7.52335691e-01),
)
_COLDEST, _HOTTEST = (5.413294490189271, 0.0, 0.0), (0.8262954810464208, 0.9945080501520986, 1.566307710274283)


def find_blackbody(kelvin: float) -> tuple[float, float, float]:
    """Colour of a black body, of luminance 1."""
    part = int(np.searchsorted(_BODY_FROM, kelvin, side="right")) - 1
    if part < 0 or part >= len(_BODY_RED):
        return _COLDEST if part < 0 else _HOTTEST
    red, green = (float(a / kelvin + b * kelvin + c) for a, b, c in (_BODY_RED[part], _BODY_GREEN[part]))
    return max(red, 0.0), max(green, 0.0), max(float(np.polyval(_BODY_BLUE[part], kelvin)), 0.0)


def to_grey(color: Array) -> Array:
    """Luminance in all channels."""
    return np.repeat((color @ np.array(LUMINANCE, color.dtype))[..., None], 3, axis=-1)


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
