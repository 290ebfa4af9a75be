"""Small scenes of images that are not one packed sRGB file: sequences, movies, UDIM tiles, generated ones, colour spaces, uses of alpha.

Files are written beside what the bench keeps, since a sequence, a movie and tiles are not packed.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from file_scenes import _colored, _link, _save, _wall

FILES = Path(__file__).resolve().parents[2] / "out" / "matter" / "files"
_FRAME, _FRAMES = 3, 5
_SIDE = 64  # pixels of a movie, whose coders want some


def _write(name: str, pixels: np.ndarray) -> Path:
    """A PNG of 8 bits of sRGB values (h, w, 3)."""
    path = FILES / name
    if not path.exists():
        FILES.mkdir(parents=True, exist_ok=True)
        height, width, _ = pixels.shape
        image = bpy.data.images.new("Written", width, height)
        image.pixels.foreach_set(np.dstack([pixels, np.ones((height, width))]).astype(np.float32).ravel())
        image.filepath_raw, image.file_format = str(path), "PNG"
        image.save()
        bpy.data.images.remove(image)
    return path


def _frames() -> list[Path]:
    """Frames from red to blue, half of each black."""
    paths = []
    for number in range(1, _FRAMES + 1):
        pixels = np.zeros((_SIDE, _SIDE, 3))
        pixels[:, _SIDE // 2 :] = 0.9 - 0.15 * number, 0.2, 0.15 * number
        paths.append(_write(f"frame_{number:03}.png", pixels))
    return paths


def _movie() -> Path:
    """The frames as a movie, without loss."""
    path = FILES / "frames.avi"
    if not path.exists():
        scene = bpy.data.scenes.new("Movie")
        strip = scene.sequence_editor_create().strips.new_image("Frames", str(_frames()[0]), 1, 1)
        for other in _frames()[1:]:
            strip.elements.append(other.name)
        scene.frame_start, scene.frame_end = 1, _FRAMES
        scene.render.resolution_x = scene.render.resolution_y = _SIDE
        scene.view_settings.view_transform = "Standard"
        settings = scene.render.image_settings
        if hasattr(settings, "media_type"):
            settings.media_type = "VIDEO"
        settings.file_format = "FFMPEG"
        scene.render.ffmpeg.format, scene.render.ffmpeg.codec = "AVI", "HUFFYUV"
        scene.render.filepath = str(path)
        scene.render.use_file_extension = False
        bpy.ops.render.render(animation=True, scene=scene.name)
        bpy.data.scenes.remove(scene)
    return path


def _played(source: str, file: Callable[[], Path]) -> Callable[[Any], Any]:
    """What a scene shows of a sequence or movie in its third frame."""

    def color(tree: Any) -> Any:
        image = bpy.data.images.load(str(file()))
        image.source = source
        out = _link(tree, "TexImage", {}, image=image)
        user = out.node.image_user
        user.frame_duration, user.frame_start, user.use_auto_refresh = _FRAMES, 1, True
        bpy.context.scene.frame_set(_FRAME)
        return out

    return color


def _tiles(tree: Any) -> Any:
    """Two by two tiles of a colour each."""
    for row in range(2):
        for column in range(2):
            _write(f"tile.{1001 + 10 * row + column}.png", np.ones((8, 8, 3)) * (0.9 - 0.7 * column, 0.5, 0.1 + 0.7 * row))
    image = bpy.data.images.load(str(FILES / "tile.1001.png"))
    image.source, image.filepath = "TILED", str(FILES / "tile.<UDIM>.png")
    for number in (1002, 1011, 1012):
        image.tiles.new(number)
    return _link(tree, "TexImage", {}, image=image)


def _spread_over_tiles(wall: Any) -> None:
    wall.data.uv_layers[0].uv.foreach_set("vector", np.float32([0.01, 0.01, 1.99, 0.01, 1.99, 1.99, 0.01, 1.99]))


def _generated(tree: Any) -> Any:
    image = bpy.data.images.new("Grid", 256, 256)
    image.generated_type = "COLOR_GRID"
    return _link(tree, "TexImage", {}, image=image)


def _spaced(space: str, kind: str = "PNG", depth: str = "8") -> Callable[[Any], Any]:
    """The four fields in a file whose numbers are of a colour space."""

    def color(tree: Any) -> Any:
        image = _save(kind, depth, "NONE", dull=True)
        image.colorspace_settings.name = space
        return _link(tree, "TexImage", {}, image=image)

    return color


def _shown(*how: str, alpha: bool) -> Callable[[Any], Any]:
    def make(scene: Any) -> Any:
        def shader(tree: Any) -> Any:
            image = _link(tree, "TexImage", {}, image=_save(*how))
            inputs = {"Base Color": image, **({"Alpha": image.node.outputs["Alpha"]} if alpha else {})}
            return _link(tree, "BsdfPrincipled", inputs).node

        return shader

    return make


SCENES: dict[str, Callable[[], None]] = {
    "image sequence": _wall(_colored(_played("SEQUENCE", lambda: _frames()[0]))),
    "movie": _wall(_colored(_played("MOVIE", _movie))),
    "UDIM tiles": _wall(_colored(_tiles), after=_spread_over_tiles),
    "generated image": _wall(_colored(_generated)),
    "image in Linear Rec.2020": _wall(_colored(_spaced("Linear Rec.2020"))),
    "image in Display P3": _wall(_colored(_spaced("Display P3"))),
    "image in Non-Color": _wall(_colored(_spaced("Non-Color"))),
    "EXR in ACEScg": _wall(_colored(_spaced("ACEScg", "OPEN_EXR", "32"))),
    "EXR in Non-Color": _wall(_colored(_spaced("Non-Color", "OPEN_EXR", "32"))),
    "EXR, channel packed": _wall(_shown("OPEN_EXR", "32", "CHANNEL_PACKED", alpha=False)),
    "EXR, premultiplied": _wall(_shown("OPEN_EXR", "32", "PREMUL", alpha=False)),
    "alpha, channel packed, used": _wall(_shown("PNG", "8", "CHANNEL_PACKED", alpha=True)),
    "alpha, none": _wall(_shown("PNG", "8", "NONE", alpha=True)),
    "alpha, premultiplied, unused": _wall(_shown("PNG", "8", "PREMUL", alpha=False)),
}
