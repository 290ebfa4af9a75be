"""A point light inside a closed cube: I cos / d^2 on black walls; on walls of albedo rho all its watts over area * (1 - rho).

With the light in the middle every wall has a sixth of them, whatever rho is. The statistical tests of this file share floors.ALPHA.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from boxes import room_mesh
from closed_forms import from_point
from known_light import bake_adaptive, bake_known
from leaflight.core.scene import Light, Material
from leaflight.core.settings import DIRECT_MODES
from scenes import make_scene
from stats import PLANTED_BIAS, Estimates

POWER_W, RHO = 12.0, 0.6
CENTRE, ASIDE = (0.0, 0.0, 0.0), (0.2, -0.15, 0.1)
CASES = [(place, direct) for place in ("centre", "aside") for direct in DIRECT_MODES]
N_CASE = 2 * len(CASES)  # black and grey walls


def cube_scene(place, rho):
    lamp = Light("POINT", "Lamp", CENTRE if place == "centre" else ASIDE, power_rgb=(POWER_W,) * 3)
    return make_scene([room_mesh()], [lamp], [Material("Wall", (rho,) * 3)])


def direct_light(scene):
    return lambda position, normal: POWER_W / (4 * math.pi) * from_point(scene.lights[0].position_m, position, normal)


@pytest.fixture(scope="module", params=CASES, ids="-".join)
def black(request, tmp_path_factory):
    place, direct = request.param
    scene = cube_scene(place, 0.0)
    return bake_known(tmp_path_factory.mktemp("black"), scene, direct_light(scene), direct, size=64)


@pytest.fixture(scope="module", params=CASES, ids="-".join)
def grey(request, tmp_path_factory):
    """The whole walls, for which the truth is known: all six together, or each where the lamp is in the middle."""
    place, direct = request.param
    truth = POWER_W / 6 / (1 - RHO)
    knobs = {"size": 64, "max_photons": 300_000}
    found = bake_known(tmp_path_factory.mktemp("grey"), cube_scene(place, RHO), lambda p, n: np.full(len(p), truth), direct, **knobs)
    wall = found.texels.texel_chart[found.light.tree.start[np.sort(found.light.leaves)]] if place == "centre" else 0
    return sum_by(found.on_leaves(), wall)


def sum_by(leaves, group):
    """Estimates of the mean light on groups of leaves."""
    group = np.broadcast_to(group, len(leaves.value))
    area = np.bincount(group, leaves.weight)

    def mean(values):
        return np.bincount(group, values * leaves.weight) / area

    noise = np.sqrt(np.bincount(group, (leaves.noise * leaves.weight) ** 2)) / area
    return Estimates(mean(leaves.value), mean(leaves.truth), noise, mean(leaves.doubt), area)


def test_every_leaf_is_within_its_stated_error(black):
    assert not black.on_leaves().complaint(N_CASE)


def test_mean_is_all_watts_over_all_walls(black):
    assert abs(black.on_leaves().mean_bias) < 1e-3
    assert black.on_leaves().mean == pytest.approx(POWER_W / 6, rel=1e-3)


def test_a_planted_bias_is_rejected(black):
    assert black.on_leaves().times(PLANTED_BIAS).complaint(N_CASE)


def test_grey_walls_are_within_their_stated_error(grey):
    assert not grey.complaint(N_CASE)
    assert abs(grey.mean_bias) < 3e-3


def test_a_planted_bias_of_grey_walls_is_rejected(grey):
    assert grey.times(PLANTED_BIAS).complaint(N_CASE)


@pytest.mark.parametrize("direct", DIRECT_MODES)
def test_adaptive_bake_is_within_its_stated_error(tmp_path, direct):
    scene = cube_scene("aside", 0.0)
    found = bake_adaptive(tmp_path, scene, direct_light(scene), direct, size=128)
    assert found.light.error < 0.03
    assert found.real_error() < 1.2 * found.light.error


def test_pages_show_what_the_leaves_hold(tmp_path):
    scene = cube_scene("aside", 0.0)
    found = bake_adaptive(tmp_path, replace(scene, lights=scene.lights * 2), direct_light(scene), "rays")
    assert found.at_texels() == pytest.approx(2 * found.truth, rel=0.02)
