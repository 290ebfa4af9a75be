"""Has what the panels and views show drawn again."""

from __future__ import annotations

import bpy


def redraw(context: bpy.types.Context, kind: str) -> None:
    """Regions of the 3D views: the sidebars "UI", or the views "WINDOW", whose drawing may take long."""
    areas = [area for window in context.window_manager.windows for area in window.screen.areas if area.type == "VIEW_3D"]
    for region in (region for area in areas for region in area.regions if region.type == kind):
        region.tag_redraw()
