"""Morton codes of cells of space and orientation; the leading bits of a code are those of the enclosing cells."""

import numpy as np

from ..util.arrays import FloatArray, Int64, IntArray
from ..util.geometry import UnitBox, triangle_normals_areas
from .scene import SceneSnapshot

# Shifts and masks that put two zeros between the bits of numbers of up to ten bits.
_SPREAD = ((16, 0x30000FF), (8, 0x300F00F), (4, 0x30C30C3), (2, 0x9249249))


def code_places(place: Int64) -> Int64:
    """(n,) int64: Morton codes of places (n, 3) int64, from 0 to 1023; x has the lowest bit."""
    for shift, mask in _SPREAD:
        place = (place | place << shift) & mask
    return place[:, 0] | place[:, 1] << 1 | place[:, 2] << 2


def find_facing(normal: FloatArray) -> Int64:
    """(n,) int64: the direction nearest to each normal (n, 3): 0 and 1 are +X and -X, then Y and Z likewise."""
    axis = np.abs(normal).argmax(axis=1)
    return 2 * axis + (normal[np.arange(len(normal)), axis] < 0)


def code_cells(scene: SceneSnapshot, tri: IntArray, bits: int) -> Int64:
    """(m,) int64: code of the cell in which each of the triangles (m,) lies: the direction that it faces, then the Morton code.

    bits   halvings of the scene's box, up to 10. Without its last three bits, a code is that of a cell twice as large, and so on
    """
    corner = scene.vertex_position[scene.tri_vertex[tri]].astype(np.float64)
    middle = UnitBox.from_points(scene.vertex_position).to_unit(corner.mean(axis=1)) + 0.5
    place = np.clip(middle * (1 << bits), 0, (1 << bits) - 1).astype(np.int64)
    return find_facing(triangle_normals_areas(corner)[0]) << 3 * bits | code_places(place)
