"""Meshes as arrays, for those who read colours from them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class LocalMesh:
    """One mesh in the space of its object.

    position        (n_vertex, 3) float64
    corner_vertex   (n_corner,) int32
    polygon_start   (n_polygon,) int32   first corner
    polygon_slot    (n_polygon,) int32   material slot
    corner_normal   (n_corner, 3) float64, 0 on flat faces: each triangle of a bent one has its own, as in Cycles
    tri_corner      (n_tri, 3) int32, consecutive for each polygon
    tri_polygon     (n_tri,) int32
    layers          UV layers by name, (n_corner, 2) float64 each
    render_layer    name of the layer that textures use by default, "" none
    colors, short   see read_attributes
    attributes      names of all attributes
    """

    position: NDArray[np.float64]
    corner_vertex: NDArray[np.int32]
    polygon_start: NDArray[np.int32]
    polygon_slot: NDArray[np.int32]
    corner_normal: NDArray[np.float64]
    tri_corner: NDArray[np.int32]
    tri_polygon: NDArray[np.int32]
    layers: dict[str, NDArray[np.float64]]
    render_layer: str
    colors: dict[str, NDArray[np.float32]]
    short: frozenset[str]
    attributes: frozenset[str]

    @property
    def n_corner(self) -> int:
        return len(self.corner_vertex)

    @property
    def n_polygon(self) -> int:
        return len(self.polygon_start)


@dataclass(frozen=True)
class WorldMesh:
    """The triangles of a mesh in the world; vertices that no triangle uses are left out.

    vertex_position   (n_vertex, 3) float64, m
    tri_vertex, tri_corner   (n_tri, 3) int32, anticlockwise seen from the front
    tri_polygon, tri_slot    (n_tri,) int32
    tri_normal        (n_tri, 3, 3) float32, unit
    left_out          polygons dropped whole for a coordinate that is not finite
    """

    vertex_position: NDArray[np.float64]
    tri_vertex: NDArray[np.int32]
    tri_corner: NDArray[np.int32]
    tri_polygon: NDArray[np.int32]
    tri_slot: NDArray[np.int32]
    tri_normal: NDArray[np.float32]
    left_out: int


def read_positions(mesh: Any) -> NDArray[np.float32]:
    """(n_vertex, 3) float32 of a Blender mesh."""
    return _read(mesh, "position", "vector", mesh.vertices, "co", (len(mesh.vertices), 3), np.float32)


def read_corner_vertices(mesh: Any) -> NDArray[np.int32]:
    """(n_corner,) int32 of a Blender mesh."""
    return _read(mesh, ".corner_vert", "value", mesh.loops, "vertex_index", (len(mesh.loops),), np.int32)


def read_faces(mesh: Any, name: str, dtype: Any) -> NDArray[Any]:
    """(n_polygon,) of a Blender mesh: an attribute of faces, which is zero where there is none of this name."""
    found, shape = mesh.attributes.get(name), (len(mesh.polygons),)
    values = np.zeros(shape, dtype)
    if found is not None and found.domain == "FACE" and len(found.data) == len(values):
        found.data.foreach_get("value", values)
    return values


def _read(mesh: Any, attribute: str, value: str, items: Any, name: str, shape: tuple[int, ...], dtype: Any) -> NDArray[Any]:
    """Attributes are copied as they are, many times as fast as items, which are asked one by one; in Edit Mode there are only these."""
    found, values = mesh.attributes.get(attribute), np.empty(shape, dtype)
    if found is not None and len(found.data) == len(items):
        found.data.foreach_get(value, values.reshape(-1))
    else:
        items.foreach_get(name, values.reshape(-1))
    return values
