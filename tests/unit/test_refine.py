"""The subdivision rule: quiet on even light, awake at edges, blind to noise."""

import dataclasses

import numpy as np
import pytest
from leaflight.core.radiosity import quadtree, refine
from trees import SquareBake, even


def rule(oracle="significance", threshold=0.05, stability=16, preview_depth=2):
    return refine.Rule(oracle, threshold, stability, preview_depth)


def marks(bake, the_rule, forced=None, background=None):
    forced = np.zeros(len(bake.tree), bool) if forced is None else forced
    background = np.zeros((3, len(bake.tree))) if background is None else background
    totals, solution = bake.totals(), bake.solution()
    comparison = refine.Comparison.of(bake.tree, totals, solution, the_rule)
    return refine.mark(bake.tree, totals, solution, comparison, the_rule, forced, background)


def shown(bake):
    totals = bake.totals()
    comparison = refine.Comparison.of(bake.tree, totals, bake.solution(), rule())
    return refine.choose_leaves(bake.tree, comparison)


def refined(photons, sampler, rounds=8, **kwargs):
    bake = SquareBake(**kwargs)
    rng = np.random.default_rng(11)
    for _ in range(rounds):
        bake.throw(*sampler(rng, photons // rounds))
        while len(marked := marks(bake, rule())):
            bake.tree = quadtree.split(bake.tree, marked)
        bake.grow()
    bake.tally.grow(len(bake.tree))
    return bake


def half_lit(rng, n):
    s, t = rng.random((2, n))
    return s * 0.3, t


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_even_light_is_not_split(degree):
    bake = refined(50_000, even, degree=degree)
    assert bake.tree.current.sum() <= 4  # the root, but for one false alarm


def uneven(cells, photons):
    """Places of photons: on the left halves of `cells` columns of the square 0.8 times their mean, on the right halves 1.2."""
    s, t, side = np.random.default_rng(0).random((3, photons))
    column = np.floor(s * cells)
    return (column + (s * cells - column + (side > 0.4)) / 2) / cells, t


@pytest.mark.parametrize("direct", [False, True])
def test_a_difference_is_judged_beside_all_light(direct):
    """As much direct light again halves it."""
    bake = SquareBake(side=16, degree=0, preview_depth=1)
    bake.throw(*uneven(1, 20_000))
    light = np.where(direct, bake.solution().flux / bake.tree.area, 0.0)
    assert [len(marks(bake, rule("paper", one), background=light)) for one in (0.07, 0.15)] == ([1, 0] if direct else [1, 1])


def test_a_difference_is_relative_whatever_the_size_of_the_node():
    """In every one of 64 nodes a step of 20 % about its mean."""
    bake = SquareBake(side=32, degree=0, preview_depth=1, level=3)
    bake.throw(*uneven(8, 400_000))
    assert [len(marks(bake, rule("paper", threshold))) for threshold in (0.15, 0.3)] == [64, 0]


def chi_squares(n_bake, depth, noise_share=1.0):
    """(n_bake,) sigmas of even light; the noise that is expected may be a share of the right one."""
    sigmas = []
    for seed in range(n_bake):
        bake = SquareBake(side=4 * 2**depth, degree=1, preview_depth=depth)
        bake.throw(*np.random.default_rng(seed).random((2, 2000)))
        totals = bake.totals()
        totals = dataclasses.replace(totals, weight2=totals.weight2 * noise_share)
        sigmas.append(refine.indicator(bake.tree, totals, bake.solution(), np.array([0]), depth, 16).sigmas[0])
    return np.array(sigmas)


@pytest.mark.slow
def test_the_chi_square_of_even_light_has_its_mean_and_spread():
    """Over many bakes sigmas has mean 0 and deviation 1: neither asleep nor nervous."""
    sigmas = chi_squares(300, 1)
    assert abs(np.mean(sigmas)) < 0.2
    assert np.std(sigmas) == pytest.approx(1.0, abs=0.15)


@pytest.mark.slow
def test_a_noise_of_3_percent_too_little_shows():
    """Of 64 previews' functions; in 200 bakes the mean is known to 0.07."""
    right, wrong = chi_squares(200, 3), chi_squares(200, 3, 0.97)
    assert abs(np.mean(right)) < 0.15 < np.mean(wrong)


def test_a_step_is_split_however_low_it_is():
    """Of 3 % about the mean, once photons tell it from noise."""
    bake = SquareBake(side=16, degree=0, preview_depth=1)
    low = np.random.default_rng(0).random((2, 200_000))
    low[0] = np.where(np.random.default_rng(1).random(200_000) < 0.03, low[0] / 2, low[0])
    bake.throw(*low[:, :2000])
    assert len(marks(bake, rule())) == 0
    bake.throw(*low[:, 2000:])
    assert len(marks(bake, rule())) == 1


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_the_edge_of_light_is_found(degree):
    bake = refined(200_000, half_lit, degree=degree, side=32)
    current = np.flatnonzero(bake.tree.current)
    smallest = current[bake.tree.side[current] == bake.tree.side[current].min()]
    middle = (bake.tree.origin[smallest, 0] + bake.tree.side[smallest] / 2) / 32
    assert bake.tree.side[smallest[0]] <= 4
    assert np.abs(middle - 0.3).max() < 0.15


def test_a_linear_ramp_needs_no_split_of_a_linear_basis():
    def ramp(rng, n):
        return np.sqrt(rng.random(n)), rng.random(n)

    assert refined(100_000, ramp, degree=1).tree.current.sum() == 1
    assert refined(100_000, ramp, degree=0).tree.current.sum() > 16


def test_the_papers_oracle_compares_means_of_stable_previews():
    bake = SquareBake(side=16, degree=0, preview_depth=1)
    rng = np.random.default_rng(0)
    bake.throw(rng.random(400) * 0.5, rng.random(400))
    bake.throw(rng.random(30), rng.random(30))
    assert len(marks(bake, rule("paper", threshold=0.5))) == 1
    assert len(marks(bake, rule("paper", threshold=3.0))) == 0
    assert len(marks(bake, rule("paper", threshold=0.5, stability=1000))) == 0


def test_too_few_photons_are_never_compared():
    bake = SquareBake(side=16, degree=0, preview_depth=1)
    rng = np.random.default_rng(0)
    bake.throw(rng.random(63) * 0.5, rng.random(63))
    assert len(marks(bake, rule())) == 0
    bake.throw(rng.random(1) * 0.5, rng.random(1))
    assert len(marks(bake, rule())) == 1


def test_shown_leaves_tile_and_are_fewest_where_light_is_even():
    bake = refined(200_000, half_lit, degree=1, side=32)
    leaves = shown(bake)
    quadtree.node_of_texel(bake.tree, leaves, bake.n_texel)
    dark = bake.tree.origin[leaves, 0] >= 16
    assert (bake.tree.side[leaves[dark]] == 16).all()  # unlit half: as large as the root's split allows


def test_pruning_takes_back_a_split_that_only_noise_asked_for():
    bake = SquareBake(side=32, degree=1, preview_depth=2)
    bake.tree = quadtree.split(bake.tree, np.array([0]))
    bake.grow()
    bake.throw(*np.random.default_rng(1).random((2, 5000)))
    assert shown(bake).tolist() == [0]


@pytest.mark.parametrize(("photons", "count"), [(100, 1), (1600, 4)])
def test_children_that_saw_few_of_many_photons_must_differ_by_more(photons, count):
    """A step of light in a node of even light, eight times the noise of 100 photons: the price is then 30."""
    rng = np.random.default_rng(1)
    bake = SquareBake(side=32, degree=1, preview_depth=0)
    bake.throw(*rng.random((2, 5000)))
    bake.preview_depth = 1
    bake.grow()
    bake.throw(*half_lit(rng, photons))
    assert len(shown(bake)) == count
    alone = SquareBake(side=32, degree=1, preview_depth=1)
    alone.throw(*half_lit(rng, photons))
    assert len(shown(alone)) == 4
