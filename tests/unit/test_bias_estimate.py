"""Light that leaves cannot hold, on a square whose light is known."""

import math

import numpy as np
import pytest
from leaflight.core.filter import bias_estimate, reconstruct
from leaflight.core.radiosity import quadtree, refine
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
def test_bias_of_smooth_light_falls_about_as_is_extrapolated(degree, splits):
    """With so many photons that the children have hardly any noise."""
    bake = throw_on_split(1_400_000, degree, [every] * splits)
    bias = find_bias(bake, current(bake))
    assert 0.4 < bias._extrapolate(np.arange(bake.n_texel)).mean() / bias.unbiased.mean() < 1.6


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
    assert (bias.unbiased >= 0).all()


def test_bias_of_leaves_without_previews_is_about_that_which_previews_would_show():
    """On smooth light and constant leaves, whose squared bias is a quarter of their parents'."""
    bake = throw_on_split(400_000, 0, [every])
    bake.tree = quadtree.split(bake.tree, current(bake))
    assert not bake.tree.has_children[current(bake)].any()
    seen = throw_on_split(400_000, 0, [every, every])
    guessed, expected = (find_bias(one, current(one)).unbiased.mean() for one in (bake, seen))
    assert 0.7 < guessed / expected < 1.4


def test_the_stated_noise_of_the_bias_is_its_noise():
    """Even light has no bias: what is found is noise, of each node as large as is stated."""
    found, expected = [], []
    for seed in range(8):
        bake = throw(even, 100_000, seed, degree=1, level=2, preview_depth=1)
        tree, solution, nodes, sample = bake.tree, bake.solution(), current(bake), np.arange(bake.n_texel)
        leaf, node = (quadtree.node_of_texel(tree, ids, len(sample)) for ids in (nodes, np.flatnonzero(~tree.has_children)))
        shown = reconstruct.Blend.of(bake.texels, tree, solution, leaf, halves=True).at(sample)
        weight, blind2 = np.ones((len(sample), 3), np.float32), np.zeros(len(sample))
        asked = bias_estimate.AskedLight(leaf, *bake.texels.own_points_at(sample), shown, weight)
        parts = bias_estimate.compare_with_nodes(tree, solution, node, asked, np.ones(3), blind2)
        for values, out in ((parts[0], found), (parts[2], expected)):
            out.append((np.bincount(node, values) ** 2).sum())
    assert np.sum(found) == pytest.approx(np.sum(expected), rel=0.25)


@pytest.mark.parametrize("unbiased", [0.0, 0.25, 1.0])
def test_the_sum_is_the_mean_of_both_estimates_by_inverse_variance(unbiased):
    """Without an error the first is taken as it is. Where it is below the other, which has no selection bias, its error counts more."""
    every = np.arange(64)

    def sum_up(value, stderr):
        full = np.ones(len(every))
        noise = stderr * math.sqrt(len(every)) * full
        return bias_estimate.Bias(every, value * full, value * full, noise, 4.0 * full, 16.0 * full).sum_up(every)

    forecast, its_stderr = sum_up(unbiased, 1e9)
    assert 0.25 < forecast < 1.0
    assert its_stderr == pytest.approx(bias_estimate.FALL_DOUBT * forecast)
    assert sum_up(unbiased, 0.0) == (unbiased, 0.0)
    for stderr in (0.5 * its_stderr, its_stderr):
        counted = stderr * (bias_estimate.HIDDEN_DOUBT if unbiased < forecast else 1.0)
        share = counted**2 / (counted**2 + its_stderr**2)
        found = sum_up(unbiased, stderr)
        assert found == pytest.approx((unbiased + share * (forecast - unbiased), math.sqrt(share) * its_stderr))
