"""Images of 8 bit sRGB, between whose pixels Cycles takes the mean of the bytes, which is darker than that of their light.

Source: Blender, intern/cycles/kernel/device/cpu/image.h and kernel/svm/image.h: what is compressed as sRGB is multiplied by alpha, and
interpolated, before it becomes linear; where the alpha is used, the colour is divided by it in between.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ...core.output.image_file import linear_to_srgb, srgb_to_linear

MOST_FINER, _MOST_PARTS = 1536, 9  # texels on a side of the finer image, and parts on one of a texel
_GAP = 0.002  # half way between texels, relative to the image, that is left
_TABLE_STEPS = 1 << 16
_TABLE = srgb_to_linear(np.arange(_TABLE_STEPS, dtype=np.float32) / np.float32(_TABLE_STEPS - 1))
_TABLE.flags.writeable = False
_ROWS = 128  # of the finer image that are made at once
_MEASURED = 16  # rows of an image by which the light between pixels is measured
_GAUSS = 0.5 - math.sqrt(1.0 / 12.0)  # of the two-point rule on [0, 1]


def refine_srgb(
    pixels: NDArray[np.float32], extension: str, alpha: NDArray[np.float32] | None = None, most_texels: int = MOST_FINER
) -> NDArray[np.float32]:
    """An image with so many more texels that the light between its pixels is Cycles'; as it was where that is as good.

    pixels      (height, width, 3) float32, linear, of bytes
    extension   as of a TextureImage
    alpha       (height, width) float32 by which colours count between pixels
    most_texels   on a side of the finer image
    """
    most = min(_MOST_PARTS, min(most_texels, MOST_FINER) // max(*pixels.shape[:2], 1))
    if most < 3 or extension == "CLIP":
        return pixels
    encoded = linear_to_srgb(pixels)
    parts = math.ceil(math.sqrt(_find_gap(pixels, encoded) / _GAP))
    if parts < 2:
        return pixels
    parts, most = parts | 1, most - 1 + most % 2  # odd, so that the middle of a pixel stays one
    parts = min(parts, most)
    if alpha is not None:
        encoded = np.concatenate([encoded * alpha[..., None], alpha[..., None]], axis=2)
    (row, up), (column, along) = (_place(side, parts, extension == "REPEAT") for side in pixels.shape[:2])
    out = np.empty((len(up), len(along), 3), np.float32)
    for low in range(0, len(up), _ROWS):
        band = slice(low, low + _ROWS)
        between = encoded[row[0, band]] * (1 - up[band, None, None]) + encoded[row[1, band]] * up[band, None, None]
        between = between[:, column[0]] * (1 - along[:, None]) + between[:, column[1]] * along[:, None]
        if alpha is not None:
            between = between[..., :3] / np.where(between[..., 3:] > 0, between[..., 3:], 1)
        _decode(between, out[band])
    return out


def multiply_alpha(pixels: NDArray[np.float32], alpha: NDArray[np.float32], is_encoded: bool) -> NDArray[np.float32]:
    """Colours (h, w, 3) as Cycles shows them of an image whose alpha (h, w) is not used."""
    if not is_encoded:
        return pixels * alpha[..., None]
    return _decode(linear_to_srgb(pixels) * alpha[..., None], np.empty_like(pixels))


def measure_between(stored: NDArray[np.uint8]) -> tuple[float, float, float]:
    """The mean light of Cycles between the pixels of an opaque image, relative to that of the pixels, by some rows of it.

    stored   (height, width, 1, 3 or 4), sRGB; where alpha is not full it does not count
    """
    height, width, channels = stored.shape
    if min(height, width) < 2:
        return 1.0, 1.0, 1.0
    low = np.unique(np.linspace(0, height - 2, _MEASURED).astype(np.int64))
    corner = np.stack([stored[low, :-1], stored[low, 1:], stored[low + 1, :-1], stored[low + 1, 1:]]).reshape(4, -1, channels)
    opaque = np.ones(corner.shape[1], bool) if channels < 4 else (corner[..., 3] == 255).all(axis=0)
    corner = corner[:, opaque, : min(channels, 3)].astype(np.float32) / np.float32(255)
    light = _decode(corner, np.empty_like(corner)).mean(axis=(0, 1), dtype=np.float64) if opaque.any() else np.zeros(min(channels, 3))
    if not light.all():
        return 1.0, 1.0, 1.0
    found = np.zeros_like(light)
    for x in (_GAUSS, 1 - _GAUSS):
        for y in (_GAUSS, 1 - _GAUSS):
            weight = np.array([(1 - x) * (1 - y), x * (1 - y), (1 - x) * y, x * y], np.float32)
            between = np.tensordot(weight, corner, 1)
            found += _decode(between, between).mean(axis=0, dtype=np.float64) / 4
    red, green, blue = np.broadcast_to(found / light, 3).tolist()
    return red, green, blue


def _decode(encoded: NDArray[np.float32], out: NDArray[np.float32]) -> NDArray[np.float32]:
    """Linear light of sRGB values, written to `out`."""
    _TABLE.take((encoded * np.float32(_TABLE_STEPS - 1) + np.float32(0.5)).astype(np.int32), out=out, mode="clip")
    return out


def _place(side: int, parts: int, is_repeated: bool) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """The two texels (2, n) that each of the finer ones lies between, and how far it is from the first (n,)."""
    place = (np.arange(side * parts) + 0.5) / parts - 0.5
    first = np.floor(place).astype(np.int64)
    both = np.stack([first, first + 1])
    return both % side if is_repeated else both.clip(0, side - 1), (place - first).astype(np.float32)


def _find_gap(pixels: NDArray[np.float32], encoded: NDArray[np.float32]) -> float:
    """How much darker it is half way between pixels, along rows or columns, relative to the image; n parts leave 1 / n^2."""
    gaps, mean = [0.0], max(float(pixels.mean(dtype=np.float64)), 1e-6)
    for values, stored in ((pixels, encoded), (pixels.swapaxes(0, 1), encoded.swapaxes(0, 1))):
        if len(values) > 1:
            darker = srgb_to_linear((stored[1:] + stored[:-1]) / 2)
            gaps.append(float(((values[1:] + values[:-1]) / 2 - darker).mean(dtype=np.float64)) / mean)
    return max(gaps)
