"""Blender images -> linear Rec.709 textures, each read once."""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable
from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...core.output.image_file import srgb_to_linear
from ...core.scene.scene import TextureImage
from .image_files import ImageFiles, ImagePixels
from .image_parts import find_cell, open_frame, open_tile
from .srgb_filtering import multiply_alpha, refine_srgb

MAX_TEXTURE_SIDE_TEXELS = 4096
_MOST_REFINED = 1 << 24  # texels of all images that are refined
_SHARPEST = 4  # times as many texels a side are read of an image as a page has; a finer image than the page is not refined
_EXTENSIONS = ("REPEAT", "EXTEND", "CLIP", "MIRROR")
_LEAST_DARKER = 0.002  # the light between pixels that is cared for
_APART = ("CHANNEL_PACKED", "NONE")  # of colours that alpha has nothing to do with


class ImageTable:
    """The textures of a snapshot; one for each image and way of using it.

    most_texels   on a side of them, which are reduced to that
    is_refined    coarse ones get more texels, so that they are between their own what Cycles has there
    """

    def __init__(self, most_texels: int = MAX_TEXTURE_SIDE_TEXELS, is_refined: bool = True) -> None:
        self._room_for_refined = _MOST_REFINED if is_refined else 0
        self.most_texels = min(most_texels, MAX_TEXTURE_SIDE_TEXELS)
        self.files = ImageFiles(self.most_texels)
        self.images: list[TextureImage] = []
        self._index: dict[tuple[int, int, str, bool, str, bool], int] = {}
        self._derived: dict[Hashable, int] = {}
        self.derived_texels = 0
        self._pixels: dict[tuple[int, int], ImagePixels | None] = {}

    def read(self, image: Any, frame: int) -> ImagePixels | None:
        """The image's pixels, of a sequence those of a frame; None where its file is missing or it has none."""
        key = (image.session_uid, frame)
        if key not in self._pixels:
            self._pixels[key] = _read_whole(image, frame, self.most_texels, self.files)
        return self._pixels[key]

    def add(self, image: TextureImage) -> int:
        """Where an image that is not one of Blender's is in `images`."""
        self.images.append(image)
        return len(self.images) - 1

    def find_derived(self, key: Hashable) -> int | None:
        """Where an image that was made of others is in `images`."""
        return self._derived.get(key)

    def add_derived(self, key: Hashable, image: TextureImage) -> int:
        """Where an image made of others is in `images` from now on."""
        self._derived[key] = self.add(image)
        self.derived_texels += image.pixels.shape[0] * image.pixels.shape[1]
        return self._derived[key]

    def keep(self, used: Iterable[int]) -> dict[int, int]:
        """Leave out the images that no material shows, such as those between two nodes; gives where the others are now."""
        place = {index: number for number, index in enumerate(sorted(set(used)))}
        self.images = [self.images[index] for index in place]
        return place

    def index(self, image: Any, frame: int, extension: str, closest: bool, output: str = "Color", uses_alpha: bool = False) -> int:
        """Where what an output shows of the image is in `images`; it must have been read.

        uses_alpha   whether the node's output Alpha is used, without which Cycles shows colours multiplied by it
        """
        extension = extension if extension in _EXTENSIONS else "REPEAT"
        key = (image.session_uid, frame, extension, closest, output, uses_alpha)
        if key not in self._index:
            pixels = self._pixels[image.session_uid, frame]
            assert pixels is not None
            self._index[key] = len(self.images)
            if output == "Alpha" and pixels.alpha is not None:
                shown = np.repeat(pixels.alpha[..., None], 3, axis=2)
            else:
                is_apart = image.alpha_mode in _APART or image.colorspace_settings.is_data
                shown = self._show_color(pixels, extension, closest, None if is_apart else pixels.alpha, uses_alpha)
            self.images.append(TextureImage(image.name, shown, extension, closest))
        return self._index[key]

    def _show_color(
        self, pixels: ImagePixels, extension: str, closest: bool, alpha: NDArray[np.float32] | None, uses_alpha: bool
    ) -> NDArray[np.float32]:
        """The colours that Cycles shows, (h, w, 3); alpha (h, w) is what they are multiplied by."""
        color = pixels.pixels
        if alpha is not None and pixels.is_associated and uses_alpha:
            return color / np.where(alpha == 0.0, np.float32(1.0), alpha)[..., None]
        if alpha is not None and not (pixels.is_associated or uses_alpha):
            color, alpha = multiply_alpha(color, alpha, pixels.is_encoded), None
        if closest or not pixels.is_encoded:
            return color
        is_reduced = 2 * max(color.shape[:2]) > self.most_texels  # or may be
        most = self.most_texels // _SHARPEST
        shown = color if is_reduced or self._room_for_refined <= 0 else refine_srgb(color, extension, alpha, most)
        if shown is not color:
            self._room_for_refined -= shown.shape[0] * shown.shape[1]
        elif min(pixels.between_rgb) < 1.0 - _LEAST_DARKER:
            shown = color * np.float32(pixels.between_rgb)
        return shown


def read_pixels(image: Any, most_texels: int = 0) -> ImagePixels | None:
    """Pixels of a Blender image of one file, None when there are none to be had.

    most_texels   on a side, it is reduced to; 0: as many as any texture may have
    """
    most_texels = most_texels or MAX_TEXTURE_SIDE_TEXELS
    was_loaded = image.has_data
    width, height = image.size
    if not width or not height or len(image.pixels) != width * height * image.channels:
        return None
    flat = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(flat)
    if not was_loaded and not image.is_dirty and image.source == "FILE":
        image.buffers_free()  # memory as it was
    stored = flat.reshape(height, width, image.channels)
    space = image.colorspace_settings.name
    # byte pixels come as they are stored; float pixels come linear already, whatever their file held
    encoded = not image.is_float and not image.colorspace_settings.is_data and "Linear" not in space
    note = ""
    if encoded and space != "sRGB":
        note = f"colour space {space} of image {image.name} is read as sRGB"
    elif not encoded and not image.is_float and not image.colorspace_settings.is_data and space != "Linear Rec.709":
        note = f"colour space {space} of image {image.name} is read as Linear Rec.709"
    if not image.is_float and image.channels in (1, 3, 4):
        np.multiply(flat, np.float32(255.0), out=flat)
        made = ImagePixels.of_bytes(np.rint(flat, out=flat).astype(np.uint8).reshape(stored.shape), encoded, True, most_texels, note)
        return replace(made, is_encoded=space == "sRGB")
    opaque = np.nan_to_num(stored[..., 3]) if image.channels == 4 and stored[..., 3].min() < 1.0 else None
    color = stored[..., :3] if image.channels >= 3 else np.repeat(stored[..., :1], 3, axis=2)
    color = np.nan_to_num(color, nan=0.0, posinf=0.0, neginf=0.0)
    if encoded:
        color = srgb_to_linear(color)
    coverage = None if opaque is None else _reduce(opaque[..., None], most_texels)[..., 0]
    return replace(ImagePixels.of(_reduce(color, most_texels), coverage, note), is_associated=image.is_float)


def _read_whole(image: Any, frame: int, most_texels: int, files: ImageFiles) -> ImagePixels | None:
    """Pixels of an image, all of its tiles, or a frame of it."""
    if image.source == "SEQUENCE":
        with open_frame(image, frame) as one:
            return read_pixels(one, most_texels)
    if image.source == "TILED" and len(image.tiles) > 1:
        return _read_tiles(image, most_texels)
    found = files.take(image)
    return read_pixels(image, most_texels) if found is None else found


def _read_tiles(image: Any, most: int) -> ImagePixels | None:
    """UDIM tiles side by side as one image, in the size of the largest; the mean where there is none."""
    cells, found, lost = [find_cell(tile.number) for tile in image.tiles], {}, ""
    low, high = np.min(cells, axis=0), np.max(cells, axis=0)
    columns, rows = (int(n) for n in high - low + 1)
    most_texels = max(int(most / math.sqrt(columns * rows)), 1)  # all of them are as large as one image
    for number, (tile, cell) in enumerate(zip(image.tiles, cells, strict=True)):
        opened = open_tile(image, tile.number) if number else nullcontext(image)  # the first one's are handed out as they are painted
        with opened as one:
            pixels = read_pixels(one, most_texels)
        if pixels is None:
            lost = lost or f"tile {tile.number} of image {image.name} is missing, the mean of the others is used"
        else:
            found[cell] = pixels
    if not found:
        return None
    mean = np.mean([one.mean for one in found.values()], axis=0)
    height, width = np.max([one.pixels.shape[:2] for one in found.values()], axis=0)
    stored = np.tile(mean.astype(np.float32), (rows * height, columns * width, 1))
    for (column, row), one in found.items():
        place = stored[(row - low[1]) * height :, (column - low[0]) * width :][:height, :width]
        up, aside = (np.arange(n) * have // n for n, have in zip((height, width), one.pixels.shape[:2], strict=True))
        place[..., :3] = one.pixels[up][:, aside]
        place[..., 3] = 1.0 if one.alpha is None else one.alpha[up][:, aside]
    alpha = stored[..., 3].copy() if stored[..., 3].min() < 1.0 else None
    unsaved = f"what was painted on tiles of image {image.name} counts from when it is saved" if image.is_dirty else ""
    note = lost or unsaved or next((one.note for one in found.values() if one.note), "")
    red, green, blue, opaque = (float(x) for x in mean)
    grid = (int(low[0]), int(low[1]), columns, rows)
    made = ImagePixels(np.ascontiguousarray(stored[..., :3]), alpha, (red, green, blue, opaque), note, grid)
    ways = [(one.is_encoded, one.is_associated) for one in found.values()]
    encoded, associated = (all(way) for way in zip(*ways, strict=True))
    red, green, blue = np.mean([one.between_rgb for one in found.values()], axis=0).tolist()
    return replace(made, is_encoded=encoded, is_associated=associated, between_rgb=(red, green, blue))


def find_sphere_mean(pixels: NDArray[np.float32]) -> NDArray[np.float64]:
    """(3,) mean radiance of an equirectangular picture, rows weighted by solid angle."""
    height = len(pixels)
    weight = np.cos((np.arange(height) + 0.5) / height * np.pi - np.pi / 2)
    mean: NDArray[np.float64] = weight @ pixels.mean(axis=1, dtype=np.float64) / weight.sum()
    return mean


def _reduce(color: NDArray[np.float32], most_texels: int) -> NDArray[np.float32]:
    """Averages of whole blocks, so that no side is above most_texels; an incomplete last block is averaged too."""
    for axis in (0, 1):
        side = color.shape[axis]
        block = -(-side // most_texels)
        if block > 1:
            start = np.arange(0, side, block)
            count = np.minimum(start + block, side) - start
            color = np.add.reduceat(color, start, axis=axis) / count.reshape((-1, 1, 1) if axis == 0 else (1, -1, 1)).astype(np.float32)
    return np.ascontiguousarray(color, np.float32)
