"""Images that could not be written to the output folder at the end of a bake: where they are, and the way to where they belong."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from pathlib import Path
from typing import Any

import bpy

from ...core.output.image_room import SPARE_PREFIX
from ..read.tags import remove_mark
from ..show import image_views
from ..show.images import find_path, relative_path
from ..show.layout import SPARE, worn_images
from ..show.page_store import find_folder, keep_page
from .request import find_output


def finish_view(file: dict[str, Any], linear: Path, scene: bpy.types.Scene) -> None:
    """Write an image through the scene's view transform, into a spare folder where the disk is full.

    file   of the result; its path is changed then
    Raises OSError where there is no room anywhere.
    """
    path = Path(file["path"])
    try:
        image_views.save_file_view(linear, path, scene)
    except OSError:
        spare = path.parent if path.parent.name.startswith(SPARE_PREFIX) else Path(tempfile.mkdtemp(prefix=SPARE_PREFIX))
        image_views.save_file_view(linear, spare / path.name, scene)
        file["path"] = str(spare / path.name)


def mark_spare(scene: bpy.types.Scene, folder: str) -> None:
    """Remember where the images of a scene's bake are; "" where they belong."""
    remove_mark(scene, SPARE)
    if folder:
        scene[SPARE] = folder


def find_spare(scene: bpy.types.Scene) -> Path | None:
    """The folder that holds images of the scene's bake until there is room for them; None where there is none."""
    folder = Path(scene.get(SPARE, ""))
    return folder if folder.name.startswith(SPARE_PREFIX) and folder.is_dir() else None


def move_images(scene: bpy.types.Scene, spare: Path, output: Path) -> int:
    """Move the images to the output folder, have those that the scene wears read from there, and give their number.

    Raises OSError with a sentence where they cannot be written there either; all of them are in the spare folder then.
    """
    files = sorted(path for path in spare.iterdir() if path.is_file())
    copied: list[Path] = []
    try:
        output.mkdir(parents=True, exist_ok=True)
        for file in files:
            part = output / f".{file.name}.{os.getpid()}.part"
            copied.append(part)
            shutil.copyfile(file, part)
        for file, part in zip(files, copied, strict=True):
            os.replace(part, output / file.name)
    except OSError as reason:
        for part in copied:
            with contextlib.suppress(OSError):
                part.unlink(missing_ok=True)
        raise OSError(
            f"{output}: the images cannot be written there either ({reason.strerror or reason}); choose another output folder."
        ) from reason
    for image in worn_images(scene).values():
        path = find_path(image)
        if find_folder(path) == spare.resolve():
            image.filepath = relative_path(keep_page(output.resolve() / path.name))
    shutil.rmtree(spare, ignore_errors=True)
    remove_mark(scene, SPARE)
    return len(files)


class LEAFLIGHT_OT_move_images(bpy.types.Operator):
    """The way out in the panel."""

    bl_idname = "leaflight.move_images"
    bl_label = "Write Images Again"
    bl_description = "Move the images of this bake from the temporary folder to the output folder"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return find_spare(context.scene) is not None and not context.window_manager.leaflight_state.running

    def execute(self, context: bpy.types.Context) -> set[str]:
        spare, output = find_spare(context.scene), find_output(context.scene)
        try:
            assert spare is not None
            count = move_images(context.scene, spare, output)
        except OSError as reason:
            self.report({"ERROR"}, str(reason))
            return {"CANCELLED"}
        self.report({"INFO"}, f"{count} image{'' if count == 1 else 's'} in {output}")
        return {"FINISHED"}


def draw_spare(layout: Any, context: bpy.types.Context) -> None:
    """The button, where there is something to move."""
    if find_spare(context.scene):
        layout.operator("leaflight.move_images", icon="FILE_TICK")


CLASSES = (LEAFLIGHT_OT_move_images,)
