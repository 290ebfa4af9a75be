"""Numbers of cells: what is near and faces the same way shares them, and leading bits are those of larger cells."""

import numpy as np
import pytest
from leaflight.core.scene.morton import code_cells
from scenes import Mesh, make_scene

SIDE = 16


@pytest.fixture(scope="module")
def grid():
    """Facets in the middles of SIDE^3 cells of a box, each facing up or down in turn, and the column, row and floor of each."""
    place = np.stack(np.meshgrid(*[np.arange(SIDE)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    corner = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0]]) * 0.1
    facets = place[:, None] + 0.5 + corner
    facets[1::2] = facets[1::2, ::-1]
    ends = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1e-3], [SIDE, SIDE, SIDE]])[None]  # they make the box
    points = np.concatenate([facets, ends]).reshape(-1, 3)
    return make_scene([Mesh("Grid", points, np.arange(len(points)).reshape(-1, 3))]), place


def test_each_cell_has_its_own_number_by_side(grid):
    scene, place = grid
    code = code_cells(scene, np.arange(len(place)), 4)
    assert len(np.unique(code)) == len(place)
    np.testing.assert_array_equal(code >> 12, np.where(np.arange(len(place)) % 2, 5, 4))  # down, up


@pytest.mark.parametrize("larger", [1, 2, 4])
def test_leading_bits_are_the_larger_cell(grid, larger):
    scene, place = grid
    facing_up = np.arange(0, len(place), 2)
    code = code_cells(scene, facing_up, 4) >> 3 * larger
    block = (place[facing_up] >> larger) @ [1, 100, 10_000]
    assert len(np.unique(np.stack([code, block], axis=1), axis=0)) == len(np.unique(code)) == len(np.unique(block))


def test_six_ways_are_told_apart():
    turned = [np.roll([[0, 0, 0], [1, 0, 0], [0, 1, 0]], turn, axis=1)[::side] for turn in range(3) for side in (1, -1)]
    points = np.concatenate(turned).astype(float)
    scene = make_scene([Mesh("Ways", points, np.arange(18).reshape(-1, 3))])
    assert sorted(code_cells(scene, np.arange(6), 1) >> 3) == [0, 1, 2, 3, 4, 5]


def test_a_scene_without_extent_has_one_cell():
    scene = make_scene([Mesh("Point", np.zeros((3, 3)), [[0, 1, 2]])])
    assert len(np.unique(code_cells(scene, np.zeros(3, int), 7))) == 1
