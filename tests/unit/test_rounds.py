"""How long rounds are and how they are shared out."""

import math

import numpy as np
import pytest
from leaflight.core.transport.rounds import (
    FIRST_ROUND_PHOTONS,
    ROUND_PHOTONS,
    SHARD_PHOTONS,
    SPARE,
    grow_photons,
    next_photons,
    share_photons,
)

PLENTY = 10**9


def next_plain(so_far, most, n_node, wanted_error, error, fixed_error, degree=None):
    """Where all photons told as much as those of a first round."""
    return next_photons(so_far, most, n_node, wanted_error, error, fixed_error, degree)[0]


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


def test_no_round_goes_beyond_the_photons_of_the_bake():
    assert next_plain(900, 1000, 10, 0.05, 1.0, 0.0) == 100


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
