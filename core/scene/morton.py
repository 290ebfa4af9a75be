"""Morton codes of cells of space, whose leading bits are those of the enclosing cells; and the axis that a normal is nearest to."""

import numpy as np

from ..util.arrays import FloatArray, Int64

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
