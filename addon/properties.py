"""What the panel lets one choose, kept in the scene: every knob of core.settings, and what only Blender knows.

No `from __future__ import annotations` here: Blender reads properties out of annotations.
"""

import dataclasses
from typing import Any

import bpy

from ..core.settings import Settings

# Target errors behind the names; any other error is "custom" and shows none of them pressed.
QUALITY_ERROR = {"DRAFT": 0.20, "PREVIEW": 0.10, "PRODUCTION": 0.05}

_CUSTOM = 0
_MAX_INT = 2**31 - 1  # Blender's integers have 32 bits; the command line goes further
_SUBTYPES = {"texels": "PIXEL", "s": "TIME_ABSOLUTE"}


def list_groups() -> list[str]:
    """The groups of knobs, in their order."""
    return list(dict.fromkeys(knob.metadata["group"] for knob in dataclasses.fields(Settings)))


def list_knobs(group: str) -> list[str]:
    """Names of the knobs of a group, which are the properties' names too."""
    return [knob.name for knob in dataclasses.fields(Settings) if knob.metadata["group"] == group]


def make_settings(properties: Any) -> Settings:
    """The settings that stand in the panel.

    Raises ValueError with a sentence where nothing is chosen, or a value is out of its range.
    """
    values = {knob.name: _read(getattr(properties, knob.name), knob) for knob in dataclasses.fields(Settings)}
    more = [name for name in values["passes"] if name != properties.main_pass]
    values["passes"] = (properties.main_pass, *more)
    if not values["formats"]:
        raise ValueError("no file format is chosen: choose one in the panel's Output.")
    return Settings(**values)


def describe_choice(choice: str) -> str:
    """Label of a choice: EXR, Combined."""
    return choice.upper() if len(choice) <= 3 else choice.capitalize()


def _read(value: Any, knob: "dataclasses.Field[Any]") -> Any:
    if isinstance(value, set):
        return tuple(choice for choice in knob.metadata["choices"] if choice in value)
    return float(f"{value:.7g}") if isinstance(value, float) else value  # Blender's are float32: 0.05 reads 0.0500000007


def _make_property(knob: "dataclasses.Field[Any]") -> Any:
    about, default = knob.metadata, knob.default
    description = about["help"][0].upper() + about["help"][1:]
    named: dict[str, Any] = {"name": knob.name.replace("_", " ").title(), "description": description}
    limits: dict[str, Any] = {"min": about["low"], "max": about["high"], "default": default}
    subtype = _SUBTYPES.get(about["unit"], "NONE")
    if about["unit"] and subtype == "NONE":
        named["description"] += f", in {about['unit']}"
    if about["choices"]:
        items = [(choice, describe_choice(choice), "") for choice in about["choices"]]
        flags = {"options": {"ENUM_FLAG"}, "default": set(default)} if isinstance(default, tuple) else {"default": default}
        return bpy.props.EnumProperty(items=items, **named, **flags)
    if isinstance(default, bool):
        return bpy.props.BoolProperty(default=default, **named)
    if isinstance(default, str):
        return bpy.props.StringProperty(default=default, **named)
    if isinstance(default, int):
        return bpy.props.IntProperty(**named, **limits | {"max": min(about["high"], _MAX_INT)}, subtype=subtype)
    if subtype == "TIME_ABSOLUTE":
        return bpy.props.FloatProperty(**named, **limits, subtype=subtype, unit=subtype)
    return bpy.props.FloatProperty(**named, **limits, precision=1 if about["high"] > 10 else 3)


def _get_quality(properties: Any) -> int:
    error = float(f"{properties.error:.7g}")
    return next((number for number, value in enumerate(QUALITY_ERROR.values(), 1) if value == error), _CUSTOM)


def _set_quality(properties: Any, number: int) -> None:
    if number != _CUSTOM:
        properties.error = list(QUALITY_ERROR.values())[number - 1]


def _list_uv_layers(properties: Any, context: Any, text: str) -> list[str]:
    meshes = {obj.data for obj in context.scene.objects if obj.type == "MESH"}
    return sorted({layer.name for mesh in meshes for layer in mesh.uv_layers if text.lower() in layer.name.lower()})


_KNOBS = {knob.name: _make_property(knob) for knob in dataclasses.fields(Settings) if knob.name != "passes"}
_PASSES = next(knob for knob in dataclasses.fields(Settings) if knob.name == "passes")
_PASS_ITEMS = [(choice, describe_choice(choice), "") for choice in _PASSES.metadata["choices"]]
_QUALITY_ITEMS = [
    ("CUSTOM", "Custom", "Another target error", _CUSTOM),
    *((name, name.capitalize(), f"Bake until the error is {error:.0%}", i) for i, (name, error) in enumerate(QUALITY_ERROR.items(), 1)),
]

_BLENDER_ONLY = {
    "objects": bpy.props.EnumProperty(
        name="Objects",
        description="Objects that get a lightmap; the others still cast light and shadow",
        items=[("ALL", "All", "Every mesh that is shown in render"), ("SELECTED", "Selected", "The selected meshes")],
    ),
    "quality": bpy.props.EnumProperty(
        name="Quality",
        description="How small the error must be before the bake stops",
        items=_QUALITY_ITEMS,
        get=_get_quality,
        set=_set_quality,
    ),
    "main_pass": bpy.props.EnumProperty(
        name="Pass", description="What the objects show after the bake", items=_PASS_ITEMS, default=_PASSES.default[0]
    ),
    "passes": bpy.props.EnumProperty(
        name="More Passes", description="Images to write besides the one that is shown", items=_PASS_ITEMS, options={"ENUM_FLAG"}
    ),
    "uv_layer": bpy.props.StringProperty(
        name="UV Layer", description="Use this UV layer as it is; empty: unwrap into a layer of Leaflight's own", search=_list_uv_layers
    ),
    "output": bpy.props.StringProperty(
        name="Output",
        description="Folder of the images; // is the folder of the .blend",
        default="//lightmaps",
        subtype="DIR_PATH",
        options={"PATH_SUPPORTS_BLEND_RELATIVE"},
    ),
}

LeaflightProperties = type("LeaflightProperties", (bpy.types.PropertyGroup,), {"__annotations__": {**_KNOBS, **_BLENDER_ONLY}})
