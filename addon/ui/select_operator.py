"""Selects what a warning is about.

No `from __future__ import annotations` here: Blender reads properties out of annotations.
"""

import bpy

from ...core.util.user_text import match_name, write_sentence
from ..read.tags import find_original


class LEAFLIGHT_OT_select(bpy.types.Operator):
    """What a warning names may be an object, an instance, a material or a lamp: the objects that have it are selected."""

    bl_idname = "leaflight.select"
    bl_label = "Select"
    bl_description = "Select the objects that this is about"
    bl_options = frozenset({"REGISTER", "UNDO"})

    names: bpy.props.StringProperty(options={"HIDDEN", "SKIP_SAVE"})  # one a line

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if context.mode != "OBJECT":
            cls.poll_message_set("Change to Object Mode first")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        names = self.names.splitlines()
        meant = find_objects(context, names)
        if not meant:
            self.report({"WARNING"}, write_sentence(names, "is not in this view layer any more.").text)
            return {"CANCELLED"}
        for obj in context.view_layer.objects:
            obj.select_set(False)
        hidden = []
        for obj in meant:
            obj.hide_set(False)
            obj.select_set(True)
            if not obj.visible_get():
                hidden.append(obj.name)
        context.view_layer.objects.active = meant[0]
        if hidden:
            self.report({"INFO"}, write_sentence(hidden, "is in a hidden collection, or hidden in viewports; show it to see it.").text)
        return {"FINISHED"}


def find_objects(context: bpy.types.Context, names: list[str]) -> list[bpy.types.Object]:
    """Objects of the view layer with these names, or, where there are none, with materials or data of these names."""
    objects = context.view_layer.objects
    known = [match_name(name, objects) for name in names]
    if any(known):
        return [objects[name] for name in dict.fromkeys(known) if name]
    wanted = set(names)
    return [
        obj for obj in objects if (obj.data and obj.data.name in wanted) or any(_has_material(slot, wanted) for slot in obj.material_slots)
    ]


def is_known(context: bpy.types.Context, name: str) -> bool:
    """Whether the view layer has an object of this name, or the file something of this name that an object may wear.

    For each drawing of the panel: to look through all objects' materials takes too long. The mesh of an object that was deleted stays
    in the file, mostly under the object's name, and so does the object where something points to it.
    """
    if match_name(name, bpy.data.objects):
        return bool(match_name(name, context.view_layer.objects))
    found = [blocks.get(name) for blocks in (bpy.data.materials, bpy.data.meshes, bpy.data.lights)]
    return any(block and block.users > block.use_fake_user for block in found)


def _has_material(slot: bpy.types.MaterialSlot, wanted: set[str]) -> bool:
    """Whether a slot shows a material of one of these names, or the copy of one that wears its bake."""
    material = find_original(slot.material)
    return material is not None and material.name in wanted


CLASSES = (LEAFLIGHT_OT_select,)
