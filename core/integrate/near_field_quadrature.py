"""Near-field quadrature of closed forms: the few points of a texel could miss the peak of a light nearer than a texel is wide."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..lights.direct_lights import AreaSource, PointSource, Source, TriangleSource
from ..lights.direct_points import GAUSS_POINTS, Receivers, TexelChunk, row_pieces
from ..util.arrays import Float32, Float64, IntArray
from ..util.geometry import dot_rows

# Four points suffice where the distance to a light is at least this many times the points' radius: with an inverse-square law their values
# then differ by half of their mean.
_FAR = 14.0
# The same for the straight edge of a wide light close by: two points across it are then within 1 % of the mean of its profile,
# 1 + x / sqrt(x^2 + h^2).
_FAR_FROM_EDGE = 2.5
_EDGE_HALVINGS = (
    6  # squares along an edge whose quarters would hold less than a thousandth of the texel's light: 4 ** -6, on 2 ** 6 of them
)
_GENTLE = 0.5  # four points give the mean of a closed form whose range inside a texel, relative to that mean, is at most this
_MOST_HALVINGS, _JUMP_HALVINGS = 12, 5  # halvings of a texel's side; float32 positions are not much finer
_SQUARES_AT_ONCE = 2**13  # about as many as fit the cache


def find_peaks(source: Source, receivers: Receivers, n_point: int) -> NDArray[np.bool_]:
    """(n,) bool: whether light changes much between the points of a texel.

    source      one light, or one for each texel
    receivers   n_point points of n texels: the first point of every texel, then the second
    """
    middle, radius_squared = _enclose(receivers, n_point)
    out: NDArray[np.bool_] = _span_squared(source, middle) < _FAR**2 * radius_squared
    out |= _edge_distance_squared(source, middle) < _FAR_FROM_EDGE**2 * radius_squared
    return out


def _enclose(receivers: Receivers, n_point: int) -> tuple[Float32, Float32]:
    """Enclose the points of each of n texels in a sphere: its centre (n, 3) and squared radius (n,)."""
    place = receivers.position.reshape(n_point, -1, 3)
    middle: Float32 = place.mean(axis=0)
    radius_squared: Float32 = ((place - middle) ** 2).sum(axis=2).max(axis=0)
    return middle, radius_squared


def _span_squared(source: Source, place: Float32) -> Float32:
    """(n,) float32, unit box squared: squared distance over which a light changes much at positions (n, 3); inf for a distant light."""
    if isinstance(source, PointSource):
        centre, size_squared = source.centre, source.radius**2
    elif isinstance(source, AreaSource):
        centre, size_squared = source.centre, np.maximum((source.x_axis**2).sum(axis=1), (source.y_axis**2).sum(axis=1))
    elif isinstance(source, TriangleSource):
        centre = source.corners.mean(axis=1)
        size_squared = ((source.corners - centre[:, None]) ** 2).sum(axis=2).max(axis=1)
    else:
        return np.full(len(place), np.inf, np.float32)
    out: Float32 = np.maximum(((centre - place) ** 2).sum(axis=1), size_squared)
    return out


def _edge_distance_squared(source: Source, place: Float32) -> Float32:
    """(n,) float32, unit box squared: squared distance to the edge of a flat light, where its light ends if it is close; inf for others."""
    if isinstance(source, AreaSource) and source.ellipse:
        away = place - source.centre
        x, y = (dot_rows(away, axis) / dot_rows(axis, axis) for axis in (source.x_axis, source.y_axis))
        beyond = 1 - 1 / np.maximum(np.hypot(x, y), np.float32(1e-6))  # along the line from the centre
        height = dot_rows(away, source.z_axis)
        across = x[:, None] * source.x_axis + y[:, None] * source.y_axis
        return beyond * beyond * dot_rows(across, across) + height * height
    if isinstance(source, AreaSource):
        x, y = source.x_axis, source.y_axis
        corners = source.centre[:, None] + np.stack([-x - y, y - x, x + y, x - y], axis=1)
    elif isinstance(source, TriangleSource):
        corners = source.corners
    else:
        return np.full(len(place), np.inf, np.float32)
    least = np.full(len(place), np.inf, np.float32)
    for start, end in zip(corners.swapaxes(0, 1), np.roll(corners, -1, axis=1).swapaxes(0, 1), strict=True):
        along, away = end - start, place - start
        share = np.clip(dot_rows(away, along) / np.maximum(dot_rows(along, along), np.float32(1e-30)), 0, 1)
        away = away - share[:, None] * along
        np.minimum(least, dot_rows(away, away), out=least)
    return least


def average_peaks(source: Source, lamp: IntArray | None, chunk: TexelChunk, texels: IntArray) -> tuple[Float64, Float64]:
    """Mean of the closed form over each texel (n,), and the variance of that mean (n,), by squares that are smaller near the light.

    lamp     (n,) int: row of the source for each texel; None where the source is a single light
    texels   (n,) int: rows of the chunk
    """
    mean, variance = np.zeros((2, len(texels)))
    pieces = row_pieces(np.arange(len(texels)), len(GAUSS_POINTS))
    waiting = [(piece, np.zeros((len(piece), 2)), np.full(len(piece), np.inf, np.float32), 0) for piece in pieces]
    while waiting:
        own, low, before, halvings = waiting.pop()
        side = 0.5**halvings
        points = low + side * GAUSS_POINTS
        receivers = chunk.receivers_at(texels[own], points)
        lights = source if lamp is None else source.rows(np.tile(lamp[own], len(points)))
        closed = lights.irradiance(receivers.position, receivers.normal).reshape(len(points), -1)
        middle, radius_squared = _enclose(receivers, len(points))
        own_lights = source if lamp is None else source.rows(lamp[own])
        flat = _span_squared(own_lights, middle) >= _FAR**2 * radius_squared
        if halvings < _EDGE_HALVINGS:
            flat &= _edge_distance_squared(own_lights, middle) >= _FAR_FROM_EDGE**2 * radius_squared
        # A square that spans two triangles with a gap between them never becomes small.
        flat |= (halvings >= _JUMP_HALVINGS) & (radius_squared > before / 2)
        flat |= halvings == _MOST_HALVINGS
        mean += np.bincount(own[flat], closed[:, flat].mean(axis=0) * side**2, len(mean))
        variance += np.bincount(own[flat], (estimate_bend(closed[:, flat]) * side**2) ** 2, len(mean))
        quarters = low[~flat][:, None] + side / 2 * np.array([[0, 0], [1, 0], [0, 1], [1, 1]])
        left = np.repeat(own[~flat], 4), quarters.reshape(-1, 2), np.repeat(radius_squared[~flat], 4)
        cuts = _cut_between_pairs(left[0])
        waiting += [(*part, halvings + 1) for part in zip(*(np.split(values, cuts) for values in left), strict=True) if len(part[0])]
    return mean, variance


def _cut_between_pairs(pair: IntArray) -> IntArray:
    """Where to cut a list of squares into pieces that fit the cache; squares of a pair (n,), ascending, stay together."""
    end = np.flatnonzero(np.diff(pair)) + 1
    return end[np.diff((end - 1) // _SQUARES_AT_ONCE, append=(len(pair) - 1) // _SQUARES_AT_ONCE) > 0]


def estimate_bend(closed: Float64) -> Float64:
    """(n,) float64: possible error of the mean of values (4, n) at the Gauss points: 0 where the values lie in a plane of small slope."""
    twist = np.abs(closed[0] - closed[1] - closed[2] + closed[3]) / 4
    reach = closed.max(axis=0) - closed.min(axis=0)
    out: Float64 = np.where(reach > _GENTLE * closed.mean(axis=0), reach / 4, twist)
    return out
