"""What the panel lets one choose, kept in the scene: every knob of core.settings, and what only Blender knows.

No `from __future__ import annotations` here: Blender reads properties out of annotations.
"""

import dataclasses
from typing import Any

import bpy

from ...core.util.settings import Settings
from . import quantities, words

# Target errors behind the names; any other error is "custom" and shows none of them pressed.
QUALITY_ERROR = {"DRAFT": 0.10, "PREVIEW": 0.05, "PRODUCTION": 0.02}

_CUSTOM = 0
_BY_PAGE, _BY_DENSITY = 0, 1
_MAX_INT = 2**31 - 1  # Blender's integers have 32 bits; the command line goes further
_SUBTYPES = {"texels": "PIXEL", "s": "TIME_ABSOLUTE"}


def list_groups() -> list[str]:
    """The groups of knobs, in their order."""
    return list(dict.fromkeys(knob.metadata["group"] for knob in dataclasses.fields(Settings)))


def list_knobs(group: str) -> list[str]:
    """Names of the knobs of a group, which are the properties' names too."""
    return [knob.name for knob in dataclasses.fields(Settings) if knob.metadata["group"] == group]


def is_changed(properties: Any, name: str) -> bool:
    """Whether a knob is not as it is in a new file."""
    knob = next(knob for knob in dataclasses.fields(Settings) if knob.name == name)
    return bool(_read(getattr(properties, name), knob) != knob.default)


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


def _read(value: Any, knob: "dataclasses.Field[Any]") -> Any:
    if isinstance(value, set):
        return tuple(choice for choice in knob.metadata["choices"] if choice in value)
    return float(f"{value:.7g}") if isinstance(value, float) else value  # Blender's are float32: 0.05 reads 0.0500000007


def _make_property(knob: "dataclasses.Field[Any]") -> Any:
    about, default = knob.metadata, knob.default
    description = about["help"][0].upper() + about["help"][1:]
    named: dict[str, Any] = {"name": words.name_knob(knob), "description": description}
    limits: dict[str, Any] = {"min": about["low"], "max": about["high"], "default": default}
    subtype = _SUBTYPES.get(about["unit"], "NONE")
    if about["unit"] and subtype == "NONE":
        named["description"] += f", in {about['unit']}"
    if about["choices"]:
        items = [(choice, words.name_choice(choice), words.CHOICE_ABOUT.get(choice, "")) for choice in about["choices"]]
        flags = {"options": {"ENUM_FLAG"}, "default": set(default)} if isinstance(default, tuple) else {"default": default}
        return bpy.props.EnumProperty(items=items, **named, **flags)
    if isinstance(default, str):
        return bpy.props.StringProperty(default=default, **named)
    if isinstance(default, bool):
        return bpy.props.BoolProperty(default=default, **named)
    if isinstance(default, int):
        return bpy.props.IntProperty(**named, **limits | {"max": min(about["high"], _MAX_INT)}, subtype=subtype)
    if subtype == "TIME_ABSOLUTE":
        return bpy.props.FloatProperty(**named, **limits, subtype=subtype, unit=subtype)
    return bpy.props.FloatProperty(**named, **limits, precision=1 if about["high"] > 10 else 3)


def _get_quality(properties: Any) -> int:
    if properties.custom_quality:
        return _CUSTOM
    error = float(f"{properties.error:.7g}")
    return next((number for number, value in enumerate(QUALITY_ERROR.values(), 1) if value == error), _CUSTOM)


def _set_quality(properties: Any, number: int) -> None:
    properties.custom_quality = number == _CUSTOM
    if number != _CUSTOM:
        properties.error = list(QUALITY_ERROR.values())[number - 1]


def _get_resolution(properties: Any) -> int:
    return _BY_DENSITY if properties.density > 0.0 else _BY_PAGE


def _set_resolution(properties: Any, number: int) -> None:
    if number == _get_resolution(properties):
        return
    if number == _BY_DENSITY:
        properties.density = properties.last_density
    else:
        properties.last_density, properties.density = properties.density, 0.0


def _list_uv_layers(properties: Any, context: Any, text: str) -> list[str]:
    meshes = {obj.data for obj in context.scene.objects if obj.type == "MESH"}
    return sorted({layer.name for mesh in meshes for layer in mesh.uv_layers if text.lower() in layer.name.lower()})


_KNOBS = {knob.name: _make_property(knob) for knob in dataclasses.fields(Settings) if knob.name != "passes"}
_PASSES = next(knob for knob in dataclasses.fields(Settings) if knob.name == "passes")
_PASS_ITEMS = [(choice, words.name_choice(choice), words.PASS_ABOUT.get(choice, "")) for choice in _PASSES.metadata["choices"]]
_QUALITY_ITEMS = [
    *((name, name.capitalize(), f"Bake until the error is {error:.0%}", i) for i, (name, error) in enumerate(QUALITY_ERROR.items(), 1)),
    ("CUSTOM", "Custom", "Another target error", _CUSTOM),
]
_RESOLUTION_ITEMS = [
    ("PAGE", "Page Size", "Everything on one page, as finely as fits; on more pages where one has no room for it", _BY_PAGE),
    ("DENSITY", "Density", "So many texels per metre of surface, on as many pages as that takes", _BY_DENSITY),
]
_SHOWN_ITEMS = [
    ("SHOW", "Show the Bake", "The baked objects show the image: Lighting times their base colour, any other pass by itself, unlit"),
    ("NODES", "Add Nodes Only", "The image is placed in copies of the materials, linked to nothing, for you to link"),
]


def _make_text(name: str, write: Any, read: Any) -> Any:
    """A knob as text, where its number cannot be read; text that says no number changes nothing, and none at all is the knob's 0."""
    knob = next(knob for knob in dataclasses.fields(Settings) if knob.name == name)
    low, high = knob.metadata["low"], knob.metadata["high"]

    def get(properties: Any) -> str:
        value = getattr(properties, name)
        return write(value) if value else ""

    def set_(properties: Any, text: str) -> None:
        value = read(text) if text.strip() else (0 if low == 0 else None)
        if value is not None:
            setattr(properties, name, type(knob.default)(min(max(value, low), high, _MAX_INT)))

    about = knob.metadata["help"]
    return bpy.props.StringProperty(
        name=words.name_knob(knob), description=about[0].upper() + about[1:], get=get, set=set_, options={"SKIP_SAVE"}
    )


# The knob, and what its field shows where it is 0.
TEXTS = {
    "max_photons": "",
    "time_limit": "no limit",
    "value_range": "each page's own",
    "workers": "one per core",
}
_TEXT_PROPERTIES = {
    "error_percent": bpy.props.FloatProperty(
        name="Target Error",
        description="How noisy the lightmap may be when the bake stops: the relative error of a typical pixel",
        subtype="PERCENTAGE",
        min=0.01,
        max=100.0,
        precision=1,
        get=lambda properties: 100.0 * properties.error,
        set=lambda properties, percent: setattr(properties, "error", float(f"{percent / 100.0:.6g}")),
        options={"SKIP_SAVE"},
    ),
    "max_photons_text": _make_text("max_photons", quantities.write_count, quantities.read_count),
    "time_limit_text": _make_text("time_limit", quantities.write_duration, quantities.read_duration),
    "value_range_text": _make_text("value_range", "{:g}".format, quantities.read_number),
    "workers_text": _make_text("workers", str, quantities.read_count),
}

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
    "custom_quality": bpy.props.BoolProperty(options={"HIDDEN"}),
    "resolution": bpy.props.EnumProperty(
        name="Resolution",
        description="What decides how large texels are on the surface",
        items=_RESOLUTION_ITEMS,
        get=_get_resolution,
        set=_set_resolution,
    ),
    "last_density": bpy.props.FloatProperty(default=64.0, options={"HIDDEN"}),
    "materials": bpy.props.EnumProperty(name="After the Bake", description="What baked objects wear after the bake", items=_SHOWN_ITEMS),
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
        description="Folder of the images; // is the folder of the .blend, {blend_name} its name",
        default="//lightmaps/{blend_name}",
        subtype="DIR_PATH",
        options={"PATH_SUPPORTS_BLEND_RELATIVE"},
    ),
}

LeaflightProperties = type(
    "LeaflightProperties", (bpy.types.PropertyGroup,), {"__annotations__": {**_KNOBS, **_BLENDER_ONLY, **_TEXT_PROPERTIES}}
)
