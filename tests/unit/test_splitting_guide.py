"""How many photons part where: least noise at the same work, and what little is known is not taken for truth."""

import numpy as np
import pytest
from leaflight.core.radiosity.splitting_guide import (
    LEAST_FACTOR,
    MOST_FACTOR,
    SplitGuide,
    SplitTally,
    weigh_deposits,
)
from trees import SquareBake

NO_ROOT = np.zeros(1, np.int64)  # the tree's one root is of object 0


def make_tree(level=1):
    """One root with previews below it."""
    bake = SquareBake(side=16, preview_depth=level)
    return bake.tree


def make_guide(tree, rates, groups=1e5, n_object=1):
    """A guide that has seen many groups at all nodes of the lowest level, with (rays, noise) of a group at each."""
    lowest = tree.levels[-1] + n_object
    rays, noise = np.array(rates, float).T
    guide = SplitGuide.empty(n_object + len(tree))
    guide.add_round([SplitTally(lowest, np.full(len(lowest), groups), groups * rays, groups * noise)])
    return guide, lowest


def test_factors_go_as_the_root_of_noise_over_work():
    tree = make_tree()
    rates = [(10.0, 1.0), (10.0, 4.0), (40.0, 4.0), (10.0, 9.0)]
    guide, lowest = make_guide(tree, rates)
    factor, weight = guide.plan(tree, NO_ROOT)
    np.testing.assert_allclose(factor[lowest] / factor[lowest[0]], [1, 2, 1, 3], rtol=0.01)
    rays, noise = np.array(rates).T
    assert (factor[lowest] * rays).sum() == pytest.approx(rays.sum(), rel=0.01)  # the same work
    assert weight == pytest.approx(noise.sum() / (noise / factor[lowest]).sum(), rel=0.01)
    best = noise.sum() * rays.sum() / np.sqrt(noise * rays).sum() ** 2  # Cauchy and Schwarz allow no more
    assert weight == pytest.approx(best, rel=0.01)


def test_factors_and_weights_have_bounds():
    tree = make_tree()
    for useful_rays, extreme in ((10.0, LEAST_FACTOR), (0.5, MOST_FACTOR)):
        guide, lowest = make_guide(tree, [(10.0, 1e-9), (10.0, 1e-9), (10.0, 1e-9), (useful_rays, 1.0)])
        factor, weight = guide.plan(tree, NO_ROOT)
        assert extreme in factor[lowest]
        assert factor.min() >= LEAST_FACTOR
        assert factor.max() <= MOST_FACTOR
        assert 1.0 < weight <= MOST_FACTOR
    assert (factor[lowest[:3]] == LEAST_FACTOR).all()  # work that the useful place cannot take is not done elsewhere


def test_nothing_known_changes_nothing():
    tree = make_tree()
    guide = SplitGuide.empty(1 + len(tree))
    for _ in range(2):
        factor, weight = guide.plan(tree, NO_ROOT)
        assert (factor == 1).all()
        assert weight == 1.0
        guide.add_round([SplitTally(np.array([0]), np.ones(1), np.ones(1), np.zeros(1))])  # light that comes to nothing


def test_what_few_groups_tell_is_mixed_with_what_is_known_above():
    tree = make_tree()
    for groups, least, most in ((1.0, 0.9, 1.3), (1e6, 3.9, 4.1)):
        guide, lowest = make_guide(tree, [(1.0, 1.0), (1.0, 1.0), (1.0, 1.0), (1.0, 16.0)], groups)
        factor, _ = guide.plan(tree, NO_ROOT)
        assert least < factor[lowest[3]] / factor[lowest[0]] < most


def dark_of(light, leaves):
    return 0.1 * np.maximum(light[:, leaves], 0.0).mean()


def test_light_is_worth_most_on_dark_small_leaves():
    bake = SquareBake(side=64, preview_depth=1)
    tree = bake.tree
    leaves, light = tree.levels[1], np.ones((3, len(tree)))
    light[:, leaves[0]] = 0.1
    worth = weigh_deposits(tree, leaves, light, 10**9)
    share = (tree.end - tree.start)[leaves[1]]
    dark = dark_of(light, leaves)
    assert worth[0, leaves[1]] == pytest.approx(share / (1 + dark**2) / tree.area[leaves[1]] ** 2, rel=1e-6)
    assert worth[0, leaves[0]] / worth[0, leaves[1]] == pytest.approx((1 + dark**2) / (0.01 + dark**2), rel=1e-6)
    few = weigh_deposits(tree, leaves, light, 1)[:, leaves]
    assert (few < 0.1 * worth[:, leaves]).all()  # one photon for all of them: its leaf stays as uncertain as it was
    light[1, leaves[0]] = -5.0  # a fitted plane may dip below zero
    dipped = weigh_deposits(tree, leaves, light, 10**9)[1, leaves]
    assert dipped[0] / dipped[1] == pytest.approx((1 + dark_of(light, leaves) ** 2) / dark_of(light, leaves) ** 2, rel=1e-6)
