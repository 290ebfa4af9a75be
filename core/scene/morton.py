"""Cells of space that hold what is near and faces the same way, as numbers whose leading bits are those of the cells around."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..util.arrays import IntArray
from ..util.geometry import UnitBox, triangle_normals_areas
from .scene import SceneSnapshot

# Shifts and masks that put two zeros between bits that follow each other, of numbers of up to eight bits.
_SPREAD = ((8, 0x00F00F), (4, 0x0C30C3), (2, 0x249249))


def code_cells(scene: SceneSnapshot, tri: IntArray, bits: int) -> NDArray[np.int64]:
    """(m,): of the cell that each of the triangles (m,) lies in: which of six ways it faces, and then its Morton code.

    bits   halvings of the scene's box, up to 8; without the last three bits of a number, or six, it is that of a cell twice, or four times,
           as large
    """
    corner = scene.vertex_position[scene.tri_vertex[tri]].astype(np.float64)
    middle = UnitBox.from_points(scene.vertex_position).to_unit(corner.mean(axis=1)) + 0.5
    place = np.clip(middle * (1 << bits), 0, (1 << bits) - 1).astype(np.int64)
    for shift, mask in _SPREAD:
        place = (place | place << shift) & mask
    normal = triangle_normals_areas(corner)[0]
    axis = np.abs(normal).argmax(axis=1)
    facing = 2 * axis + (normal[np.arange(len(tri)), axis] < 0)
    code: NDArray[np.int64] = facing << 3 * bits | place[:, 0] | place[:, 1] << 1 | place[:, 2] << 2
    return code
