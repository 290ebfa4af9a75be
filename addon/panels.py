"""The Leaflight tab of the 3D View's sidebar."""

from __future__ import annotations

import textwrap
from typing import Any

import bpy

from . import restore
from .bake_state import BakeState
from .properties import QUALITY_ERROR, list_groups, list_knobs
from .request import find_output_error, list_objects

_IN_MAIN = ("size", "density")
_SHOWN_WARNINGS = 6
_CHARACTER_PIXELS = 7.0  # of a label's text at a scale of 1, on average


class _Sidebar:
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Leaflight"


class LEAFLIGHT_PT_main(_Sidebar, bpy.types.Panel):
    bl_idname = "LEAFLIGHT_PT_main"
    bl_label = "Leaflight"

    def draw(self, context: bpy.types.Context) -> None:
        state: BakeState = context.window_manager.leaflight_state
        layout = _prepare(self.layout)
        column = layout.column()
        column.enabled = not state.running
        _draw_choices(column, context)
        if state.running:
            _draw_progress(layout, state)
        else:
            _draw_bake(layout, context)
        if state.error:
            _draw_sentence(layout.box(), context, state.error, "ERROR")
        if not state.running and restore.has_bake(context.scene):
            _draw_result(layout, context, state)
        if state.warnings:
            _draw_warnings(layout, context, state)


def _draw_choices(column: Any, context: bpy.types.Context) -> None:
    properties = context.scene.leaflight
    column.row().prop(properties, "objects", expand=True)
    count = len(list_objects(context))
    row = column.row()
    row.alignment = "RIGHT"
    row.label(text=f"{count} object{'' if count == 1 else 's'} to bake")
    for name in _IN_MAIN:
        column.prop(properties, name)
    column.separator()
    names = column.row(align=True)
    names.use_property_split = False
    for name in QUALITY_ERROR:
        names.prop_enum(properties, "quality", name)
    column.prop(properties, "main_pass")
    column.prop(properties, "output")


def _draw_bake(layout: Any, context: bpy.types.Context) -> None:
    error = find_output_error(context.scene.leaflight.output)
    if error:
        column = layout.column()
        _draw_sentence(column, context, error, "INFO")
        if not bpy.data.filepath:
            column.operator("wm.save_as_mainfile", text="Save As...", icon="FILE_TICK")
    row = layout.row()
    row.scale_y = 1.6
    row.enabled = not error
    row.operator("leaflight.bake", icon="RENDER_STILL")


def _draw_progress(layout: Any, state: BakeState) -> None:
    bar, line = state.describe()
    column = layout.column(align=True)
    row = column.split(factor=0.7, align=True)
    row.scale_y = 1.6
    row.progress(factor=state.fraction, text=bar)
    row.operator("leaflight.stop", text="Discard" if state.stopping or state.notice else "Stop")
    column.label(text=line)
    if state.describe_pace():
        column.label(text=state.describe_pace())


def _draw_result(layout: Any, context: bpy.types.Context, state: BakeState) -> None:
    box = layout.box()
    column = box.column(align=True)
    for i, line in enumerate(state.summarize()):
        column.label(text=line, icon="CHECKMARK" if i == 0 else "BLANK1")
    row = box.row(align=True)
    shown = restore.is_preview_on(context.scene)
    row.operator("leaflight.toggle_preview", icon="HIDE_OFF" if shown else "HIDE_ON", depress=shown)
    row.operator("leaflight.remove", icon="TRASH")
    row.operator("leaflight.export_gltf", text="", icon="EXPORT")
    folder = bpy.path.abspath(context.scene.leaflight.output)
    row.operator("wm.path_open", text="", icon="FILE_FOLDER").filepath = folder


def _draw_warnings(layout: Any, context: bpy.types.Context, state: BakeState) -> None:
    count, sentences = len(state.warnings), state.list_warnings()
    header, body = layout.panel("leaflight_warnings")
    header.label(text=f"{count} Warning{'' if count == 1 else 's'}", icon="ERROR")
    if body is None:
        return
    column = body.column()
    for sentence in sentences[:_SHOWN_WARNINGS]:
        _draw_sentence(column, context, sentence, "DOT")
    if len(sentences) > _SHOWN_WARNINGS:
        column.label(text=f"and {len(sentences) - _SHOWN_WARNINGS} more", icon="BLANK1")


def _draw_sentence(layout: Any, context: bpy.types.Context, text: str, icon: str) -> None:
    """A sentence over as many lines as it needs; Blender's labels do not wrap."""
    width = context.region.width / (_CHARACTER_PIXELS * context.preferences.system.ui_scale) - 8
    column = layout.column(align=True)
    for i, line in enumerate(textwrap.wrap(text, max(int(width), 16))):
        column.label(text=line, icon=icon if i == 0 else "BLANK1")


def _prepare(layout: Any) -> Any:
    layout.use_property_split = True
    layout.use_property_decorate = False
    return layout


class _Group(_Sidebar):
    """A closed sub-panel with the knobs of one group of core.settings."""

    bl_parent_id = "LEAFLIGHT_PT_main"
    bl_options = frozenset({"DEFAULT_CLOSED"})
    group = ""
    first: tuple[str, ...] = ()  # properties besides the group's own

    def draw(self: Any, context: bpy.types.Context) -> None:
        properties = context.scene.leaflight
        column = _prepare(self.layout).column()
        column.enabled = not context.window_manager.leaflight_state.running
        for name in (*self.first, *list_knobs(self.group)):
            if name not in _IN_MAIN:
                _draw_property(column, properties, name)


def _draw_property(column: Any, properties: Any, name: str) -> None:
    about = properties.bl_rna.properties[name]
    if not (about.type == "ENUM" and about.is_enum_flag):
        column.prop(properties, name)
        return
    column.label(text=f"{about.name}:")
    grid = column.grid_flow(row_major=True, columns=3, even_columns=True, align=True)
    grid.use_property_split = False
    for item in about.enum_items:
        grid.prop_enum(properties, name, item.identifier)


_FIRST = {"Lightmap": ("uv_layer",)}
_GROUPS = tuple(
    type(f"LEAFLIGHT_PT_{group.lower()}", (_Group, bpy.types.Panel), {"bl_label": group, "group": group, "first": _FIRST.get(group, ())})
    for group in list_groups()
)

CLASSES = (LEAFLIGHT_PT_main, *_GROUPS)
