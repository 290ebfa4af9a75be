"""Where the core laid the objects out, and which images of that layout a scene wears."""

from __future__ import annotations

import json
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.util.job import LAYOUT_FILE
from ..read.export_scene import ExportedObject
from .bake_text import Worn
from .images import find_path
from .page_store import find_folder

LAYOUT = "leaflight_layout"  # on a scene that wears a bake: digest of its layout, its images by page, and what was told of putting it on
SPARE = "leaflight_spare"  # on a scene: folder of its bake's images, where they could not be written to the output folder

_RESULT = "result"  # in it: bake_text.Worn


@dataclass(frozen=True)
class Layout:
    """UVs and pages of the snapshot's triangles and objects.

    tri_uv        (n_tri, 3, 2) float64, [0, 1]
    tri_chart     (n_tri,) int64, -1 for none
    object_page   (n_object,) int64, -1 for none
    object_block  (n_object,) int64, -1 for objects with charts of their own
    object_place  (n_object, 4) float64, pages: scale and offset of the block's UVs
    digest        the same for bakes that differ in nothing but the light in their images
    """

    tri_uv: NDArray[np.float64]
    tri_chart: NDArray[np.int64]
    object_page: NDArray[np.int64]
    object_block: NDArray[np.int64]
    object_place: NDArray[np.float64]
    digest: str

    @property
    def page_count(self) -> int:
        return int(self.object_page.max(initial=-1)) + 1


def read_layout(folder: Path, objects: Sequence[ExportedObject], shown_as: str) -> Layout:
    """The layout that the core left in the job's folder; it is there before the first light is.

    shown_as   whatever else the materials of a bake depend on
    """
    with np.load(folder / LAYOUT_FILE) as stored:
        tri_uv, object_page = stored["tri_uv"], stored["object_page"]
        tri_chart, block, place = stored["tri_chart"], stored["object_block"], stored["object_place"]
    about = repr([(one.name, one.n_corner) for one in objects]) + shown_as
    digest = zlib.crc32(about.encode(), zlib.crc32(np.ascontiguousarray(tri_uv), zlib.crc32(object_page.tobytes() + block.tobytes())))
    return Layout(tri_uv, tri_chart, object_page, block, place, f"{digest:08x}")


def mark_layout(
    scene: bpy.types.Scene, layout: Layout, page_image: dict[int, bpy.types.Image], warnings: Sequence[tuple[str, str]]
) -> None:
    """Remember what the scene wears, and the sentences about it: (subject, text)."""
    shown = {str(page): image for page, image in page_image.items()}
    scene[LAYOUT] = {"digest": layout.digest, "images": shown, "warnings": json.dumps(warnings)}


def mark_result(scene: bpy.types.Scene, worn: Worn) -> None:
    """Remember what the panel says of the bake that the scene wears."""
    if LAYOUT in scene:
        scene[LAYOUT][_RESULT] = worn.encode()


def worn_result(scene: bpy.types.Scene) -> Worn | None:
    """What the panel says of the bake that the scene wears; None where nothing was kept."""
    return Worn.decode(scene[LAYOUT][_RESULT]) if LAYOUT in scene and _RESULT in scene[LAYOUT] else None


def worn_digest(scene: bpy.types.Scene) -> str:
    """Digest of the layout that the scene wears, "" without one."""
    return str(scene[LAYOUT]["digest"]) if LAYOUT in scene else ""


def worn_images(scene: bpy.types.Scene) -> dict[int, bpy.types.Image]:
    """Images by page that the scene wears; one that was deleted is left out."""
    found = scene[LAYOUT]["images"].to_dict() if LAYOUT in scene else {}
    return {int(page): image for page, image in found.items() if image is not None}


def worn_warnings(scene: bpy.types.Scene) -> list[tuple[str, str]]:
    """What was told as the scene put on the layout that it wears."""
    told = scene[LAYOUT].get("warnings", "[]") if LAYOUT in scene else "[]"  # files that an earlier version saved have none
    return [(subject, text) for subject, text in json.loads(told)]


def worn_folder(scene: bpy.types.Scene) -> Path | None:
    """Folder of the images that the scene wears; None where it wears none, or one of a bake that runs.

    Blender keeps their paths right when the .blend is saved elsewhere, and ours in custom properties not.
    """
    image = next((image for _, image in sorted(worn_images(scene).items()) if image.filepath), None)
    return find_folder(find_path(image)) if image else None
