"""Light that leaves cannot hold, on a square whose light is known: as judges tell it, and as the nodes above foretell it."""

import dataclasses

import numpy as np
import pytest
from leaflight.core.filter import bias_estimate, radiosity_solution, reconstruct
from leaflight.core.radiosity import coefficient_shrinkage, quadtree, refine
from leaflight.core.texels.error_metric import ErrorMetric
from trees import SIDE, SquareBake, current, even, glow, throw

NONE = np.nan  # no such node above


def bias_of(told, noise, parent, grandparent, judge=None):
    """Of texels that judges of their own tell."""
    told, noise, parent, grandparent = np.broadcast_arrays(*(np.array(part, float) for part in (told, noise, parent, grandparent)))
    judge = np.arange(len(told)) if judge is None else np.array(judge)
    return bias_estimate.Bias(judge.astype(np.int32), told, np.abs(told), noise, parent, grandparent)


def sum_up(bias):
    return bias.sum_up(np.arange(len(bias.told)))


def every(nodes):
    return nodes


def throw_on_split(photons, degree, choose, side=SIDE, colour=(1.0, 1.0, 1.0), sampler=glow):
    """A glow, or what the sampler throws, on a square whose nodes were split beforehand.

    choose   functions each of which picks who is split, of the current nodes
    """
    bake = SquareBake(side, degree, preview_depth=1)
    for some in choose:
        bake.tree = quadtree.split(bake.tree, some(current(bake)))
        bake.grow()
    rng = np.random.default_rng(2)
    for half in (0, 1):
        s, t = sampler(rng, photons // 2)
        bake.throw(s, t, half, emitted=photons // 2, flux=np.array(colour)[:, None] * np.ones(len(s)))
    return bake


def find_bias(bake, nodes, weight=1.0):
    """Of all texels, relative to no light unless `weight` (m or 1, 1 or 3) says so."""
    solution, texels = bake.solution(), np.arange(bake.n_texel)
    comparison = refine.Comparison.of(bake.tree, bake.totals(), solution, refine.Rule("significance", 0.0, 16, 2))
    leaf = quadtree.node_of_texel(bake.tree, nodes, bake.n_texel)
    shown = reconstruct.Blend.of(bake.texels, bake.tree, solution, leaf, halves=True).at(texels)
    weight = np.ones((len(texels), 3), np.float32) * np.float32(weight)
    asked = bias_estimate.AskedLight(leaf, *bake.texels.own_points_at(texels), shown, weight)
    return bias_estimate.find_bias(bake.tree, solution, comparison, nodes, texels, asked, np.ones(3))


def test_children_that_are_sure_are_believed():
    assert sum_up(bias_of([0.1, 0.3], 0.0, 0.4, 4.0)) == (pytest.approx(0.2), pytest.approx(0.0))


def test_of_children_that_say_nothing_counts_what_is_foretold():
    """A tenth was left on the level above; of that share a half is from the next."""
    likely = bias_estimate.FALL_GOES_ON * 0.4 * 0.1
    value, doubt = sum_up(bias_of([5.0, -5.0], 1e3, 0.4, 4.0))
    assert value == pytest.approx(likely, rel=1e-3)
    assert doubt == pytest.approx(bias_estimate.FALL_DOUBT * likely, rel=1e-3)


@pytest.mark.parametrize(("told", "share"), [(0.03, 1 / 2), (0.01, 1 / (1 + bias_estimate.HIDDEN_DOUBT**2))])
def test_both_count_by_how_sure_they_are(told, share):
    """Children of whom the choice of leaves hides some are taken for less sure than they say."""
    likely = 0.02
    doubt = bias_estimate.FALL_DOUBT * likely
    value, error = sum_up(bias_of([told] * 4, 2 * doubt, 0.4, 4.0))
    assert value == pytest.approx(likely + share * (told - likely))
    assert error == pytest.approx(doubt * np.sqrt(1 - share))


def test_what_is_too_small_to_be_squared_is_left_to_the_children():
    assert sum_up(bias_of([1e-200] * 2, 0.0, 1e-200, 1e-199)) == (pytest.approx(1e-200), 0.0)


def test_texels_of_one_judge_err_together():
    apart, together = (sum_up(bias_of([0.02] * 4, 0.02, NONE, NONE, judge)) for judge in ([0, 1, 2, 3], [7, 7, 7, 7]))
    assert together[1] == pytest.approx(2 * apart[1]) == pytest.approx(0.02)


def test_leaves_that_are_not_deep_are_foretold_by_how_it_falls_elsewhere():
    """A tenth is left, of what the shallow one's parent lacks too; what has no parent has only its children's word."""
    value, doubt = sum_up(bias_of([0.0, 0.0, 0.5, 0.5], [1e3, 1e3, 0.0, 0.0], [0.4, 0.8, NONE, NONE], [4.0, NONE, NONE, NONE]))
    by_word = coefficient_shrinkage.beyond_noise(1.0 / 4, 2 * (0.5 / 4) ** 2)
    assert value == pytest.approx(by_word + bias_estimate.FALL_GOES_ON * (0.4 + 0.8) * 0.1 / 4, rel=1e-3)
    assert doubt == pytest.approx(bias_estimate.FALL_DOUBT * bias_estimate.FALL_GOES_ON * (0.4 + 0.8) * 0.1 / 4, rel=1e-3)


@pytest.mark.parametrize(("parent", "grandparent"), [(NONE, NONE), (0.4, NONE), (0.0, 0.0), (0.4, 0.0), (-0.1, 0.3), (0.1, -0.3)])
def test_where_nothing_is_foretold_the_children_have_the_word(parent, grandparent):
    value, doubt = sum_up(bias_of([0.3, 0.1], 0.1, parent, grandparent))
    assert value == pytest.approx(coefficient_shrinkage.beyond_noise(0.2, (0.3**2 + 0.1**2) / 4))
    assert doubt == pytest.approx(np.sqrt(2) * 0.1 / 2)


def test_nothing_is_missing_where_children_say_less_than_nothing():
    for above in (0.4, NONE):
        assert sum_up(bias_of([-0.2] * 4, 1e-6, above, 10 * above))[0] == 0


def test_only_the_best_texels_count():
    """Neither by their children's word nor by what is foretold."""
    bias = bias_of([9.0, 0.1], [3.0, 0.01], [50.0, 0.4], [50.0, 4.0])
    assert bias.sum_up(np.array([1])) == sum_up(bias_of([0.1], 0.01, 0.4, 4.0))


def test_where_other_light_is_shown_leaves_miss_nothing():
    bias = bias_of([0.1, 0.3], [1e-3, 2e-3], [0.4, 8.0], [4.0, 9.0])
    left = bias.without(np.array([False, True]))
    value, doubt = (part / 2 for part in sum_up(bias_of([0.1], 1e-3, 0.4, 4.0)))
    assert sum_up(left) == (pytest.approx(value), pytest.approx(doubt))
    assert left.gap.tolist() == [0.1, 0.0]
    assert [part.tolist() for part in (left.told, left.noise)] == [[0.1, 0.0], [1e-3, 0.0]]
    assert np.isnan([left.parent[1], left.grandparent[1]]).all()
    assert bias.told.tolist() == [0.1, 0.3]


@pytest.mark.parametrize(("degree", "splits"), [(1, 2), (1, 3), pytest.param(2, 2, marks=pytest.mark.slow)])
def test_smooth_light_falls_about_as_it_is_foretold(degree, splits):
    """So many photons that the children know."""
    bake = throw_on_split(2_000_000, degree, [every] * splits)
    bias = find_bias(bake, current(bake))
    assert 0.4 < bias._foretell(np.arange(bake.n_texel)).mean() / bias.told.mean() < 1.6


def test_there_is_nothing_to_find_of_no_node():
    """Nor is it what the last node has."""
    difference = refine.Difference(*np.zeros((6, 2)))
    difference = dataclasses.replace(difference, common=np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]), sigmas=np.array([2.0, 9.0]))
    comparison = refine.Comparison((np.array([0, -1, 1]),), (difference,), np.ones(3, bool), np.ones(3))
    found = bias_estimate._find_missing_of(comparison, np.array([-1, 0, 1, 2]))
    np.testing.assert_array_equal(found, [[NONE] * 3, [1.0, 2.0, 3.0], [NONE] * 3, [4.0, 5.0, 6.0]])
    far_out = bias_estimate._find_missing_of(comparison, np.array([-1, 0, 1, 2]), 9.0)
    np.testing.assert_array_equal(far_out, [[NONE] * 3, [NONE] * 3, [NONE] * 3, [4.0, 5.0, 6.0]])


def test_what_judges_tell_beside_blind_leaves_is_what_they_tell_alone():
    bake = throw(even, 20_000, 1, degree=0, level=2, preview_depth=1)
    solution, texels = bake.solution(), np.arange(bake.n_texel)
    leaf, child = (quadtree.node_of_texel(bake.tree, ids, len(texels)) for ids in (current(bake), np.flatnonzero(~bake.tree.has_children)))
    shown = reconstruct.Blend.of(bake.texels, bake.tree, solution, leaf, halves=True).at(texels)
    weight = (1 + texels[:, None]) * np.ones(3, np.float32)
    asked = bias_estimate.AskedLight(leaf, *bake.texels.own_points_at(texels), shown, weight)
    blind = texels < bake.n_texel // 4
    every, some = (
        bias_estimate.compare_with_judges(bake.tree, solution, judge, asked, np.ones(3), np.full(len(texels), 7.0))
        for judge in (child, np.where(blind, leaf, child))
    )
    for of_every, of_some in zip(every, some, strict=True):
        np.testing.assert_array_equal(of_some, np.where(blind, 7.0, of_every))


def test_how_noise_falls_foretells_nothing():
    """Even light, and nodes that were split for nothing; a glow's stand out."""
    for sampler, known in ((even, False), (glow, True)):
        bake = throw_on_split(200_000, 1, [every, every], sampler=sampler)
        bias = find_bias(bake, current(bake))
        assert not np.isnan(bias.parent).any()
        assert np.isnan(bias.grandparent).any() != known
        assert np.isnan(bias._foretell(np.arange(bake.n_texel))).any() != known


def test_nodes_above_are_those_of_the_texels_leaf():
    """Of a square of which one quarter was split again."""
    bake = throw_on_split(200_000, 0, [every, lambda nodes: nodes[:1]])
    nodes = current(bake)
    bias = find_bias(bake, nodes)
    leaf = quadtree.node_of_texel(bake.tree, nodes, bake.n_texel)
    comparison = refine.Comparison.of(bake.tree, bake.totals(), bake.solution(), refine.Rule("significance", 0.0, 16, 2))
    common, rows = comparison.differences[0].common.mean(1), comparison.rows[0]
    for found, up, unknown in ((bias.parent, 1, 0.0), (bias.grandparent, 2, 0.75)):
        above = leaf
        for _ in range(up):
            above = bake.tree.parent[above]
        assert np.isnan(found).mean() == (above < 0).mean() == unknown
        np.testing.assert_allclose(found, np.where(above >= 0, common[rows[above]], np.nan))


def test_what_is_foretold_and_what_is_only_told_add_up():
    """So do their doubts; each texel counts in one of them."""
    told, noise, parent, grandparent = [0.03, 0.0, 0.5, 0.5], [0.02, 0.01, 0.1, 0.2], [0.4, 0.8, NONE, NONE], [4.0, NONE, NONE, NONE]
    foretold, doubt = sum_up(bias_of(told[:2], noise[:2], parent[:2], grandparent[:2]))
    by_word, word_doubt = sum_up(bias_of(told[2:], noise[2:], NONE, NONE))
    assert by_word > 0
    value, error = sum_up(bias_of(told, noise, parent, grandparent))
    assert value == pytest.approx((foretold + by_word) / 2)
    assert error == pytest.approx(np.hypot(doubt, word_doubt) / 2)


def test_where_a_parent_says_nothing_nothing_is_lost():
    assert np.isfinite(sum_up(bias_of([0.3, 0.1], 0.1, [0.4, NONE], [4.0, 4.0]))).all()


def test_no_node_is_above_a_root():
    bake = throw(even, 50_000, 1, degree=0, level=0, preview_depth=2)
    bias = find_bias(bake, current(bake))
    assert np.isnan(bias.parent).all()
    assert np.isnan(bias.grandparent).all()


def test_nodes_above_are_relative_to_brightness_too():
    bake = throw_on_split(100_000, 0, [every, every])
    weight = (1 + np.arange(bake.n_texel, dtype=np.float32)[:, None]) * np.float32([0.5, 1.0, 1.5])
    plain, weighed = (find_bias(bake, current(bake), by) for by in (1.0, weight))
    for name in ("told", "noise", "parent", "grandparent"):
        np.testing.assert_allclose(getattr(weighed, name), getattr(plain, name) * weight.mean(1), rtol=1e-5, err_msg=name)


def test_the_colour_of_light_does_not_matter():
    """What each channel lacks is relative to that channel."""
    found = []
    for colour in (np.ones(3), np.array([1.0, 0.3, 0.1])):
        bake = throw_on_split(100_000, 0, [every, every], colour=colour)
        found.append(find_bias(bake, current(bake), colour**-2))
    for name in ("parent", "grandparent"):
        np.testing.assert_allclose(getattr(found[1], name), getattr(found[0], name), rtol=1e-4, err_msg=name)


def test_a_texel_that_is_a_leaf_misses_nothing_and_is_foretold_nothing():
    bake = throw_on_split(100_000, 0, [every, every], side=4)
    bias = find_bias(bake, current(bake))
    assert (bake.tree.side[bias.judge] == 1).all()
    assert not bias.told.any()
    assert not bias.noise.any()
    assert np.isnan(bias._foretell(np.arange(bake.n_texel))).all()


def test_leaves_without_previews_miss_as_much_the_darker_it_is_around_them():
    bake = throw(even, 50_000, 1, degree=0, level=1, preview_depth=1)
    bake.tree = quadtree.split(bake.tree, current(bake))
    weight = 1 + np.arange(bake.n_texel, dtype=np.float32)[:, None]
    plain, weighed = (find_bias(bake, current(bake), by) for by in (1.0, weight))
    assert plain.told.max() > 0
    np.testing.assert_allclose(weighed.told, plain.told * weight[:, 0], rtol=1e-5)


@pytest.mark.parametrize("photons", [2000, 300])  # of 300 most parents have too few to be compared
def test_leaves_without_previews_never_miss_less_than_nothing(photons):
    bake = throw(even, photons, 1, degree=0, level=2, preview_depth=1)
    bake.tree = quadtree.split(bake.tree, current(bake))
    bias = find_bias(bake, current(bake))
    assert np.isnan(bias.parent).any() == (photons == 300)
    assert not (bias.parent >= 0).all()
    assert (bias.told >= 0).all()


def test_a_leaf_is_judged_by_its_children_whether_they_are_stable_or_not():
    """By no deeper nodes, of which there are more."""

    def left(rng, n):
        s, t = rng.random((2, n))
        return np.where(np.arange(n) % 50 > 0, 0.5 * s, 0.5 + 0.5 * s), t

    bake = throw(left, 2500, 3, degree=0, level=1, preview_depth=3)
    tree, leaves = bake.tree, current(bake)
    comparison = refine.Comparison.of(tree, bake.totals(), bake.solution(), refine.Rule("significance", 0.0, 16, 2))
    leaf = quadtree.node_of_texel(tree, leaves, bake.n_texel)
    judge = bias_estimate.find_judges(tree, leaves, np.arange(bake.n_texel))
    right = bake.texels.texel_xy[:, 0] >= SIDE // 2
    assert not comparison.stable[leaf[right]].any()
    assert comparison.stable[leaf[~right]].all()
    assert (tree.parent[judge] == leaf).all()
    assert tree.has_children[judge].all()
    assert set(judge) <= set(radiosity_solution.list_told(tree, leaves, ErrorMetric.whole(bake.texels)))


@pytest.mark.parametrize(("halves", "counted"), [((1.0, 1.0), 1.0), ((3.0, -1.0), -3.0), ((-1.0, -1.0), 0.0), ((1.0, -3.0), 0.0)])
def test_what_dips_below_zero_is_judged_as_it_is_shown(halves, counted):
    """As dark; of what is shown, a half may well be below zero."""
    bake = SquareBake(side=8, level=1)  # no photons: below all leaves it is dark
    tree, sample = bake.tree, np.arange(bake.n_texel)
    leaf, deepest = (quadtree.node_of_texel(tree, nodes, len(sample)) for nodes in (current(bake), np.flatnonzero(~tree.has_children)))
    assert (leaf != deepest).all()
    light = np.ones((2, 3, len(sample))) * np.reshape(halves, (2, 1, 1))
    shown = reconstruct.PointLight(light, np.zeros((3, len(sample))))
    weight, blind2 = np.ones((len(sample), 3), np.float32), np.full(len(sample), np.nan)
    asked = bias_estimate.AskedLight(leaf, *bake.texels.own_points_at(sample), shown, weight)
    unbiased, seen, _ = bias_estimate.compare_with_judges(tree, bake.solution(), deepest, asked, np.ones(3), blind2)
    np.testing.assert_allclose(unbiased, counted, rtol=1e-6)
    np.testing.assert_allclose(seen, abs(counted), rtol=1e-6)  # or the worst that are left out would all be those above zero


def test_dark_leaves_without_previews_state_less_than_bright_ones():
    def one_side(rng, n):
        return 0.5 + 0.5 * rng.random(n) ** 2, rng.random(n)

    bake = throw(one_side, 200_000, 1, degree=0, level=0, preview_depth=1)
    bake.tree = quadtree.split(bake.tree, current(bake))
    nodes = current(bake)
    totals, solution = bake.totals(), bake.solution()
    comparison = refine.Comparison.of(bake.tree, totals, solution, refine.Rule("significance", 0.05, 16, 1))
    missing = bias_estimate.guess_blind(bake.tree, solution, comparison, nodes)[nodes]
    dark = solution.flux[0, nodes] == 0
    assert dark.sum() == 2
    assert (missing[dark] == 0).all()
    assert (missing[~dark] > 0).all()


def test_leaves_are_judged_by_their_children():
    bake = throw(even, 400_000, 1, level=1, preview_depth=3)
    judge = bias_estimate.find_judges(bake.tree, current(bake), np.arange(bake.n_texel))
    assert (bake.tree.side[judge] == SIDE // 4).all()


def test_noise_of_what_judges_say_is_known_beforehand():
    """Even light: what judges tell is noise, by node and by bake as large as it is said to be."""
    told, expected = [], []
    for seed in range(8):
        bake = throw(even, 100_000, seed, degree=1, level=2, preview_depth=1)
        tree, solution, nodes, sample = bake.tree, bake.solution(), current(bake), np.arange(bake.n_texel)
        leaf, judge = (quadtree.node_of_texel(tree, ids, len(sample)) for ids in (nodes, np.flatnonzero(~tree.has_children)))
        shown = reconstruct.Blend.of(bake.texels, tree, solution, leaf, halves=True).at(sample)
        weight, blind2 = np.ones((len(sample), 3), np.float32), np.zeros(len(sample))
        asked = bias_estimate.AskedLight(leaf, *bake.texels.own_points_at(sample), shown, weight)
        parts = bias_estimate.compare_with_judges(tree, solution, judge, asked, np.ones(3), blind2)
        for values, out in ((parts[0], told), (parts[2], expected)):
            out.append((np.bincount(judge, values) ** 2).sum())
    assert np.sum(told) == pytest.approx(np.sum(expected), rel=0.25)
