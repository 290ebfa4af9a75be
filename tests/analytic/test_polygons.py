"""Emitting triangles and area lights at any tilt, partly below the receivers' horizon: Lambert's polygon formula.

The statistical tests of this file share floors.ALPHA.
"""

import math

import numpy as np
import pytest
from closed_forms import above_floor, from_polygon
from known_light import bake_known, black_scene, floor_mesh
from leaflight.core.scene.scene import Light
from leaflight.core.util.settings import DIRECT_MODES
from scenes import Mesh
from stats import hold_bias_is_seen, hold_unbiased

RADIANCE = 2.0
# Beside the floor, which is the unit square at z = 0, or over it; seen from it counter-clockwise.
OVER = np.array([[0.3, 0.2, 0.5], [0.4, 0.9, 0.4], [0.9, 0.5, 0.7]])
SUNK = np.array([[-0.4, 0.1, -0.5], [-0.3, 0.9, 0.2], [-0.2, 0.4, 0.9]])
EDGE = np.array([[0.6, 0.0, 0.8], [0.0, 0.8, 0.0]])  # of the area light, at right angles
TILTED = np.array([-0.5, 0.5, 0.1]) + np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]]) / 2 @ EDGE


def by_triangle(corner):
    return black_scene([floor_mesh()], others=[Mesh("Lamp", corner, [[0, 1, 2]])], glow=RADIANCE)


def by_area_light(corner):
    x, y = corner[3] - corner[0], corner[1] - corner[0]
    size = np.linalg.norm(x), np.linalg.norm(y)
    axes = np.array([x / size[0], y / size[1], np.cross(x, y) / size[0] / size[1]])
    power = (math.pi * RADIANCE * size[0] * size[1],) * 3
    lamp = Light("AREA", "Lamp", tuple(corner.mean(0)), tuple(map(tuple, axes)), power, size_m=size)
    return black_scene([floor_mesh()], [lamp])


SCENES = {
    "triangle over a plane": (by_triangle(OVER), OVER),
    "triangle through the horizon": (by_triangle(SUNK), SUNK),
    "tilted area light": (by_area_light(TILTED), TILTED),
}
CASES = [(name, direct) for name in SCENES for direct in DIRECT_MODES]


@pytest.fixture(scope="module", params=CASES, ids="-".join)
def known(request, tmp_path_factory):
    name, direct = request.param
    scene, corner = SCENES[name]
    seen = above_floor(corner)
    return bake_known(tmp_path_factory.mktemp("polygon"), scene, lambda p, n: RADIANCE * from_polygon(seen, p, n), direct)


@pytest.fixture
def subject(request):
    return request.node.callspec.params["known"][0]


def test_what_lies_below_the_horizon_is_cut_off():
    assert len(above_floor(OVER)) == 3
    assert len(above_floor(SUNK)) == 4
    assert above_floor(TILTED)[:, 2].min() == pytest.approx(0.0, abs=1e-15)


def test_every_leaf_is_within_its_stated_error(known, subject, hold):
    hold_unbiased(hold, subject, known.on_leaves(), len(CASES), 0.3)


def test_a_planted_bias_is_rejected(known, hold):
    hold_bias_is_seen(hold, "tilted polygons", known.on_leaves(), len(CASES))
