"""What of a scene no bake sees, told before it begins."""

from __future__ import annotations

from typing import Any

import bpy

from .render_levels import Warnings, find_render_objects

_LINKED_KINDS = ("objects", "collections", "meshes", "materials", "node_groups")
_NAMED = 3  # of what is missing in a file


def warn_left_out(view_layer: Any, warnings: Warnings) -> None:
    """Adds what is missing from linked files, overrides, volumes, and a working space that is not read."""
    _warn_working_space(warnings)
    _warn_exposure(warnings)
    _warn_missing(warnings)
    _warn_overrides(view_layer, warnings)
    volumes = sorted(obj.name for obj in find_render_objects(view_layer) if obj.type == "VOLUME")
    warnings.extend((name, "its volume is left out: it casts neither light nor shadow") for name in volumes)


def _warn_exposure(warnings: Warnings) -> None:
    """Applied to the light, it would count twice where Cycles renders the baked scene."""
    scene = bpy.context.scene
    exposure = scene.cycles.film_exposure if scene.render.engine == "CYCLES" else 1.0
    if exposure != 1.0:
        text = f"Exposure {exposure:g} of the film (Render properties) is not in the images"
        warnings.append(("", f"{text}: it brightens them where Cycles shows them"))


def _warn_overrides(view_layer: Any, warnings: Warnings) -> None:
    """Easily forgotten, they change every surface."""
    if view_layer.material_override:
        text = f"Material Override {view_layer.material_override.name} of view layer {view_layer.name} is baked on every object"
        warnings.append(("", f"{text}; clear it (View Layer properties, Override) to bake their own materials"))
    if getattr(view_layer, "world_override", None):  # since Blender 4.5
        text = f"World Override {view_layer.world_override.name} of view layer {view_layer.name} lights the bake"
        warnings.append(("", f"{text}; clear it (View Layer properties, Override) to bake with the scene's own world"))


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
