"""What of a scene no bake sees, told before it begins."""

from __future__ import annotations

from typing import Any

import bpy

from .render_levels import Warnings, find_render_objects

_LINKED_KINDS = ("objects", "collections", "meshes", "materials", "node_groups")
_NAMED = 3  # of what is missing in a file


def warn_left_out(view_layer: Any, warnings: Warnings) -> None:
    """Adds what is missing from linked files, strands and points that a render would show, and a working space that is not read."""
    _warn_working_space(warnings)
    _warn_missing(warnings)
    for obj in sorted(find_render_objects(view_layer), key=lambda obj: str(obj.name)):
        if obj.type in ("CURVES", "POINTCLOUD"):
            what = "strands of hair" if obj.type == "CURVES" else "points"
            warnings.append((obj.name, f"{what} are left out: they cast neither light nor shadow; convert them to a mesh"))
        elif any(_shows_strands(modifier) for modifier in obj.modifiers):
            warnings.append((obj.name, "its particle hair is left out: it casts neither light nor shadow; convert it to a mesh"))


def _shows_strands(modifier: Any) -> bool:
    if modifier.type != "PARTICLE_SYSTEM" or not modifier.show_render or modifier.particle_system is None:
        return False
    settings = modifier.particle_system.settings
    return bool(settings.type == "HAIR" and settings.render_type == "PATH" and settings.count)


def _warn_missing(warnings: Warnings) -> None:
    """In a script or in the background Blender tells only its console that a file it links from is gone."""
    missing: dict[str, list[str]] = {}
    for kind in _LINKED_KINDS:
        for block in getattr(bpy.data, kind):
            if block.library and block.is_missing:
                missing.setdefault(block.library.filepath, []).append(block.name)
    for path, names in sorted(missing.items()):
        found = list(dict.fromkeys(names))
        listed = ", ".join(found[:_NAMED]) + (" and more" if len(found) > _NAMED else "")
        where = "Outliner, Blender File, right-click, Relocate"
        warnings.append(("", f"{listed}: not found in the linked file {path}, so the light is without; find the file again ({where})"))


def _warn_working_space(warnings: Warnings) -> None:
    colorspace = getattr(bpy.data, "colorspace", None)  # from Blender 5.0 on
    space = getattr(colorspace, "working_space", "Linear Rec.709")
    if space != "Linear Rec.709":
        warnings.append(("", f"the file's working space {space} is treated as Linear Rec.709"))
