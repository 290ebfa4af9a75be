"""Baked light as the scene's colour management shows it: view transform, look, exposure and curves, in an 8 bit file."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

import bpy


def save_file_view(linear: Path, path: Path, scene: bpy.types.Scene) -> None:
    """Write the PNG `path` from a linear file; see save_view."""
    image = bpy.data.images.load(str(linear), check_existing=False)
    try:
        image.colorspace_settings.name = "Linear Rec.709"
        image.alpha_mode = "CHANNEL_PACKED"
        save_view(image, path, scene)
    finally:
        bpy.data.images.remove(image)


def save_view(image: bpy.types.Image, path: Path, scene: bpy.types.Scene) -> None:
    """Write the PNG `path` from an image with the scene's view transform; alpha stays as it is.

    The file appears under its name only when it is complete.
    Raises OSError with a sentence when it cannot be written.
    """
    # The user's output settings are neither touched nor used. Curves and white balance can be copied in no other way.
    lender = scene.copy()
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.png")
    try:
        lender.render.dither_intensity = 0.0
        target = lender.render.image_settings
        if hasattr(target, "media_type"):  # since Blender 5.0
            target.media_type = "IMAGE"
        target.file_format, target.color_mode, target.color_depth, target.compression = "PNG", "RGBA", "8", 15
        target.color_management = "FOLLOW_SCENE"
        image.save_render(str(temporary), scene=lender)
        os.replace(temporary, path)
    except (RuntimeError, OSError) as reason:
        cause = str(reason).strip().partition("\n")[0].removeprefix("Error: ")
        raise OSError(f"{path}: cannot be written ({cause}); choose a folder that can be written to.") from reason
    finally:
        with contextlib.suppress(OSError):  # where it could not be made it cannot be taken away either
            temporary.unlink(missing_ok=True)
        bpy.data.scenes.remove(lender)
