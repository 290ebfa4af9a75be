"""Cells of a hand-made grid: two charts, one of them with a hole."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from leaflight.core.texels.texel_grid import TexelGrid, build_grid, fill_border, interleave_bits, part_bits, step_codes
from leaflight.core.util.row_spans import RowSpans

RING = [(2, 2, 7), (3, 2, 4), (3, 5, 7), (4, 2, 4), (4, 5, 7), (5, 2, 7)]  # y, first x, end x


def make_grid(spans: list[tuple[int, int, int, int]]) -> TexelGrid:
    """Spans (triangle, y, first x, end x), their texels numbered on; triangle 0 is chart 0, 2 is chart 1, 1 has no texels."""
    tri, y, start, end = np.array(spans, np.int32).T
    grid = build_grid(RowSpans(tri, y, start, end, start, start), np.array([0, -1, 1], np.int32), 2)
    row = grid.tri_row[tri, 2] + y
    entry = 0
    for k in range(len(tri)):
        for x in range(start[k], end[k]):
            grid.cell_entry[grid.row_cell[row[k], 2] + x] = entry
            entry += 1
    return grid


def make_ring() -> TexelGrid:
    """A ring of texels in chart 0, texel (4, 3) in its hole is chart 1."""
    return make_grid([(0, *span) for span in RING] + [(2, 3, 4, 5)])


def test_filled_cells_are_found() -> None:
    grid = make_ring()
    x, y = np.array([2.0, 6.99, 3.5, 5.0, 4.5]), np.array([2.0, 5.99, 4.0, 3.0, 3.5])
    assert grid.find(np.array([0, 0, 0, 0, 2]), x, y).tolist() == [0, 17, 10, 7, 18]


def test_no_triangle_finds_nothing() -> None:
    middle = np.full(2, 3.0)
    assert make_ring().find(np.array([1, -1]), middle, middle).tolist() == [-1, -1]


def test_border_takes_the_nearest_entry_of_its_own_chart() -> None:
    grid = make_ring()
    hole = (np.array([0]), np.array([4.5]), np.array([3.5]))
    assert grid.find(*hole).tolist() == [-1]
    fill_border(grid)
    assert grid.find(*hole).tolist() == [7]  # its neighbour to the right
    outside_x, outside_y = np.array([1.0, 7.5, 2.5, 6.5, 7.5]), np.array([2.5, 4.5, 1.5, 6.5, 6.5])
    assert grid.find(np.zeros(5, int), outside_x, outside_y).tolist() == [0, 12, 0, 17, 17]
    assert grid.find(np.full(2, 2), np.array([3.5, 5.5]), np.array([3.5, 4.5])).tolist() == [18, 18]


def test_border_never_takes_the_next_chart() -> None:
    """Above chart 0's last row the table goes on with chart 1, whose texel (6, 3) is no neighbour of the gap in row 5."""
    grid = make_grid([(0, 5, 2, 4), (0, 5, 9, 11), (2, 3, 6, 7)])
    fill_border(grid)
    assert grid.find(np.zeros(5, int), np.arange(4.5, 9.0), np.full(5, 5.5)).tolist() == [1, 1, -1, 2, 2]


@given(st.lists(st.tuples(st.integers(0, 65535), st.integers(0, 65535)), min_size=1))
def test_interleave_bits(points: list[tuple[int, int]]) -> None:
    x, y = np.array(points).T
    expected = [sum(((a >> i & 1) << 2 * i) | ((b >> i & 1) << 2 * i + 1) for i in range(16)) for a, b in points]
    assert interleave_bits(x, y).tolist() == expected


@given(st.lists(st.tuples(st.integers(0, 65535), st.integers(0, 65535)), min_size=1))
def test_parted_bits_are_those_that_were_interleaved(points: list[tuple[int, int]]) -> None:
    x, y = np.array(points).T
    np.testing.assert_array_equal(part_bits(interleave_bits(x, y)), [x, y])


_PLACES = st.integers(0, 2**14 - 1)
_STEPS = st.integers(-8, 8)


@given(st.lists(st.tuples(_PLACES, _PLACES), min_size=1), _STEPS, _STEPS)
def test_a_step_from_code_to_code_is_one_of_columns_and_rows(points: list[tuple[int, int]], right: int, up: int) -> None:
    x, y = np.array(points).T
    within = (x + right >= 0) & (y + up >= 0)
    found = step_codes(interleave_bits(x, y), right, up)
    np.testing.assert_array_equal(found[within], interleave_bits(x + right, y + up)[within])
    assert (found[~within] >= 1 << 28).all()
    assert (found < 1 << 30).all()
