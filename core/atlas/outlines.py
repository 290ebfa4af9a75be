"""Borders and sizes of charts, and their rotation to the smallest bounding box."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..util.arrays import BoolArray, Float64, Int64
from ..util.coverage import expand_ranges
from .layer_check import signed_areas

_TURNS = 24  # angles tried in a quarter turn, to find the smallest box
_POINTS_AT_ONCE = 1 << 16  # points of all turns together, to bound memory
_AS_LONG = 1.0 - 1e-4  # share of the longest edge from which an edge counts as equally long
_CLEARLY_SMALLER = 0.999  # the longest edge keeps its direction unless another turn saves this much


@dataclass(frozen=True)
class Outlines:
    """The borders of charts, each with its smallest coordinates at 0.

    edge     (n_edge, 2, 2) float64, m: both ends
    start    (n_chart + 1,) int64         edges of chart c are start[c]:start[c + 1]
    extent   (n_chart, 2) float64, m
    area     (n_chart,) float64, m^2
    rigid    (n_chart,) bool              whether the chart must not be turned
    """

    edge: Float64
    start: Int64
    extent: Float64
    area: Float64
    rigid: BoolArray

    @property
    def edge_chart(self) -> Int64:
        """(n_edge,) int64."""
        return np.repeat(np.arange(len(self.extent)), np.diff(self.start))

    def select(self, charts: Int64) -> Outlines:
        """The outlines of some charts, in their order."""
        _, rows = expand_ranges(self.start[charts], self.start[charts + 1])
        start = np.concatenate([[0], np.cumsum(np.diff(self.start)[charts])])
        return Outlines(self.edge[rows], start, self.extent[charts], self.area[charts], self.rigid[charts])

    def scale(self, size: float) -> Outlines:
        """The same outlines, `size` times as large."""
        return Outlines(self.edge * size, self.start, self.extent * size, self.area * size**2, self.rigid)


def straighten_charts(uv: Float64, chart: Int64, shared: BoolArray, n_chart: int) -> Float64:
    """Charts rotated to the smallest box and moved to 0. The angles tried are that of the longest border edge and _TURNS even steps.

    uv       (n, 3, 2) float64
    chart    (n,) int64
    shared   (n, 3) bool, sides within a chart
    """
    edge, edge_chart = _border(uv, chart, shared)
    vector = edge[:, 1] - edge[:, 0]
    length = np.hypot(vector[:, 0], vector[:, 1])
    longest = np.zeros(n_chart)
    np.maximum.at(longest, edge_chart, length)
    is_longest = length > _AS_LONG * longest[edge_chart]  # so that the first of equal edges is chosen, whatever the rounding
    order = np.lexsort((np.arange(len(edge)), ~is_longest, edge_chart))
    first = order[np.unique(edge_chart[order], return_index=True)[1]]
    angles = np.zeros((_TURNS + 1, n_chart))
    angles[0, edge_chart[first]] = -np.arctan2(vector[first, 1], vector[first, 0])
    angles[1:] = (np.arange(_TURNS) * (np.pi / 2 / _TURNS))[:, None]
    best, chosen = np.full(n_chart, np.inf), np.zeros(n_chart)
    for angle, box in zip(angles, _box_areas(edge, edge_chart, angles), strict=True):
        better = box < best * _CLEARLY_SMALLER
        best, chosen = np.where(better, box, best), np.where(better, angle, chosen)
    turned = _turn(uv, np.cos(chosen)[chart], np.sin(chosen)[chart])
    low, _ = find_bounds(turned, chart, n_chart)
    return turned - low[chart][:, None]


def measure_outlines(uv: Float64, chart: Int64, shared: BoolArray, n_chart: int) -> Outlines:
    """The borders of charts whose smallest coordinates are 0; none is rigid.

    uv, chart, shared   as in straighten_charts
    """
    edge, edge_chart = _border(uv, chart, shared)
    order = np.argsort(edge_chart, kind="stable")
    start = np.searchsorted(edge_chart[order], np.arange(n_chart + 1))
    _, high = find_bounds(uv, chart, n_chart)
    area = np.bincount(chart, np.abs(signed_areas(uv)), n_chart).astype(np.float64)
    return Outlines(edge[order], start, np.maximum(high, 0.0), area, np.zeros(n_chart, bool))


def _box_areas(edge: Float64, edge_chart: Int64, angles: Float64) -> Float64:
    """(n_turn, n_chart) float64, m^2: areas of the boxes around charts turned by angles (n_turn, n_chart), rad; 0 without a border."""
    order = np.argsort(edge_chart, kind="stable")
    chart, begin, count = np.unique(edge_chart[order], return_index=True, return_counts=True)
    x, y = edge[order].reshape(-1, 2).T
    areas = np.zeros_like(angles)
    at_once = max(_POINTS_AT_ONCE // max(len(x), 1), 1)
    for first in range(0, len(angles) if len(chart) else 0, at_once):
        turns = slice(first, first + at_once)
        cosine, sine = (np.repeat(of(angles[turns, chart]), 2 * count, axis=1) for of in (np.cos, np.sin))
        turned = (x * cosine - y * sine, x * sine + y * cosine)
        width, height = (np.maximum.reduceat(axis, 2 * begin, axis=1) - np.minimum.reduceat(axis, 2 * begin, axis=1) for axis in turned)
        areas[turns, chart] = width * height
    return areas


def _border(uv: Float64, chart: Int64, shared: BoolArray) -> tuple[Float64, Int64]:
    tri, side = np.nonzero(~shared)
    return np.stack([uv[tri, side], uv[tri, (side + 1) % 3]], axis=1), chart[tri]


def find_bounds(points: Float64, group: Int64, count: int) -> tuple[Float64, Float64]:
    """(count, k) each: least and greatest coordinates of the corners (n, 3, k) of triangles of each group (n,); 0 for an empty group."""
    low, high = np.full((count, points.shape[2]), np.inf), np.full((count, points.shape[2]), -np.inf)
    for axis in range(points.shape[2]):
        np.minimum.at(low[:, axis], group, points[..., axis].min(axis=1))
        np.maximum.at(high[:, axis], group, points[..., axis].max(axis=1))
    known = low <= high
    return np.where(known, low, 0.0), np.where(known, high, 0.0)


def _turn(points: Float64, cosine: Float64, sine: Float64) -> Float64:
    x, y = points[..., 0], points[..., 1]
    cosine, sine = cosine[:, None], sine[:, None]
    return np.stack([x * cosine - y * sine, x * sine + y * cosine], axis=2)
