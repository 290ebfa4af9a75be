"""A uniform sky of radiance L: pi L on an open plane, pi L less the wall's Lambert polygon beside a black wall.

The statistical tests of this file share floors.ALPHA.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from closed_forms import from_polygon
from known_light import bake_known, black_scene, floor_mesh, state_errors
from leaflight.core.util.settings import DIRECT_MODES
from scenes import Mesh
from stats import hold_bias_is_seen, hold_stated_error, hold_statement, hold_unbiased

RADIANCE = 0.5
WALL = np.array([[0, -0.5, 0], [0, 1.5, 0], [0, 1.5, 1.5], [0, -0.5, 1.5]])


def open_sky(position, normal):
    return np.full(len(position), math.pi * RADIANCE)


def beside_wall(position, normal):
    return RADIANCE * (math.pi - from_polygon(WALL, position, normal))


def sky_scene(*others):
    return replace(black_scene([floor_mesh()], others=others), world_rgb=(RADIANCE,) * 3)


def under_a_map(scene):
    """The same sky as a map of its radiance."""
    return replace(scene, world_rgb=(0.0, 0.0, 0.0), world_map=np.full((16, 32, 3), RADIANCE, np.float32))


SCENES = {"open": (sky_scene(), open_sky), "wall": (sky_scene(Mesh("Wall", WALL, [[0, 1, 2, 3]])), beside_wall)}
SCENES["map"] = (under_a_map(SCENES["wall"][0]), beside_wall)
CASES = [(name, direct) for name in SCENES for direct in DIRECT_MODES]


@pytest.fixture(scope="module", params=CASES, ids="-".join)
def known(request, tmp_path_factory):
    name, direct = request.param
    return bake_known(tmp_path_factory.mktemp("sky"), *SCENES[name], direct, error=0.01, max_photons=1_500_000)


def test_the_wall_takes_nearly_half():
    at_its_foot = np.array([[1e-3, 0.5, 0.0]])
    assert beside_wall(at_its_foot, np.array([[0.0, 0.0, 1.0]]))[0] == pytest.approx(math.pi * RADIANCE / 2, rel=0.01)


def test_every_leaf_is_within_its_stated_error(known, scene_name, hold):
    hold_unbiased(hold, f"sky, {scene_name}", known.on_leaves(), len(CASES), 0.5)


def test_a_planted_bias_is_rejected(known, hold):
    hold_bias_is_seen(hold, "sky", known.on_leaves(), len(CASES))


@pytest.fixture(scope="module", params=[pytest.param(direct, marks=pytest.mark.slow) for direct in DIRECT_MODES])
def errors(request, tmp_path_factory):
    return request.param, state_errors(tmp_path_factory.mktemp("adaptive"), *SCENES["wall"], request.param)


def test_each_adaptive_bake_is_within_its_stated_error(errors, hold):
    for stated, real in errors[1]:
        hold_stated_error(hold, "sky, wall", real, stated)


def test_adaptive_bakes_together_state_their_error(errors, hold):
    hold_statement(hold, "sky, wall", errors[1], errors[0])
