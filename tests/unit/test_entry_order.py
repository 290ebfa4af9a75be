"""Entries that move in place come to be where a copy in that order would have them."""

import numpy as np
import pytest
from leaflight.core.texels.entry_order import EntryOrder


def draw_order(seed, count=5000):
    """An order of which patches go in which order to the end, and where each entry comes from."""
    rng = np.random.default_rng(seed)
    edges = np.unique(np.append([0, count], rng.integers(0, count, 400)))
    gone = np.flatnonzero(rng.random(len(edges) - 1) < 0.3)
    start, size = edges[gone], np.diff(edges)[gone]
    order = rng.permutation(len(gone))
    going = np.concatenate([np.arange(start[k], start[k] + size[k]) for k in order])
    return EntryOrder.of(start, size, order, count), np.append(np.setdiff1d(np.arange(count), going), going)


@pytest.mark.parametrize("seed", range(4))
def test_values_move_as_a_copy_would_have_them(seed):
    order, source = draw_order(seed)
    rng = np.random.default_rng(9)
    for values in (rng.random(len(source)), rng.integers(0, 9, (len(source), 2), np.int32), rng.random(len(source)) < 0.5):
        expected = values[source]
        order.apply(values)
        np.testing.assert_array_equal(values, expected)
    place = order.place()
    np.testing.assert_array_equal(source[place[:-1]], np.arange(len(source)))
    assert place[-1] == -1


def test_what_cannot_be_moved_in_place_is_refused():
    order, source = draw_order(0)
    with pytest.raises(ValueError, match="one after the other in memory"):
        order.apply(np.zeros((len(source), 2)).T.copy().T)


def test_what_lies_before_the_first_that_goes_stays():
    order = EntryOrder.of(np.array([6]), np.array([2]), np.array([0]), 12)
    assert order.stay.tolist() == [[0, 8], [6, 12]]
    values = np.arange(12)
    order.apply(values)
    assert values.tolist() == [0, 1, 2, 3, 4, 5, 8, 9, 10, 11, 6, 7]


def test_patches_that_follow_each_other_go_as_one():
    order = EntryOrder.of(np.array([2, 3, 8]), np.array([1, 4, 1]), np.array([0, 1, 2]), 10)
    assert order.go.tolist() == [[2, 8], [7, 9]]
    values = np.arange(10)
    order.apply(values)
    assert values.tolist() == [0, 1, 7, 9, 2, 3, 4, 5, 6, 8]


def test_all_of_a_map_may_go():
    order = EntryOrder.of(np.array([0, 3]), np.array([3, 3]), np.array([1, 0]), 6)
    values = np.arange(6)
    order.apply(values)
    assert values.tolist() == [3, 4, 5, 0, 1, 2]
    assert order.place().tolist() == [3, 4, 5, 0, 1, 2, -1]
