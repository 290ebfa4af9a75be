"""Parts of the numbers that photons are born from."""

import numpy as np
import pytest
from leaflight.core.transport.emission_cells import BINS, SLICES, BirthCells, find_bins, find_slice

# The first emitter's numbers cut along the second of them, the second emitter's left whole.
CUT = BirthCells(
    np.int32([0, 0, 1]),
    np.float32([[0, 0, 0, 0], [0, 0.5, 0, 0], [0, 0, 0, 0]]),
    np.float32([[1, 0.5, 1, 1], [1, 0.5, 1, 1], [1, 1, 1, 1]]),
    np.array([0.3, 0.3, 0.4]),
    np.array([0.1, 0.7, 0.2]),
)


def test_one_cell_for_each_emitter_is_all_of_its_numbers():
    cells = BirthCells.whole(np.array([0.25, 0.75]))
    points = np.random.default_rng(1).random((6, 4), np.float32)
    np.testing.assert_array_equal(cells.place(np.array([0, 0, 0, 1, 1, 1]), points), points)
    np.testing.assert_array_equal(cells.share, cells.natural)


def test_numbers_fill_their_cell():
    points = np.random.default_rng(1).random((4000, 4), np.float32)
    for cell in range(3):
        numbers = CUT.place(np.full(4000, cell), points)
        assert (numbers >= CUT.low[cell]).all()
        assert (numbers < CUT.low[cell] + CUT.side[cell]).all()
        np.testing.assert_allclose(numbers.mean(0), CUT.low[cell] + CUT.side[cell] / 2, atol=0.03)


def test_no_number_is_1():
    edge = np.full((1, 4), 1 - 2.0**-24, np.float32)
    assert CUT.place(np.array([1]), edge).max() < 1


def test_each_cell_has_its_share_to_within_one_and_on_average_exactly():
    shifts = (np.arange(1000) + 0.5) / 1000
    counts = np.array([np.diff(CUT.count_births(23, shift)) for shift in shifts])
    assert (counts.sum(1) == 23).all()
    assert np.abs(counts - 23 * CUT.share).max() < 1
    np.testing.assert_allclose(counts.mean(0), 23 * CUT.share, atol=0.01)


def test_shares_that_add_up_to_just_below_1_lose_no_photon():
    cells = BirthCells.whole(np.array([0.1] * 10 + [0.0]) * (1 - 1e-12))
    ends = cells.count_births(10**6, 0.999999)
    assert ends[-2:].tolist() == [10**6, 10**6]


@pytest.mark.parametrize("axis", range(4))
def test_bins_know_their_cell_and_their_slice_along_each_number(axis):
    points = np.full((3, 4), 0.5, np.float32)
    points[:, axis] = [0, 0.49, 1 - 2.0**-24]
    bins = find_bins(np.array([2, 2, 7]), points)
    assert (bins // BINS).tolist() == [2, 2, 7]
    assert find_slice(bins, axis).tolist() == [0, int(0.49 * SLICES), SLICES - 1]
    assert find_slice(bins, (axis + 1) % 4).tolist() == [SLICES // 2] * 3
