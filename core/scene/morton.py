"""Morton codes of cells of space and orientation; the leading bits of a code are those of the enclosing cells."""

from __future__ import annotations

import numpy as np

from ..util.arrays import Int64, IntArray
from ..util.geometry import UnitBox, triangle_normals_areas
from .scene import SceneSnapshot

# Shifts and masks that put two zeros between the bits of numbers of up to eight bits.
_SPREAD = ((8, 0x00F00F), (4, 0x0C30C3), (2, 0x249249))


def code_cells(scene: SceneSnapshot, tri: IntArray, bits: int) -> Int64:
    """(m,) int64: code of the cell in which each of the triangles (m,) lies: one of six directions that it faces, then the Morton code.

    bits   halvings of the scene's box, up to 8. Without its last three bits, a code is that of a cell twice as large, and so on
    """
    corner = scene.vertex_position[scene.tri_vertex[tri]].astype(np.float64)
    middle = UnitBox.from_points(scene.vertex_position).to_unit(corner.mean(axis=1)) + 0.5
    place = np.clip(middle * (1 << bits), 0, (1 << bits) - 1).astype(np.int64)
    for shift, mask in _SPREAD:
        place = (place | place << shift) & mask
    normal = triangle_normals_areas(corner)[0]
    axis = np.abs(normal).argmax(axis=1)
    facing = 2 * axis + (normal[np.arange(len(tri)), axis] < 0)
    return facing << 3 * bits | place[:, 0] | place[:, 1] << 1 | place[:, 2] << 2
