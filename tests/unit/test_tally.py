"""Sums become the right irradiance, and no photon's energy is lost by splitting."""

import numpy as np
import pytest
from leaflight.core.radiosity import quadtree, tally
from trees import SquareBake


@pytest.mark.parametrize("degree", [0, 1, 2])
@pytest.mark.parametrize("width", [1.0, 0.33])
def test_even_light_is_even_also_at_a_clipped_border(degree, width):
    """Photons on a fine lattice: every node must read flux over covered area, at its rim too."""
    bake = SquareBake(side=16, degree=degree, width=width)
    line = (np.arange(800) + 0.5) / 800
    s, t = (a.ravel() for a in np.meshgrid(line * width, line))
    bake.throw(s, t, emitted=len(s))
    deepest = np.flatnonzero(~bake.tree.has_children)
    at_s, at_t = np.random.default_rng(0).uniform(0.01, 0.99, (2, 50)) * [[width], [1]]
    np.testing.assert_allclose(bake.values(deepest, at_s, at_t), 1.0 / width, rtol=0.03)


def test_late_children_scale_their_functions_by_what_their_parent_saw():
    """Eq. 10 holds for the functions as it does for the flux: each integrates to its node's flux, level by level."""
    rng = np.random.default_rng(5)
    bake = SquareBake(side=16, degree=1, preview_depth=1)
    for _ in range(3):
        bake.throw(*rng.random((2, 3000)))
        bake.tree = quadtree.split(bake.tree, np.flatnonzero(bake.tree.current & bake.tree.has_children))
        bake.grow()
    bake.throw(*rng.random((2, 3000)))
    solution = bake.solution()
    whole = (solution.coefficient.sum(0) * bake.tree.moment[:, :3].T).sum(1)
    np.testing.assert_allclose(whole, solution.flux, rtol=1e-9)
    for level in bake.tree.levels:
        np.testing.assert_allclose(whole[:, level].sum(1), 1.0, rtol=0.01)


def test_components_and_halves_are_told_apart():
    """Indirect light of 2 W in the even half of the bake, on the right; direct of 1 W in the odd, on the left."""
    rng = np.random.default_rng(1)
    bake = SquareBake(side=8, degree=1, preview_depth=1)
    bake.throw(0.5 + 0.5 * rng.random(200), rng.random(200), half=0, emitted=400, flux=np.full((3, 200), 4.0), is_first=False)
    bake.throw(0.5 * rng.random(600), rng.random(600), half=1, emitted=600)
    solution, moment = bake.solution(), bake.tree.moment[0, :3]
    np.testing.assert_allclose(solution.flux_half[:, :, 0], [[2.0] * 3, [1.0] * 3])
    np.testing.assert_allclose((solution.half[..., 0] * moment).sum(2), solution.flux_half[:, :, 0])
    np.testing.assert_allclose((solution.coefficient[..., 0] * moment).sum(2), [[0.6] * 3, [0.8] * 3])  # of 1000 photons in all
    np.testing.assert_allclose(solution.flux[:, 0], 1.4)
    left, right = (bake.tree.origin[bake.tree.children[0, :], 0] == at for at in (0, 4))
    of_children = solution.coefficient[..., bake.tree.children[0]][:, 0, 0]
    assert of_children[0, left] == pytest.approx(1.2, rel=0.1)
    assert of_children[1, right] == pytest.approx(1.6, rel=0.15)
    assert not of_children[0, right].any()
    assert not of_children[1, left].any()


def test_children_without_photons_take_their_parents_function():
    rng = np.random.default_rng(5)
    bake = SquareBake(side=16, degree=1, preview_depth=1)
    bake.throw(np.sqrt(rng.random(100_000)), rng.random(100_000))
    bake.tree = quadtree.split(bake.tree, np.array([0]))
    bake.grow()
    bake.tally.grow(len(bake.tree))
    fine = np.flatnonzero(~bake.tree.has_children)
    coarse = bake.tree.children[0]
    at_s, at_t = rng.random((2, 40))
    np.testing.assert_allclose(
        bake.values(fine, at_s, at_t), bake.values(coarse, at_s, at_t), rtol=0.02
    )  # the parent's own is shrunk a hair


def test_variance_is_that_of_repeated_bakes():
    """Of four nodes, in bakes whose photons mostly land elsewhere; 120 of them show a variance to 7 %."""
    values, stated = [], []
    for seed in range(120):
        rng = np.random.default_rng(seed)
        bake = SquareBake(side=8, degree=1, preview_depth=1)
        n = rng.poisson(2000)
        bake.throw(*rng.random((2, n)), emitted=2000, flux=np.broadcast_to(rng.choice([0.5, 1.5], n), (3, n)))
        solution = bake.solution()
        values.append(solution.flux[0, 1:] / bake.tree.area[1:])
        stated.append(solution.variance[0, 1:])
    assert np.var(values, axis=0).mean() == pytest.approx(np.mean(stated), rel=0.15)


@pytest.mark.parametrize("watts", [1e-30, 1e-17, 1.0, 1e17, 1e25, 1e30])
def test_squares_of_any_power_are_summed(watts):
    """Photons carry all of a scene's light: those of planets that a sun shines on have more watts than float32 can square."""
    flux = np.float32(watts) * np.float32([[1.0, 2.0, 3.0], [0.0, 0.0, 0.0], [0.5, 0.5, 0.5]])
    sums = tally.deposit(np.array([0, 1, 1]), *np.zeros((2, 3)), flux, None, 2, 0)
    np.testing.assert_allclose(sums.weight2 / float(np.float32(watts)) ** 2, [[1.0, 13.0], [0.0, 0.0], [0.25, 0.5]], rtol=1e-6)
