"""How many photons part where: least noise at the same work, and what little is known is not taken for truth."""

import numpy as np
import pytest
from leaflight.core.radiosity.splitting_guide import (
    LEAST_FACTOR,
    MOST_FACTOR,
    SplitGuide,
    SplitTally,
    Splitting,
    weigh_deposits,
    weigh_groups,
)
from leaflight.core.texels.error_metric import Parts
from leaflight.core.transport.emission_cells import BirthCells
from leaflight.core.transport.photon_log import Groups
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


def test_a_plan_that_does_less_work_counts_for_no_less_than_none():
    """Nearly all noise comes of a place whose groups take so many rays that they are cut; the rest is bounded."""
    tree = make_tree()
    guide, lowest = make_guide(tree, [(1e6, 3.0), (1e6, 3.0), (1e6, 3.0), (0.05, 1.0)], groups=1e12)
    factor, weight = guide.plan(tree, NO_ROOT)
    assert (factor[lowest[:3]] == LEAST_FACTOR).all()
    assert weight == 1.0


def test_places_with_hardly_a_ray_are_not_told_apart_by_them():
    tree = make_tree()
    guide, lowest = make_guide(tree, [(1e-4, 1.0), (1e-2, 1.0), (1.0, 1.0), (1.0, 1.0)], groups=1e9)
    factor, _ = guide.plan(tree, NO_ROOT)
    assert factor[lowest[0]] == factor[lowest[1]] > factor[lowest[2]]


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


def test_new_nodes_begin_with_what_is_known_of_their_parents():
    tree, finer = make_tree(1), make_tree(2)
    guide, lowest = make_guide(tree, [(1.0, 1.0), (1.0, 1.0), (1.0, 4.0), (1.0, 4.0)])
    guide.grow(1 + len(finer))
    factor, _ = guide.plan(finer, NO_ROOT)
    newest = finer.levels[2]
    np.testing.assert_allclose(factor[newest + 1], factor[finer.parent[newest] + 1], rtol=1e-6)
    assert factor[lowest[2]] == pytest.approx(2 * factor[lowest[0]], rel=0.01)


def test_objects_without_a_lightmap_are_places_too():
    tree = make_tree()
    guide, lowest = make_guide(tree, [(1.0, 4.0)] * 4, n_object=2)
    guide.add_round(
        [SplitTally(np.array([1]), np.array([4e5]), np.array([4e5]), np.array([1e-9])), SplitTally(lowest, *np.full((3, 4), 1e5))]
    )
    factor, _ = guide.plan(tree, NO_ROOT)
    assert factor[1] < 0.5 * factor[lowest].min()
    told = Splitting(factor, np.zeros((3, len(tree))), BirthCells.whole(np.ones(1)))
    places = told.find_places(np.array([3, 9]), np.array([True, False]), np.array([0, 1]))
    assert places.tolist() == [2 + 3, 1]


def test_what_nobody_met_is_expected_to_be_like_the_rest_of_its_object():
    """Both ways: a chart like the object's faces without texels, and those like the chart."""
    tree = make_tree()
    seen, of_second = np.array([0, 1]), np.ones(1, np.int64)
    guide = SplitGuide.empty(2 + len(tree))
    guide.add_round([SplitTally(seen, np.full(2, 1e6), np.full(2, 1e6), np.array([1e6, 9e6]))])
    factor, _ = guide.plan(tree, of_second)
    np.testing.assert_allclose(factor[2:], factor[1], rtol=1e-3)
    assert factor[1] == pytest.approx(3 * factor[0], rel=0.01)
    guide, lowest = SplitGuide.empty(2 + len(tree)), tree.levels[-1] + 2
    many = np.full(4, 1e6)
    guide.add_round([SplitTally(lowest, many, many, 9 * many), SplitTally(seen[:1], many[:1], many[:1], many[:1])])
    factor, _ = guide.plan(tree, of_second)
    np.testing.assert_allclose(factor[lowest], factor[1], rtol=1e-3)
    assert factor[1] == pytest.approx(3 * factor[0], rel=0.01)


def test_rounds_count_by_their_groups_whatever_their_light_is_worth():
    tree, rays = make_tree(), np.ones(4)
    first, second = np.array([1.0, 1.0, 9.0, 9.0]), np.array([9.0, 1.0, 1.0, 1.0])
    mean = (first / first.mean() + 3 * second / second.mean()) / 4  # three times as many groups in the second round
    for worth in (1.0, 1e9):
        guide, lowest = make_guide(tree, np.stack([rays, first], axis=1))
        guide.add_round([SplitTally(lowest, np.full(4, 3e5), 3e5 * rays, 3e5 * second * worth)])
        factor, _ = guide.plan(tree, NO_ROOT)
        np.testing.assert_allclose(factor[lowest] / factor[lowest[1]], np.sqrt(mean / mean[1]), rtol=1e-3)


def test_groups_are_summed_as_if_nobody_had_been_told_anything():
    """A place where twice as many parted has twice the rays, and half the noise, of what it would have had."""
    groups = Groups(np.int32([4, 2, 4]), np.float32([2, 1, 2]), np.array([20, 10, 24]), np.int32([0, 0, 1, 2]))
    worth = np.array([[1.0, 2.0], [0.0, 0.0], [0.0, 1.0]])
    flux = np.float32([[1, 1, 3, 2], [5, 5, 5, 5], [0, 2, 0, 0]])
    noise = weigh_groups(groups, worth, np.array([0, 1, 0, 1]), flux)
    assert noise.tolist() == [1 + (2 + 4), 9, 8]
    tally = SplitTally.of(groups, noise)
    assert tally.place.tolist() == [2, 4]
    assert tally.groups.tolist() == [1, 2]
    assert tally.rays.tolist() == [10, 22]
    assert tally.noise.tolist() == [9, 2 * (1 + (2 + 4)) + 2 * 8]


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


def test_of_parts_that_are_judged_each_counts_by_its_weight_and_its_own_dark():
    tree = SquareBake(side=16, preview_depth=1).tree
    leaves, light = tree.levels[1], np.ones((3, len(tree)))
    of_entry = np.full(256, -1, np.int32)
    for part, leaf in enumerate(leaves[:3]):
        of_entry[tree.start[leaf] : tree.end[leaf]] = part
    parts = Parts([np.arange(1)] * 3, np.array([0.0, 1.0, 8.0], np.float32), of_entry)
    worth = weigh_deposits(tree, leaves, light, 10**9, (parts, np.array([2.0, 2.0, 9.0])))[0, leaves]
    assert worth / worth[0] == pytest.approx([1.0, 1 / 2, 1 / 2, 0.0], rel=1e-6)  # what is not judged is worth nothing


def test_light_on_a_chart_smaller_than_grain_is_worth_something():
    tree = SquareBake(side=2, preview_depth=1).tree
    worth = weigh_deposits(tree, tree.levels[1], np.ones((3, len(tree))), 10**9)
    assert worth == pytest.approx(np.full((3, len(tree)), 4 / 1.01 / tree.area[0] ** 2), rel=1e-6)


def test_worth_goes_down_to_the_deepest_nodes_and_grain_counts_together():
    bake = SquareBake(side=8, preview_depth=3)
    tree = bake.tree
    light = np.ones((3, len(tree)))
    worth = weigh_deposits(tree, tree.levels[3], light, 10**9)  # leaves of one texel
    together = tree.levels[1]  # of four
    for level in tree.levels[2:]:
        above = tree.parent[level]
        while (tree.depth[above] > 1).any():
            above = tree.parent[above]
        np.testing.assert_array_equal(worth[:, level], worth[:, above])
    assert worth[0, together[0]] == pytest.approx(16 / 1.01 / tree.area[together[0]] ** 2, rel=1e-6)
