"""Leaflight's choices for one object, in Object properties."""

from __future__ import annotations

import bpy

from ..app.request import can_be_baked
from ..read.object_settings import BAKE, IGNORE
from .panel_parts import prepare

_WITH_FACES = frozenset(("MESH", "CURVE", "SURFACE", "FONT", "META"))


class LEAFLIGHT_PT_object(bpy.types.Panel):
    bl_idname = "LEAFLIGHT_PT_object"
    bl_label = "Leaflight"
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "object"
    bl_options = frozenset({"DEFAULT_CLOSED"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        obj = context.object
        return obj is not None and (obj.type in _WITH_FACES or obj.type == "LIGHT" or can_be_baked(obj))

    def draw(self, context: bpy.types.Context) -> None:
        obj = context.object
        chosen = obj.leaflight
        column = prepare(self.layout).column()
        column.enabled = not context.window_manager.leaflight_state.running
        if not can_be_baked(obj):
            column.prop(chosen, "role", expand=False)
            if chosen.role == BAKE:
                column.label(text="Casts light: only meshes get a lightmap", icon="INFO")
            return
        column.row().prop(chosen, "role", expand=True)
        finer = column.column()
        finer.active = chosen.role == BAKE
        finer.prop(chosen, "density_factor")
        sides = column.column()
        sides.active = chosen.role != IGNORE
        sides.prop(chosen, "sides")


CLASSES = (LEAFLIGHT_PT_object,)
