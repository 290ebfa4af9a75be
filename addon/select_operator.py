"""Selects what a warning is about.

No `from __future__ import annotations` here: Blender reads properties out of annotations.
"""

import bpy

from ..core.told import match_name, tell


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
            self.report({"WARNING"}, tell(names, "is not in this view layer any more.").text)
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
            self.report({"INFO"}, tell(hidden, "is in a hidden collection, or hidden in viewports; show it to see it.").text)
        return {"FINISHED"}


def find_objects(context: bpy.types.Context, names: list[str]) -> list[bpy.types.Object]:
    """Objects of the view layer with these names, or, where there are none, with materials or data of these names."""
    objects = context.view_layer.objects
    known = [match_name(name, objects) for name in names]
    if any(known):
        return [objects[name] for name in dict.fromkeys(known) if name]
    wanted = set(names)
    return [
        obj
        for obj in objects
        if (obj.data and obj.data.name in wanted) or any(s.material and s.material.name in wanted for s in obj.material_slots)
    ]


def is_known(name: str) -> bool:
    """Whether the file has something of this name that can be selected, or an object that wears it."""
    return any(match_name(name, blocks) for blocks in (bpy.data.objects, bpy.data.materials, bpy.data.meshes, bpy.data.lights))


CLASSES = (LEAFLIGHT_OT_select,)
