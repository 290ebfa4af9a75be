"""What the panel draws of the bake that a scene wears, and the row that shows it in the view."""

from __future__ import annotations

from typing import Any

import bpy

from ...core.util.user_text import Sentence
from ..app.request import find_output
from ..app.spare_images import draw_spare
from ..show import layout as layout_marks
from ..show import restore
from ..show.bake_text import Worn
from ..show.scene_prints import describe_changes
from .panel_parts import draw_sentence, draw_subjects


def draw_buttons(layout: Any, context: bpy.types.Context) -> None:
    """What can be done with the bake that the scene wears."""
    box = layout.box()
    row = box.row(align=True)
    shown = restore.is_preview_on(context.scene)
    watch = context.window_manager.leaflight_changes
    text = "Show Old Bake" if watch.watch(context) or watch.older else "Show Bake"
    row.operator("leaflight.toggle_preview", text=text, icon="HIDE_OFF" if shown else "HIDE_ON", depress=shown)
    row.operator("leaflight.remove", icon="TRASH")
    row = box.row(align=True)
    row.operator("leaflight.export_gltf", text="Export .glb", icon="EXPORT")
    folder = layout_marks.worn_folder(context.scene) or find_output(context.scene)
    opener = row.row(align=True)
    opener.enabled = folder.is_dir()
    opener.operator("wm.path_open", text="Folder", icon="FILE_FOLDER").filepath = str(folder)
    draw_spare(box, context)
    box.operator("leaflight.refine", icon="ADD")


def draw_doubts(layout: Any, context: bpy.types.Context) -> None:
    """Why the light that is seen is not that of the bake, or no longer that of the scene."""
    if restore.MISSING in context.scene:
        draw_sentence(layout, context, context.scene[restore.MISSING], "ERROR")
    watch = context.window_manager.leaflight_changes
    changes = watch.watch(context)
    if changes:
        told = f"{describe_changes(changes)}. The light that you see is out of date: bake again."
        draw_subjects(layout, context, Sentence(tuple(changes), told), "ERROR")
    if watch.older:
        told = f"Changed between two bakes: {', '.join(watch.older[:3])}. What was not selected shows the older light: bake All."
        draw_subjects(layout, context, Sentence(watch.older, told), "ERROR")


def draw_lines(layout: Any, context: bpy.types.Context, worn: Worn) -> None:
    """What came out of the bake."""
    if not worn.lines:
        return
    box = layout.box()
    lines = box.column(align=True)
    for i, line in enumerate(worn.lines):
        icon = "CHECKMARK" if i == 0 else "BLANK1"
        if worn.worst and worn.worst in line:
            draw_subjects(lines, context, Sentence((worn.worst,), line), icon)
        else:
            draw_sentence(lines, context, line, icon)
    if worn.details:
        header, body = box.panel("leaflight_details", default_closed=True)
        header.label(text="Details")
        for line in worn.details if body else ():
            body.label(text=line, icon="BLANK1")


def draw_show_it(column: Any) -> None:
    """The button that switches the view, as high as a line."""
    column.operator("leaflight.show_it", text="Show It in This View", icon="SHADING_TEXTURE")
