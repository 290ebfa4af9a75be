"""Baked images as 8 bit textures of a glTF file."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from ...core.output.image_file import linear_to_srgb
from ..nodes.images_read import read_pixels
from ..show.image_views import save_view


def write_texture(image: bpy.types.Image, path: Path, own_range: bool) -> tuple[bpy.types.Image, float]:
    """A new image from the PNG `path`, sRGB of the light over a range, and that range: 1, or the brightest of the light.

    Raises ValueError with a sentence when the image has no pixels.
    """
    read = read_pixels(image)
    if read is None:
        raise ValueError(f"{image.name}: its file {bpy.path.abspath(image.filepath)} is missing; bake again.")
    light = np.maximum(read.pixels, 0.0)
    value_range = float(max(light.max(initial=0.0), np.float32(1e-6))) if own_range else 1.0
    height, width = light.shape[:2]
    pixels = np.ones((height, width, 4), np.float32)
    pixels[..., :3] = linear_to_srgb(np.minimum(light / np.float32(value_range), 1.0))
    texture = bpy.data.images.new(path.stem, width, height, alpha=False, float_buffer=False)
    texture.pixels.foreach_set(pixels.ravel())
    texture.filepath_raw, texture.file_format = str(path), "PNG"
    texture.save()
    return texture, value_range


def write_view(image: bpy.types.Image, path: Path, scene: bpy.types.Scene) -> bpy.types.Image:
    """A new image from the PNG `path`, as the scene's colour management shows it."""
    save_view(image, path, scene)
    return bpy.data.images.load(str(path), check_existing=False)
