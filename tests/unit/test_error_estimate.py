"""The stated error against the real one, on a square whose light is known."""

from dataclasses import replace

import numpy as np
import pytest
from leaflight.core.filter import error_estimate
from leaflight.core.filter.filtered_field import FilteredField
from leaflight.core.filter.radiosity_solution import RadiositySolution
from leaflight.core.filter.reconstruct import Blend
from leaflight.core.filter.subtexel_tally import SubtexelLight, mix
from leaflight.core.radiosity import coefficient_shrinkage, quadtree, refine, tally
from leaflight.core.radiosity.spatial_shrinkage import SpatialShrinkage
from leaflight.core.texels import error_metric
from trees import SIDE, SquareBake, current, even, even_truth, hill, hill_truth, throw


def state(bake, nodes, direct_variance=0.0, smooth_grain=False, risk=None, squares=None):
    dark = np.zeros((bake.n_texel, 3), np.float32)
    direct = FilteredField.plain(dark, dark + np.float32(direct_variance))
    return error_estimate.state_error(read(bake, nodes, risk=risk, squares=squares), direct, bake.texels, smooth_grain)


def read(bake, nodes=None, **more):
    """What state_error asks: of the bake's current nodes if none are named."""
    totals, solution = bake.totals(), bake.solution()
    comparison = refine.Comparison.of(bake.tree, totals, solution, refine.Rule("significance", 0.0, 16, 2))
    return RadiositySolution(bake.tree, totals, solution, comparison, current(bake) if nodes is None else nodes, **more)


def dark_of(bake):
    """No direct light."""
    return FilteredField.plain(*np.zeros((2, bake.n_texel, 3), np.float32))


def noise_of(bake, nodes):
    """What state_error says of photons' noise alone, relative; nodes of one size."""
    solution = bake.solution()
    brightness = solution.flux[0, nodes] / bake.tree.area[nodes]
    variance = solution.variance[0, nodes] * bake.tree.rank[nodes] * state(bake, nodes).correction[0]
    return np.sqrt((variance / (brightness**2 + (error_metric.DARK_FLOOR * brightness.mean()) ** 2)).mean())


def real_error(bake, nodes, truth):
    """As estimate states it: of blended leaves at texels' middles, relative to local brightness, over the best of them."""
    s, t = (bake.texels.texel_xy.T + 0.5) / SIDE
    leaf = quadtree.node_of_texel(bake.tree, nodes, bake.n_texel)
    shown = Blend.of(bake.texels, bake.tree, bake.solution(), leaf).at(np.arange(len(leaf))).irradiance.sum(0)[0]
    squares = (shown - truth(s, t)) ** 2 / (truth(s, t) ** 2 + error_metric.DARK_FLOOR**2)
    return np.sqrt(np.sort(squares)[: int(error_metric.BEST_TEXELS * len(squares))].mean())


def ratio_of_errors(make, truth, n_bake):
    """Root mean squares of stated over real error, over bakes."""
    stated, real = [], []
    for seed in range(n_bake):
        bake = make(seed)
        stated.append(state(bake, current(bake)).relative)
        real.append(real_error(bake, current(bake), truth))
    return np.sqrt(np.mean(np.square(stated)) / np.mean(np.square(real)))


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_noise_alone_is_stated_within_a_quarter(degree):
    """On the safe side: what is left of a bias by chance is added where it is positive."""
    ratio = ratio_of_errors(lambda seed: throw(even, 50_000, seed, degree=degree, level=3), even_truth, n_bake=6)
    assert 0.95 < ratio < 1.25


@pytest.mark.parametrize(("degree", "level"), [(0, 3), (1, 2), (2, 2)])
def test_light_that_coarse_leaves_cannot_hold_is_stated_within_a_quarter(degree, level):
    bake = throw(hill, 700_000, 0, degree=degree, level=level)
    nodes = current(bake)
    stated = state(bake, nodes).relative
    assert 0.75 < stated / real_error(bake, nodes, hill_truth) < 1.25
    assert stated > 2 * noise_of(bake, nodes)  # or the test would be of noise again


@pytest.mark.parametrize("degree", [1, 2])
def test_noise_is_stated_as_shrinking_leaves_it(degree):
    """Even light: with all noise of the functions that are shrunk it would be stated half too large."""
    stated, real = [], []
    for seed in range(12):
        bake = throw(even, 50_000, seed, degree=degree, level=2, preview_depth=0)
        nodes, tree = current(bake), bake.tree
        shown, risk = coefficient_shrinkage.shrink_leaves(tree, bake.totals(), nodes)
        solution = tally.solve_tallies(shown, bake.totals())
        bake.solution = lambda solution=solution: solution
        stated.append(state(bake, nodes, risk=risk).relative)
        real.append(real_error(bake, nodes, even_truth))
    assert 0.8 < np.sqrt(np.mean(np.square(stated)) / np.mean(np.square(real))) < 1.25


def test_the_stated_error_takes_the_correction():
    """Four photons at each place err as a quarter as many, as few leaves state without seeing it."""
    clumped, single = [], []
    for seed in range(4):
        for stated, copies in ((clumped, 4), (single, 1)):
            bake = throw(lambda rng, n, k=copies: np.repeat(rng.random((2, n // k)), k, axis=1), 80_000, seed, degree=0, level=4)
            stated.append(state(bake, current(bake)).relative)
    assert np.mean(clumped) == pytest.approx(2 * np.mean(single), rel=0.2)


def test_no_photons_are_no_statement():
    bake = SquareBake(side=8)
    assert np.isnan(state(bake, current(bake)).relative)


def test_noise_of_direct_light_counts_and_is_told_apart():
    bake = throw(even, 50_000, 1, degree=0, level=3)
    without, with_it = state(bake, current(bake)), state(bake, current(bake), direct_variance=0.2**2)
    expected = 0.2**2 / (1 + error_metric.DARK_FLOOR**2)
    assert with_it.relative**2 - without.relative**2 == pytest.approx(expected, rel=0.1)
    assert with_it.direct**2 == pytest.approx(expected, rel=0.02)
    assert with_it.texel_direct2() == pytest.approx(np.full(SIDE * SIDE, expected), rel=0.2)
    assert without.direct == 0
    assert not without.texel_direct2().any()


def test_leaves_that_are_shown_with_what_is_around_err_by_what_they_state():
    """Half of them, three times as bright as they are; the others as without."""
    bake = throw(even, 4000, seed=3, level=2)
    nodes = np.flatnonzero(bake.tree.current)
    row_of = np.full(len(bake.tree), -1, np.int32)
    row_of[nodes[::2]] = np.arange(len(nodes[::2]))
    own = bake.solution().flux[:, nodes[::2]] / bake.tree.area[nodes[::2]]
    few = SpatialShrinkage(row_of, own, np.ones(len(own[0])), 3.0 * own, np.full_like(own, 0.25))
    alone, stated = (error_estimate.state_error(read(bake), dark_of(bake), bake.texels, False, few=one) for one in (None, few))
    assert stated.photons**2 == pytest.approx((0.25 / (9.0 + 4 * error_metric.DARK_FLOOR**2) + alone.photons**2) / 2, rel=0.1)
    surer = replace(few, variance=0.0 * few.variance)
    assert error_estimate.state_error(read(bake), dark_of(bake), bake.texels, False, few=surer).relative < 0.8 * alone.relative


def ripple_squares(bake, rows, height, photons, seed):
    """Squares of the texels `rows`, on which photons tell of ripples that leaves do not hold; and that light, (n,)."""
    truth = np.ones(bake.n_texel)
    truth[rows] += height * np.where(bake.texels.texel_xy[rows, 0] % 2, 1, -1)
    irradiance = np.zeros((2, 3, len(rows)))
    irradiance[1] = np.random.default_rng(seed).poisson(photons * truth[rows]) / photons
    return SubtexelLight(rows.astype(np.int32), irradiance, irradiance[1] / photons, np.full((3, len(rows)), 1 / photons)), truth


@pytest.mark.parametrize(("height", "photons"), [(0.3, 40.0), (0.3, 400.0), (0.1, 1000.0)])
def test_what_squares_add_and_leave_is_stated(height, photons):
    real2, stated2, unaware2 = [], [], []
    for seed in range(4):
        bake = throw(even, 100_000, seed, degree=0, level=3)
        rows = np.arange(0, bake.n_texel, 2)
        squares, truth = ripple_squares(bake, rows, height, photons, seed)
        leaf = quadtree.node_of_texel(bake.tree, current(bake), bake.n_texel)
        light = Blend.of(bake.texels, bake.tree, bake.solution(), leaf).at(np.arange(bake.n_texel)).irradiance.astype(np.float32)
        mix(light, np.zeros(light.shape[1:], np.float32), squares, bake.texels)
        errors2 = (((light.sum(0) - truth) / np.hypot(truth, error_metric.DARK_FLOOR)) ** 2).mean(0)
        real2.append(np.sort(errors2)[: int(error_metric.BEST_TEXELS * len(errors2))].mean())
        stated2.append(state(bake, current(bake), squares=squares).relative ** 2)
        unaware2.append(state(bake, current(bake)).relative ** 2)
    assert np.sqrt(np.mean(stated2) / np.mean(real2)) == pytest.approx(1, abs=0.25)
    assert np.mean(unaware2) < 0.5 * np.mean(real2)  # or the test could not fail
