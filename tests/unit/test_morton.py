"""Numbers of cells: leading bits are those of larger cells; and the way that a facet faces."""

import numpy as np
import pytest
from leaflight.core.scene.morton import code_places, find_facing

SIDE = 16


@pytest.mark.parametrize("larger", [0, 1, 2, 4])
def test_leading_bits_are_the_larger_cell(larger):
    place = np.stack(np.meshgrid(*[np.arange(SIDE)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    cell, block = code_places(place) >> 3 * larger, (place >> larger) @ [1, 100, 10_000]
    assert len(np.unique(np.stack([cell, block], axis=1), axis=0)) == len(np.unique(cell)) == len(np.unique(block))


def test_the_way_a_facet_faces_is_that_of_its_greatest_part():
    normals = np.array([[0.8, 0.6, 0], [-0.8, 0.6, 0], [0.6, 0.8, 0], [0, -1, 0], [0, 0.6, 0.8], [0.1, 0, -0.9]])
    assert find_facing(normals).tolist() == [0, 1, 2, 3, 4, 5]
