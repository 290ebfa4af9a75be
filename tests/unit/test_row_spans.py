"""Spans of rows against exact clipping of every texel."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from leaflight.core.util.coverage import clip_to_texels
from leaflight.core.util.row_spans import find_row_spans

COORDINATE = st.one_of(st.floats(0.0, 9.0), st.integers(0, 9).map(float))
TRIANGLE = st.lists(st.tuples(COORDINATE, COORDINATE), min_size=3, max_size=3).map(np.array)


def area_of(corners: np.ndarray) -> float:
    one, two = corners[1] - corners[0], corners[2] - corners[0]
    return 0.5 * abs(one[0] * two[1] - one[1] * two[0])


@settings(max_examples=60, deadline=None)
@given(TRIANGLE)
def test_spans_hold_the_triangle_and_full_texels_are_full(corners: np.ndarray) -> None:
    if area_of(corners) < 1e-6:
        return
    spans = find_row_spans(corners[None])
    grid = np.stack(np.meshgrid(np.arange(9), np.arange(9)), axis=-1).reshape(-1, 2)
    pieces = clip_to_texels(np.repeat(corners[None], len(grid), axis=0), grid)
    area = np.bincount(pieces.pair, pieces.area, minlength=len(grid)).reshape(9, 9)
    np.testing.assert_allclose(area.sum(), area_of(corners), rtol=1e-9)
    touched, full = np.zeros((9, 9), bool), np.zeros((9, 9), bool)
    for row in range(len(spans.y)):
        touched[spans.y[row], spans.touched_start[row] : spans.touched_end[row]] = True
        full[spans.y[row], spans.full_start[row] : spans.full_end[row]] = True
    np.testing.assert_allclose(area[full], 1.0, rtol=1e-12)
    assert area[~touched].max(initial=0.0) < 1e-12
    assert (full <= touched).all()


def test_full_texels_are_found() -> None:
    """Below the diagonal of 8 x 8 lie 28 whole texels; row 0 has 7 of them and touches 8."""
    spans = find_row_spans(np.array([[[0.0, 0.0], [8.0, 0.0], [0.0, 8.0]]]))
    assert (spans.full_end - spans.full_start).tolist() == [7, 6, 5, 4, 3, 2, 1, 0]
    assert (spans.touched_end - spans.touched_start).tolist() == [8, 7, 6, 5, 4, 3, 2, 1]


def test_needle_makes_few_pairs() -> None:
    """A diagonal needle across 1000 texels touches about 2000, not the million of its bounding box."""
    spans = find_row_spans(np.array([[[0.2, 0.1], [1000.3, 999.9], [0.2, 0.1001]]]))
    assert 999 <= (spans.touched_end - spans.touched_start).sum() < 3010
