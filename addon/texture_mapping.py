"""Where an image texture lies on a mesh: a UV layer and an affine mapping of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from mathutils import Euler
from numpy.typing import NDArray

from ..core.scene import FloatArray
from .node_ports import Port


@dataclass(frozen=True)
class UvMapping:
    """A UV layer ("" the one active for render) and the mapping of it.

    affine   rows of a (4, 4) matrix over (u, v, 0, 1)
    """

    layer: str = ""
    affine: tuple[tuple[float, ...], ...] = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0))

    def apply(self, uv: FloatArray) -> NDArray[np.float64]:
        """Texture coordinates of layer coordinates.

        uv, out  (..., 2) float64
        """
        affine = np.array(self.affine)
        mapped: NDArray[np.float64] = uv @ affine[:2, :2].T + affine[:2, 3]
        return mapped


UNMAPPED = UvMapping()


def read_mapping(vector: Port | None) -> UvMapping | None:
    """The mapping that a vector source gives; None when it is not an affine image of a UV layer."""
    if vector is None or vector.is_value:
        return UNMAPPED
    node = vector.node
    if node.type == "UVMAP":
        return UvMapping(node.uv_map)
    if node.type == "TEX_COORD" and vector.socket.name == "UV":
        return UNMAPPED
    if node.type == "ATTRIBUTE" and node.attribute_type == "GEOMETRY" and vector.socket.name in ("Vector", "Color"):
        return UvMapping(node.attribute_name)
    if node.type != "MAPPING":
        return None
    inner = read_mapping(vector.sibling("Vector"))
    affine = _mapping_matrix(vector)
    if inner is None or affine is None:
        return None
    return UvMapping(inner.layer, tuple(tuple(float(x) for x in row) for row in affine @ np.array(inner.affine)))


def _mapping_matrix(vector: Port) -> NDArray[np.float64] | None:
    """The (4, 4) matrix of a Mapping node, None where it has none.

    Source: Blender manual, Mapping node: Point is scale, rotate, move; Texture is its inverse; Vector does not move.
    """
    node = vector.node
    location, rotation, scale = (_constant(vector.sibling(name)) for name in ("Location", "Rotation", "Scale"))
    if location is None or rotation is None or scale is None or node.vector_type == "NORMAL":
        return None
    matrix = np.eye(4)
    matrix[:3, :3] = np.array(Euler(rotation, "XYZ").to_matrix()) @ np.diag(scale)
    if node.vector_type != "VECTOR":
        matrix[:3, 3] = location
    if node.vector_type != "TEXTURE":
        return matrix
    return np.linalg.inv(matrix) if np.abs(np.linalg.det(matrix)) > 0.0 else None


def _constant(port: Port | None) -> Any:
    """The three numbers of an unlinked vector input, None for a linked one; a hidden Location input counts as zero."""
    if port is None:
        return (0.0, 0.0, 0.0)
    return tuple(port.socket.default_value) if port.is_value else None
