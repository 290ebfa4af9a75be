"""What the panel draws of the bake that a scene wears, and the row that shows it in the view."""

from __future__ import annotations

from typing import Any

import bpy

from ...core.util.user_text import Sentence
from ..app.request import find_output
from ..app.spare_images import draw_spare
from ..show import layout, restore, view_shading
from ..show.bake_text import Worn
from ..show.scene_prints import describe_changes
from .panel_parts import draw_sentence, draw_subjects


def draw_result(column: Any, context: bpy.types.Context, worn: Worn) -> None:
    """Buttons first, so that they stay where they are whatever is said below."""
    box = column.box()
    row = box.row(align=True)
    shown = restore.is_preview_on(context.scene)
    watch = context.window_manager.leaflight_changes
    changes = watch.watch(context)
    text = "Show Old Bake" if changes or watch.older else "Show Bake"
    row.operator("leaflight.toggle_preview", text=text, icon="HIDE_OFF" if shown else "HIDE_ON", depress=shown)
    row.operator("leaflight.remove", icon="TRASH")
    row = box.row(align=True)
    row.operator("leaflight.export_gltf", text="Export .glb", icon="EXPORT")
    folder = layout.worn_folder(context.scene) or find_output(context.scene)
    opener = row.row(align=True)
    opener.enabled = folder.is_dir()
    opener.operator("wm.path_open", text="Folder", icon="FILE_FOLDER").filepath = str(folder)
    draw_spare(box, context)
    box.operator("leaflight.refine", icon="ADD")
    if restore.MISSING in context.scene:
        draw_sentence(box, context, context.scene[restore.MISSING], "ERROR")
    if shown and view_shading.hides_bake(context):
        draw_sentence(box, context, "This view does not show the baked light.", "INFO")
        draw_show_it(box)
    if changes:
        told = f"{describe_changes(changes)}. The light that you see is out of date: bake again."
        draw_subjects(box, context, Sentence(tuple(changes), told), "ERROR")
    if watch.older:
        told = f"Changed between two bakes: {', '.join(watch.older[:3])}. What was not selected shows the older light: bake All."
        draw_subjects(box, context, Sentence(watch.older, told), "ERROR")
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
