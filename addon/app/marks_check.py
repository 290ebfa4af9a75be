"""Our custom properties in a file that may be anybody's: what does not have the shape that we write is taken off before it is read.

Other add-ons, scripts, and files of other versions may leave anything under our names; everything else in the add-on may then rely on them.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable
from typing import Any

import bpy

from ..read import baked_copies, tags, uv_layer
from ..show import images, layout, materials_write, restore, scene_prints
from ..show.material_nodes import MODES

_KINDS = ("objects", "meshes", "materials", "images", "collections", "node_groups")


def drop_broken_marks() -> None:
    """Takes off what is called like a mark of ours and is none."""
    scenes = list(bpy.data.scenes)
    for blocks in (scenes, *(getattr(bpy.data, kind) for kind in _KINDS)):
        for block in blocks:
            for name in [name for name in block.keys() if name in _SHAPES]:  # noqa: SIM118  no dictionary
                if not _fits(block, name):
                    del block[name]


def _fits(block: Any, name: str) -> bool:
    kind, shape = _SHAPES[name]
    try:
        return (kind is None or isinstance(block, kind)) and bool(shape(block[name], block))
    except (KeyError, TypeError, AttributeError, ValueError, RecursionError):
        return False


def _is_text(value: Any, _block: Any = None) -> bool:
    return isinstance(value, str)


def _is_flag(value: Any, _block: Any = None) -> bool:
    return isinstance(value, bool | int)


def _has_texts(*names: str) -> Callable[[Any, Any], bool]:
    return lambda value, _block: all(isinstance(value[name], str) for name in names)


def _has_flags(*names: str) -> Callable[[Any, Any], bool]:
    return lambda value, _block: all(isinstance(value[name], bool | int) for name in names)


def _is_place(value: Any, _block: Any) -> bool:
    numbers = [float(number) for number in value]
    return len(numbers) == 4 and all(map(math.isfinite, numbers)) and min(numbers[:2]) > 0.0


def _is_block_or_gone(value: Any, kind: type) -> bool:
    return value is None or isinstance(value, kind)


def _is_bake(value: Any, _block: Any) -> bool:
    if value["mode"] not in MODES or not isinstance(value["uv_layer"], str):
        return False
    held = value["slots"].to_dict().values() if "slots" in value else ()
    materials = [entry.get(name) for entry in held for name in ("original", "object_material")]
    return (
        _is_block_or_gone(value.get("image"), bpy.types.Image)
        and all(entry["link"] in ("OBJECT", "DATA") for entry in held)
        and all(_is_block_or_gone(one, bpy.types.Material) for one in materials)
    )


def _ends(value: Any, block: Any) -> bool:
    """Whether one comes from our copy of a material to one of the user's, and in no ring."""
    seen = {block}
    while value is not None:
        if not isinstance(value, bpy.types.Material) or value in seen:
            return False
        seen.add(value)
        value = value.get(tags.ORIGINAL) if tags.MADE in value else None
    return True


def _is_layout(value: Any, _block: Any) -> bool:
    pages = value["images"].to_dict()
    told = value.get("warnings", "[]")
    return (
        isinstance(value["digest"], str)
        and isinstance(value.get("result", ""), str)
        and all(name.isdecimal() and _is_block_or_gone(image, bpy.types.Image) for name, image in pages.items())
        and all(isinstance(subject, str) and isinstance(text, str) for subject, text in json.loads(told))
    )


def _is_registry(value: Any, _block: Any) -> bool:
    return all(_is_block_or_gone(copy, bpy.types.Object) for copy in value.to_dict().values())


def _is_source(value: Any, block: Any) -> bool:
    return _is_block_or_gone(value, bpy.types.Object) and value != block


def _is_mesh_to_share(value: Any, block: Any) -> bool:
    return value is None or (isinstance(value, bpy.types.Mesh) and block.type == "MESH")


def _are_names(value: Any, _block: Any) -> bool:
    return all(isinstance(name, str) for name in _as_list(json.loads(value)))


def _as_list(value: Any) -> Iterable[Any]:
    if not isinstance(value, list):
        raise TypeError(f"expected a list, got {value!r}")
    return value


_SHAPES: dict[str, tuple[Any, Callable[[Any, Any], Any]]] = {
    tags.MADE: (None, _is_flag),
    tags.STATE: (bpy.types.Scene, _is_text),
    tags.STATE_IS: (bpy.types.Scene, _is_text),
    tags.STATE_LACK: (bpy.types.Scene, _is_text),
    tags.STATE_OF: (bpy.types.Scene, _is_text),
    tags.STATE_OBJECTS: (bpy.types.Scene, _are_names),
    uv_layer.LAYER: (bpy.types.Mesh, _has_texts("name", "digest", "active", "render")),
    uv_layer.ACTIVE: (bpy.types.Mesh, _has_texts("before", "shown")),
    uv_layer.PLACE: (bpy.types.Object, _is_place),
    baked_copies.COPIES: (bpy.types.Collection, _is_registry),
    baked_copies.SOURCE: (bpy.types.Object, _is_source),
    baked_copies.HIDDEN: (bpy.types.Object, _has_flags("viewport", "render")),
    baked_copies.SHARED_MESH: (bpy.types.Object, _is_mesh_to_share),
    baked_copies.SHAPE: (bpy.types.Mesh, _is_text),
    scene_prints.PRINTS: (bpy.types.Scene, _is_text),
    images.PAGE: (bpy.types.Image, _is_text),
    materials_write.BAKE: (bpy.types.Object, _is_bake),
    tags.ORIGINAL: (bpy.types.Material, _ends),
    materials_write.ADDED_SLOT: (bpy.types.Mesh, _is_flag),
    restore.MISSING: (bpy.types.Scene, _is_text),
    layout.LAYOUT: (bpy.types.Scene, _is_layout),
    layout.SPARE: (bpy.types.Scene, _is_text),
    tags.LIVE: (bpy.types.Image, _is_flag),
    tags.STANDS_FOR: (bpy.types.Image, lambda value, block: _is_block_or_gone(value, bpy.types.Image) and value != block),
}
