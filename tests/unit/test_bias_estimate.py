"""Light that leaves cannot hold, on a square whose light is known: as judges tell it, and as the nodes above foretell it."""

import numpy as np
import pytest
from leaflight.core.filter import bias_estimate, radiosity_solution, reconstruct
from leaflight.core.radiosity import quadtree, refine
from leaflight.core.texels.error_metric import ErrorMetric
from trees import SIDE, SquareBake, current, even, glow, throw


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


@pytest.mark.parametrize(("degree", "splits"), [(1, 2), (1, 3), pytest.param(2, 2, marks=pytest.mark.slow)])
def test_smooth_light_falls_about_as_it_is_foretold(degree, splits):
    """So many photons that the children know."""
    bake = throw_on_split(2_000_000, degree, [every] * splits)
    bias = find_bias(bake, current(bake))
    assert 0.4 < bias._foretell(np.arange(bake.n_texel)).mean() / bias.told.mean() < 1.6


def test_how_noise_falls_foretells_nothing():
    """Even light, and nodes that were split for nothing; a glow's stand out."""
    for sampler, known in ((even, False), (glow, True)):
        bake = throw_on_split(200_000, 1, [every, every], sampler=sampler)
        bias = find_bias(bake, current(bake))
        assert not np.isnan(bias.parent).any()
        assert np.isnan(bias.grandparent).any() != known
        assert np.isnan(bias._foretell(np.arange(bake.n_texel))).any() != known


def test_the_colour_of_light_does_not_matter():
    """What each channel lacks is relative to that channel."""
    found = []
    for colour in (np.ones(3), np.array([1.0, 0.3, 0.1])):
        bake = throw_on_split(100_000, 0, [every, every], colour=colour)
        found.append(find_bias(bake, current(bake), colour**-2))
    for name in ("parent", "grandparent"):
        np.testing.assert_allclose(getattr(found[1], name), getattr(found[0], name), rtol=1e-4, err_msg=name)


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
