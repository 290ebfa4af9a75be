"""Exact clipping of triangles against a grid of texels, and polynomial moments of the clipped parts."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from .arrays import BoolArray, Float64, FloatArray, Int32, Int64, IntArray
from .progress import Say

CHUNK_SIZE = 1 << 16  # items processed at a time, so that temporary arrays stay in the cache

# Quadrature on a triangle, exact up to a degree: corner weights (n_point, 3) of the points, and their shares of the area (n_point,).
# Source: Dunavant 1985, "High degree efficient symmetrical Gaussian quadrature rules for the triangle", rules 1, 2, 4;
# for rule 4 the closed form of its tabulated numbers is used.
_SQRT_10 = 10.0**0.5
_NEAR, _FAR = ((8.0 - _SQRT_10 + sign * (38.0 - 44.0 * 0.4**0.5) ** 0.5) / 18.0 for sign in (1.0, -1.0))
_SHARE_NEAR, _SHARE_FAR = ((620.0 + sign * (213125.0 - 53320.0 * _SQRT_10) ** 0.5) / 3720.0 for sign in (1.0, -1.0))


def _three_points(near: float) -> list[list[float]]:
    far = 1.0 - 2.0 * near
    return [[far, near, near], [near, far, near], [near, near, far]]


_RULES: dict[int, tuple[list[list[float]], list[float]]] = {
    0: ([[1.0 / 3.0] * 3], [1.0]),
    2: (_three_points(1.0 / 6.0), [1.0 / 3.0] * 3),
    4: (_three_points(_NEAR) + _three_points(_FAR), [_SHARE_NEAR] * 3 + [_SHARE_FAR] * 3),
}


def monomial_exponents(degree: int) -> tuple[tuple[int, int], ...]:
    """Exponents of s and t in the order 1, s, t, s^2, st, t^2, s^3, s^2 t, ...

    Raises ValueError when the degree is not 0, 2 or 4.
    """
    if degree not in _RULES:
        raise ValueError(f"degree: expected 0, 2 or 4, got {degree}")
    return tuple((total - of_t, of_t) for total in range(degree + 1) for of_t in range(total + 1))


def expand_ranges(start: IntArray, end: IntArray) -> tuple[Int64, Int64]:
    """All integers of the ranges, concatenated.

    start, end   (k,) int; ranges with end <= start are empty
    out          (n,) int64 index of the range, (n,) int64 the integer
    """
    length = np.maximum(end.astype(np.int64) - start, 0)
    owner = np.repeat(np.arange(len(length)), length)
    shift = start - (np.cumsum(length) - length)
    return owner, np.arange(len(owner)) + shift[owner]


def chunk_ranges(start: IntArray, end: IntArray, size: int = CHUNK_SIZE) -> Iterator[tuple[Int64, Int64, Int64]]:
    """The ranges cut and grouped so that each group holds at most `size` integers.

    start, end   (k,) int
    yields       (r,) int64 distinct indices of ranges, ascending, (r,) and (r,) int64 start and end of a part that is not empty
    """
    length = np.maximum(end.astype(np.int64) - start, 0)
    after = np.cumsum(length)
    before = after - length
    for low in range(0, int(after[-1]) if len(after) else 0, size):
        rows = np.arange(np.searchsorted(after, low, side="right"), np.searchsorted(before, low + size, side="left"))
        rows = rows[length[rows] > 0]
        first = start[rows] + np.maximum(low - before[rows], 0)
        last = start[rows] + np.minimum(low + size - before[rows], length[rows])
        yield rows, first, last


@dataclass(frozen=True)
class Pieces:
    """Triangles that together form the part of a triangle inside a texel; all of one pair are consecutive.

    pair  (n,) int64     index of the pair (triangle, texel)
    x, y  (3, n) float64 corners, texels from the texel's centre
    area  (n,) float64   texels^2, positive
    """

    pair: Int64
    x: Float64
    y: Float64
    area: Float64


def clip_to_texels(uv: Float64, texel_xy: IntArray, side: Float64 | None = None) -> Pieces:
    """Clip triangle i to texel i, or to a smaller square around its centre; the results are triangles.

    uv        (n, 3, 2) float64, texels, either orientation
    texel_xy  (n, 2) int
    side      (n,) float64, texels: sides of the squares; 1 if None
    Source: Sutherland & Hodgman 1974, "Reentrant polygon clipping".
    """
    local = uv - (texel_xy[:, None, :] + 0.5)
    if side is not None:
        local /= side[:, None, None]
    side_1, side_2 = local[:, 1] - local[:, 0], local[:, 2] - local[:, 0]
    mirrored = side_1[:, 0] * side_2[:, 1] < side_1[:, 1] * side_2[:, 0]
    x, y = local[:, :, 0].ravel(), local[:, :, 1].ravel()
    polygon = np.repeat(np.arange(len(uv)), 3)
    for sign in (1.0, -1.0):
        y, x, polygon = _clip_half_plane(y, x, polygon, sign)
        x, y, polygon = _clip_half_plane(x, y, polygon, sign)
    if not len(polygon):
        return Pieces(polygon, np.empty((3, 0)), np.empty((3, 0)), np.empty(0))
    first = _first_of_polygon(polygon)
    middle = np.flatnonzero((first[:-1] != np.arange(len(first) - 1)) & (polygon[:-1] == polygon[1:]))
    corners = (first[middle], middle, middle + 1)  # a fan about each polygon's first corner
    piece_x, piece_y = np.stack([x[i] for i in corners]), np.stack([y[i] for i in corners])
    pair = polygon[middle]
    if side is not None:
        piece_x *= side[pair]
        piece_y *= side[pair]
    area = 0.5 * ((piece_x[1] - piece_x[0]) * (piece_y[2] - piece_y[0]) - (piece_x[2] - piece_x[0]) * (piece_y[1] - piece_y[0]))
    area = np.where(mirrored[pair], -area, area)
    kept = area > 0.0
    return Pieces(pair[kept], piece_x[:, kept], piece_y[:, kept], area[kept])


def _clip_half_plane(along: Float64, across: Float64, polygon: Int64, sign: float) -> tuple[Float64, Float64, Int64]:
    """Polygons clipped to sign * along <= 1/2; corners of one polygon are consecutive and in order."""
    depth = 0.5 - sign * along
    inside = depth >= 0.0
    if inside.all():
        return along, across, polygon
    following = np.arange(1, len(polygon) + 1)
    last = np.flatnonzero(np.append(polygon[1:] != polygon[:-1], True))
    following[last] = np.append(0, last[:-1] + 1)
    crossing = inside != inside[following]
    emitted = inside.astype(np.int64) + crossing
    source = np.repeat(np.arange(len(polygon)), emitted)
    new_along, new_across = along[source], across[source]
    cut = np.flatnonzero(crossing)
    to = following[cut]
    place = np.cumsum(emitted)[cut] - 1
    new_along[place] = 0.5 * sign
    depth_here, here = depth[cut], across[cut]
    new_across[place] = here + depth_here / (depth_here - depth[to]) * (across[to] - here)
    return new_along, new_across, polygon[source]


def _first_of_polygon(polygon: Int64) -> Int64:
    begins = np.append(True, polygon[1:] != polygon[:-1])
    return np.flatnonzero(begins)[np.cumsum(begins) - 1]


def piece_moments(pieces: Pieces, degree: int) -> Float64:
    """Exact integrals of the monomials about the texel's centre over each piece.

    out   (M, n) float64, texels^2 * texels^(degree of the monomial), in the order of `monomial_exponents`
    """
    exponents = monomial_exponents(degree)
    moments = np.zeros((len(exponents), len(pieces.area)))
    moments[0] = pieces.area
    for weights, share in zip(*_RULES[degree], strict=True):
        x, y = (sum(weight * corner for weight, corner in zip(weights, axis, strict=True)) for axis in (pieces.x, pieces.y))
        x_power, y_power = powers(x, degree), powers(y, degree)
        weight_area = share * pieces.area
        for k, (of_x, of_y) in enumerate(exponents[1:], start=1):
            moments[k] += weight_area * x_power[of_x] * y_power[of_y]
    return moments


def powers(value: FloatArray, degree: int) -> list[FloatArray]:
    """value^0 ... value^degree, by one multiplication each, since numpy's power is slow."""
    result = [np.ones_like(value)]
    for _ in range(degree):
        result.append(result[-1] * value)
    return result


def as_slice(rows: IntArray | range) -> IntArray | slice:
    """Ascending rows, as a slice if they are consecutive: indexing with a slice is several times faster."""
    if isinstance(rows, range):
        return slice(rows.start, rows.stop)
    return slice(int(rows[0]), int(rows[-1]) + 1) if len(rows) and rows[-1] - rows[0] == len(rows) - 1 else rows


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
