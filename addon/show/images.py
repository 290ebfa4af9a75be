"""Baked pages as Blender images: loaded from their files, or filled with pixels for a live preview."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.util.settings import DEBUG_PASSES, Settings
from ..read.tags import is_made, mark_made, remove_blocks
from .page_store import find_folder, read_digest

PAGE = "leaflight_page"  # on an image of a file that a bake may write over: digest of its content
COLOR_SPACE_OF_SUFFIX = {".exr": "Linear Rec.709", ".hdr": "Linear Rec.709", ".png": "sRGB"}


def find_shown_format(settings: Settings) -> str:
    """The first kind of file asked for that materials can show, "" none: encoded files mean nothing to them.

    A file that went through a view transform would go through it again. Of a debug pass the picture is shown, where there is one.
    """
    if settings.passes[0] in DEBUG_PASSES and "png" in settings.formats:
        return "png"
    shown = {"exr", "hdr"} | ({"png"} if settings.view_transform == "standard" else set())
    return next((kind for kind in settings.formats if kind in shown), "")


def check_shown(settings: Settings) -> None:
    """Raises ValueError with a sentence when no file of the bake could be shown on the objects."""
    if not find_shown_format(settings):
        kinds = ", ".join(kind.upper() for kind in settings.formats)
        why = "after a view transform " if "png" in settings.formats else ""
        raise ValueError(f"formats: Blender's materials cannot show {kinds} {why}as light; add EXR to the formats.")


def load_image(path: str | Path, name: str = "", pack: bool = False) -> bpy.types.Image:
    """The image of a baked file; the one we loaded before is read again. Its path is relative where the .blend is saved.

    pack   keep the file's bytes in the .blend

    Raises ValueError with a sentence when the file is missing or of an unknown kind.
    """
    path = Path(path).resolve()
    color_space = COLOR_SPACE_OF_SUFFIX.get(path.suffix.lower())
    if color_space is None:
        raise ValueError(f"{path.name}: is not an EXR, HDR or PNG file; choose one of these formats and bake again.")
    if not path.is_file():
        raise ValueError(f"{path}: the baked image is missing; bake again.")
    image = _find_loaded(path)
    if image is None:
        image = bpy.data.images.load(str(path), check_existing=False)
        mark_made(image)
    elif image.packed_file:
        image.unpack(method="REMOVE")  # else it would not look at the file again
    _give_name(image, name or path.stem, path)
    image[PAGE] = read_digest(path)
    image.filepath = relative_path(path)  # reads the file again, too
    image.colorspace_settings.name = color_space
    image.alpha_mode = "CHANNEL_PACKED"  # alpha is coverage and must not scale the light
    if pack:
        image.pack()
    return image


def preview_image(name: str, width: int, height: int) -> bpy.types.Image:
    """A generated float image in linear Rec.709 for set_pixels."""
    image = bpy.data.images.new(name, width, height, alpha=True, float_buffer=True)
    image.colorspace_settings.name = "Linear Rec.709"  # before any pixels: setting it later zeroes them
    image.alpha_mode = "CHANNEL_PACKED"
    mark_made(image)
    return image


def set_pixels(image: bpy.types.Image, page: NDArray[np.floating[Any]]) -> None:
    """Shows a page in a generated image.

    page   (height, width, 3 or 4) float, row 0 at the bottom
    Raises ValueError when the page's shape is not the image's.
    """
    width, height = image.size
    if page.shape[:2] != (height, width) or page.shape[2:] not in ((3,), (4,)):
        raise ValueError(f"{image.name}: expected pixels of shape ({height}, {width}, 4), got {page.shape}")
    pixels = np.ones((height, width, 4), dtype=np.float32)
    pixels[..., : page.shape[2]] = page
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    if not follows_images(bpy.context.window_manager.windows):
        image.update_tag()


def remove_unused_images() -> None:
    """Deletes our images that at most an open editor shows; their files stay."""
    made = [image for image in bpy.data.images if is_made(image)]
    users_of = bpy.data.user_map(subset=made) if made else {}
    unused = [image for image in made if not image.use_fake_user and all(isinstance(user, bpy.types.Screen) for user in users_of[image])]
    remove_blocks(unused)


def is_overexposed(image: bpy.types.Image) -> bool:
    """Whether more than half of what a page shows is brighter than white."""
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    pixels = pixels.reshape(-1, image.channels)
    covered = pixels[:, 3] > 0.0 if image.channels == 4 else slice(None)
    brightest = pixels[covered, :3].max(axis=1)
    return brightest.size > 0 and float(np.median(brightest)) > 1.0


def follows_images(windows: Iterable[bpy.types.Window]) -> bool:
    """Whether every view of these windows draws an image anew by itself when its pixels change.

    One that has finished its samples does not, until something is tagged; only EEVEE's does, from Blender 5.2 at the latest on.
    There a tag has it make all its shadows anew, which takes several times as long as the picture.
    """
    views = [(area.spaces.active, window.scene) for window in windows for area in window.screen.areas if area.type == "VIEW_3D"]
    shown = [(space.shading.type, scene.render.engine) for space, scene in views]
    return bpy.app.version >= (5, 2, 0) and all(
        kind == "MATERIAL" or (kind, engine) == ("RENDERED", "BLENDER_EEVEE") for kind, engine in shown
    )


def find_path(image: bpy.types.Image) -> Path:
    """Where the file of an image is; links that lead in a ring are left as they are."""
    return Path(os.path.realpath(bpy.path.abspath(image.filepath, library=image.library)))


def _find_loaded(path: Path) -> bpy.types.Image | None:
    for image in bpy.data.images:
        if is_made(image) and image.source == "FILE" and not image.library and find_path(image) == path:
            return image
    return None


def _give_name(image: bpy.types.Image, name: str, path: Path) -> None:
    """The earlier image of the same file, which the new bake is about to replace, makes room for it."""
    holder = bpy.data.images.get(name)
    if holder not in (None, image) and is_made(holder) and find_folder(find_path(holder)) == find_folder(path):
        holder.name = f"{name}.earlier"
    image.name = name


def relative_path(path: Path) -> str:
    """Blender's // path where there is one: the .blend is saved, and on Windows on the same drive."""
    blend = bpy.data.filepath
    if not blend or os.path.splitdrive(blend)[0].lower() != path.drive.lower():
        return str(path)
    return str(bpy.path.relpath(str(path)))
