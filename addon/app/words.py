"""Names of settings and choices as artists know them; the command line has its own. No bpy here."""

from __future__ import annotations

import dataclasses
from typing import Any

from ...core.util.settings import IMAGE_FORMATS

_CHOICES = {
    "bake": "Whole Scene",
    "objects": "Each Object",
    "standard": "Plain sRGB",
    "scene": "As in the Scene",
    "rays": "Shadow Rays",
    "stderr": "Noise",
    "rgbm": "RGBM",
    "rgbd": "RGBD",
    "logluv": "LogLuv",
}
_KNOBS = {
    "error_of": "Measure",
    "value_range": "Greatest Value",
    "view_transform": "PNG Colours",
    "name_pattern": "File Names",
    "formats": "File Format",
    "pack": "Pack into .blend",
    "force": "Always Bake Again",
    "atlas": "Share Pages",
    "contact": "Cut at Contacts",
    "hierarchical": "Adaptive Leaves",
    "seams": "Close Seams",
    "finest_texels": "Smallest Leaf",
    "workers": "Processes",
}
PASS_ABOUT = {
    "combined": "What one sees: light times colour, plus what glows",
    "lighting": "Light without colour: irradiance divided by pi",
    "direct": "The part of the lighting that comes straight from lights",
    "indirect": "The part of the lighting that was reflected at least once",
    "diffuse": "Light times colour, without what glows",
    "emission": "What glows by itself",
    "albedo": "Colour without light",
    "stderr": "How noisy each pixel still is: the standard error of the lighting, as it is estimated",
    "leaf_edges": "Where the light was stored in finer and coarser pieces",
    "level": "How fine these pieces are",
    "photons": "How many photons each piece received",
    "charts": "The pieces into which the surfaces were cut, each in its own colour",
}


CHOICE_ABOUT = {
    "exr": "Linear light without a limit: for Blender and most engines",
    "hdr": "Linear light without a limit (Radiance), for programs that do not read EXR",
    "png": "8 bit sRGB, clipped at white: a picture, for viewers",
    "rgbm": "For engines without float textures: colour times a multiplier in alpha",
    "rgbd": "For engines without float textures: colour over a divisor in alpha",
    "logluv": "For engines without float textures: logarithmic brightness and colour",
    "bake": "Stop when the scene as a whole has the error that you ask for",
    "objects": "Stop when each object has it, compared with its own brightness: for dim rooms and small things; takes longer",
}


def name_knob(knob: dataclasses.Field[Any]) -> str:
    """Label of a setting."""
    return str(_KNOBS.get(knob.name) or knob.metadata["label"] or knob.name.replace("_", " ").title())


def name_choice(choice: str) -> str:
    """Label of a choice: EXR, Leaf Edges."""
    return _CHOICES.get(choice) or (choice.upper() if choice in IMAGE_FORMATS else choice.replace("_", " ").title())
