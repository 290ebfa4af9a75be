"""A world that is one equirectangular picture, as it is or changed by nodes -> a map of its radiance, read straight from the pixels.

It is many times faster than to have Cycles evaluate it, which does so for all else.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..nodes.colors_read import ColorReader
from ..nodes.images_read import ImageTable, find_sphere_mean
from ..nodes.node_colors import WHITE, Color, to_rgb
from ..nodes.node_ports import Port, find_source
from ..nodes.texture_mapping import UvMapping
from .shaders_read import Surface
from .world_map import LARGE_SIZE, LIGHT_PATH

_STILL = ("FILE", "GENERATED")
_FULL_TURN = 2.0 * math.pi


def open_sky() -> ColorReader:
    """A reader of a world, to which an environment texture is an image that is mapped to directions, at most turned about the vertical."""
    return ColorReader(ImageTable(LARGE_SIZE[0]), sky=(_read_environment, LIGHT_PATH))


def unroll_sky(reader: ColorReader, surface: Surface) -> NDArray[np.float32] | None:
    """(h, w, 3), W/m^2/sr, of a world's surface by open_sky; None where something of it was replaced."""
    shown = surface.emission
    if reader.replaced or shown.image < 0 or not isinstance(shown.mapping, UvMapping):
        return None
    return _unroll(reader.images.images[shown.image].pixels, np.float32(shown.rgb), shown.mapping.affine[0][3] * _FULL_TURN)


def _read_environment(reader: ColorReader, port: Port) -> Color | None:
    node, turn = port.node, _find_picture(port)
    pixels = None if turn is None or port.socket.name == "Alpha" else reader.images.read(node.image, 0)
    if turn is None or pixels is None or pixels.alpha is not None or pixels.note:
        return None
    image = reader.images.index(node.image, 0, "REPEAT", False)
    turned = np.eye(4)
    turned[0, 3] = turn / _FULL_TURN
    first, second, third, fourth = (tuple(row) for row in turned.tolist())
    return Color(WHITE, image, UvMapping(affine=(first, second, third, fourth)), to_rgb(find_sphere_mean(pixels.pixels)))


def _find_picture(color: Port) -> float | None:
    """By how much an environment texture's picture is turned, rad; None where it is not one equirectangular picture, at most turned."""
    node = color.node
    turn = _find_turn(color)
    if turn is None or node.projection != "EQUIRECTANGULAR" or node.image is None or node.image.source not in _STILL:
        return None
    mapped = node.color_mapping
    return None if getattr(mapped, "use_color_ramp", False) or mapped.brightness != 1.0 or mapped.contrast != 1.0 else turn


def _unroll(pixels: NDArray[np.float32], strength: NDArray[np.float32] | np.float32, turn: float) -> NDArray[np.float32]:
    height, width, _ = pixels.shape
    rows = 2 * height // width  # of a large picture the columns alone were reduced
    radiance = pixels if rows < 2 or height % rows else pixels.reshape(height // rows, rows, width, 3).mean(axis=1)
    return _turn_columns(np.maximum(radiance * strength, np.float32(0)), turn)


def _find_turn(color: Port) -> float | None:
    """By how much the picture's directions are turned about +Z, rad; None where they are not just turned so."""
    mapping = color.node.texture_mapping
    if (
        tuple(mapping.rotation) != (0.0, 0.0, 0.0)
        or tuple(mapping.scale) != (1.0, 1.0, 1.0)
        or tuple(mapping.translation) != (0.0, 0.0, 0.0)
    ):
        return None
    vector = color.sibling("Vector")
    if vector is None or vector.is_value:
        return 0.0
    if vector.node.type == "TEX_COORD":
        return 0.0 if vector.socket.name == "Generated" else None
    if vector.node.type != "MAPPING" or vector.node.vector_type != "POINT":
        return None
    inputs = {name: find_source(Port(vector.node.inputs[name], vector.groups)) for name in ("Vector", "Location", "Rotation", "Scale")}
    origin = inputs.pop("Vector")
    if origin.is_value or origin.node.type != "TEX_COORD" or origin.socket.name != "Generated":
        return None
    if not all(port.is_value for port in inputs.values()):
        return None
    location, rotation, scale = (tuple(inputs[name].socket.default_value) for name in ("Location", "Rotation", "Scale"))
    if location != (0.0, 0.0, 0.0) or scale != (1.0, 1.0, 1.0) or rotation[:2] != (0.0, 0.0):
        return None
    return float(rotation[2])


def _turn_columns(radiance: NDArray[np.float32], turn: float) -> NDArray[np.float32]:
    """What is seen by looking up turned directions: columns moved along, between two of them by their mean."""
    moved = turn / _FULL_TURN * radiance.shape[1]
    whole, part = math.floor(moved), np.float32(moved - math.floor(moved))
    near = np.roll(radiance, whole, axis=1)
    return near if part < 1e-4 else near * (1 - part) + np.roll(radiance, whole + 1, axis=1) * part
