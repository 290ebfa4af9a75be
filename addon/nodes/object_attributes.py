"""Properties that shaders show: of Attribute nodes of the kinds Object, Instancer and View Layer, and of Object Info nodes.

Measured with Cycles of Blender 5.0: which data-blocks are asked in which order, and what numbers of other shapes become.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any, TypeAlias

import bpy

from .color_attributes import Faces
from .node_colors import Rgb
from .node_ports import Port

Rgba: TypeAlias = tuple[float, float, float, float]

RANDOM = "Random"  # an output of Object Info nodes
NOTHING: Rgba = (0.0, 0.0, 0.0, 0.0)
_MOST_NUMBERS = 4
_ELEMENT = re.compile(r"\[\d+\]$")  # of an array: Blender's own paths know it, Cycles does not


def shows_object(port: Port) -> bool:
    """Whether a node gives a property of the object that it is on."""
    node = port.node
    if node.type == "ATTRIBUTE":
        return node.attribute_type in ("OBJECT", "INSTANCER")
    return node.type == "OBJECT_INFO" and port.socket.name in ("Color", "Alpha", RANDOM)


def shows_view_layer(port: Port) -> bool:
    """Whether a node gives a property of the view layer, of its scene or that scene's world."""
    return port.node.type == "ATTRIBUTE" and port.node.attribute_type == "VIEW_LAYER"


def find_shown(faces: Faces | None, port: Port) -> Rgba | None:
    """What such a node gives on the faces of an object, or, without any, of the view layer; None if nothing has it: NOTHING is shown."""
    if faces is None:
        scene = bpy.context.scene
        return find_rgba((bpy.context.view_layer, scene, scene.world), port.node.attribute_name)
    node, blocks = port.node, [faces.shown, getattr(faces.shown, "data", None)]
    if node.type == "OBJECT_INFO" and port.socket.name == RANDOM:
        return (faces.random_level,) * 4
    if node.type == "OBJECT_INFO":
        red, green, blue, alpha = (faces.source if faces.is_instance else faces.shown).color
        return red, green, blue, alpha
    if node.attribute_type == "INSTANCER" and faces.is_instance:
        own = _find_of_instance(faces, node.attribute_name)
        if own:
            return own
        blocks.insert(0, faces.source)
    return find_rgba(blocks, node.attribute_name)


def can_read_instances() -> bool:
    """Whether what geometry nodes give to instances is known to scripts: from Blender 5.0 on."""
    return hasattr(bpy.types.Object, "evaluated_geometry")


def _find_of_instance(faces: Faces, name: str) -> Rgba | None:
    """An attribute that geometry nodes give to instances."""
    if faces.maker is None or faces.maker.type == "EMPTY" or not can_read_instances():  # an empty has collections alone, and no nodes
        return None
    geometry = faces.maker.evaluated_geometry()
    points = geometry.instances_pointcloud()
    attribute, ids = (points.attributes.get(one) if points else None for one in (name, "id"))
    numbers = range(len(attribute.data)) if attribute else ()
    place = next((place for place in numbers if ids.data[place].value == faces.number), -1) if ids else faces.number
    if place not in numbers:
        return None
    found = (getattr(attribute.data[place], kind, None) for kind in ("color", "vector", "value"))
    return next((rgba for rgba in map(_to_rgba, found) if rgba), None)


def pick_output(rgba: Rgba, output: str) -> Rgb:
    """What an output of such a node gives of it."""
    red, green, blue, alpha = rgba
    mean = (red + green + blue) / 3.0
    return {"Alpha": (alpha,) * 3, "Fac": (mean,) * 3, "Factor": (mean,) * 3}.get(output, (red, green, blue))


def find_rgba(blocks: Iterable[Any], path: str) -> Rgba | None:
    """A property of the first of these data-blocks that has it: a custom one of that name, or one of Blender's own by its path."""
    found = (_to_rgba(_find_value(block, path)) for block in blocks if block is not None)
    return next((rgba for rgba in found if rgba), None)


def find_random(name: str) -> float:
    """[0, 1]: what an Object Info node calls Random on an object of this name that is no instance.

    Source: Blender, intern/cycles/util/hash.h: hash_string, and hash_uint2, the last rounds of Jenkins' lookup3.
    """
    key = 0
    for byte in name.encode():
        key = (37 * key + byte - 256 * (byte > 127)) % 2**32
    a, b, c = key, 0, 0
    a, b, c = ((start + 0xDEADBEEF + (2 << 2) + 13) % 2**32 for start in (a, b, c))
    for turn in (14, 11, 25, 16, 4, 14, 24):
        c = ((c ^ b) - (b << turn | b >> 32 - turn)) % 2**32
        a, b, c = b, c, a
    return b / (2**32 - 1)


def _find_value(block: Any, path: str) -> Any:
    value = block.get(path)
    if value is not None or not path or _ELEMENT.search(path):
        return value
    try:
        return block.path_resolve(path)
    except ValueError:
        return None


def _to_rgba(value: Any) -> Rgba | None:
    """Numbers as a colour; None of what is none, as a word or a data-block."""
    if isinstance(value, int | float):
        return float(value), float(value), float(value), 1.0
    try:
        numbers = [float(one) for one in value]
    except (TypeError, ValueError):
        return None
    if isinstance(value, str) or not 1 < len(numbers) <= _MOST_NUMBERS:
        return None
    red, green, blue, alpha = (*numbers, *NOTHING[len(numbers) : 3], 1.0)[:_MOST_NUMBERS]
    return red, green, blue, alpha
