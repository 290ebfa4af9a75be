"""Shows baked images on objects: each slot gets our copy of its material, at the object's level, and the original back again.

The user's materials, meshes' slots and other objects are never edited. What a slot held is remembered on the object.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import bpy
import numpy as np

from ..read.steps import Pause, Steps, run_steps
from ..read.tags import (
    NAME,
    ORIGINAL,
    find_original,
    is_made,
    local_objects,
    mark_made,
    not_editable_error,
    remove_mark,
    remove_unused,
    suffixed_name,
)
from ..read.uv_layer import ACTIVE, PLACE, activate_layer, layer_name, release_active
from .images import find_path
from .material_nodes import MODES, write_nodes
from .node_groups import remove_unused_groups

BAKE = "leaflight_bake"  # on an object: image, mode, uv_layer; and `slots`, what they held, while the bake is shown
ADDED_SLOT = "leaflight_added_slot"  # on a mesh that had no slot

Sentences = list[tuple[str, str]]  # (subject, sentence)


Pair = tuple[bpy.types.Object, bpy.types.Image]
Copies = dict[tuple[Any, ...], bpy.types.Material]  # ours; the key holds all in which they differ


def assign(pairs: Iterable[Pair], mode: str = "combined", uv_layer: str = "") -> Sentences:
    """`assign_steps` at once."""
    return run_steps(assign_steps(pairs, mode, uv_layer))


def assign_steps(pairs: Iterable[Pair], mode: str, uv_layer: str) -> Steps[Sentences]:
    """Shows each image on its object, in place of any earlier bake, and gives what could not be done.

    Materials are made in steps, and put on all objects in the last: after each step that changes a slot, Blender evaluates all of the
    scene's relations anew, which takes longer than thousands of slots do.

    mode       combined: the image is all one sees; lighting: it lights the base colour; nodes: placed, but linked to nothing
    uv_layer   name of the layer the images are laid out in; "" is the layer we wrote
    """
    if mode not in MODES:
        raise ValueError(f"mode: expected one of {', '.join(MODES)}, got {mode!r}")
    warnings: Sentences = []
    copies: Copies = {}
    ready: list[tuple[bpy.types.Object, bpy.types.Image, str]] = []
    for obj, image in pairs:
        error = not_editable_error(obj)
        name = uv_layer or ("" if error else layer_name(obj.data))
        if not error and name not in obj.data.uv_layers:
            error = f"{obj.name}: has no UV layer {name or NAME} to show the bake with; bake it again."
        if error:
            warnings.append((obj.name, error))
            continue
        for original in dict.fromkeys(find_original(slot.material) for slot in obj.material_slots) or [None]:
            warnings += _provide(copies, obj, original, image, mode, name)[1]
            yield Pause.HOLD
        ready.append((obj, image, name))
    for obj, image, name in ready:
        uncover(obj)
        obj[BAKE] = {"image": image, "mode": mode, "uv_layer": name if uv_layer else ""}
        warnings += _cover(obj, image, mode, name, copies)
    _remove_unused_copies()
    return warnings


def show(objects: Iterable[bpy.types.Object]) -> Sentences:
    """Shows the bakes again that `hide` took off; the originals may have changed meanwhile."""
    warnings: Sentences = []
    missing: dict[bpy.types.Image, list[str]] = {}
    is_there: dict[bpy.types.Image, bool] = {}
    copies: Copies = {}
    for obj in local_objects(objects):
        if BAKE not in obj or is_shown(obj):
            continue
        bake, error = obj[BAKE], not_editable_error(obj)
        image, name = bake.get("image"), bake["uv_layer"] or ("" if error else layer_name(obj.data))
        if not error and (image is None or name not in obj.data.uv_layers):
            error = f"{obj.name}: its baked image or UV layer was deleted; bake it again."
        if error:
            warnings.append((obj.name, error))
            continue
        if image not in is_there:
            is_there[image] = image.source != "FILE" or bool(image.packed_file) or find_path(image).is_file()
        if not is_there[image]:
            missing.setdefault(image, []).append(obj.name)
        else:
            warnings += _cover(obj, image, bake["mode"], name, copies)
    for image, names in missing.items():
        more = f" and {len(names) - 1} more" if len(names) > 1 else ""
        subject = "" if more else names[0]  # else the sentence would be said to be about the first alone
        warnings.append((subject, f"{names[0]}{more}: the baked image {find_path(image)} is missing; put it back, or bake again."))
    return warnings


def hide(objects: Iterable[bpy.types.Object]) -> None:
    """Puts the original materials back and keeps what `show` needs."""
    objects = local_objects(objects)
    for obj in objects:
        uncover(obj)
    release_meshes({obj.data for obj in objects if obj.type == "MESH"})
    _remove_unused_copies()


def _remove_unused_copies() -> None:
    remove_unused(bpy.data.materials)
    remove_unused_groups()


def is_shown(obj: bpy.types.Object) -> bool:
    """Whether the object shows a bake now."""
    return BAKE in obj and "slots" in obj[BAKE]


def find_image(obj: bpy.types.Object) -> bpy.types.Image | None:
    """The image of the bake that the object carries, shown or not; None without one."""
    image: bpy.types.Image | None = obj[BAKE].get("image") if BAKE in obj else None
    return image


def find_worn_meshes() -> set[bpy.types.Mesh]:
    """The meshes on which objects of any scene carry a bake in our layer, shown or not."""
    placed = {obj for scene in bpy.data.scenes for obj in local_objects(scene.objects)}  # not what is in no scene any more
    return {obj.data for obj in placed if BAKE in obj and not obj[BAKE]["uv_layer"]}


def uncover(obj: bpy.types.Object) -> None:
    """Gives every slot that shows a copy of ours its own material and link again; what the user put in since stays."""
    held = _pop_held(obj)
    for index, slot in enumerate(obj.material_slots):
        if slot.link != "OBJECT" or not is_made(slot.material):
            continue
        original = find_original(slot.material)
        entry = _take_entry(held, str(index), original)
        if entry is None and index < len(obj.data.materials) and find_original(obj.data.materials[index]) == original:
            entry = {"link": "DATA"}
        elif entry is None:
            entry = {"link": "OBJECT", "object_material": original}
        slot.material = entry.get("object_material")
        slot.link = entry["link"]
    if obj.type == "MESH" and not obj.data.library:
        _clear_mesh(obj.data)


def _clear_mesh(mesh: bpy.types.Mesh) -> None:
    """We put nothing into a mesh's own slots, but joining objects does: what they wear then."""
    for index, material in enumerate(mesh.materials):
        if is_made(material):
            mesh.materials[index] = find_original(material)


def release_meshes(meshes: Iterable[bpy.types.Mesh]) -> None:
    """Gives meshes what showing a bake took from them: the active UV layer, and no slot; not while an object shows a bake on them."""
    users: dict[bpy.types.Mesh, list[bpy.types.Object]] = {mesh: [] for mesh in meshes if ADDED_SLOT in mesh or ACTIVE in mesh}
    for obj in bpy.data.objects if users else ():
        if obj.data in users:
            users[obj.data].append(obj)
    for mesh, of_mesh in users.items():
        if not any(is_shown(obj) for obj in of_mesh):
            release_active(mesh)
            _remove_added_slot(mesh, of_mesh)


def _remove_added_slot(mesh: bpy.types.Mesh, users: list[bpy.types.Object]) -> None:
    """Takes the slot off that we gave a mesh without one, unless the user filled it."""
    if ADDED_SLOT not in mesh:
        return
    remove_mark(mesh, ADDED_SLOT)
    if len(mesh.materials) != 1 or mesh.materials[0] or any(slot.material for obj in users for slot in obj.material_slots):
        return
    material_index = np.zeros(len(mesh.polygons), dtype=np.int32)
    had_index = "material_index" in mesh.attributes
    mesh.polygons.foreach_get("material_index", material_index)
    mesh.materials.clear()  # drops the faces' indices too
    if had_index:
        mesh.polygons.foreach_set("material_index", material_index)


def _provide(
    copies: Copies, obj: bpy.types.Object, original: bpy.types.Material | None, image: bpy.types.Image, mode: str, uv_layer: str
) -> tuple[bpy.types.Material, Sentences]:
    """Our copy of a material for an object, made where there is none yet, and the warnings from making it."""
    place = PLACE if PLACE in obj else ""
    key = (original, image, uv_layer, place)
    warnings: Sentences = []
    if key not in copies:
        copies[key] = _make_copy(original)
        error = write_nodes(copies[key], image, uv_layer, mode, place)
        if error:
            subject = original.name if original else obj.name
            warnings.append((subject, f"{subject}: {error}"))
    return copies[key], warnings


def _cover(obj: bpy.types.Object, image: bpy.types.Image, mode: str, uv_layer: str, copies: Copies) -> Sentences:
    warnings: Sentences = []
    if not obj.material_slots:
        obj.data.materials.append(None)
        obj.data[ADDED_SLOT] = True
    held: dict[str, dict[str, Any]] = {}
    for index, slot in enumerate(obj.material_slots):
        original, link = find_original(slot.material), slot.link
        copy, told = _provide(copies, obj, original, image, mode, uv_layer)
        warnings += told
        slot.link = "OBJECT"  # never the mesh's own slot: objects that share the mesh keep their materials
        own = find_original(slot.material) if is_made(slot.material) else slot.material
        pointers = {"original": original, "object_material": own}
        held[str(index)] = {"link": link} | {name: block for name, block in pointers.items() if block}
        slot.material = copy
    obj[BAKE]["slots"] = held
    if PLACE not in obj:
        activate_layer(obj.data, uv_layer)
    return warnings


def _make_copy(original: bpy.types.Material | None) -> bpy.types.Material:
    """Our copy, marked; Blender gives it no fake user and no asset mark."""
    if original is None:
        copy = bpy.data.materials.new(NAME)
        if copy.node_tree:
            copy.node_tree.nodes.clear()
    else:
        copy = original.copy()
        copy.name = suffixed_name(original.name)
        copy[ORIGINAL] = original
    mark_made(copy)
    return copy


def _pop_held(obj: bpy.types.Object) -> dict[str, dict[str, Any]]:
    if not is_shown(obj):
        return {}
    held: dict[str, dict[str, Any]] = obj[BAKE]["slots"].to_dict()  # a copy: it outlives the property
    del obj[BAKE]["slots"]
    return held


def _take_entry(held: dict[str, dict[str, Any]], index: str, original: bpy.types.Material | None) -> dict[str, Any] | None:
    """What the slot held: the entry of its index, or, after the user added or removed slots, the first with its original."""
    fitting = [key for key, entry in held.items() if entry.get("original") == original]
    if not fitting:
        return None
    return held.pop(index if index in fitting else fitting[0])
