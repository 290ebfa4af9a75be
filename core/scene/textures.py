"""Texture look-up in many images at once, since numpy is slow on short arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..util.arrays import FloatArray, IntArray
from ..util.geometry import gather
from .scene import TextureImage

_BLACK = np.zeros((1, 1, 3), np.float32)


class Textures:
    """Images in groups with the same extension and interpolation; each group is looked up at once.

    Texel (x, y) has its centre at ((x + 0.5) / width, (y + 0.5) / height), as in Blender. An image without texels is black.
    """

    def __init__(self, images: Sequence[TextureImage]) -> None:
        groups: dict[tuple[str, bool], list[int]] = {}
        for number, image in enumerate(images):
            groups.setdefault((image.extension, image.closest), []).append(number)
        self._group, self._member = np.zeros((2, len(images)), np.intp)
        for group, numbers in enumerate(groups.values()):
            self._group[numbers], self._member[numbers] = group, np.arange(len(numbers))
        self._joined = [_Joined.of([images[number] for number in numbers]) for numbers in groups.values()]

    def at(self, image: IntArray, uv: FloatArray) -> NDArray[np.float32]:
        """Colours of images (n,) int.

        uv    (n, 2) float; values that are not finite count as 0
        out   (n, 3) float32; its transpose is contiguous
        """
        member = gather(self._member, image)
        if len(self._joined) == 1:
            return self._joined[0].at(member, uv)
        rgb = np.empty((3, len(image)), np.float32)
        group = gather(self._group, image)
        for number in np.bincount(group).nonzero()[0].tolist():
            own = (group == number).nonzero()[0]
            for channel, values in zip(rgb, self._joined[number].at(gather(member, own), uv[own]).T, strict=True):
                channel[own] = values
        return rgb.T


def sample_texture(image: TextureImage, uv: FloatArray) -> NDArray[np.float32]:
    """Colours of one image; uv and result are as for Textures.at."""
    return Textures([image]).at(np.zeros(len(uv), np.intp), uv)


@dataclass(frozen=True)
class _Joined:
    """A group of images with the same extension and interpolation.

    pixels        (k,) float32: all images, flattened and concatenated
    size          (2, n_image) float32: width and height
    column, row   (2, c) and (2, r) int: _neighbours of all images, concatenated, as offsets: column plus row is the index of a texel's
                  first channel in `pixels`; negative for no texel
    start         (2, n_image) int: index of each image's first entry in `column` and in `row`
    """

    extension: str
    closest: bool
    pixels: NDArray[np.float32]
    size: NDArray[np.float32]
    column: IntArray
    row: IntArray
    start: IntArray

    @classmethod
    def of(cls, images: Sequence[TextureImage]) -> _Joined:
        pictures = [image.pixels if image.pixels.size else _BLACK for image in images]
        pixels, first = lay_together(pictures)
        size = np.array([[picture.shape[1], picture.shape[0]] for picture in pictures]).T
        extension, columns, rows = images[0].extension, [], []
        for begin, (width, height) in zip(first, size.T.tolist(), strict=True):
            columns.append(3 * _neighbours(width, extension))
            row = 3 * width * _neighbours(height, extension)
            rows.append(np.where(row < 0, row, row + begin))
        lengths = np.array([[part.shape[1] for part in parts] for parts in (columns, rows)])
        return cls(
            extension=extension,
            closest=images[0].closest,
            pixels=pixels,
            size=size.astype(np.float32),
            column=np.concatenate(columns, axis=1),
            row=np.concatenate(rows, axis=1),
            start=np.cumsum(lengths, axis=1) - lengths,
        )

    def at(self, member: IntArray, uv: FloatArray) -> NDArray[np.float32]:
        """As Textures.at; member (n,) int: indices within the group."""
        place = uv.T if are_finite(uv) else np.where(np.isfinite(uv), uv, 0).T
        is_alone = self.size.shape[1] == 1
        size = self.size if is_alone else gather(self.size, member)
        if self.extension == "REPEAT":
            place = place - np.floor(place)
            place *= size
        elif self.extension == "MIRROR":
            place = size * (place - 2.0 * np.floor(place / 2.0))
        else:
            place = np.clip(size * place, -0.5, size + 0.5)
        place += 1 if self.closest else 0.5  # _neighbours counts from the texel before the image
        low = np.floor(place)
        x, y = low.astype(np.intp) if is_alone else low.astype(np.intp) + gather(self.start, member)
        column, row = gather(self.column, x), gather(self.row, y)
        place -= low
        share = np.empty((2, *place.shape), np.float32)  # weights of both neighbours, by axis
        np.subtract(1, place, out=share[0], casting="same_kind")
        share[1] = place
        if self.closest:
            column, row, share = column[:1], row[:1], np.ones_like(share[:1])
        if self.extension == "CLIP":
            share *= np.stack([column, row], axis=1) >= 0
        return self._weigh(row[:, None] + column, share[:, 1, None] * share[:, 0])

    def _weigh(self, first: IntArray, weight: NDArray[np.float32]) -> NDArray[np.float32]:
        """(n, 3) view of rows: weighted sums of the texels at indices first (i, j, n) in `pixels`."""
        rgb = np.empty((3, *first.shape), np.float32)
        for channel, values in enumerate(rgb):  # four times as fast as whole texels of 12 bytes each
            self.pixels[channel:].take(first, out=values, mode="wrap")
        out: NDArray[np.float32] = np.einsum("cijn,ijn->cn", rgb, weight)
        return out.T


def lay_together(pictures: Sequence[NDArray[np.float32]]) -> tuple[NDArray[np.float32], list[int]]:
    """The arrays concatenated to one, (k,), and the start of each. Arrays that are parts of one array are not copied."""
    whole = pictures[0].base
    if len(pictures) == 1:
        return pictures[0].reshape(-1), [0]
    if whole is not None and whole.ndim == 1 and all(picture.base is whole and picture.flags.c_contiguous for picture in pictures):
        return whole, [(picture.ctypes.data - whole.ctypes.data) // whole.itemsize for picture in pictures]
    lengths = [picture.size for picture in pictures]
    return np.concatenate([picture.reshape(-1) for picture in pictures]), (np.cumsum(lengths) - lengths).tolist()


@lru_cache(maxsize=64)
def _neighbours(size: int, extension: str) -> IntArray:
    """(2, k) int: column e has the texels at e - 1 and e, between whose centres a coordinate may lie, after extension; -1 for none."""
    texel = np.arange(-1, (2 if extension == "MIRROR" else 1) * size + 2)
    if extension == "REPEAT":
        texel %= size
    elif extension == "MIRROR":
        texel = np.minimum(texel % (2 * size), 2 * size - 1 - texel % (2 * size))
    elif extension == "EXTEND":
        texel = texel.clip(0, size - 1)
    else:
        texel[texel >= size] = -1
    return np.stack([texel[:-1], texel[1:]])


def clamp_colours(values: FloatArray, highest: float) -> FloatArray:
    """Colours clamped to 0 ... highest; 0 where they are not finite."""
    clamped: FloatArray = np.maximum(values if are_finite(values) else np.where(np.isfinite(values), values, 0), 0)
    return np.minimum(clamped, np.float32(highest), out=clamped)


def are_finite(values: FloatArray) -> bool:
    """Whether all values are finite; twice as fast as with the method `all`."""
    return bool(np.logical_and.reduce(np.isfinite(values), axis=None))
