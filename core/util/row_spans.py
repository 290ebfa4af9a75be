"""Spans of texels in each row of a page that a triangle touches, and that it covers wholly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .arrays import BoolArray, Float64, Int32, Int64
from .coverage import chunk_ranges, expand_ranges
from .progress import Say


@dataclass(frozen=True)
class RowSpans:
    """Spans of texels, one for each row of each triangle.

    tri            (n,) int32
    y              (n,) int32   row
    touched_start  (n,) int32   the triangle touches texels touched_start <= x < touched_end
    touched_end    (n,) int32
    full_start     (n,) int32   it covers texels full_start <= x < full_end wholly; both equal touched_start if there are none
    full_end       (n,) int32
    """

    tri: Int32
    y: Int32
    touched_start: Int32
    touched_end: Int32
    full_start: Int32
    full_end: Int32


def find_row_spans(uv: Float64, say: Say = lambda share: None) -> RowSpans:
    """Spans of texels under triangles.

    uv    (n_tri, 3, 2) float64, texels
    say   receives the finished share of the triangles
    """
    first_row = np.floor(uv[:, :, 1].min(axis=1)).astype(np.int64)
    end_row = np.ceil(uv[:, :, 1].max(axis=1)).astype(np.int64)
    parts = [np.empty((6, 0), np.int32)]
    for tri, start, end in chunk_ranges(first_row, end_row):
        say(int(tri[0]) / len(uv))
        owner, y = expand_ranges(start, end)
        parts.append(_spans_of_rows(uv, tri[owner], y))
    tri, y, *spans = np.concatenate(parts, axis=1)
    return RowSpans(tri, y, *spans)


def _spans_of_rows(uv: Float64, tri: Int64, row: Int64) -> Int32:
    bottom, top = row.astype(np.float64), row + 1.0
    left, right = np.full(len(row), np.inf), np.full(len(row), -np.inf)
    # The left side of a triangle is convex in y and the right side concave, so the extremes over a row that the
    # triangle crosses from bottom to top are found on its two lines.
    inner_left, inner_right = right.copy(), left.copy()
    sides = [(uv[:, i], uv[:, (i + 1) % 3]) for i in range(3)]
    for line in (bottom, top):
        line_left, line_right = np.full(len(row), np.inf), np.full(len(row), -np.inf)
        for one, other in sides:
            x, met = _side_at(one[tri], other[tri], line)
            line_left = np.where(met, np.minimum(line_left, x), line_left)
            line_right = np.where(met, np.maximum(line_right, x), line_right)
        crossed = line_left <= line_right
        left, right = np.minimum(left, line_left), np.maximum(right, line_right)
        inner_left = np.where(crossed, np.maximum(inner_left, line_left), np.inf)
        inner_right = np.where(crossed, np.minimum(inner_right, line_right), -np.inf)
    for corner in range(3):
        x, y = uv[tri, corner, 0], uv[tri, corner, 1]
        inside = (y >= bottom) & (y <= top)
        left = np.where(inside, np.minimum(left, x), left)
        right = np.where(inside, np.maximum(right, x), right)
    touched_start, touched_end = np.floor(left), np.ceil(right)
    full_start, full_end = np.ceil(inner_left), np.floor(inner_right)
    some = full_end > full_start
    full_start, full_end = np.where(some, full_start, touched_start), np.where(some, full_end, touched_start)
    return np.stack([tri, row, touched_start, touched_end, full_start, full_end]).astype(np.int32)


def _side_at(one: Float64, other: Float64, line: Float64) -> tuple[Float64, BoolArray]:
    """x where the side meets the line y = `line`, and whether it does; a horizontal side does not count, since its neighbours do."""
    rise = other[:, 1] - one[:, 1]
    met = (np.minimum(one[:, 1], other[:, 1]) <= line) & (np.maximum(one[:, 1], other[:, 1]) >= line) & (rise != 0.0)
    x = one[:, 0] + (line - one[:, 1]) / np.where(met, rise, 1.0) * (other[:, 0] - one[:, 0])
    return np.clip(x, np.minimum(one[:, 0], other[:, 0]), np.maximum(one[:, 0], other[:, 0])), met
