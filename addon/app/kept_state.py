"""The state that is kept of the bake which a scene wears, for Refine to go on from."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy

from ...core.bake.checkpoint import INFO_FILE, read_info, remove_checkpoint
from ...core.util.digest import hash_file
from ..read.tags import STATE, STATE_IS, STATE_LACK, STATE_OBJECTS, STATE_OF, remove_marks
from ..show.layout import worn_folder
from .arguments import BakeRequest

MOST_MB = 1000  # a larger state is not kept beside an artist's images
REFINED = 0.5  # of the error so far, where the panel does not ask for less


def mark_state(scene: bpy.types.Scene, request: BakeRequest, result: dict[str, Any]) -> None:
    """Remember where the state of the bake that the scene wears is, or why none was kept."""
    remove_marks(scene)
    if request.keep is None or not (request.keep / INFO_FILE).is_file():
        scene[STATE_LACK] = _explain_lack(request, result)
        return
    folder, images = request.keep.resolve(), worn_folder(scene)
    beside = images is not None and images.drive.lower() == folder.drive.lower()
    scene[STATE] = Path(os.path.relpath(folder, images)).as_posix() if beside else str(folder)
    scene[STATE_IS] = hash_file(folder / INFO_FILE)
    scene[STATE_OBJECTS] = json.dumps(request.objects)
    scene[STATE_OF] = Path(bpy.data.filepath).stem


def _explain_lack(request: BakeRequest, result: dict[str, Any]) -> str:
    if request.keep is None:
        return "it was baked without --keep"
    if result["stopped_by"] == "interrupted":
        return "it was stopped too early"
    if result["stopped_by"] == "time_limit":
        return "its time limit ended too early"
    if not result["photons"]:
        return "it has direct light only"
    return f"that needs more than {MOST_MB:,} MB, or room on the disk"


def find_state(scene: bpy.types.Scene) -> Path | None:
    """Folder of the state that the scene's bake can be gone on from; None where nothing is kept, or that of another bake."""
    if STATE not in scene:
        return None
    folder = (worn_folder(scene) or Path()) / scene[STATE]
    info = folder / INFO_FILE
    if not folder.is_absolute() or not info.is_file() or scene.get(STATE_IS) not in (None, hash_file(info)):
        return None
    return folder.resolve()


def describe_lack(scene: bpy.types.Scene) -> str:
    """A sentence why the scene's bake cannot be gone on with, "" where it can."""
    if find_state(scene) is not None:
        return ""
    if STATE not in scene:
        lack = scene.get(STATE_LACK, "")
        return f"Nothing was kept of this bake to go on with{f': {lack}' if lack else ''}. Press Bake, with a smaller error for less noise"
    folder = (worn_folder(scene) or Path()) / scene[STATE]
    if (folder / INFO_FILE).is_file() and folder.is_absolute():
        return f"The folder {folder.name} is of another bake than the one that you see. Press Bake, or redo what you have undone"
    return f"The folder {folder.name}, which holds what Refine needs, is gone. Put it back beside the images, or press Bake"


def refine_request(scene: bpy.types.Scene, request: BakeRequest) -> BakeRequest:
    """The request of a bake, changed to go on from the state to the panel's error, or to half the error so far.

    Raises ValueError with a sentence where there is no state.
    """
    folder = find_state(scene)
    info = read_info(folder) if folder else None
    if info is None:
        raise ValueError("nothing is kept of this bake that could be gone on with: bake it again.")
    asked = request.settings
    error = asked.error if asked.error < info.error else max(REFINED * info.error, 1e-4)
    settings = replace(asked, error=error, max_photons=asked.max_photons + info.photons)
    objects = tuple(json.loads(scene.get(STATE_OBJECTS, json.dumps(request.objects))))
    return replace(request, settings=settings, objects=objects, resume=folder)


def remove_state(scene: bpy.types.Scene) -> None:
    """Delete the state of the scene's bake from disk, if no other .blend or scene may want to go on from it, and forget it."""
    folder = find_state(scene)
    if folder and not _is_shared(scene, folder):
        remove_checkpoint(folder)
    remove_marks(scene)


def _is_shared(scene: bpy.types.Scene, folder: Path) -> bool:
    """Whether it is the state of the .blend that this one was saved from under another name, or of a scene that this is a copy of."""
    kept_by = scene.get(STATE_OF, "")
    return kept_by not in ("", Path(bpy.data.filepath).stem) or any(find_state(one) == folder for one in bpy.data.scenes if one != scene)
