"""Where an image texture lies on a mesh: an affine mapping of a UV layer, or of positions, seen flat or from six sides."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from mathutils import Euler
from numpy.typing import NDArray

from ...core.util.arrays import FloatArray
from .node_ports import Port

UV, OBJECT, WORLD, GENERATED = "UV", "OBJECT", "WORLD", "GENERATED"  # what is mapped


@dataclass(frozen=True)
class UvMapping:
    """What is mapped, and the mapping of it.

    layer    of UV, "" the one active for render
    affine   rows of a (4, 4) matrix over (x, y, z, 1), for UV over (u, v, 0, 1)
    space    UV, or positions: in the object's space or the world's, or from 0 to 1 over the mesh's texture space
    box      whether each face is seen along the axis that its normal is next to, in place of along z
    """

    layer: str = ""
    affine: tuple[tuple[float, ...], ...] = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    space: str = UV
    box: bool = False

    def into_grid(self, grid: tuple[int, int, int, int]) -> UvMapping:
        """The same place in an image of several UDIM tiles (see images_read.ImagePixels)."""
        column, row, columns, rows = grid
        into = np.diag([1.0 / columns, 1.0 / rows, 1.0, 1.0])
        into[:2, 3] = -column / columns, -row / rows
        return replace(self, affine=_to_rows(into @ np.array(self.affine)))

    def apply(self, coordinates: FloatArray, normal: FloatArray | None = None) -> NDArray[np.float64]:
        """Texture coordinates.

        coordinates   (..., 2) or (..., 3) float64: what is mapped
        normal        (n, 3) float64, in the object's space: of the n triangles whose corners (n, 3, 3) the coordinates are; for box alone
        out           (..., 2) float64
        """
        affine, n = np.array(self.affine), coordinates.shape[-1]
        if not self.box or normal is None:
            flat: NDArray[np.float64] = coordinates @ affine[:2, :n].T + affine[:2, 3]
            return flat
        return _project_box(coordinates @ affine[:3, :n].T + affine[:3, 3], normal)


UNMAPPED = UvMapping()


def _project_box(place: FloatArray, normal: FloatArray) -> NDArray[np.float64]:
    """Each triangle seen along an axis, mirrored so that it reads from outside.

    place  (n, 3, 3) float64; out (n, 3, 2).  Source: Blender, intern/cycles/kernel/svm, box projection of images
    """
    axis = np.abs(normal).argmax(axis=1)
    turned = (np.take_along_axis(normal, axis[:, None], axis=1)[:, 0] > 0.0) == (axis > 0)
    first = np.take_along_axis(place, np.array([1, 0, 1])[axis][:, None, None], axis=2)[..., 0]
    second = np.take_along_axis(place, np.array([2, 2, 0])[axis][:, None, None], axis=2)[..., 0]
    return np.stack([np.where(turned[:, None], 1.0 - first, first), second], axis=-1)


def read_mapping(vector: Port | None) -> UvMapping | None:
    """The mapping that a vector source gives; None when it is not an affine image of a UV layer or of positions."""
    if vector is None or vector.is_value:
        return UNMAPPED
    node, output = vector.node, vector.socket.name
    if node.type == "UVMAP":
        return None if node.from_instancer else UvMapping(node.uv_map)
    if node.type == "TEX_COORD":
        return _read_coordinate(node, output)
    if node.type == "NEW_GEOMETRY" and output == "Position":
        return UvMapping(space=WORLD)
    if node.type == "ATTRIBUTE" and node.attribute_type == "GEOMETRY" and output in ("Vector", "Color"):
        return UvMapping(node.attribute_name)
    if node.type != "MAPPING":
        return None
    inner = read_mapping(vector.sibling("Vector"))
    affine = _mapping_matrix(vector)
    if inner is None or affine is None:
        return None
    return replace(inner, affine=_to_rows(affine @ np.array(inner.affine)))


def _read_coordinate(node: Any, output: str) -> UvMapping | None:
    if node.from_instancer:
        return None
    if output == "Object" and node.object is not None:
        matrix = node.object.matrix_world
        return UvMapping(space=WORLD, affine=_to_rows(np.array(matrix.inverted()))) if matrix.determinant() else None
    return {"UV": UNMAPPED, "Object": UvMapping(space=OBJECT), "Generated": UvMapping(space=GENERATED)}.get(output)


def _to_rows(matrix: FloatArray) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(x) for x in row) for row in matrix)


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
