"""Numbers of cells: what is near and faces the same way shares them, and leading bits are those of larger cells."""

import numpy as np
from leaflight.core.scene.morton import code_cells
from scenes import Mesh, make_scene

SIDE = 16


def test_leading_bits_are_the_way_a_facet_faces_and_the_larger_cell():
    """Facets in the middles of SIDE^3 cells of a box, each facing up or down in turn."""
    place = np.stack(np.meshgrid(*[np.arange(SIDE)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    facets = place[:, None] + 0.5 + np.array([[-0.1, -0.1, 0.0], [0.1, -0.1, 0.0], [0.0, 0.1, 0.0]])
    facets[1::2] = facets[1::2, ::-1]
    ends = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1e-3], [SIDE, SIDE, SIDE]])[None]  # they make the box
    points = np.concatenate([facets, ends]).reshape(-1, 3)
    scene = make_scene([Mesh("Grid", points, np.arange(len(points)).reshape(-1, 3))])
    code = code_cells(scene, np.arange(len(place)), 4)
    np.testing.assert_array_equal(code >> 12, np.where(np.arange(len(place)) % 2, 5, 4))  # down, up
    for larger in (0, 1, 2, 4):
        cell = code[::2] >> 3 * larger
        block = (place[::2] >> larger) @ [1, 100, 10_000]
        assert len(np.unique(np.stack([cell, block], axis=1), axis=0)) == len(np.unique(cell)) == len(np.unique(block))
