"""The Leaflight tab of the 3D View's sidebar."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import bpy

from ...core.util.user_text import Sentence, begin_line, group_warnings, split_error
from ..app.bake_state import BakeState
from ..app.properties import TEXTS, is_changed, list_groups, list_knobs
from ..app.request import find_mode_error, find_output_error
from ..app.scene_meter import SceneMeter, find_worn
from ..show import restore, view_shading
from ..show.layout import worn_result
from . import preferences
from .checker import is_checker_on
from .panel_parts import describe_estimate, describe_evened, describe_takers, draw_sentence, draw_subjects, prepare
from .panel_result import draw_buttons, draw_doubts, draw_lines, draw_show_it
from .presets import LEAFLIGHT_PT_presets
from .select_operator import is_known

_SHOWN_WARNINGS = 6
_KEPT_LINES = 3  # of the plan: what a bake is of; its own lines take the place of the others
_MOST = 0.5  # of all texels: one object that takes so many is named
_BAKE_HEIGHT = 1.6  # of the button


class _Sidebar:
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Leaflight"


class LEAFLIGHT_PT_main(_Sidebar, bpy.types.Panel):
    bl_idname = "LEAFLIGHT_PT_main"
    bl_label = "Bake"
    bl_order = 0

    def draw_header_preset(self, _context: bpy.types.Context) -> None:
        LEAFLIGHT_PT_presets.draw_panel_header(self.layout)

    def draw(self, context: bpy.types.Context) -> None:
        """Buttons stand above all that changes its height, so that none moves under the mouse; below them what is urgent comes first."""
        state: BakeState = context.window_manager.leaflight_state
        layout = prepare(self.layout)
        row = layout.row()
        row.enabled = not state.running
        row.prop(context.scene.leaflight, "objects", expand=True)
        worn, has_bake = find_worn(context), restore.has_bake(context.scene)
        now = "" if state.running else find_output_error(context.scene.leaflight.output)
        if state.running:
            _draw_bar(layout, state)
        else:
            _draw_bake(layout, context, now)
        wears = has_bake and (worn.lines or not state.running)  # else it is the first bake of the scene, which is not done
        if wears:
            buttons = layout.column()
            buttons.enabled = not state.running
            draw_buttons(buttons, context)
        if state.running:  # Stop stands above what may be said meanwhile
            _draw_progress(layout, context, state)
        elif wears and view_shading.hides_bake(context) and restore.is_preview_on(context.scene):
            draw_sentence(layout, context, "This view does not show the baked light.", "INFO")
            draw_show_it(layout)
        error = _find_error(context, state)
        if error and error != now:
            _draw_error(layout.box(), context, error)
        if wears:
            draw_doubts(layout, context)
        # What this Blender knows of the last bake is told only of files without a word about it: undo may have brought back another bake.
        unmarked = has_bake and worn_result(context.scene) is None
        warnings = state.list_warnings(context.scene.session_uid, unmarked) or (list(worn.warnings) if has_bake else [])
        if warnings:
            _draw_warnings(layout, context, group_warnings(warnings))
        if wears:
            lines = layout.column()
            lines.enabled = not state.running
            draw_lines(lines, context, worn)
        if not state.running:
            _draw_plan(layout, context)


def _find_error(context: bpy.types.Context, state: BakeState) -> str:
    """The error of the last bake, if it is this scene's, or that of one that was deleted; else ""."""
    owner = next((scene for scene in bpy.data.scenes if scene.session_uid == state.scene), context.scene)
    return state.error if owner == context.scene else ""


def _draw_error(layout: Any, context: bpy.types.Context, error: str) -> None:
    draw_subjects(layout, context, split_error(error, partial(is_known, context)), "ERROR")


def _draw_bake(layout: Any, context: bpy.types.Context, output_error: str) -> None:
    row = layout.row()
    row.scale_y = _BAKE_HEIGHT
    row.operator("leaflight.bake", icon="RENDER_STILL")
    if output_error:
        column = layout.column()
        draw_sentence(column, context, output_error, "INFO")
        if not bpy.data.filepath:
            column.operator("wm.save_as_mainfile", text="Save As...", icon="FILE_TICK")
    mode_error = find_mode_error(context)
    if mode_error:
        column = layout.column()
        draw_sentence(column, context, mode_error, "INFO")
        column.operator("object.mode_set", text="Leave Edit Mode", icon="OBJECT_DATAMODE").mode = "OBJECT"


def _draw_bar(layout: Any, state: BakeState) -> None:
    """In the place of Bake, and no button: a second click on Bake must not stop it."""
    row = layout.row()
    row.scale_y = _BAKE_HEIGHT
    row.progress(factor=state.fraction, text=state.describe()[0])


def _draw_plan(layout: Any, context: bpy.types.Context) -> None:
    """What will be baked, before it is."""
    meter: SceneMeter = context.window_manager.leaflight_meter
    meter.watch(context)
    column = layout.box().column(align=True)
    if meter.problem:
        _draw_error(column, context, meter.problem)
    elif meter.estimate is None:
        column.label(text="Measuring..." if meter.stale else "No mesh with faces to bake", icon="SORTTIME" if meter.stale else "INFO")
    else:
        lines = describe_estimate(meter.estimate)
        if meter.stale:  # in place of a line, for another would move all that is below
            lines[-1] = "The scene changed: measuring..."
        _draw_lines(column, lines, active=not meter.stale)
        _draw_lines(column, describe_evened(meter.estimate), active=not meter.stale)
        for name, share in meter.estimate.takers[:1]:
            if share >= _MOST:
                draw_subjects(column, context, Sentence((name,), describe_takers(meter.estimate)[0]), "INFO")
        for names, told in (
            (meter.estimate.too_large, "larger than a page at this density: baked less finely"),
            (meter.estimate.nearly, "about as large as a page at this density: may be baked less finely"),
        ):
            if names:
                draw_subjects(column, context, group_warnings((name, told) for name in names)[0], "ERROR")


def _draw_progress(layout: Any, context: bpy.types.Context, state: BakeState) -> None:
    """As high as the plan that stood here before: else Blender slides all panels below, and draws them a dozen times meanwhile."""
    column = layout.box().column(align=True)
    kept = list(state.plan[:_KEPT_LINES])
    scene = next((scene for scene in bpy.data.scenes if scene.session_uid == state.scene), context.scene)
    offers_view = scene == context.scene and view_shading.hides_bake(context) and restore.is_preview_on(scene)
    if scene != context.scene:
        kept = [f"Baking the scene {scene.name}", *kept[: _KEPT_LINES - 1]]
    _draw_lines(column, kept[: _KEPT_LINES - 1] if offers_view else kept, active=False)
    if offers_view:
        draw_show_it(column)
    column.label(text=state.describe()[1])  # in place of the memory and the time, the next row too
    row = column.split(factor=0.7, align=True)
    if state.stopping or state.notice:
        row.operator("leaflight.discard", icon="TRASH")
    else:
        row.label(text=begin_line(state.describe_goal()))
    row.operator("leaflight.stop")


def _draw_lines(column: Any, lines: Sequence[str], active: bool) -> None:
    plan = column.column(align=True)
    plan.active = active
    for i, line in enumerate(lines):
        plan.label(text=begin_line(line), icon="TEXTURE" if i == 0 else "BLANK1")


def _draw_warnings(layout: Any, context: bpy.types.Context, warnings: list[Sentence]) -> None:
    header, body = layout.panel("leaflight_warnings")
    header.label(text=f"{len(warnings)} Warning{'' if len(warnings) == 1 else 's'}", icon="ERROR")
    if body is None:
        return
    column = body.column()
    for told in warnings[:_SHOWN_WARNINGS]:
        draw_subjects(column, context, told, "DOT")
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
            if name in TEXTS:
                column.prop(properties, f"{name}_text", placeholder=TEXTS[name])
            elif name not in drawn:
                _draw_property(column, properties, name)


def _draw_quality(column: Any, context: bpy.types.Context) -> tuple[str, ...]:
    properties = context.scene.leaflight
    presets = column.grid_flow(row_major=True, columns=2, even_columns=True, align=True)
    presets.use_property_split = False
    presets.prop(properties, "quality", expand=True)
    error = column.column()
    error.active = properties.quality == "CUSTOM"
    error.prop(properties, "error_percent", slider=False)
    column.label(text="Measure the error of:")
    measure = column.row(align=True)
    measure.use_property_split = False
    measure.prop(properties, "error_of", expand=True)
    return ("error", "error_of")


def _draw_lightmap(column: Any, context: bpy.types.Context) -> tuple[str, ...]:
    properties = context.scene.leaflight
    column.row().prop(properties, "resolution", expand=True)
    if properties.resolution == "DENSITY":
        column.prop(properties, "density")
    column.prop(properties, "size")
    shown = is_checker_on(context)
    column.operator("leaflight.checker", icon="TEXTURE", depress=shown)
    column.separator()
    column.prop(properties, "uv_layer", placeholder="Leaflight (new)")
    return ("size", "density")


def _draw_output(column: Any, context: bpy.types.Context) -> tuple[str, ...]:
    properties = context.scene.leaflight
    column.prop(properties, "main_pass")
    column.prop(properties, "materials")
    folder = column.column()
    folder.use_property_split = False
    folder.label(text="Folder:")
    folder.prop(properties, "output", text="")
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
_LAST = ("Advanced", "Research")
_ORDERED = sorted(list_groups(), key=lambda group: (group != "Quality", group in _LAST and 1 + _LAST.index(group)))


def _shows_research(context: bpy.types.Context) -> bool:
    """Whether the user asked for it, or the file has settings of it that a bake would heed."""
    return preferences.wants(context, "research") or any(is_changed(context.scene.leaflight, name) for name in list_knobs("Research"))


def _make_panel(group: str, order: int) -> type:
    special = {"special": staticmethod(_SPECIAL[group])} if group in _SPECIAL else {}
    options = {} if group in _OPEN else {"bl_options": frozenset({"DEFAULT_CLOSED"})}
    poll = {"poll": classmethod(lambda _cls, context: _shows_research(context))} if group == "Research" else {}
    return type(
        f"LEAFLIGHT_PT_{group.lower()}",
        (_Group, bpy.types.Panel),
        {"bl_label": group, "group": group, "bl_order": order, **special, **options, **poll},
    )


CLASSES = (
    LEAFLIGHT_PT_main,
    *(_make_panel(group, order) for order, group in enumerate(_ORDERED, 1)),
)
