import itertools
import math
from functools import partial
from statistics import NormalDist

import numpy as np
import pytest
from floors import ALPHA, chi_square_sigmas
from leaflight.core.util import sampling

BINS = 16
SAMPLES = 200_000
HALF_ANGLE_RAD = 0.3


def _around(points):
    return np.arctan2(points[:, 1], points[:, 0]) / (2 * math.pi) % 1


def _solid_angle_bins(lowest, pdf_at_cosine):
    """Directions as (height, turn) in the unit square, with the probability of each row of bins from the density there."""
    cosine = lowest + (1 - lowest) * (np.arange(BINS) + 0.5) / BINS
    steradians = 2 * math.pi * (1 - lowest) / BINS**2
    return (
        lambda d: (np.clip((d[:, 2] - lowest) / (1 - lowest), 0, 1), _around(d)),
        np.broadcast_to(pdf_at_cosine(cosine), BINS) * steradians,
    )


WARPS = {
    "disk": (sampling.square_to_uniform_disk, lambda p: ((p**2).sum(axis=1), _around(p)), np.full(BINS, 1 / BINS**2)),
    "cosine": (sampling.square_to_cosine_hemisphere, *_solid_angle_bins(0, lambda cosine: cosine / math.pi)),
    **{
        name: (
            partial(sampling.square_to_uniform_cone, half_angle_rad=angle),
            *_solid_angle_bins(math.cos(angle), lambda cosine, angle=angle: 1 / (2 * math.pi * (1 - math.cos(angle)))),
        )
        for name, angle in (("sphere", math.pi), ("cone", HALF_ANGLE_RAD))
    },
    "triangle": (
        sampling.square_to_uniform_triangle,
        lambda b: (b.sum(axis=1) ** 2, b[:, 0] / np.maximum(b.sum(axis=1), 1e-12)),
        np.full(BINS, 1 / BINS**2),
    ),
}
CRITICAL_Z = NormalDist().inv_cdf((1 - ALPHA) ** (1 / (2 * len(WARPS) + 1)))  # Sidak: one alpha for the file


def _chi_square_z(name, u):
    """The chi-square of a warp's histogram against its density, as a normal deviate. Source: Wilson & Hilferty 1931."""
    warp, to_square, row_probability = WARPS[name]
    counts = np.histogram2d(*to_square(warp(u).astype(np.float64)), BINS, [[0, 1], [0, 1]])[0]
    expected = np.repeat(row_probability[:, None], BINS, axis=1) * len(u)
    assert expected.sum() == pytest.approx(len(u), rel=1e-6)
    k = BINS**2 - 1
    chi_square = ((counts - expected) ** 2 / expected).sum()
    return ((chi_square / k) ** (1 / 3) - (1 - 2 / (9 * k))) / math.sqrt(2 / (9 * k))


@pytest.mark.parametrize("name", WARPS)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_warp_follows_its_density(name, dtype, hold):
    u = np.random.default_rng(5).random((SAMPLES, 2), dtype)
    assert WARPS[name][0](u).dtype == dtype
    hold("warps: chi-square against the density", _chi_square_z(name, u), high=CRITICAL_Z, unit="sigmas")


@pytest.mark.parametrize("name", WARPS)
def test_a_bias_of_three_percent_is_seen(name, hold):
    u = np.random.default_rng(5).random((SAMPLES, 2))
    u[: SAMPLES * 3 // 100] *= 0.5
    hold("warps: chi-square with 3 % of the numbers halved", _chi_square_z(name, u), low=CRITICAL_Z, unit="sigmas")


def test_a_tiny_cone_keeps_its_width_in_float32():
    u = np.random.default_rng(6).random((1000, 2), np.float32)
    across = np.linalg.norm(sampling.square_to_uniform_cone(u, 1e-7)[:, :2], axis=1)
    np.testing.assert_allclose(across, 1e-7 * np.sqrt(u[:, 0]), rtol=1e-5)


def _alias_weights():
    rng = np.random.default_rng(8)
    return {
        "one": [3.0],
        "equal": np.full(7, 0.1),
        "zeros": [0, 0, 5, 0, 1, 0],
        "one of many": np.eye(50)[17],
        "wide": 10.0 ** rng.uniform(-12, 12, 200),
        "random": rng.random(101),
        "huge": [1e308, 1e308, 1e308],
        "light first": [0.1, 0.1, 0.1, 5, 3],
        "heavy first": [5, 3, 0.1, 0.1, 0.1],
    }


@pytest.mark.parametrize("name", _alias_weights())
def test_alias_table_gives_each_index_its_share_and_a_uniform_rest(name):
    table = sampling.AliasTable(np.array(_alias_weights()[name], float))
    n = len(table.probability)
    u = (np.arange(n * 5000) + 0.5) / (n * 5000)
    index, rest = table.sample(u)
    share = np.bincount(index, minlength=n) / len(u)
    # an index is a few intervals of u, each known to within one step
    np.testing.assert_allclose(share, table.probability, atol=2 * n / len(u))
    assert not share[table.probability == 0].any()
    assert (rest >= 0).all()
    assert (rest < 1).all()
    for common in np.flatnonzero(share > 0.05):
        counts = np.histogram(rest[index == common], 8, (0, 1))[0]
        assert np.ptp(counts) <= 4 * n + 8 + 0.01 * counts.mean()


ALIAS_WEIGHTS = np.random.default_rng(10).uniform(0.2, 1.0, 40)


def _alias_chi_square(expected_weights):
    table = sampling.AliasTable(ALIAS_WEIGHTS)
    index = table.sample(np.random.default_rng(11).random(10 * SAMPLES))[0]
    expected = expected_weights / expected_weights.sum() * len(index)
    return chi_square_sigmas(np.bincount(index, minlength=len(expected)), expected)


def test_alias_table_chooses_by_its_weights(hold):
    hold("alias table: chi-square against the weights", _alias_chi_square(ALIAS_WEIGHTS), high=CRITICAL_Z, unit="sigmas")


def test_an_alias_weight_that_is_off_by_three_percent_is_seen(hold):
    off = ALIAS_WEIGHTS.copy()
    off[off.argmax()] *= 1.03
    hold("alias table: chi-square with one weight 3 % off", _alias_chi_square(off), low=CRITICAL_Z, unit="sigmas")


@pytest.mark.parametrize("weights", [[], [0.0, 0.0], [1.0, -1.0], [np.nan, 1], [np.inf, 1], [[1.0, 2.0]]])
def test_weights_that_cannot_be_chosen_from_are_refused(weights):
    with pytest.raises(ValueError, match="weights: expected"):
        sampling.AliasTable(np.array(weights))


def test_streams_are_the_same_for_the_same_shard_only():
    keys = [(0, 0, 1), (0, 1, 0), (1, 0, 0), (1, 1, 0), (0, 1, 1)]
    draws = [sampling.shard_rng(*key).random() for key in keys]
    assert len(set(draws)) == len(keys)
    assert draws == [sampling.shard_rng(*key).random() for key in keys]


def points_of(shift, start, count):
    """Those of one sequence."""
    return sampling.low_discrepancy_points(shift[None], np.array([start]), np.array([count]))


def test_points_go_on_where_they_stopped():
    shift = np.array([1, 2**31, 2**32 - 1, 12345], np.uint32)
    points = points_of(shift, 0, 100)
    assert points.dtype == np.float32
    np.testing.assert_array_equal(points_of(shift, 60, 40), points[60:])
    across = points_of(shift, 2**17 - 50, 100)
    np.testing.assert_array_equal(points_of(shift, 2**17, 50), across[50:])
    assert (across[50:] != points[:50]).all()  # beyond a shard's photons it is another shift
    far = points_of(shift, 2**40, 1000)
    assert far.min() >= 0
    assert far.max() < 1


def test_points_of_some_sequences_are_those_of_each():
    shift = np.random.default_rng(2).integers(0, 2**32, (5, 4), np.uint32)
    start, count = np.array([0, 2**17 - 3, 5, 3 * 2**17, 2**17 - 1]), np.array([4, 10, 1, 2**18 + 5, 1])
    points = sampling.low_discrepancy_points(shift, start, count)
    assert points.T.flags.c_contiguous
    end = np.cumsum(count)
    for row in range(5):
        np.testing.assert_array_equal(points[end[row] - count[row] : end[row]], points_of(shift[row], start[row], count[row]))


@pytest.mark.parametrize(("first", "second"), list(itertools.combinations(range(4), 2)))
def test_points_fall_one_each_into_the_cells_of_a_net(first, second):
    points = points_of(np.array([5, 6, 7, 8], np.uint32), 0, 4096)
    cells = np.floor(points[:, [first, second]] * 64)
    assert len(np.unique(cells, axis=0)) == 4096
    assert len(np.unique(np.floor(points[:, first] * 4096))) == 4096


def test_no_frequency_carries_much_more_noise_than_of_random_points():
    """A lattice has waves that all of its points lie on: over random points its noise there is thousandfold, and seen as stripes."""
    count, cells = 1 << 12, 16
    points = points_of(np.array([5, 6, 7, 8], np.uint32), 0, count)
    lattice = np.arange(count)[:, None] * 1.1673039782614187 ** -np.arange(1.0, 5.0) % 1.0

    def most_power(points):
        histogram = np.histogramdd(points, cells, [(0.0, 1.0)] * 4)[0]
        return (np.abs(np.fft.rfftn(histogram)).ravel()[1:] ** 2).max() / count

    assert most_power(lattice) > 1000  # or the test would see nothing
    assert most_power(points) < 200


def test_points_of_a_group_are_spread_and_each_is_uniform():
    count = 1 + np.arange(9000) % 9
    group = np.repeat(np.arange(9000), count)
    points = sampling.grouped_points(count, group, np.random.default_rng(4))
    assert points.shape == (2, len(group))
    assert points.dtype == np.float32
    assert ((points >= 0) & (points < 1)).all()
    eight = points[:, np.isin(group, np.flatnonzero(np.arange(9000) % 9 == 7))].reshape(2, -1, 8)
    for axis in eight:  # one in every eighth
        np.testing.assert_array_equal(np.sort((axis * 8).astype(int), axis=1), np.broadcast_to(np.arange(8), axis.shape))
    cells = np.bincount((points * 8).astype(int)[0] * 8 + (points * 8).astype(int)[1], minlength=64)
    assert np.abs(cells / len(group) * 64 - 1).max() < 0.2  # 702 in each
    assert sampling.grouped_points(np.zeros(0, int), np.zeros(0, int), np.random.default_rng(4)).shape == (2, 0)
