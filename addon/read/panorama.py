"""A world that is one equirectangular picture -> a map of its radiance, read straight from the pixels.

It is many times faster than to have Cycles evaluate it, which does so for all else.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..nodes.images_read import read_pixels
from ..nodes.node_ports import Port, find_source
from .world_map import LARGE_SIZE

_STILL = ("FILE", "GENERATED")
_FULL_TURN = 2.0 * math.pi


def read_panorama(source: Port) -> NDArray[np.float32] | None:
    """(h, w, 3), W/m^2/sr, of a background node that shows a picture, at most turned about the vertical; None for all else.

    source   what feeds the world's surface
    """
    if source.node.type != "BACKGROUND":
        return None
    strength, color = source.sibling("Strength"), source.sibling("Color")
    if strength is None or color is None or not strength.is_value or color.node.type != "TEX_ENVIRONMENT":
        return None
    node = color.node
    turn = _find_turn(color)
    if turn is None or node.projection != "EQUIRECTANGULAR" or node.image is None or node.image.source not in _STILL:
        return None
    if getattr(node.color_mapping, "use_color_ramp", False) or node.color_mapping.brightness != 1.0 or node.color_mapping.contrast != 1.0:
        return None
    pixels = read_pixels(node.image, LARGE_SIZE[0])
    if pixels is None or pixels.alpha is not None or pixels.note:
        return None
    height, width, _ = pixels.pixels.shape
    rows = 2 * height // width  # of a large picture the columns alone were reduced
    radiance = pixels.pixels if rows < 2 or height % rows else pixels.pixels.reshape(height // rows, rows, width, 3).mean(axis=1)
    radiance = np.maximum(radiance, np.float32(0)) * np.float32(max(strength.socket.default_value, 0.0))
    return _turn_columns(radiance, turn)


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
