"""Squares of even texels have the moments of their texels."""

import numpy as np
import pytest
from leaflight.core.texels.texel_moments import EvenSquares
from trees import make_square_map

SIDE = 64


def squares_of(texels, area=None):
    return EvenSquares.of(
        texels.texel_chart, texels.texel_code, texels.texel_xy, texels.texel_area if area is None else area, texels.part_entry
    )


@pytest.mark.parametrize("degree", [0, 2, 4])
def test_squares_have_the_moments_of_their_texels(degree):
    """In ranges that end with squares and in such that end within; the square's diagonal cuts some, and so does its right end."""
    texels = make_square_map(SIDE, 2, width=0.7)
    n, squares = len(texels.texel_area), squares_of(texels)
    whole = squares.first[squares.side == 16]
    assert len(whole) > 2
    start, end = np.array([0, whole[0], whole[1] + 5, 100, whole[2], 5]), np.array([n, whole[1], n, whole[2] + 9, whole[2] + 256, 5])
    centre, half = np.random.default_rng(1).uniform(0, SIDE, (6, 2)), np.array([32.0, 8.0, 16.0, 8.0, 4.0, 8.0])
    by_itself = EvenSquares(texels.texel_xy, texels.texel_area, np.arange(n), np.ones(n, np.int32))
    expected = by_itself.range_moments(start, end, centre, half, degree)
    found = squares.range_moments(start, end, centre, half, degree)
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
