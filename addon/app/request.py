"""What a press of the Bake button asks for, from the panel's properties."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import bpy

from ...core.util.file_names import clean_name
from ..read.baked_copies import SOURCE
from ..read.object_settings import BAKE
from ..read.render_levels import find_render_objects
from ..show.images import check_shown
from .arguments import BakeRequest
from .kept_state import MOST_MB
from .properties import make_settings

UNSAVED = "Save the file first: lightmaps go into a folder beside it."


def make_request(context: bpy.types.Context) -> BakeRequest:
    """The bake of the open scene that stands in the panel.

    Raises ValueError with a sentence where that cannot be baked.
    """
    properties = context.scene.leaflight
    error = find_output_error(properties.output)
    if error:
        raise ValueError(error)
    chosen = properties.objects == "SELECTED"
    names = [obj.name for obj in list_objects(context)]
    if chosen and not names:
        raise ValueError("no mesh is selected that is to be baked: select some, or choose All in the panel.")
    output = find_output(context.scene)
    settings, name = make_settings(properties), _name_pages(context.scene)
    check_shown(settings)
    return BakeRequest(
        settings=settings,
        objects=tuple(names) if chosen else (),
        uv_layer=properties.uv_layer,
        nodes_only=properties.materials == "NODES",
        output=output,
        name=name,
        keep=output / f"{clean_name(name)}.refine",
        keep_mb=MOST_MB,
        keep_pages=True,
    )


def find_output(scene: bpy.types.Scene) -> Path:
    """The folder of the panel. By its default a copy of the .blend, saved under another name, has one of its own."""
    name = Path(bpy.data.filepath).stem or "lightmap"
    return Path(bpy.path.abspath(scene.leaflight.output.replace("{blend_name}", name)))  # as Blender's own path templates have it


def _name_pages(scene: bpy.types.Scene) -> str:
    """The file's name, and the scene's where there are several: one must not write over what another wears."""
    name = Path(bpy.data.filepath).stem or "lightmap"
    return f"{name}_{scene.name}" if len(bpy.data.scenes) > 1 else name


def resolve_paths(request: BakeRequest) -> BakeRequest:
    """The request with whole paths in place of those that begin in the folder of the open .blend.

    Raises ValueError with a sentence where no .blend is open.
    """
    found: dict[str, Path] = {}
    for name in sorted(request.beside):
        path = f"//{getattr(request, name).as_posix()}"
        if not bpy.data.filepath:
            raise ValueError(f"{path}: is beside the .blend, and no .blend is open; write the whole path.")
        error = find_output_error(path)
        if error:
            raise ValueError(error)
        found[name] = Path(bpy.path.abspath(path))
    return dataclasses.replace(request, beside=frozenset(), **found)


def list_objects(context: bpy.types.Context) -> list[bpy.types.Object]:
    """The objects of the view layer that would get a lightmap, by name."""
    if context.scene.leaflight.objects == "SELECTED":
        # A baked copy that was clicked on stands for the object hidden behind it.
        known = set(context.view_layer.objects)
        found = {obj.get(SOURCE) or obj for obj in context.view_layer.objects.selected} & known
    else:
        found = find_render_objects(context.view_layer)
    chosen = {obj.name: obj for obj in found if obj.leaflight.role == BAKE and can_be_baked(obj)}
    return [chosen[name] for name in sorted(chosen)]


def can_be_baked(obj: bpy.types.Object) -> bool:
    """Whether an object, or what it is an instance of, may get a lightmap."""
    return obj.type == "MESH" or (obj.instance_type == "COLLECTION" and obj.instance_collection is not None)


def find_output_error(output: str) -> str:
    """A sentence why nothing can be written to the folder, or ""."""
    if not output.strip():
        return "no output folder is chosen: choose one in the panel."
    if output.startswith("//") and not bpy.data.filepath:
        return UNSAVED
    if not output.startswith("//") and not Path(output).is_absolute():  # Blender would take the folder that it was started in
        name = output.removeprefix("./").removeprefix("~/")
        return f"{output}: does not say where it begins; write //{name} for a folder beside the .blend, or a whole path."
    return ""


def find_mode_error(context: bpy.types.Context) -> str:
    """A sentence why nothing can be baked or shown in this mode, or ""."""
    if not context.mode.startswith("EDIT"):
        return ""
    return f"{context.object.name}: is in Edit Mode; leave it (Tab) to bake."
