"""Meshes as arrays, for those who read colours from them."""

from __future__ import annotations

from dataclasses import dataclass

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
