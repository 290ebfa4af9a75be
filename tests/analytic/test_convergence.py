"""Rates of convergence: error falls at least as the root of the photons, and with the node size h as h, h^2, h^3 by the basis.

A function of degree p on nodes of side h leaves an error of order h^(p + 1) of a smooth light. Sources: Feda 1996; Tobler et al. 1997, 3.2.
"""

import numpy as np
import pytest
from boxes import room_mesh
from known_light import bake_known
from leaflight.core import quadtree, tally
from leaflight.core.scene import Light, Material
from leaflight.core.settings import BASES
from scenes import make_scene
from stats import fit_slope
from trees import SquareBake

PHOTONS = (20_000, 80_000, 320_000)
SIDE_TEXELS = 64
REPEATS = 10**8  # of every photon: no slope may pass for noise
DEEP = Light("POINT", "Lamp", (0.1, 0.05, 0.0), power_rgb=(12.0,) * 3)


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


def node_error(degree, finest_texels):
    """Root mean square error over the square."""
    bake = bake_without_noise(degree, finest_texels)
    s, t = np.random.default_rng(7).random((2, 20_000))
    found = bake.values(np.flatnonzero(~bake.tree.has_children), s, t)
    return np.sqrt(np.mean((found - smooth_light(s, t)) ** 2))


@pytest.mark.parametrize(("degree", "sizes"), [(0, (2, 4, 8, 16)), (1, (4, 8, 16, 32)), (2, (8, 16, 32, 64))], ids=BASES)
def test_error_falls_with_the_size_of_nodes(degree, sizes, hold):
    errors = [node_error(degree, size) for size in sizes]
    bounds = {"low": degree + 0.85, "high": degree + 1.15, "points": tuple(zip(sizes, errors, strict=True))}
    hold(f"convergence: slope of log error over log node size, {BASES[degree]}", fit_slope(np.array(sizes), np.array(errors)), **bounds)


def photon_errors(folder, rho, counts):
    """Root mean square error of leaves, relative to the mean, from pairs of bakes that differ only by their seeds."""
    scene = make_scene([room_mesh()], [DEEP], [Material("Wall", (rho,) * 3)])

    def value(count, seed):
        knobs = {"size": 64, "error": 1e-4, "max_photons": count, "seed": seed}
        return bake_known(folder / f"{count}_{seed}", scene, lambda p, n: np.ones(len(p)), "photons", **knobs).on_leaves().value

    pairs = [(value(count, 1), value(count, 2)) for count in counts]
    return np.array([np.sqrt(np.mean((one - other) ** 2) / 2) / one.mean() for one, other in pairs])


@pytest.mark.parametrize("rho", [0.0, 0.7])
def test_error_falls_at_least_as_the_root_of_the_photons(tmp_path, rho, hold):
    """Kronecker's points do better than chance where nothing scatters."""
    errors = photon_errors(tmp_path, rho, PHOTONS)
    assert errors[0] < 0.2
    bounds = {"low": -1.1, "high": -0.45, "points": tuple(zip(PHOTONS, errors, strict=True))}
    hold(f"convergence: slope of log error over log photons, albedo {rho:g}", fit_slope(np.array(PHOTONS), errors), **bounds)
