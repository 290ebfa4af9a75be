"""Mipmaps of images, of means of the values and of their squares, so that no bright spot is missed.

Source: Williams 1983, "Pyramidal Parametrics".
"""

from dataclasses import replace

import numpy as np

from ..util.arrays import Float32, FloatArray, IntArray
from .scene import TextureImage
from .textures import clamp_colours, sample_texture

_ROWS = 256  # rows of a level made at once, since the squares of a whole image would take much memory
_MOST = np.finfo(np.float32).max


class Mipmap:
    """Mipmap of an image times a colour, (3,), from half size on; levels are made at their first use."""

    def __init__(self, image: TextureImage, rgb: tuple[float, float, float]) -> None:
        self._image = replace(image, closest=False)  # interpolated, since with odd sizes the texels of levels are slightly displaced
        self._shown = image.pixels, np.array(rgb, np.float32)
        self._levels: list[tuple[TextureImage, TextureImage]] = []

    def at(self, level: int, uv: FloatArray) -> tuple[Float32, Float32]:
        """Colours at uv (n, 2) and their squares, (n, 3) each: means over squares of 2 ** level texels; level > 0."""
        while len(self._levels) < level:
            mean, square = (halve(one.pixels) for one in self._levels[-1]) if self._levels else self._halve_image()
            self._levels.append((replace(self._image, pixels=mean), replace(self._image, pixels=square)))
        mean, square = (sample_texture(one, uv) for one in self._levels[level - 1])
        return mean, square

    def _halve_image(self) -> tuple[Float32, Float32]:
        pixels, rgb = self._shown
        edge, parts = _find_edges(len(pixels)), []
        for first in range(0, len(edge) - 1, _ROWS):
            rows = edge[first : first + _ROWS + 1]
            with np.errstate(over="ignore", invalid="ignore"):  # overflowing values are not finite, and count as 0
                shown = clamp_colours(pixels[rows[0] : rows[-1]] * rgb, np.inf)
                squares = np.minimum(shown * shown, _MOST)
            parts.append([_average(values, rows - rows[0]) for values in (shown, squares)])
        mean, square = (np.concatenate(part) for part in zip(*parts, strict=True))
        return mean, square


def halve(pixels: Float32) -> Float32:
    """((height + 1) // 2, (width + 1) // 2, 3) float32: means of four texels of (height, width, 3); with odd sizes some of two or one."""
    return _average(pixels, _find_edges(len(pixels)))


def _find_edges(size: int) -> IntArray:
    """First texels of (size + 1) // 2 blocks of one or two texels, and the end; each starts within half a block of its even share."""
    count = (size + 1) // 2
    return np.arange(count + 1) * size // count


def _average(pixels: Float32, rows: IntArray) -> Float32:
    """Means over blocks of rows, which begin at `rows`, and of columns."""
    for axis, edge in enumerate((rows, _find_edges(pixels.shape[1]))):
        half = pixels.take(edge[:-1], axis)  # mean of the first and the last of a block, which may be the same
        half *= np.float32(0.5)
        half += np.float32(0.5) * pixels.take(edge[1:] - 1, axis)
        pixels = half
    return pixels
