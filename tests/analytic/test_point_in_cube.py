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
from leaflight.core.scene.scene import Light, Material
from leaflight.core.util.settings import DIRECT_MODES
from scenes import make_scene
from stats import Estimates, hold_bias_is_seen, hold_stated_error, hold_unbiased

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
def grey_bake(request, tmp_path_factory):
    place, direct = request.param
    truth = POWER_W / 6 / (1 - RHO)
    knobs = {"max_photons": 300_000, "error": 0.002}  # which all of the photons take; how many texels there are counts for nothing
    return bake_known(tmp_path_factory.mktemp("grey"), cube_scene(place, RHO), lambda p, n: np.full(len(p), truth), direct, **knobs)


@pytest.fixture
def grey(request, grey_bake):
    """The whole walls, for which the truth is known: all six together, or each where the lamp is in the middle."""
    at_centre = request.node.callspec.params["grey_bake"][0] == "centre"
    start = np.sort(grey_bake.light.tree.start[grey_bake.light.leaves])
    return sum_by(grey_bake.on_leaves(), grey_bake.texels.texel_chart[start] if at_centre else 0)


def sum_by(leaves, group):
    """Estimates of the mean light on groups of leaves."""
    group = np.broadcast_to(group, len(leaves.value))
    area = np.bincount(group, leaves.weight)

    def mean(values):
        return np.bincount(group, values * leaves.weight) / area

    noise = np.sqrt(np.bincount(group, (leaves.noise * leaves.weight) ** 2)) / area
    return Estimates(mean(leaves.value), mean(leaves.truth), noise, mean(leaves.doubt), area)


def test_every_leaf_is_within_its_stated_error(black, hold):
    hold_unbiased(hold, "point in a black cube", black.on_leaves(), N_CASE, 0.1)


def test_mean_is_all_watts_over_all_walls(black):
    assert black.on_leaves().mean == pytest.approx(POWER_W / 6, rel=1e-3)


def test_a_planted_bias_is_rejected(black, hold):
    hold_bias_is_seen(hold, "point in a cube", black.on_leaves(), N_CASE)


def test_grey_walls_are_within_their_stated_error(grey, hold):
    hold_unbiased(hold, "point in a grey cube", grey, N_CASE, 0.3)


def test_indirect_light_is_the_rest_of_the_series(grey_bake, hold):
    """The part of the leaves' flux that has bounced, over all walls."""
    tree, leaves = grey_bake.light.tree, grey_bake.light.leaves
    bounced = grey_bake.light.solution.coefficient[1, 0][:, leaves]
    flux = (bounced * tree.moment[leaves, : len(bounced)].T).sum()
    off = flux / (RHO * POWER_W / (1 - RHO)) - 1
    hold("point in a grey cube: mean indirect light off rho P / (S (1 - rho))", 100 * abs(off), high=0.5, unit="%")


def test_a_planted_bias_of_grey_walls_is_rejected(grey, hold):
    hold_bias_is_seen(hold, "point in a cube", grey, N_CASE)


@pytest.mark.parametrize("direct", DIRECT_MODES)
def test_adaptive_bake_is_within_its_stated_error(tmp_path, direct, hold):
    scene = cube_scene("aside", 0.0)
    found = bake_adaptive(tmp_path, scene, direct_light(scene), direct, size=128)
    assert found.light.error < 0.03
    hold_stated_error(hold, "point in a black cube", found.real_error(), found.light.error)


def test_pages_show_what_the_leaves_hold(tmp_path):
    scene = cube_scene("aside", 0.0)
    found = bake_adaptive(tmp_path, replace(scene, lights=scene.lights * 2), direct_light(scene), "rays")
    assert found.at_texels() == pytest.approx(2 * found.truth, rel=0.02)
