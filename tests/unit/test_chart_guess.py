import numpy as np
import pytest
from leaflight.addon.app.chart_guess import guess_charts
from leaflight.core.atlas.charts import make_charts
from leaflight.core.util.settings import Settings
from scenes import box_mesh, grid_mesh, make_scene, sphere_mesh


def guess(meshes):
    scene = make_scene(meshes)
    return guess_charts(scene.tri_position, scene.tri_object, len(meshes)).tolist()


def test_what_is_no_number_is_no_chart():
    broken = np.full((4, 3, 3), np.nan)
    assert guess_charts(broken, np.zeros(4, int), 1).tolist() == [0]


@pytest.mark.parametrize("mesh", [sphere_mesh("Ball", rings=16, segments=24), grid_mesh("Cloth", cells=12, noise=0.1), box_mesh()])
def test_xatlas_makes_about_as_many(mesh):
    made = len(make_charts(make_scene([mesh]), Settings()).chart_page)
    assert made / 3 <= guess([mesh])[0] <= 3 * made
