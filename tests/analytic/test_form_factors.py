"""One black shape lights another: squares that face each other or meet at an edge, coaxial disks.

A Lambertian of radiance L brings pi L F on average, F being the published form factor, and at each point what Lambert's polygon or
the disk's closed form says. Area lights shine on one side, emitting triangles on both. The statistical tests of this file share
floors.ALPHA.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from closed_forms import (
    factor_of_coaxial_disks,
    factor_of_parallel_rectangles,
    factor_of_perpendicular_rectangles,
    from_disk,
    from_polygon,
)
from known_light import bake_known, black_scene, floor_mesh, state_errors
from leaflight.core.scene.scene import Light
from leaflight.core.util.settings import DIRECT_MODES
from scenes import Mesh
from stats import hold_bias_is_seen, hold_stated_error, hold_statement, hold_unbiased

RADIANCE = 2.0
DISK_RADIUS, LAMP_RADIUS, HEIGHT = 0.5, 0.3, 0.6
ABOVE = np.array([[0, 0, 1], [0, 1, 1], [1, 1, 1], [1, 0, 1]], float)
UPRIGHT = np.array([[0, 0, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1]], float)
CIRCLE = np.stack([np.cos(phi := 2 * np.pi * np.arange(96) / 96), np.sin(phi), 0 * phi], axis=1)
CIRCLE *= math.sqrt(2 * math.pi / 96 / math.sin(2 * math.pi / 96))  # a disk's area


def disk_mesh(name, radius, height, uv=None):
    return Mesh(name, CIRCLE * radius + [0.5, 0.5, height], [list(range(len(CIRCLE)))], uv)


def by_mesh(receiver, lamp):
    return black_scene([receiver], others=[lamp], glow=RADIANCE)


def by_area_light(receiver, corner, shape="RECTANGLE"):
    """A light over a rectangle, or the ellipse in it; counter-clockwise corners for who is lit."""
    x, y = corner[3] - corner[0], corner[1] - corner[0]
    size = np.linalg.norm(x), np.linalg.norm(y)
    axes = np.array([x / size[0], y / size[1], np.cross(x, y) / size[0] / size[1]])
    area = size[0] * size[1] * (math.pi / 4 if shape == "ELLIPSE" else 1)
    power = (math.pi * RADIANCE * area,) * 3
    place = tuple(corner.mean(0))
    return black_scene([receiver], [Light("AREA", "Lamp", place, tuple(map(tuple, axes)), power, shape=shape, size_m=size)])


def from_corners(corner):
    return lambda position, normal: RADIANCE * from_polygon(corner, position, normal)


def from_lamp_disk(position, normal):
    return RADIANCE * from_disk(LAMP_RADIUS, HEIGHT, np.linalg.norm(position[:, :2] - 0.5, axis=1))


DISK_FLOOR = disk_mesh("Disk", DISK_RADIUS, 0.0, [0.5 + 0.48 * CIRCLE[:, :2]])
LAMP_SQUARE = np.array([[-1, -1, 0], [-1, 1, 0], [1, 1, 0], [1, -1, 0]]) * LAMP_RADIUS + [0.5, 0.5, HEIGHT]
QUAD = [[0, 1, 2, 3]]
PARALLEL, PERPENDICULAR = factor_of_parallel_rectangles(1, 1, 1), factor_of_perpendicular_rectangles(1, 1, 1)
TO_LAMP = factor_of_coaxial_disks(DISK_RADIUS, LAMP_RADIUS, HEIGHT)
SCENES = {
    "parallel mesh": (by_mesh(floor_mesh(), Mesh("Lamp", ABOVE, QUAD)), from_corners(ABOVE), PARALLEL),
    "parallel area": (by_area_light(floor_mesh(), ABOVE), from_corners(ABOVE), PARALLEL),
    "perpendicular mesh": (by_mesh(floor_mesh(), Mesh("Lamp", UPRIGHT, QUAD)), from_corners(UPRIGHT), PERPENDICULAR),
    "perpendicular area": (by_area_light(floor_mesh(), UPRIGHT), from_corners(UPRIGHT), PERPENDICULAR),
    "disk mesh": (by_mesh(DISK_FLOOR, disk_mesh("Lamp", LAMP_RADIUS, HEIGHT)), from_lamp_disk, TO_LAMP),
    "disk area": (by_area_light(DISK_FLOOR, LAMP_SQUARE, "ELLIPSE"), from_lamp_disk, TO_LAMP),
}
SLOW_CASE = ("disk mesh", "rays")  # of ninety-four lamps
CASES = [(name, direct) for name in SCENES for direct in DIRECT_MODES]
PARAMS = [pytest.param(case, id="-".join(case), marks=[pytest.mark.slow] * (case == SLOW_CASE)) for case in CASES]


@pytest.fixture(scope="module", params=PARAMS)
def known(request, tmp_path_factory):
    name, direct = request.param
    scene, irradiance, _ = SCENES[name]
    return bake_known(tmp_path_factory.mktemp("factor"), scene, irradiance, direct)


def test_published_factors():
    """Of unit squares: Howell's C-11 and C-14 as tabled; of disks: seen from far away, area over pi d^2."""
    assert pytest.approx((0.199825, 0.200044), abs=1e-6) == (PARALLEL, PERPENDICULAR)
    assert factor_of_coaxial_disks(0.01, 0.2, 10.0) == pytest.approx(0.04 / 100.04, rel=1e-5)


def test_every_leaf_is_within_its_stated_error(known, scene_name, hold):
    hold_unbiased(hold, f"form factor, {scene_name}", known.on_leaves(), len(CASES), 0.3)


def test_mean_is_the_form_factor(known, scene_name, hold):
    off = known.on_leaves().mean / (math.pi * RADIANCE * SCENES[scene_name][2]) - 1
    hold(f"form factor, {scene_name}: off the published one", 100 * abs(off), high=0.3, unit="%")


def test_a_planted_bias_is_rejected(known, hold):
    hold_bias_is_seen(hold, "form factors", known.on_leaves(), len(CASES))


@pytest.fixture(scope="module", params=["rays", pytest.param("photons", marks=pytest.mark.slow)])
def errors(request, tmp_path_factory):
    scene, irradiance, _ = SCENES["perpendicular mesh"]
    return request.param, state_errors(tmp_path_factory.mktemp("adaptive"), scene, irradiance, request.param)


def test_each_adaptive_bake_is_within_its_stated_error(errors, hold):
    for stated, real in errors[1]:
        hold_stated_error(hold, "perpendicular squares", real, stated)


def test_adaptive_bakes_together_state_their_error(errors, hold):
    hold_statement(hold, "perpendicular squares", errors[1], errors[0])


def test_the_other_one_is_lit_alike(tmp_path):
    """Reciprocity: the lamp and the floor in each other's places."""
    lamp = replace(floor_mesh(), name="Lamp")
    wall = Mesh("Wall", UPRIGHT, QUAD, floor_mesh().uv)
    found = bake_known(tmp_path, by_mesh(wall, lamp), lambda p, n: RADIANCE * from_polygon(lamp.vertex, p, n), "rays")
    assert found.on_leaves().mean == pytest.approx(math.pi * RADIANCE * PERPENDICULAR, rel=3e-3)
