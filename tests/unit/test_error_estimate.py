"""The stated error against the real one, on a square whose light is known."""

import numpy as np
import pytest
from leaflight.core.filter import error_estimate
from leaflight.core.filter.error_estimate import PhotonLight
from leaflight.core.filter.filtered_field import FilteredField
from leaflight.core.radiosity import quadtree, refine
from leaflight.core.radiosity.leaf_light import evaluate_nodes
from leaflight.core.radiosity.radiosity_solution import RadiositySolution
from leaflight.core.texels import error_metric
from trees import SIDE, SquareBake, even, even_truth, hill, hill_truth, throw


def read(bake, shrink=False):
    return RadiositySolution.of(bake.tree, bake.tally, refine.Rule("significance", 0.0, 16, 2), shrink)


def leaves_of(bake, reading):
    return quadtree.node_of_texel(bake.tree, reading.leaves, bake.n_texel)


def state(bake, direct_variance=0.0, shrink=False):
    """What is stated of leaves, and of direct light beside them that has some variance."""
    reading, dark = read(bake, shrink), np.zeros((bake.n_texel, 3), np.float32)
    leaf = leaves_of(bake, reading)
    total = float(reading.mean[leaf].sum())
    photons = PhotonLight(lambda entry: reading.mean[leaf[entry]], total, lambda entry: reading.error2[leaf[entry]])
    direct = FilteredField.plain(dark, dark + np.float32(direct_variance))
    return error_estimate.state_error(error_metric.ErrorMetric.whole(bake.texels), direct, photons)


def real_error(bake, truth, shrink=False):
    """Of leaves at texels' middles, relative to local brightness, over the best of them."""
    s, t = (bake.texels.texel_xy.T + 0.5) / SIDE
    reading, places = read(bake, shrink), bake.texels.own_points(0, bake.n_texel)
    shown = evaluate_nodes(bake.tree, reading.solution.coefficient, leaves_of(bake, reading), *places).sum(0)[0]
    squares = (shown - truth(s, t)) ** 2 / (truth(s, t) ** 2 + error_metric.DARK_FLOOR**2)
    return np.sqrt(np.sort(squares)[: int(error_metric.BEST_TEXELS * len(squares))].mean())


def ratio_of_errors(make, truth, n_bake, shrink=False):
    """Root mean squares of stated over real error, over bakes."""
    bakes = [make(seed) for seed in range(n_bake)]
    stated, real = [state(one, shrink=shrink).relative for one in bakes], [real_error(one, truth, shrink) for one in bakes]
    return np.sqrt(np.mean(np.square(stated)) / np.mean(np.square(real)))


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_noise_alone_is_stated_within_a_quarter(degree):
    """On the safe side: what is left of a bias by chance is added where it is positive."""
    ratio = ratio_of_errors(lambda seed: throw(even, 50_000, seed, degree=degree, level=3, preview_depth=0), even_truth, n_bake=6)
    assert 0.95 < ratio < 1.25


@pytest.mark.parametrize("degree", [1, 2])
def test_noise_is_stated_as_shrinking_leaves_it(degree):
    """Even light: with all noise of the functions that are shrunk it would be stated half too large."""
    ratio = ratio_of_errors(lambda seed: throw(even, 50_000, seed, degree=degree, level=2, preview_depth=0), even_truth, 12, shrink=True)
    assert 0.8 < ratio < 1.25


@pytest.mark.parametrize(("degree", "level"), [(0, 3), (1, 2), (2, 2)])
def test_light_that_coarse_leaves_cannot_hold_is_stated_within_a_quarter(degree, level):
    ratio = ratio_of_errors(lambda seed: throw(hill, 700_000, seed, degree=degree, level=level), hill_truth, 2)
    assert 0.75 < ratio < 1.25


def clump(rng, n, copies):
    """Even light, so many photons at each place."""
    return np.repeat(rng.random((2, n // copies)), copies, axis=1)


def test_the_stated_error_takes_the_correction():
    """Four photons at each place err as a quarter as many, as few leaves state without seeing it."""
    clumped, single = [], []
    for seed in range(4):
        for stated, copies in ((clumped, 4), (single, 1)):
            bake = throw(
                lambda rng, n, k=copies: np.repeat(rng.random((2, n // k)), k, axis=1), 80_000, seed, degree=0, level=4, preview_depth=0
            )
            stated.append(state(bake).relative)
    assert np.mean(clumped) == pytest.approx(2 * np.mean(single), rel=0.2)


def test_no_light_has_no_error():
    direct = FilteredField.plain(*np.zeros((2, 64, 3), np.float32))
    metric = error_metric.ErrorMetric.whole(SquareBake(side=8).texels)
    assert error_estimate.state_error(metric, direct, PhotonLight.none()).relative == 0.0


def test_noise_of_direct_light_counts_and_is_told_apart():
    bake = throw(even, 50_000, 1, degree=0, level=3, preview_depth=0)
    without, with_it = state(bake), state(bake, direct_variance=0.2**2)
    expected = 0.2**2 / (1 + error_metric.DARK_FLOOR**2)
    assert with_it.relative**2 - without.relative**2 == pytest.approx(expected, rel=0.1)
    assert with_it.direct**2 == pytest.approx(expected, rel=0.02)
    assert with_it.texel_direct2() == pytest.approx(np.full(SIDE * SIDE, expected), rel=0.2)
    assert without.direct == 0
    assert not without.texel_direct2().any()
