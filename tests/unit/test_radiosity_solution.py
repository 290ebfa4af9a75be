"""What the tallies say after a round: leaves that tile the charts, and the functions of all nodes that anybody asks for."""

import numpy as np
import pytest
from leaflight.core.filter.radiosity_solution import RadiositySolution, list_told
from leaflight.core.filter.subtexel_tally import SubtexelLight
from leaflight.core.radiosity import coefficient_shrinkage, quadtree, refine, tally
from leaflight.core.texels.error_metric import ErrorMetric
from trees import hill, throw

RULE = refine.Rule("significance", 0.5, 16, 2)


@pytest.fixture(scope="module")
def bake():
    return throw(hill, 100_000, 1, degree=1, level=2)


def read(bake, shrink=False, squares=None):
    return RadiositySolution.of(bake.tree, bake.tally, RULE, ErrorMetric.whole(bake.texels), shrink, squares)


def test_leaves_tile_the_charts(bake):
    reading = read(bake)
    leaf = quadtree.node_of_texel(bake.tree, reading.leaves, bake.n_texel)
    assert sorted(set(leaf)) == sorted(reading.leaves)
    assert 1 < len(reading.leaves) < len(bake.tree)
    assert np.array_equal(reading.leaves, refine.choose_leaves(bake.tree, reading.comparison))


def test_all_that_is_asked_for_is_solved_and_the_rest_is_not(bake):
    reading, whole = read(bake), bake.solution()
    told = list_told(bake.tree, reading.leaves, ErrorMetric.whole(bake.texels))
    assert set(reading.leaves) < set(told)
    compared = np.flatnonzero(refine.find_comparable(bake.tree, reading.totals, RULE.stability))
    for nodes in (told, compared):
        np.testing.assert_array_equal(reading.solution.coefficient[..., nodes], whole.coefficient[..., nodes])
    assert not np.array_equal(reading.solution.coefficient, whole.coefficient)


def test_leaves_that_are_shrunk_know_what_that_takes(bake):
    plain, shrunk = read(bake), read(bake, shrink=True)
    assert plain.risk is None
    tree, risk = coefficient_shrinkage.shrink_leaves(bake.tree, plain.totals, plain.leaves)
    np.testing.assert_array_equal(shrunk.risk, risk)
    whole = tally.solve_tallies(tree, plain.totals)
    np.testing.assert_array_equal(shrunk.solution.coefficient[..., shrunk.leaves], whole.coefficient[..., shrunk.leaves])
    assert not np.array_equal(plain.solution.coefficient, shrunk.solution.coefficient)
    np.testing.assert_array_equal(plain.solution.flux[:, plain.leaves], shrunk.solution.flux[:, plain.leaves])
    assert shrunk.tree is bake.tree  # noise is told by what is not shrunk


def test_squares_are_handed_on(bake):
    nothing = SubtexelLight(np.zeros(0, np.int32), np.zeros((2, 3, 0)), *np.zeros((2, 3, 0)))
    assert read(bake, squares=nothing).squares is nothing
