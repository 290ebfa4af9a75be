"""Colours and numbers of a shader node tree as a constant times an image: exact where that holds, else the nearest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from .color_attributes import ColorLayer, ColorTable, Faces
from .images_read import ImageTable, find_sphere_mean
from .node_colors import BLACK, GREY, MATH, WHITE, Color, Rgb, add_rgb, find_brightness, multiply_rgb, to_rgb
from .node_ports import Port
from .object_attributes import NOTHING, find_shown, pick_output, shows_object, shows_view_layer
from .texture_mapping import read_mapping

TEXTURE_COLOR: Rgb = (0.5, 0.5, 0.5)  # mean of a procedural texture, roughly
REPLACED_BY_GREY = "is replaced by a grey of 0.5"
RAMP_SAMPLES = 64


class ColorReader:
    """Reads the colours and numbers of one material, light or world.

    faces      that wear the material; None of a light or world
    colors     where their colour attributes go
    replaced   what could not be taken as it is, for one warning
    by_faces   whether what was read depends on the faces, or
    by_object  on the object that they are of
    """

    def __init__(self, images: ImageTable, faces: Faces | None = None, colors: ColorTable | None = None) -> None:
        self.images, self.faces, self.colors = images, faces, colors
        self.by_faces = self.by_object = False
        self.replaced: list[str] = []
        self.missing_rgb = GREY  # what stands for a missing image; Blender's magenta would tint the room

    def note(self, text: str) -> None:
        if text not in self.replaced:
            self.replaced.append(text)

    def read_color(self, port: Port | None, default: Rgb = WHITE) -> Color:
        """The colour that a source port gives."""
        if port is None:
            return Color(default)
        if port.is_value:
            return Color(_value_rgb(port.socket, default))
        if shows_view_layer(port) or (self.faces is not None and shows_object(port)):
            return _read_property(self, port)
        return _COLOR_READERS.get(port.node.type, _read_other_color)(self, port)

    def read_number(self, port: Port | None, default: float) -> float:
        """The number that a source port gives, or its mean over an image."""
        if port is None:
            return default
        if port.is_value:
            return find_brightness(_value_rgb(port.socket, (default, default, default)))
        reader = _NUMBER_READERS.get(port.node.type)
        if reader:
            return reader(self, port)
        color = self.read_color(port)
        if color.image >= 0:
            self.note(f"{_describe(port.node)} is replaced by its mean")
        return find_brightness(color.mean)

    def mix(self, first: Color, second: Color, fraction: float) -> Color:
        """(1 - fraction) first + fraction second."""
        return self.add(first.times(1.0 - fraction), second.times(fraction))

    def add(self, first: Color, second: Color) -> Color:
        """The sum; of two different images the brighter one stands for both."""
        if max(second.mean) <= 0.0:
            return first
        if max(first.mean) <= 0.0:
            return second
        if first.image == second.image and first.mapping == second.mapping:
            mean = None if first.mean_rgb is None else add_rgb(first.mean, second.mean)
            return replace(first, rgb=add_rgb(first.rgb, second.rgb), mean_rgb=mean)
        self.note("a mix of textures is replaced by the brighter one")
        main, other = (first, second) if sum(first.mean) >= sum(second.mean) else (second, first)
        total = add_rgb(main.mean, other.mean)
        scale = [t / m if m > 0.0 else 1.0 for t, m in zip(total, main.mean, strict=True)]
        return main.times((scale[0], scale[1], scale[2]))


def _read_image(reader: ColorReader, port: Port) -> Color:
    node = port.node
    pixels = reader.images.read(node.image) if node.image else None
    if pixels is None:
        reader.note(f"image {node.image.name} is missing, a constant is used" if node.image else "an image texture has no image")
        return Color(reader.missing_rgb)
    if pixels.note:
        reader.note(pixels.note)
    if port.socket.name == "Alpha":
        return Color((pixels.mean[3],) * 3)
    mean = pixels.mean[:3]
    if node.type == "TEX_ENVIRONMENT":
        reader.note(f"image {node.image.name} is replaced by its mean over the sphere")
        return Color(to_rgb(find_sphere_mean(pixels.pixels)))
    vector = port.sibling("Vector")
    mapping = None if node.projection != "FLAT" else read_mapping(vector)
    if mapping is None:
        reader.note(f"image {node.image.name} is replaced by its mean, for no UV layer maps it")
        return Color(mean)
    return Color(WHITE, reader.images.index(node.image, node.extension, node.interpolation == "Closest"), mapping, mean)


def _read_mix(reader: ColorReader, port: Port) -> Color:
    node = port.node
    if node.type == "MIX" and node.data_type != "RGBA":
        return _read_other_color(reader, port)
    names = ("Factor_Float", "A_Color", "B_Color") if node.type == "MIX" else ("Fac", "Color1", "Color2")
    fraction = min(max(reader.read_number(port.sibling(names[0]), 0.5), 0.0), 1.0)
    first, second = reader.read_color(port.sibling(names[1])), reader.read_color(port.sibling(names[2]))
    if node.blend_type == "MIX":
        return reader.mix(first, second, fraction)
    if node.blend_type == "ADD":
        return reader.add(first, second.times(fraction))
    if node.blend_type != "MULTIPLY":
        reader.note(f"blend mode {node.blend_type.replace('_', ' ').lower()} of {_describe(node)} is left out")
        return first if fraction < 1.0 or first.image >= 0 else second
    if second.image >= 0 and isinstance(first.mapping, ColorLayer) and fraction >= 1.0:
        first, second = second, first  # a texture tells more
    if second.image >= 0 and (first.image >= 0 or fraction < 1.0):
        vertex = isinstance(second.mapping, ColorLayer)
        reader.note("its vertex colours are baked as their mean" if vertex else "a product of textures takes one by its mean")
        second = Color(second.mean)
    if second.image >= 0:
        return second.times(first.rgb)
    return first.times(add_rgb(multiply_rgb(second.rgb, (fraction,) * 3), (1.0 - fraction,) * 3))


def _read_ramp(reader: ColorReader, port: Port) -> Color:
    fraction = port.sibling("Fac")
    if fraction is not None and (fraction.is_value or fraction.node.type in _NUMBER_READERS):
        return Color(to_rgb(port.node.color_ramp.evaluate(reader.read_number(fraction, 0.5))))
    reader.note(f"{_describe(port.node)} is replaced by its mean")
    samples = [to_rgb(port.node.color_ramp.evaluate(i / (RAMP_SAMPLES - 1))) for i in range(RAMP_SAMPLES)]
    return Color(to_rgb(np.mean(samples, axis=0)))


def _read_other_color(reader: ColorReader, port: Port) -> Color:
    """A node unknown to us: the mean of its colour inputs, or the one textured input."""
    colors = [reader.read_color(port.sibling(one.identifier)) for one in port.node.inputs if one.type == "RGBA" and one.enabled]
    if not colors:
        reader.note(f"{_describe(port.node)} {REPLACED_BY_GREY}")
        return Color(TEXTURE_COLOR)
    reader.note(f"{_describe(port.node)} is approximated")
    textured = next((color for color in colors if color.image >= 0), None)
    if textured:
        return textured
    return Color(to_rgb(np.mean([color.mean for color in colors], axis=0)))


def _read_attribute(reader: ColorReader, port: Port) -> Color:
    """An attribute of the mesh; black where it has none, as in Cycles."""
    node = port.node
    name = node.layer_name if node.type == "VERTEX_COLOR" else node.attribute_name
    reader.by_faces = True
    if reader.faces is None or reader.colors is None or (node.type == "ATTRIBUTE" and node.attribute_type != "GEOMETRY"):
        reader.note(f"{_describe(node)} {REPLACED_BY_GREY}")
        return Color(TEXTURE_COLOR)
    layer = ColorLayer(name, port.socket.identifier if port.socket.identifier in ("Fac", "Alpha") else "Color")
    found = reader.faces.find_range(layer) if name or node.type == "VERTEX_COLOR" else None
    if found is None and name in reader.faces.local.attributes:
        reader.note(f"{_describe(node)} {REPLACED_BY_GREY}, for attribute {name} is of a kind that is not read")
        return Color(TEXTURE_COLOR)
    if found is None:
        reader.note(
            f"{reader.faces.name} has no {f'colour attribute {name}' if name else 'colour attribute'}, so it is black there, as in Blender"
        )
        return Color(BLACK)
    low, mean, high = found
    if (low == high).all():
        return Color(to_rgb(low))
    return Color(WHITE, reader.colors.index(), layer, to_rgb(mean))


def _read_property(reader: ColorReader, port: Port) -> Color:
    """A property of the object, or of the view layer; black where it has none, as in Cycles."""
    owner = None if shows_view_layer(port) else reader.faces
    reader.by_object = reader.by_object or owner is not None
    rgba = find_shown(owner, port)
    if not rgba:
        name, path = owner.name if owner else "the view layer", port.node.attribute_name
        reader.note(f"{name} has no property {path} of numbers, so it is black there, as in Blender")
    return Color(pick_output(rgba or NOTHING, port.socket.name))


def _read_output_value(reader: ColorReader, port: Port) -> Color:
    return Color(_value_rgb(port.socket, WHITE))


def _read_math(reader: ColorReader, port: Port) -> float:
    values = [reader.read_number(port.sibling(socket.identifier), 0.0) for socket in port.node.inputs[:2]]
    operation = MATH.get(port.node.operation)
    if operation is None:
        reader.note(f"{_describe(port.node)} is left out")
        return values[0]
    result = operation(*values)
    return min(max(result, 0.0), 1.0) if port.node.use_clamp else result


def _read_light_path(reader: ColorReader, port: Port) -> float:
    """As a ray sees it that gathers diffuse light."""
    reader.note(f"{_describe(port.node)} is taken as diffuse rays see it")
    return 1.0 if port.socket.name in ("Is Diffuse Ray", "Ray Depth", "Diffuse Depth") else 0.0


def _read_fresnel(reader: ColorReader, port: Port) -> float:
    reader.note(f"{_describe(port.node)} is approximated")
    return 0.05  # facing a dielectric


def _read_channel(reader: ColorReader, port: Port) -> float:
    color = reader.read_color(port.sibling("Color"))
    if color.image >= 0:
        reader.note("a texture's channel is replaced by its mean")
    return color.mean[{"Red": 0, "R": 0, "Green": 1, "G": 1}.get(port.socket.name, 2)]


def _value_rgb(socket: Any, default: Rgb) -> Rgb:
    value = getattr(socket, "default_value", default)
    return to_rgb(value) if hasattr(value, "__len__") else (float(value),) * 3


def _describe(node: Any) -> str:
    return f"node {node.label or node.name}"


_COLOR_READERS: dict[str, Callable[[ColorReader, Port], Color]] = {
    "TEX_IMAGE": _read_image,
    "TEX_ENVIRONMENT": _read_image,
    "MIX": _read_mix,
    "MIX_RGB": _read_mix,
    "VALTORGB": _read_ramp,
    "VERTEX_COLOR": _read_attribute,
    "ATTRIBUTE": _read_attribute,
    "RGB": _read_output_value,
    "VALUE": _read_output_value,
}
_NUMBER_READERS: dict[str, Callable[[ColorReader, Port], float]] = {
    "MATH": _read_math,
    "LIGHT_PATH": _read_light_path,
    "FRESNEL": _read_fresnel,
    "LAYER_WEIGHT": _read_fresnel,
    "SEPARATE_COLOR": _read_channel,
    "SEPRGB": _read_channel,
}
