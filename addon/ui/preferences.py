"""What a user chooses once, for all files: Edit > Preferences > Add-ons > Leaflight.

No `from __future__ import annotations` here: Blender reads properties out of annotations.
"""

from typing import Any

import bpy

from . import keymap

ADDON = str(__package__).rpartition(".addon")[0]  # the name that Blender gave to the extension


class LeaflightPreferences(bpy.types.AddonPreferences):
    bl_idname = ADDON

    research: bpy.props.BoolProperty(
        name="Research Settings",
        description="Show the panel Research: settings of the method, for comparisons. A bake does not need them",
    )
    sound: bpy.props.BoolProperty(name="Sound at the End", description="Play a short tone when a bake is done")

    def draw(self, context: bpy.types.Context) -> None:
        column = self.layout.column()
        column.prop(self, "research")
        column.prop(self, "sound")
        keymap.draw(column, context)


def get_preferences(context: bpy.types.Context) -> Any:
    """The user's choices; None where Blender does not know this as an add-on, as on pip's bpy."""
    addon = context.preferences.addons.get(ADDON)
    return addon.preferences if addon else None


def wants(context: bpy.types.Context, name: str) -> bool:
    """Whether the user has switched on `research` or `sound`."""
    return bool(getattr(get_preferences(context), name, False))


CLASSES = (LeaflightPreferences,)
