"""The Leaflight tab of the 3D View's sidebar."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import bpy

from ...core.util.told import Told, group_warnings, split_error
from ..app.bake_state import BakeState
from ..app.properties import list_groups, list_knobs
from ..app.request import find_mode_error, find_output, find_output_error
from ..app.scene_meter import SceneMeter
from ..app.spare_images import draw_spare
from ..show import restore
from ..show.layout import worn_folder
from .checker import is_checker_on
from .panel_parts import describe_estimate, draw_sentence, draw_told, prepare
from .select_operator import is_known

_SHOWN_WARNINGS = 6
_KEPT_LINES = 3  # of the plan: what a bake is of; of the others its own lines take the place


class _Sidebar:
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Leaflight"


class LEAFLIGHT_PT_main(_Sidebar, bpy.types.Panel):
    bl_idname = "LEAFLIGHT_PT_main"
    bl_label = "Bake"
    bl_order = 0

    def draw(self, context: bpy.types.Context) -> None:
        state: BakeState = context.window_manager.leaflight_state
        layout = prepare(self.layout)
        now = "" if state.running else find_output_error(context.scene.leaflight.output)
        if state.running:
            _draw_progress(layout, context, state)
        else:
            _draw_plan(layout, context)
            _draw_bake(layout, context, now)
        error = _find_error(context, state)
        if error and error != now:
            draw_told(layout.box(), context, split_error(error, partial(is_known, context)), "ERROR")
        scene, has_bake = context.scene.session_uid, restore.has_bake(context.scene)
        if not state.running and has_bake:
            _draw_result(layout, context, state.describe_worn(scene))
        warnings = state.list_warnings(scene, has_bake)
        if warnings:
            _draw_warnings(layout, context, group_warnings(warnings))


def _find_error(context: bpy.types.Context, state: BakeState) -> str:
    """The error of the last bake, if it is this scene's, or that of one that was deleted; else ""."""
    owner = next((scene for scene in bpy.data.scenes if scene.session_uid == state.scene), context.scene)
    return state.error if owner == context.scene else ""


def _draw_plan(layout: Any, context: bpy.types.Context) -> None:
    """What will be baked, before it is."""
    meter: SceneMeter = context.window_manager.leaflight_meter
    meter.watch(context)
    layout.row().prop(context.scene.leaflight, "objects", expand=True)
    column = layout.box().column(align=True)
    if meter.problem:
        draw_sentence(column, context, meter.problem, "ERROR")
    elif meter.estimate is None:
        column.label(text="Measuring..." if meter.stale else "No mesh with faces to bake", icon="SORTTIME" if meter.stale else "INFO")
    else:
        lines = column.column(align=True)
        lines.active = not meter.stale
        for i, line in enumerate(describe_estimate(meter.estimate)):
            lines.label(text=line, icon="TEXTURE" if i == 0 else "BLANK1")
        if meter.stale:
            column.label(text="The scene changed: measuring...", icon="SORTTIME")
        for names, told in (
            (meter.estimate.too_large, "larger than a page at this density: baked less finely"),
            (meter.estimate.nearly, "about as large as a page at this density: may be baked less finely"),
        ):
            if names:
                draw_told(column, context, group_warnings((name, told) for name in names)[0], "ERROR")


def _draw_bake(layout: Any, context: bpy.types.Context, output_error: str) -> None:
    if output_error:
        column = layout.column()
        draw_sentence(column, context, output_error, "INFO")
        if not bpy.data.filepath:
            column.operator("wm.save_as_mainfile", text="Save As...", icon="FILE_TICK")
    mode_error = find_mode_error(context)
    if mode_error:
        draw_sentence(layout, context, mode_error, "INFO")
    row = layout.row()
    row.scale_y = 1.6
    row.enabled = not output_error
    row.operator("leaflight.bake", icon="RENDER_STILL")


def _draw_progress(layout: Any, context: bpy.types.Context, state: BakeState) -> None:
    """As high as what stood here before: else Blender slides all panels below, drawing them a dozen times while the bake starts."""
    bar, line = state.describe()
    meter: SceneMeter = context.window_manager.leaflight_meter
    row = layout.row()
    row.enabled = False
    row.prop(context.scene.leaflight, "objects", expand=True)
    column = layout.box().column(align=True)
    plan = column.column(align=True)
    plan.active = False
    for i, text in enumerate(describe_estimate(meter.estimate)[:_KEPT_LINES] if meter.estimate else ()):
        plan.label(text=text, icon="TEXTURE" if i == 0 else "BLANK1")
    for text in (line, state.describe_pace()):  # in place of the memory and the time
        column.label(text=text)
    row = layout.split(factor=0.7, align=True)
    row.scale_y = 1.6
    row.progress(factor=state.fraction, text=bar)
    row.operator("leaflight.stop", text="Discard" if state.stopping or state.notice else "Stop")


def _draw_result(layout: Any, context: bpy.types.Context, lines: Sequence[str]) -> None:
    box = layout.box()
    column = box.column(align=True)
    for i, line in enumerate(lines):
        draw_sentence(column, context, line, "CHECKMARK" if i == 0 else "BLANK1")
    row = box.row(align=True)
    shown = restore.is_preview_on(context.scene)
    row.operator("leaflight.toggle_preview", icon="HIDE_OFF" if shown else "HIDE_ON", depress=shown)
    row.operator("leaflight.remove", icon="TRASH")
    row.operator("leaflight.export_gltf", text="", icon="EXPORT")
    folder = worn_folder(context.scene) or find_output(context.scene)
    opener = row.row(align=True)
    opener.enabled = folder.is_dir()
    opener.operator("wm.path_open", text="", icon="FILE_FOLDER").filepath = str(folder)
    draw_spare(box, context)
    box.operator("leaflight.refine", icon="ADD")


def _draw_warnings(layout: Any, context: bpy.types.Context, warnings: list[Told]) -> None:
    header, body = layout.panel("leaflight_warnings")
    header.label(text=f"{len(warnings)} Warning{'' if len(warnings) == 1 else 's'}", icon="ERROR")
    if body is None:
        return
    column = body.column()
    for told in warnings[:_SHOWN_WARNINGS]:
        draw_told(column, context, told, "DOT")
    if len(warnings) > _SHOWN_WARNINGS:
        column.label(text=f"and {len(warnings) - _SHOWN_WARNINGS} more", icon="BLANK1")


class _Group(_Sidebar):
    """A panel with the knobs of one group of core.settings; `special` draws some of them in its own way."""

    group = ""
    special: Any = None

    def draw(self: Any, context: bpy.types.Context) -> None:
        properties = context.scene.leaflight
        column = prepare(self.layout).column()
        column.enabled = not context.window_manager.leaflight_state.running
        drawn = type(self).special(column, context) if type(self).special else ()
        for name in list_knobs(self.group):
            if name not in drawn:
                _draw_property(column, properties, name)


def _draw_quality(column: Any, context: bpy.types.Context) -> tuple[str, ...]:
    properties = context.scene.leaflight
    presets = column.grid_flow(row_major=True, columns=2, even_columns=True, align=True)
    presets.use_property_split = False
    presets.prop(properties, "quality", expand=True)
    error = column.column()
    error.active = properties.quality == "CUSTOM"
    error.prop(properties, "error")
    return ("error",)


def _draw_lightmap(column: Any, context: bpy.types.Context) -> tuple[str, ...]:
    properties = context.scene.leaflight
    column.row().prop(properties, "resolution", expand=True)
    if properties.resolution == "DENSITY":
        column.prop(properties, "density")
    column.prop(properties, "size")
    shown = is_checker_on(context)
    column.operator("leaflight.checker", icon="TEXTURE", depress=shown)
    column.separator()
    column.prop(properties, "uv_layer")
    return ("size", "density")


def _draw_output(column: Any, context: bpy.types.Context) -> tuple[str, ...]:
    properties = context.scene.leaflight
    column.prop(properties, "main_pass")
    column.prop(properties, "materials")
    column.prop(properties, "output")
    return ()


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


_SPECIAL = {"Quality": _draw_quality, "Lightmap": _draw_lightmap, "Output": _draw_output}
_OPEN = ("Quality", "Lightmap")
_ORDERED = sorted(list_groups(), key=lambda group: (group != "Quality", group == "Advanced"))


def _make_panel(group: str, order: int) -> type:
    special = {"special": staticmethod(_SPECIAL[group])} if group in _SPECIAL else {}
    options = {} if group in _OPEN else {"bl_options": frozenset({"DEFAULT_CLOSED"})}
    return type(
        f"LEAFLIGHT_PT_{group.lower()}",
        (_Group, bpy.types.Panel),
        {"bl_label": group, "group": group, "bl_order": order, **special, **options},
    )


CLASSES = (
    LEAFLIGHT_PT_main,
    *(_make_panel(group, order) for order, group in enumerate(_ORDERED, 1)),
)
