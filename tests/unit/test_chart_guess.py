import itertools

import numpy as np
import pytest
from leaflight.core.atlas.chart_guess import guess_charts
from leaflight.core.atlas.charts import make_charts
from leaflight.core.util.settings import Settings
from scenes import Mesh, box_mesh, grid_mesh, make_scene, moved, quad_mesh, sphere_mesh


def guess(meshes):
    scene = make_scene(meshes)
    return guess_charts(scene.tri_position, scene.tri_object, len(meshes)).tolist()


def test_flat_sides_are_charts():
    ball = sphere_mesh(rings=16, segments=24)
    assert guess([box_mesh(), quad_mesh(), Mesh("Nothing", np.zeros((0, 3)), []), moved(box_mesh(), (9.0, 0.0, 0.0)), ball]) == [
        6,
        1,
        0,
        6,
        6,
    ]


def test_vertices_that_are_there_for_each_face_are_one():
    grid = grid_mesh(cells=6)
    loose = np.concatenate([grid.vertex[list(polygon)] for polygon in grid.polygons])
    corners = np.cumsum([0, *map(len, grid.polygons)])
    split = Mesh("Split", loose, [list(range(a, b)) for a, b in itertools.pairwise(corners)])
    assert guess([grid, split]) == [1, 1]


def test_what_is_no_number_is_no_chart():
    broken = np.full((4, 3, 3), np.nan)
    assert guess_charts(broken, np.zeros(4, int), 1).tolist() == [0]


@pytest.mark.parametrize("mesh", [sphere_mesh("Ball", rings=16, segments=24), grid_mesh("Cloth", cells=12, noise=0.1), box_mesh()])
def test_xatlas_makes_about_as_many(mesh):
    made = len(make_charts(make_scene([mesh]), Settings()).chart_page)
    assert made / 3 <= guess([mesh])[0] <= 3 * made
