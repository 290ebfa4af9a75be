"""The state that is kept of the bake which a scene wears, for Refine to go on from."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import bpy

from ..core.checkpoint import INFO_FILE, read_info, remove_checkpoint
from .arguments import BakeRequest
from .tags import remove_mark

STATE = "leaflight_state"  # on a scene: the folder
MOST_MB = 1000  # a larger state is not kept beside an artist's images
REFINED = 0.5  # of the error so far, where the panel does not ask for less


def mark_state(scene: bpy.types.Scene, request: BakeRequest) -> None:
    """Remember where the state of the scene's bake is, if it was kept: relative to the .blend that there is or will be."""
    remove_mark(scene, STATE)
    if request.keep is None or not (request.keep / INFO_FILE).is_file():
        return
    folder = str(request.keep.resolve())
    blend = str(request.save.resolve()) if request.save else bpy.data.filepath
    beside = blend and os.path.splitdrive(blend)[0].lower() == os.path.splitdrive(folder)[0].lower()
    scene[STATE] = bpy.path.relpath(folder, start=os.path.dirname(blend)) if beside else folder


def has_state(scene: bpy.types.Scene) -> bool:
    """Whether the scene's bake can be gone on with."""
    return (_folder(scene) / INFO_FILE).is_file() if STATE in scene else False


def refine_request(scene: bpy.types.Scene, request: BakeRequest) -> BakeRequest:
    """The request of a bake, changed to go on from the state to the panel's error, or to half the error so far.

    Raises ValueError with a sentence where there is no state.
    """
    info = read_info(_folder(scene)) if has_state(scene) else None
    if info is None:
        raise ValueError("nothing is kept of this bake that could be gone on with: bake it again.")
    asked = request.settings
    error = asked.error if asked.error < info.error else max(REFINED * info.error, 1e-4)
    settings = replace(asked, error=error, max_photons=asked.max_photons + info.photons)
    return replace(request, settings=settings, resume=_folder(scene))


def remove_state(scene: bpy.types.Scene) -> None:
    """Delete the state of the scene's bake from disk."""
    if STATE in scene:
        remove_checkpoint(_folder(scene))
        remove_mark(scene, STATE)


def _folder(scene: bpy.types.Scene) -> Path:
    return Path(bpy.path.abspath(scene[STATE]))
