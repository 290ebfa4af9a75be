"""Sufficient test that a chart is injective, by its border, without rasterizing its triangles.

If no triangle is flipped, the number of triangles over a point is the winding number of the border around it. A border of one outer loop
and loops around holes, none of which crosses itself or another, has winding numbers of at most 1.
Source: Lipman 2014, "Bijective mappings of meshes with boundary and the degree in mesh processing", section 4.
"""

import numpy as np

from ..scene.topology import join_sets, number_points
from ..util.arrays import BoolArray, Float64, Int64, IntArray
from ..util.coverage import chunk_ranges, expand_ranges

_MOST_SIDES = 1 << 10  # of a chart's border; all pairs are compared


def find_plain_charts(tri_vertex: IntArray, tri_uv: Float64, tri_chart: Int64, shared: BoolArray) -> BoolArray:
    """(n_chart,) bool: charts that provably do not overlap themselves; False does not prove the opposite.

    tri_vertex   (n, 3) int
    tri_uv       (n, 3, 2) float64, any unit
    tri_chart    (n,) int64      -1 for triangles without a chart
    shared       (n, 3) bool     from label_charts: whether side k, which starts at corner k, is shared within its chart
    """
    n_chart = int(tri_chart.max(initial=-1)) + 1
    plain = np.ones(n_chart, bool)
    used = tri_chart >= 0
    one, other = tri_uv[:, 1] - tri_uv[:, 0], tri_uv[:, 2] - tri_uv[:, 0]
    plain[tri_chart[used & (_cross(one, other) <= 0.0)]] = False
    plain[tri_chart[_find_odd_sides(tri_vertex, tri_chart, shared)]] = False
    tri, side = np.nonzero(~shared & used[:, None])
    chart = tri_chart[tri]
    order = np.argsort(chart, kind="stable")
    tri, side, chart = tri[order], side[order], chart[order]
    start, end = tri_uv[tri, side], tri_uv[tri, (side + 1) % 3]
    place_start, place_end = number_points(np.concatenate([start, end]), np.tile(chart, 2)).reshape(2, -1)
    plain &= _winds_once(chart, start, end, place_start, place_end, n_chart)
    plain &= np.bincount(chart, minlength=n_chart) <= _MOST_SIDES
    asked = plain[chart]
    plain[_find_crossed(chart[asked], start[asked], end[asked], place_start[asked], place_end[asked])] = False
    return plain


def _cross(one: Float64, other: Float64) -> Float64:
    return one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]


def _find_odd_sides(tri_vertex: IntArray, tri_chart: Int64, shared: BoolArray) -> Int64:
    """Triangles with a shared side whose two directions are not equally frequent in their chart."""
    tri, side = np.nonzero(shared)
    start, end = tri_vertex[tri, side], tri_vertex[tri, (side + 1) % 3]
    # One number is sorted faster than two.
    pair = np.minimum(start, end).astype(np.int64) * (int(tri_vertex.max(initial=0)) + 1) + np.maximum(start, end)
    order = np.lexsort((pair, tri_chart[tri]))
    pair, chart = pair[order], tri_chart[tri[order]]
    edge = np.cumsum((np.diff(pair, prepend=-1) != 0) | (np.diff(chart, prepend=-1) != 0)) - 1
    odd = np.bincount(edge, np.where(start < end, 1.0, -1.0)[order]) != 0.0
    return np.asarray(tri[order][odd[edge]])


def _winds_once(chart: Int64, start: Float64, end: Float64, place_start: Int64, place_end: Int64, n_chart: int) -> BoolArray:
    """(n_chart,) bool: charts with exactly one counterclockwise loop. Loops that meet count as one; _find_crossed rejects them."""
    if not len(chart):  # charts without borders are closed, so some of their triangles are flipped
        return np.zeros(n_chart, bool)
    n_place = 1 + max(int(place_start.max(initial=-1)), int(place_end.max(initial=-1)))
    loop = join_sets(n_place, place_start, place_end)[place_start]
    first = np.searchsorted(chart, np.arange(n_chart)).clip(max=max(len(chart) - 1, 0))
    origin = start[first][chart]  # near the loop, so that its area does not cancel
    area = np.bincount(loop, _cross(start - origin, end - origin), n_place)
    loop_chart = np.full(n_place, -1)
    loop_chart[loop] = chart
    counterclockwise = np.bincount(loop_chart[(loop_chart >= 0) & (area > 0.0)], minlength=n_chart)
    return counterclockwise == 1


def _find_crossed(chart: Int64, start: Float64, end: Float64, place_start: Int64, place_end: Int64) -> Int64:
    """Charts with two sides that have a point in common and are not consecutive.

    If the second of two consecutive sides runs back over the first, it meets the side before, or the next side meets the first.

    chart   (n,) int64, ascending
    """
    extents = [(np.minimum(*along), np.maximum(*along)) for along in zip(start.T, end.T, strict=True)]
    crossed = [np.zeros(0, np.int64)]
    for rows, first, last in chunk_ranges(np.arange(len(chart)) + 1, np.searchsorted(chart, chart, side="right")):
        one, other = expand_ranges(first, last)
        one = rows[one]
        for low, high in extents:  # one after the other, since the first rejects most pairs
            near = np.flatnonzero((low.take(one) <= high.take(other)) & (low.take(other) <= high.take(one)))
            one, other = one.take(near), other.take(near)
        along, across = end[one] - start[one], end[other] - start[other]
        sides = [np.sign(_cross(along, point[other] - start[one])) for point in (start, end)]
        sides += [np.sign(_cross(across, point[one] - start[other])) for point in (start, end)]
        meets = (sides[0] * sides[1] <= 0.0) & (sides[2] * sides[3] <= 0.0)
        follows = (place_end[one] == place_start[other]) | (place_end[other] == place_start[one])
        crossed.append(chart[one[meets & ~follows]])
    return np.concatenate(crossed)
