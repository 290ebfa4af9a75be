"""Rates of convergence: error falls at least as the root of the photons, and with the node size h as h, h^2, h^3 by the basis.

A function of degree p on nodes of side h leaves an error of order h^(p + 1) of a smooth light. Sources: Feda 1996; Tobler et al. 1997, 3.2.
"""

import numpy as np
import pytest
from boxes import furnace_scene, room_mesh
from closed_forms import from_point
from known_light import bake_known
from leaflight.core.radiosity import quadtree, tally
from leaflight.core.scene.scene import Light, Material
from leaflight.core.util.settings import BASES
from scenes import make_scene
from stats import PLANTED_BIAS, fit_slope
from trees import SquareBake

PHOTONS, SEEDS = (20_000, 80_000, 320_000), (1, 2, 3, 4)
SIDE_TEXELS = 64
REPEATS = 10**8  # of every photon: no slope may pass for noise
POWER_W, PLACE = 12.0, (0.1, 0.05, 0.0)
STEEPEST, LEAST_STEEP = -1.1, -0.45  # slopes over photons
NEAR = 0.15  # of slopes over node sizes


def smooth_light(s, t):
    return 1 + 0.6 * np.sin(2.5 * s + 0.4) * np.cos(1.5 * t)


def bake_without_noise(degree, finest_texels):
    """A flat tree of equal leaves that has met a photon at each Gauss point of its texels, as bright as the light there."""
    bake = SquareBake(SIDE_TEXELS, degree, flat=True)
    bake.tree = quadtree.plant_trees(bake.texels, degree, 0, finest_texels, True)
    bake.tally = tally.Tally.empty(len(bake.tree), degree)
    place, weight = np.polynomial.legendre.leggauss(3)
    line = ((np.arange(SIDE_TEXELS)[:, None] + (place + 1) / 2) / SIDE_TEXELS).ravel()
    s, t = (grid.ravel() for grid in np.meshgrid(line, line))
    share = np.multiply.outer(*[np.tile(weight * 1.5, SIDE_TEXELS)] * 2).ravel()
    bake.throw(s, t, flux=np.tile(share * smooth_light(s, t), (3, 1)))
    for sums in (bake.tally.photons, bake.tally.count, bake.tally.weight2, bake.tally.raw):
        sums *= REPEATS
    return bake


def node_errors(degree, sizes):
    """node_errors(bias): root mean square error over the square, of nodes of each size."""
    s, t = np.random.default_rng(7).random((2, 20_000))
    bakes = [bake_without_noise(degree, size) for size in sizes]
    found = np.array([bake.values(np.flatnonzero(~bake.tree.has_children), s, t) for bake in bakes])
    return lambda bias=1.0: np.sqrt(np.mean((bias * found - smooth_light(s, t)) ** 2, axis=1))


@pytest.mark.parametrize(("degree", "sizes"), [(0, (2, 4, 8, 16)), (1, (4, 8, 16, 32)), (2, (8, 16, 32, 64))], ids=BASES)
def test_error_falls_with_the_size_of_nodes(degree, sizes, hold):
    """And would not if it were biased."""
    errors, exact = node_errors(degree, sizes), degree + 1
    name, points = "convergence: slope of log error over log node size", tuple(zip(sizes, errors(), strict=True))
    hold(f"{name}, {BASES[degree]}", fit_slope(np.array(sizes), errors()), low=exact - NEAR, high=exact + NEAR, points=points)
    hold(f"{name}, with a planted bias of 3 %", fit_slope(np.array(sizes), errors(PLANTED_BIAS)), high=exact - NEAR)


def lamp_light(position, normal):
    return POWER_W / (4 * np.pi) * from_point(PLACE, position, normal)


def furnace_light(position, normal):
    return np.full(len(position), np.pi / (1 - 0.7))


PHOTON_SCENES = {
    0: (make_scene([room_mesh()], [Light("POINT", "Lamp", PLACE, power_rgb=(POWER_W,) * 3)], [Material("Black", (0.0,) * 3)]), lamp_light),
    0.7: (furnace_scene(0.7), furnace_light),
}


@pytest.mark.parametrize("rho", [0, pytest.param(0.7, marks=pytest.mark.slow)])
def test_error_falls_at_least_as_the_root_of_the_photons(tmp_path, rho, hold):
    """Points of a net do better than chance where nothing scatters; a bias would stay."""

    def bake(count, seed):
        knobs = {"size": 64, "finest_texels": 8, "error": 1e-4, "max_photons": count, "seed": seed}
        return bake_known(tmp_path / f"{count}_{seed}", *PHOTON_SCENES[rho], "photons", **knobs).on_leaves()

    def errors(bias=1.0):
        squares = [np.mean([np.average((bias * f.value - f.truth) ** 2, weights=f.weight) / f.mean**2 for f in some]) for some in bakes]
        return np.sqrt(squares)

    bakes = [[bake(count, seed) for seed in SEEDS] for count in PHOTONS]
    assert errors()[0] < 0.2
    name, points = "convergence: slope of log error over log photons", tuple(zip(PHOTONS, errors(), strict=True))
    hold(f"{name}, albedo {rho:g}", fit_slope(np.array(PHOTONS), errors()), low=STEEPEST, high=LEAST_STEEP, points=points)
    hold(f"{name}, with a planted bias of 3 %", fit_slope(np.array(PHOTONS), errors(PLANTED_BIAS)), low=LEAST_STEEP)
