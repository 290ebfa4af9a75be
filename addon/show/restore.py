"""Takes a bake off again, without a trace, or only out of sight."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager

import bpy

from ..read import baked_copies, uv_layer
from ..read.steps import Pause, Steps, run_steps
from ..read.tags import MADE, find_original, is_made, local_objects, remove_blocks, remove_mark, remove_marks
from . import images, materials_write
from .layout import LAYOUT, SPARE
from .node_groups import remove_unused_groups
from .scene_prints import PRINTS

MISSING = "leaflight_missing"  # on a scene: why it does not show its bake, as a sentence
OBJECT_MARKS = (MADE, materials_write.BAKE, baked_copies.SOURCE, baked_copies.HIDDEN, baked_copies.SHARED_MESH, uv_layer.PLACE)


def remove_bake(scene: bpy.types.Scene | None = None, part: Collection[bpy.types.Object] | None = None) -> bool:
    """`remove_steps` at once."""
    return run_steps(remove_steps(scene, part))


def remove_steps(scene: bpy.types.Scene | None = None, part: Collection[bpy.types.Object] | None = None) -> Steps[bool]:
    """Restores slots, materials, UV layers, meshes and visibility and deletes all that we made, of one scene or of all.

    Image files on disk stay. Gives whether copies of objects were among it, see baked_copies.remove_copies.
    All slots are restored in one step, since Blender evaluates all of the scene's relations anew after each that changes one.

    part   only of these objects and their copies; the others keep their bake, but what is told of it on the scene goes
    """
    had_copies = baked_copies.remove_copies(scene, part)
    objects = local_objects(scene.objects if scene else bpy.data.objects)
    if part is not None:
        objects = [obj for obj in objects if baked_copies.find_source(obj) in part]
    baked_copies.unhide_sources(objects)
    for obj in objects:
        materials_write.uncover(obj)
        remove_mark(obj, materials_write.BAKE)
    yield Pause.HOLD
    worn = materials_write.find_worn_meshes()  # by objects of another scene, or of another bake
    meshes = _local_meshes(objects, everything=scene is None)
    materials_write.release_meshes(meshes)
    for mesh in meshes:
        if mesh not in worn:
            uv_layer.remove_layer(mesh)
            yield Pause.HOLD
    # An object of two scenes wears one bake: with it, the other scene may have lost the last of its own.
    for one in [one for one in bpy.data.scenes if one == scene or not (one.library or (scene and has_bake(one)))]:
        for mark in (LAYOUT, SPARE, MISSING, PRINTS):
            remove_mark(one, mark)
        remove_marks(one)
    for obj in objects:
        baked_copies.restore_shared_mesh(obj)
        for mark in OBJECT_MARKS:
            remove_mark(obj, mark)
    yield Pause.HOLD
    _remove_materials(everything=scene is None)
    images.remove_unused_images()
    if scene is None:
        _release_rest()
    return had_copies


def toggle_preview(scene: bpy.types.Scene, on: bool) -> materials_write.Sentences:
    """Switches between the baked and the original materials and objects; gives sentences about bakes that cannot be shown."""
    remove_mark(scene, MISSING)
    if on:
        baked_copies.set_copies_visible(scene, True)
        return materials_write.show(scene.objects)
    materials_write.hide(scene.objects)
    baked_copies.set_copies_visible(scene, False)
    return []


@contextmanager
def lift_bake(scene: bpy.types.Scene) -> Iterator[None]:
    """The user's own objects in place of our copies, to be read: an earlier bake must not be baked.

    Slots stay as they are, for readers look behind our materials (`tags.find_original`), and Blender takes half a second to evaluate
    thousands of changed ones. Only of objects with modifiers, which may depend on materials and on the active UV layer, are they changed.
    """
    lifted = {obj.session_uid for obj in local_objects(scene.objects) if obj.modifiers and materials_write.is_shown(obj)}
    copies = any(baked_copies.SOURCE in obj and not obj.hide_viewport for obj in scene.objects)
    materials_write.hide(obj for obj in scene.objects if obj.session_uid in lifted)
    if copies:
        baked_copies.set_copies_visible(scene, False)
    try:
        yield
    finally:
        if copies:
            baked_copies.set_copies_visible(scene, True)
        materials_write.show(obj for obj in scene.objects if obj.session_uid in lifted)


def has_bake(scene: bpy.types.Scene) -> bool:
    """Whether any object of the scene carries a bake, shown or not."""
    return any(materials_write.BAKE in obj and not obj.library and not obj.override_library for obj in scene.objects)


def is_preview_on(scene: bpy.types.Scene) -> bool:
    """Whether any object of the scene shows its bake now."""
    return any(materials_write.is_shown(obj) for obj in local_objects(scene.objects))


def _local_meshes(objects: list[bpy.types.Object], everything: bool) -> list[bpy.types.Mesh]:
    meshes = bpy.data.meshes if everything else {obj.data for obj in objects if obj.type == "MESH"}
    return [mesh for mesh in meshes if not mesh.library]


def _remove_materials(everything: bool) -> None:
    """Deletes our copies; where the user put one somewhere else, its original takes its place."""
    made = [material for material in bpy.data.materials if is_made(material) and (everything or material.users == 0)]
    for material in made:
        original = find_original(material)
        if material.users and original:
            material.user_remap(original)
    remove_blocks(made)
    remove_unused_groups()


def _release_rest() -> None:
    """What is still in use, because the user took it over, loses our mark."""
    for blocks in (bpy.data.images, bpy.data.meshes, bpy.data.collections, bpy.data.node_groups):
        for block in blocks:
            if is_made(block):
                remove_mark(block, MADE)
