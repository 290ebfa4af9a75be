"""How long rounds are and how they are shared out."""

import math

import numpy as np
import pytest
from leaflight.core.transport.rounds import (
    EARLY_GROWTH,
    EARLY_PHOTONS,
    FIRST_NODE_PHOTONS,
    FIRST_ROUND_PHOTONS,
    FIRST_SHARE,
    MOST_FIRST_PHOTONS,
    NEAR_GROWTH,
    NEAR_TIMES,
    NODE_PHOTONS,
    ROUND_GROWTH,
    ROUND_PHOTONS,
    SHARD_PHOTONS,
    SPARE,
    count_late,
    grow_photons,
    next_photons,
    share_photons,
)

PLENTY = 10**9


def next_plain(so_far, most, n_node, wanted_error, error, fixed_error, degree=None):
    """Where all photons told as much as those of a first round."""
    return next_photons(so_far, float(so_far), 1.0, most, n_node, wanted_error, error, fixed_error, degree)[0]


def first_round(most, n_node):
    return next_plain(0, most, n_node, 0.05, math.nan, 0.0)


def test_the_first_round_is_of_as_many_photons_as_tell_of_the_nodes_that_there_are():
    assert first_round(PLENTY, 10) == FIRST_ROUND_PHOTONS
    n_node = FIRST_ROUND_PHOTONS // FIRST_NODE_PHOTONS + 100
    assert first_round(PLENTY, n_node) == FIRST_NODE_PHOTONS * n_node
    assert first_round(PLENTY, 10**6) == MOST_FIRST_PHOTONS


def test_the_first_round_leaves_most_of_a_bake_to_those_that_are_split_by_then():
    assert first_round(6 * MOST_FIRST_PHOTONS, 10**6) == FIRST_SHARE * 6 * MOST_FIRST_PHOTONS
    assert first_round(FIRST_ROUND_PHOTONS + 1, 10**6) == FIRST_ROUND_PHOTONS
    assert first_round(1000, 10**6) == 1000


@pytest.mark.parametrize(("so_far", "growth"), [(EARLY_PHOTONS - 1, EARLY_GROWTH), (EARLY_PHOTONS, ROUND_GROWTH)])
def test_a_round_adds_at_most_a_share_of_all_photons_while_nothing_tells_of_less(so_far, growth):
    for error, fixed in ((math.nan, 0.0), (1.0, 0.0), (0.06, 0.05), (0.06, 0.055), (0.03, 0.03)):  # far, or not of photons
        assert next_plain(so_far, PLENTY, 10, 0.05, error, fixed) == int(growth * so_far)
    assert next_plain(10 * ROUND_PHOTONS, PLENTY, 10, 0.05, 1.0, 0.0) == ROUND_PHOTONS


@pytest.mark.parametrize(("so_far", "far"), [(EARLY_PHOTONS // 2, EARLY_GROWTH), (EARLY_PHOTONS, ROUND_GROWTH)])
def test_a_bake_whose_end_is_in_sight_comes_to_it_in_few_rounds(so_far, far):
    def grow(times):
        """Of a bake that needs so many times its photons."""
        return next_plain(so_far, PLENTY, 10, 0.05, 0.05 * math.sqrt(times / SPARE), 0.0) / so_far

    near = min(NEAR_GROWTH, ROUND_PHOTONS / so_far)
    assert grow(1.0 + near / 2.0) == pytest.approx(near / 2.0, rel=1e-3)  # no other round after it
    assert grow(1.01 + near) == pytest.approx(near, rel=1e-3)
    assert grow(0.99 * NEAR_TIMES) == pytest.approx(near, rel=1e-3)
    assert grow(1.01 * NEAR_TIMES) == pytest.approx(far, rel=1e-3)


@pytest.mark.parametrize(("degree", "power"), [(None, 1.0), (0, 1 / 2), (1, 2 / 3), (2, 3 / 4)])
@pytest.mark.parametrize("fixed", [0.0, 0.02, 0.04])
def test_a_round_aims_at_the_error_asked_for(fixed, degree, power):
    """With the photons that it asks for, noise that falls as it does on such trees would come out a little below."""
    noise2 = 1.15 * (0.05**2 - fixed**2)
    photons = next_plain(3_000_000, PLENTY, 10, 0.05, math.sqrt(noise2 + fixed**2), fixed, degree)
    then2 = noise2 * (3_000_000 / (3_000_000 + photons)) ** power + fixed**2
    assert (then2 - fixed**2) * SPARE == pytest.approx(0.05**2 - fixed**2, rel=1e-5)


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_refined_leaves_balance_noise_and_what_they_cannot_hold(degree):
    """Of leaves of side h squared noise is 1 / (N h^2), and what functions of that degree miss h^(2 degree + 2): the least sum of both."""
    side = np.geomspace(1e-4, 1.0, 100_000)

    def least(photons):
        return (1.0 / (photons * side**2) + side ** (2 * degree + 2)).min()

    assert grow_photons(least(1e4), least(1e6), degree) == pytest.approx(100.0, rel=1e-3)
    assert grow_photons(4.0, 1.0, None) == 4.0
    assert grow_photons(0.0, 1.0, degree) == 0.0


def test_a_round_is_worth_being_looked_at():
    assert next_plain(4_000_000, PLENTY, 100_000, 0.05, 0.0501, 0.0) == NODE_PHOTONS * 100_000
    assert next_plain(400_000, PLENTY, 100_000, 0.05, 0.0501, 0.0) == 400_000  # but never more than doubles them
    assert next_plain(4_000_000, PLENTY, 10, 0.05, 0.05, 0.0) == pytest.approx((SPARE - 1.0) * 4_000_000, abs=1)
    assert next_plain(1_000_000, PLENTY, 10, 0.05, 0.05, 0.0) == FIRST_ROUND_PHOTONS


@pytest.mark.parametrize(("error", "is_last"), [(math.nan, False), (1.0, False), (0.09, False), (0.07, True), (0.0501, True)])
def test_a_round_that_is_likely_to_be_enough_is_told(error, is_last):
    """Not where nothing is known, the error is far, or a round may not have so many."""
    assert next_photons(2_000_000, 2e6, 1.0, PLENTY, 10, 0.05, error, 0.0, None)[1] == is_last


def test_photons_that_tell_more_are_enough_sooner():
    one, four = (next_photons(2_000_000, 2e6, weight, PLENTY, 10, 0.05, 0.09, 0.0, None)[1] for weight in (1.0, 4.0))
    assert (one, four) == (False, True)


def test_no_round_goes_beyond_the_photons_of_the_bake():
    assert next_plain(900, 1000, 10, 0.05, 1.0, 0.0) == 100


def test_photons_that_tell_more_are_fewer():
    plain = next_plain(8_000_000, PLENTY, 10, 0.05, 0.055, 0.0)
    assert next_photons(3_000_000, 8e6, 4.0, PLENTY, 10, 0.05, 0.055, 0.0, None)[0] == plain // 4
    assert next_photons(1_000_000, 1e6, 4.0, PLENTY, 10, 0.05, 1.0, 0.0, None)[0] == 500_000  # what there was before is tripled, no more
    few_that_tell_much, _ = next_photons(100_000, 2.0 * EARLY_PHOTONS, 1.0, PLENTY, 10, 0.05, 1.0, 0.0, None)
    assert few_that_tell_much == int(ROUND_GROWTH * 2 * EARLY_PHOTONS)
    assert next_photons(100_000, 1e5, 4.0, PLENTY, 10, 0.05, 0.055, 0.0, None)[0] == FIRST_ROUND_PHOTONS // 4


@pytest.mark.parametrize("photons", [2, 3, 1001, FIRST_ROUND_PHOTONS, 3 * SHARD_PHOTONS, 1_234_567, ROUND_PHOTONS])
def test_shards_are_of_all_photons_and_both_halves_alike(photons):
    shares = share_photons(photons)
    assert sum(shares) == photons
    assert len(shares) % 2 == 0
    assert sum(shares[::2]) - sum(shares[1::2]) == photons % 2
    assert max(shares) <= SHARD_PHOTONS
    many = photons > 4 * SHARD_PHOTONS
    whole, last = (shares[:-4], shares[-4:]) if many else (shares, [])
    assert len(whole) >= 2
    assert all(abs(2 * small - large) <= 3 for small in last for large in whole)
    assert max(whole) - min(whole) <= 1


@pytest.mark.parametrize("photons", [1001, 4 * SHARD_PHOTONS, 4 * SHARD_PHOTONS + 2, ROUND_PHOTONS])
def test_of_a_round_of_many_shards_the_small_ones_are_not_waited_for(photons):
    shares = share_photons(photons)
    assert count_late(len(shares), 2) == sum(share < 0.6 * shares[0] for share in shares)
    assert count_late(len(shares), 1) == count_late(len(shares), 0) == 0  # no other round comes
