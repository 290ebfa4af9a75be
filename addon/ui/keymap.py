"""The shortcut of Bake, in the 3D View; users may change it in the preferences."""

from __future__ import annotations

from typing import Any

import bpy

_KEYMAP = "3D View"
_BAKE = "leaflight.bake"
_registered: list[tuple[Any, Any]] = []  # what Blender wants back when the extension is disabled


def register() -> None:
    """Add the shortcut; in the background Blender has no keys."""
    keys = bpy.context.window_manager.keyconfigs.addon
    if keys is None:
        return
    keymap = keys.keymaps.new(name=_KEYMAP, space_type="VIEW_3D")
    item = keymap.keymap_items.new(_BAKE, type="F12", value="PRESS", ctrl=True, shift=True)
    _registered.append((keymap, item))


def unregister() -> None:
    """Take the shortcut back."""
    for keymap, item in _registered:
        keymap.keymap_items.remove(item)
    _registered.clear()


def draw(layout: Any, context: bpy.types.Context) -> None:
    """The shortcut, as the user has it."""
    keys = context.window_manager.keyconfigs.user
    keymap = keys.keymaps.get(_KEYMAP) if keys else None
    for item in keymap.keymap_items if keymap else ():
        if item.idname == _BAKE:
            row = layout.row()
            row.label(text="Shortcut of Bake")
            row.prop(item, "type", text="", full_event=True)
