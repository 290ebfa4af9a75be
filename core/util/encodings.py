"""Encodings of colours brighter than 1 in four bytes, for engines without float textures: RGBM, RGBD and LogLuv.

All encode linear light. Decoding RGBM and RGBD needs the range they were made with; a GPU may filter their bytes, with small errors where
the multiplier changes from texel to texel. LogLuv needs no range, but splits a number over two bytes, so it must be decoded before it is
filtered. Shader code and error bounds: docs/output.md.
"""

import numpy as np
from numpy.typing import NDArray

from .arrays import Float32, Float64, FloatArray

ENCODINGS = ("rgbm", "rgbd", "logluv")
LOGLUV_MAX = 2.0 ** (32767.5 / 256.0 - 64.0)  # the greatest luminance that LogLuv can encode

_STEPS = 255.0
_LEAST_RANGE = 1e-9  # of a black page: any range decodes it
_LOG_SCALE, _LOG_OFFSET = 256.0, 64.0
_LOG_CODES = 1 << 15
_UV_SCALE = 410.0
_TINY = 1e-30
# Linear Rec.709 to XYZ, white D65. Source: ITU-R BT.709-6; SMPTE RP 177-1993 makes the matrix from its chromaticities.
_XYZ_OF_RGB = np.array(
    [
        [0.4123907992659595, 0.3575843393838780, 0.1804807884018343],
        [0.2126390058715103, 0.7151686787677559, 0.0721923153607337],
        [0.0193308187155918, 0.1191947797946260, 0.9505321522496608],
    ]
)
_RGB_OF_XYZ = np.linalg.inv(_XYZ_OF_RGB)


def find_range(rgb: FloatArray) -> float:
    """The range of RGBM and RGBD for an image: its greatest value, rounded up to four digits, and never 0.

    rgb   (..., 3) float, linear
    """
    greatest = max(float(rgb.max(initial=0.0)), _LEAST_RANGE)
    rounded = float(f"{greatest:.4g}")
    return rounded if rounded >= greatest else float(f"{greatest * 1.0005:.4g}")


def encode(rgb: FloatArray, encoding: str, value_range: float) -> NDArray[np.uint8]:
    """Encode colours in four bytes each. Negative values become 0; values beyond the range are clipped to it.

    rgb           (..., 3) float, linear
    value_range   greatest value of RGBM and RGBD; LogLuv ignores it
    out           (..., 4) uint8
    Raises ValueError for an unknown encoding and a range that is not above 0.
    """
    _check(encoding, value_range)
    colour = np.maximum(np.asarray(rgb, np.float64), 0.0)
    if encoding == "logluv":
        return _encode_logluv(colour)
    unit = np.minimum(colour / value_range, 1.0)
    brightest = unit.max(-1, keepdims=True)
    if encoding == "rgbm":
        step = np.clip(np.ceil(brightest * _STEPS), 1.0, _STEPS)
        scaled = unit / step * _STEPS
    else:
        step = np.clip(np.floor(1.0 / np.maximum(brightest, 1.0 / _STEPS)), 1.0, _STEPS)
        scaled = unit * step
    stored = np.concatenate([np.rint(np.minimum(scaled, 1.0) * _STEPS), step], axis=-1)
    return np.asarray(stored, np.uint8)


def decode(stored: NDArray[np.uint8], encoding: str, value_range: float) -> Float32:
    """The linear colours that `encode` stored.

    stored        (..., 4) uint8
    value_range   that of encode
    out           (..., 3) float32
    Raises ValueError for an unknown encoding and a range that is not above 0.
    Source: RGBM: B. Karis, "RGBM color encoding", 2009. RGBD: three.js' RGBDToLinear, to release 135. LogLuv, 32 bits: G. Ward
    Larson, "LogLuv Encoding for Full-Gamut, High-Dynamic Range Images", Journal of Graphics Tools 3(1), 1998.
    """
    _check(encoding, value_range)
    if encoding == "logluv":
        return _decode_logluv(stored)
    colour = stored[..., :3] / _STEPS
    last = np.maximum(stored[..., 3:], 1).astype(np.float64)
    linear = colour * (last / _STEPS) * value_range if encoding == "rgbm" else colour / last * value_range
    return np.asarray(linear, np.float32)


def _check(encoding: str, value_range: float) -> None:
    if encoding not in ENCODINGS:
        raise ValueError(f"encoding: expected one of {', '.join(ENCODINGS)}, got {encoding!r}")
    if not 0.0 < value_range < np.inf:
        raise ValueError(f"range: expected a number above 0, got {value_range:g}")


def _encode_logluv(rgb: Float64) -> NDArray[np.uint8]:
    """Bytes: high and low byte of the log luminance, u', v'. The top bit, the sign of the luminance, is 0."""
    xyz = np.minimum(rgb, LOGLUV_MAX) @ _XYZ_OF_RGB.T
    luminance = xyz[..., 1]
    weight = np.maximum(xyz @ [1.0, 15.0, 3.0], _TINY)
    code = np.floor(_LOG_SCALE * (np.log2(np.maximum(luminance, _TINY)) + _LOG_OFFSET))
    code = np.clip(code, 0, _LOG_CODES - 1).astype(np.int64)  # code 0 is black
    u, v = (np.clip(np.floor(_UV_SCALE * part / weight), 0.0, _STEPS) for part in (4.0 * xyz[..., 0], 9.0 * luminance))
    return np.asarray(np.stack([code >> 8, code & 255, u, v], -1), np.uint8)


def _decode_logluv(stored: NDArray[np.uint8]) -> Float32:
    code = (stored[..., 0].astype(np.int64) & 127) << 8 | stored[..., 1]
    luminance = np.where(code > 0, 2.0 ** ((code + 0.5) / _LOG_SCALE - _LOG_OFFSET), 0.0)
    u, v = ((stored[..., channel] + 0.5) / _UV_SCALE for channel in (2, 3))
    x, z = 9.0 * u / (4.0 * v), (12.0 - 3.0 * u - 20.0 * v) / (4.0 * v)
    rgb = np.stack([x, np.ones_like(x), z], -1) * luminance[..., None] @ _RGB_OF_XYZ.T
    return np.asarray(np.maximum(rgb, 0.0), np.float32)  # rounded chromaticities may lie slightly outside of Rec.709
