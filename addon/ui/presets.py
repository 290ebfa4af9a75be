"""Presets of the user's own, in the header of the panel Bake."""

from __future__ import annotations

import dataclasses

import bpy
from bl_operators.presets import AddPresetBase
from bl_ui.utils import PresetPanel

from ...core.util.settings import Settings

FOLDER = "leaflight"
_OF_THE_FILE = ("name_pattern", "cluster", "force", "passes")  # no matter of taste, or said by another name
_MORE = ("main_pass", "passes", "materials")


class LEAFLIGHT_PT_presets(PresetPanel, bpy.types.Panel):
    bl_label = "Bake Presets"
    preset_subdir = FOLDER
    preset_operator = "script.execute_preset"
    preset_add_operator = "leaflight.preset_add"


class LEAFLIGHT_OT_preset_add(AddPresetBase, bpy.types.Operator):
    bl_idname = "leaflight.preset_add"
    bl_label = "Add Bake Preset"
    bl_description = "Keep these settings under a name, or remove that preset"
    preset_menu = "LEAFLIGHT_PT_presets"
    preset_subdir = FOLDER
    preset_defines = ("settings = bpy.context.scene.leaflight",)
    preset_values = tuple(
        f"settings.{name}" for name in (*(knob.name for knob in dataclasses.fields(Settings) if knob.name not in _OF_THE_FILE), *_MORE)
    )


CLASSES = (LEAFLIGHT_PT_presets, LEAFLIGHT_OT_preset_add)
