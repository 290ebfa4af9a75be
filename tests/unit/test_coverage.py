"""Clipping and moments against polygons whose answer is known."""

from math import factorial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from leaflight.core.util.coverage import Pieces, chunk_ranges, clip_to_texels, expand_ranges, monomial_exponents, piece_moments

RANGES = st.lists(st.tuples(st.integers(0, 50), st.integers(-3, 20)), max_size=12)


@pytest.mark.parametrize("degree", [0, 2, 4])
def test_rules_are_exact_on_the_unit_triangle(degree: int) -> None:
    """The integral of x^i y^j over (0,0) (1,0) (0,1) is i! j! / (i + j + 2)!."""
    unit = Pieces(np.zeros(1, np.int64), np.array([[0.0], [1.0], [0.0]]), np.array([[0.0], [0.0], [1.0]]), np.array([0.5]))
    expected = [factorial(i) * factorial(j) / factorial(i + j + 2) for i, j in monomial_exponents(degree)]
    np.testing.assert_allclose(piece_moments(unit, degree)[:, 0], expected, rtol=1e-14)


@given(RANGES, st.integers(1, 9))
def test_ranges_are_cut_without_loss(ranges: list[tuple[int, int]], size: int) -> None:
    start = np.array([low for low, _ in ranges], dtype=np.int64)
    end = start + np.array([length for _, length in ranges], dtype=np.int64)
    expected = [(row, value) for row in range(len(start)) for value in range(start[row], end[row])]
    owner, value = expand_ranges(start, end)
    assert list(zip(owner.tolist(), value.tolist(), strict=True)) == expected
    found = []
    for rows, first, last in chunk_ranges(start, end, size):
        assert (last > first).all()
        assert (last - first).sum() <= size
        part, value = expand_ranges(first, last)
        found += zip(rows[part].tolist(), value.tolist(), strict=True)
    assert found == expected


@pytest.mark.parametrize("mirrored", [False, True])
def test_corner_cut_off_a_texel(mirrored: bool) -> None:
    """x + y < 3 in texel (1, 1): the triangle (1,1) (2,1) (1,2), whose moments about the centre are those of half a square."""
    uv = np.array([[[0.0, 0.0], [3.0, 0.0], [0.0, 3.0]]])
    pieces = clip_to_texels(uv[:, ::-1] if mirrored else uv, np.array([[1, 1]]))
    moments = piece_moments(pieces, 2).sum(axis=1)
    # About the corner (1/2, 1/6, 1/6, 1/12, 1/24, 1/12), moved to the centre.
    np.testing.assert_allclose(moments, [1 / 2, -1 / 12, -1 / 12, 1 / 24, 0, 1 / 24], atol=1e-15)


@pytest.mark.parametrize("mirrored", [False, True])
def test_squares_smaller_than_a_texel(mirrored: bool) -> None:
    """x < 1.4 in the middle half of texel (1, 1), and all of the middle tenth of texel (0, 0); pieces are in texels all the same."""
    uv = np.tile([[1.4, -20.0], [1.4, 20.0], [-30.0, 0.0]], (2, 1, 1))
    pieces = clip_to_texels(uv[:, ::-1] if mirrored else uv, np.array([[1, 1], [0, 0]]), np.array([0.5, 0.1]))
    np.testing.assert_allclose(np.bincount(pieces.pair, pieces.area), [0.15 * 0.5, 0.01], rtol=1e-12)
    first = pieces.x[:, pieces.pair == 0]
    np.testing.assert_allclose([first.min(), first.max()], [-0.25, -0.1], rtol=1e-12)
