"""Attributes of meshes at the corners of their faces, as shaders show them.

Measured with Cycles of Blender 5.0: what becomes of each kind of number, and of edges, whose attributes are shown at vertices.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.output.image_file import srgb_to_linear
from ..nodes.mesh_arrays import read_corner_vertices

Float32: TypeAlias = NDArray[np.float32]

COLORS = ("FLOAT_COLOR", "BYTE_COLOR")
_FIELDS: dict[str, tuple[str, int]] = {  # data_type -> field, numbers
    "FLOAT": ("value", 1),
    "INT": ("value", 1),
    "INT8": ("value", 1),
    "BOOLEAN": ("value", 1),
    "FLOAT2": ("vector", 2),
    "FLOAT_VECTOR": ("vector", 3),
    "FLOAT_COLOR": ("color", 4),
    "BYTE_COLOR": ("color", 4),
}


def list_wanted_attributes() -> frozenset[str]:
    """Names that Attribute and Color Attribute nodes of this file ask meshes for."""
    trees = [*(material.node_tree for material in bpy.data.materials if material.node_tree), *bpy.data.node_groups]
    nodes = [node for tree in trees for node in tree.nodes]
    of_mesh = [node.attribute_name for node in nodes if node.bl_idname == "ShaderNodeAttribute" and node.attribute_type == "GEOMETRY"]
    return frozenset(of_mesh + [node.layer_name for node in nodes if node.bl_idname == "ShaderNodeVertexColor"])


def read_attributes(mesh: Any, asked: frozenset[str]) -> tuple[dict[str, Float32], frozenset[str]]:
    """Colours of faces and vertices by name, (n_corner, 4) float32 each, linear; with those of other kinds that are asked for.

    "" is the one that nodes use by default. Also names of those with one number or two, which have the first as their Fac.
    """
    found, short = {}, set()
    for attribute in mesh.attributes:
        if attribute.data_type not in _FIELDS or not (attribute.name in asked or _is_plain_color(attribute)):
            continue
        values = _read_values(attribute)
        if attribute.domain == "EDGE":
            values = _bring_to_vertices(mesh, values, attribute.data_type)
            if attribute.data_type == "BYTE_COLOR":
                values = _decode_bytes(values)
        found[attribute.name] = _bring_to_corners(mesh, _make_rgba(values), attribute.domain)
        if values.shape[1] < 3:
            short.add(attribute.name)
    default = mesh.attributes.default_color_name  # of faces too, which render_color_index does not count
    return found | ({"": found[default]} if default in found else {}), frozenset(short)


def _is_plain_color(attribute: Any) -> bool:
    return attribute.data_type in COLORS and attribute.domain != "EDGE"


def _read_values(attribute: Any) -> NDArray[np.float32]:
    """(n, numbers) float32; of bytes on edges 0 to 255, as they are."""
    field, width = _FIELDS[attribute.data_type]
    as_bytes = attribute.data_type == "BYTE_COLOR" and attribute.domain == "EDGE"
    dtype = {"INT": np.int32, "INT8": np.int32, "BOOLEAN": np.bool_}.get(attribute.data_type, np.float32)
    values = np.empty((len(attribute.data), width), dtype)
    attribute.data.foreach_get("color_srgb" if as_bytes else field, values.ravel())
    values = np.nan_to_num(values.astype(np.float32), posinf=0.0, neginf=0.0)
    return np.rint(255.0 * values) if as_bytes else values


_MEANS: dict[str, Callable[[NDArray[np.float64]], NDArray[np.float64]]] = {
    "INT": lambda mean: np.copysign(np.floor(np.abs(mean) + 0.5), mean),
    "INT8": lambda mean: np.copysign(np.floor(np.abs(mean) + 0.5), mean),
    "BOOLEAN": np.ceil,  # one of the edges is enough
    "BYTE_COLOR": np.floor,
}


def _bring_to_vertices(mesh: Any, values: Float32, data_type: str) -> Float32:
    """(n_vertex, numbers): the mean of a vertex's edges, loose ones too, of the attribute's own kind."""
    vertex = np.empty(2 * len(mesh.edges), np.int32)
    mesh.edges.foreach_get("vertices", vertex)
    count = np.bincount(vertex, minlength=len(mesh.vertices))
    total = [np.bincount(vertex, np.repeat(column, 2), minlength=len(mesh.vertices)) for column in values.T.astype(np.float64)]
    mean = np.stack(total, axis=1) / np.maximum(count, 1)[:, None]
    out: Float32 = _MEANS.get(data_type, np.asarray)(mean).astype(np.float32)
    return out


def _bring_to_corners(mesh: Any, rgba: Float32, domain: str) -> Float32:
    if domain in ("POINT", "EDGE"):
        return rgba[read_corner_vertices(mesh)]
    if domain == "FACE":
        count = np.empty(len(mesh.polygons), np.int32)
        mesh.polygons.foreach_get("loop_total", count)
        return np.repeat(rgba, count, axis=0)
    return rgba


def _make_rgba(values: Float32) -> Float32:
    """(n, 4): one number is a grey, two are red and green."""
    n, width = values.shape
    if width == 1:
        values = np.repeat(values, 3, axis=1)
    rgba = np.zeros((n, 4), np.float32)
    rgba[:, 3] = 1.0
    rgba[:, : values.shape[1]] = values
    return rgba


def _decode_bytes(rgba: Float32) -> Float32:
    """(n, 4): linear, of sRGB bytes."""
    encoded = rgba / np.float32(255.0)
    linear = srgb_to_linear(encoded)
    linear[:, 3] = encoded[:, 3]
    return linear
