"""Shrunk functions of leaves: less noise where light is even, the whole slope where it is steep, and the same flux."""

import numpy as np
import pytest
from leaflight.core.radiosity import coefficient_shrinkage, tally
from trees import SquareBake

ROOT = np.array([0])


def shrunk_bake(sampler, photons, degree, seed=0, **kwargs):
    """A bake, its solution as photons have it, and with the root shrunk."""
    bake = SquareBake(side=16, degree=degree, preview_depth=1, **kwargs)
    bake.throw(*sampler(np.random.default_rng(seed), photons))
    totals = bake.totals()
    shown = coefficient_shrinkage.shrink_leaves(bake.tree, totals, ROOT)
    return bake, shown, tally.solve_tallies(bake.tree, totals), tally.solve_tallies(shown, totals)


def ramp(rng, n):
    return np.sqrt(rng.random(n)), rng.random(n)


def test_a_slope_keeps_the_share_that_is_not_noise():
    """Of photons of different powers, in both halves of the bake and both components, on a strip: told by orthonormal functions."""
    rng, width = np.random.default_rng(3), 0.25
    bake = SquareBake(side=16, width=width, preview_depth=1)
    square = energy = 0.0
    for half, is_first in ((0, True), (1, True), (1, False)):
        x, y = rng.random((2, 400)) * [[width], [1.0]]
        flux = rng.uniform(0.1, 2.0, (3, 400)) * (0.8 + 0.4 * y)
        bake.throw(x, y, half, flux=flux, is_first=is_first)
        along = np.sqrt(12.0 / width) * np.stack([x / width - 0.5, y - 0.5])
        energy, square = energy + flux @ along.T, square + (flux**2).sum()
    share = 1.0 - 2 * square / width / (energy**2).sum()
    assert 0.2 < share < 0.9
    plain, totals = tally.solve_tallies(bake.tree, bake.totals()), bake.totals()
    shrunk = tally.solve_tallies(coefficient_shrinkage.shrink_leaves(bake.tree, totals, ROOT), totals)
    slopes = [solution.coefficient[..., 1:, 0] * [width, 1.0] for solution in (plain, shrunk)]
    np.testing.assert_allclose(slopes[1], share * slopes[0], rtol=1e-5)


@pytest.mark.parametrize("degree", [1, 2])
def test_a_slope_that_many_photons_tell_stays(degree):
    _, _, plain, shrunk = shrunk_bake(ramp, 20_000, degree)
    slope = (shrunk.coefficient[:, :, 1, 0].sum(0) / plain.coefficient[:, :, 1, 0].sum(0))[0]
    assert 0.98 < slope < 1.02


def test_each_degree_is_shrunk_for_itself():
    """A ramp has nothing that only quadratic functions could hold."""
    before, after = np.zeros((2, 40))
    for seed in range(40):
        _, _, plain, shrunk = shrunk_bake(ramp, 5_000, 2, seed)
        before[seed], after[seed] = ((solution.coefficient[:, 0, 3:, 0].sum(0) ** 2).sum() for solution in (plain, shrunk))
    assert after.mean() < 0.6 * before.mean()


@pytest.mark.parametrize("degree", [0, 1, 2])
@pytest.mark.parametrize("width", [1.0, 0.3])
def test_flux_stays_and_so_do_other_nodes(degree, width):
    def strip(rng, n):
        s, t = rng.random((2, n))
        return s * width, t

    bake, shown, plain, shrunk = shrunk_bake(strip, 300, degree, width=width)
    np.testing.assert_allclose(shrunk.flux, plain.flux, rtol=1e-9)
    np.testing.assert_array_equal(shown.project[1:], bake.tree.project[1:])
    if degree == 0:
        np.testing.assert_allclose(shown.project, bake.tree.project)
