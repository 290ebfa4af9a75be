"""Squares of even texels have the moments of their texels."""

import numpy as np
import pytest
from leaflight.core.texel_moments import EvenSquares
from trees import make_square_map

SIDE = 64


def squares_of(texels, area=None):
    return EvenSquares.of(
        texels.texel_chart, texels.texel_code, texels.texel_xy, texels.texel_area if area is None else area, texels.part_entry
    )


def one_by_one(texels, start, end, centre, half, degree):
    """Moments of ranges as sums over texels, each asked for by itself."""
    out = []
    for first, last, middle, size in zip(start, end, centre, half, strict=True):
        entry = np.arange(first, last)
        out.append(texels.range_moments(entry, entry + 1, np.tile(middle, (len(entry), 1)), np.full(len(entry), size), degree).sum(axis=0))
    return np.array(out)


@pytest.mark.parametrize("degree", [0, 2, 4])
def test_squares_have_the_moments_of_their_texels(degree):
    """In ranges that end with squares and in such that end within; the page's diagonal cuts some squares, and so does its right end."""
    texels = make_square_map(SIDE, 2, width=0.7)
    n = len(texels.texel_area)
    start, end = np.array([0, 256, 512, 100, 300, 5]), np.array([n, 512, 1024, 1200, 310, 5])
    centre, half = np.random.default_rng(1).uniform(0, SIDE, (6, 2)), np.array([32.0, 8.0, 16.0, 8.0, 4.0, 8.0])
    found = texels.range_moments(start, end, centre, half, degree)
    expected = one_by_one(texels, start, end, centre, half, degree)
    np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-13 * np.abs(expected).max())


def test_squares_are_where_all_texels_are_alike():
    texels = make_square_map(SIDE, 1)
    squares = squares_of(texels)
    assert set(squares.side) == {1, 16}
    assert (squares.side.astype(int) ** 2).sum() == len(texels.texel_area)
    whole = squares.first[squares.side == 16]
    assert not np.isin(texels.part_entry, whole[:, None] + np.arange(256)).any()
    assert len(whole) == 12  # of 16, four are on the diagonal
    area = texels.texel_area.copy()
    area[whole[3] + 77] *= 2  # as where a layer overlaps itself
    np.testing.assert_array_equal(squares_of(texels, area).first[squares_of(texels, area).side == 16], np.delete(whole, 3))
