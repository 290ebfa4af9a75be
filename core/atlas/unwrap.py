"""Charts of objects in metres, by xatlas. Polygons that it leaves out or gets wrong become charts of their own."""

from collections.abc import Callable

import numpy as np

from ..scene.topology import pair_corners
from ..util.arrays import BoolArray, Float64, Int64, IntArray
from ..util.geometry import triangle_normals_areas
from .chart_borders import find_plain_charts
from .layer_check import find_overlaps, label_charts, signed_areas
from .outlines import find_bounds
from .xatlas_requests import XatlasRequests, project, sum_by

_LEAST_STRETCH = 1e-3  # least UV area over area in space; a triangle with less is unfolded on its own


class Unwrapping:
    """Charts of some objects, requested from xatlas on construction and collected by `finish`."""

    def __init__(
        self, tri_position: Float64, tri_vertex: IntArray, tri_polygon: IntArray, tri_corner: IntArray, tri_object: IntArray
    ) -> None:
        """tri_position   (n, 3, 3) float64, m
        tri_vertex     (n, 3) int    objects have no vertices in common, nor polygons, nor corners
        tri_polygon    (n,) int
        tri_corner     (n, 3) int
        tri_object     (n,) int, triangles of an object are consecutive
        """
        self._vertex, self._corner = tri_vertex, tri_corner
        self._polygon, self._object = (np.unique(label, return_inverse=True)[1].ravel() for label in (tri_polygon, tri_object))
        self._normal, area = triangle_normals_areas(tri_position)
        self._position = _centre(tri_position, self._object, np.flatnonzero(area > 0))
        # In an enormous object, centring rounds small triangles to points, which cannot be laid out.
        self._area = np.where(triangle_normals_areas(self._position)[1] > 0, area, 0.0)
        self._solid = solid = np.flatnonzero(self._area > 0)
        self._asked = XatlasRequests(
            self._position[solid], self._normal[solid], self._area[solid], tri_vertex[solid], tri_polygon[solid], tri_object[solid]
        )

    def cancel(self) -> None:
        self._asked.cancel()

    def finish(self, watch: Callable[[int, int], None] = lambda *_: None) -> tuple[Int64, Float64, BoolArray]:
        """Charts without overlap, each with its area in space as UV area; a corner has one UV in all triangles of its polygon.

        watch   called regularly while xatlas works, with the current object and its number of finished triangles; it may raise
        out     (n,) int64 chart, in the order of the objects, -1 without area; (n, 3, 2) float64 UV, m; (n, 3) bool whether side k is
                shared within its chart
        Raises ValueError if xatlas cannot be loaded, UnfolderDied with the code and the object if it crashes.
        """
        area, solid = self._area, self._solid
        group, uv = np.full(len(area), -1, np.int64), np.zeros((len(area), 3, 2))
        group[solid], uv[solid] = self._asked.read(watch)
        bad = (area > 0) & ((group < 0) | (signed_areas(uv) < _LEAST_STRETCH * area))
        bad[_torn_corners(group, uv, self._corner, area > 0)] = True
        chart, shared = self._label(group, uv)
        new, alone = solid, np.zeros(len(area), bool)
        for _ in range(3):  # an overlapping polygon gets its own chart, then another layout; after that nothing can overlap
            bad[new] |= self._find_overlaps(group, uv, chart, shared)[new]
            if not bad.any():
                break
            new = self._take_out(bad, alone, group, uv)
            bad[:] = False
            chart, shared = self._label(group, uv)
        used = chart >= 0
        # Scale each chart to its area in space, since xatlas stretched charts and polygons were taken out of them.
        wanted, laid = (np.bincount(chart[used], values[used]) for values in (area, np.abs(signed_areas(uv))))
        # A chart whose UV area rounds to 0 is a point and is not scaled.
        uv[used] *= np.sqrt(np.divide(wanted, laid, out=np.ones(len(wanted)), where=laid > 0))[chart[used], None, None]
        return chart, uv, shared

    def _label(self, group: Int64, uv: Float64) -> tuple[Int64, BoolArray]:
        extent = np.zeros(self._object.max(initial=-1) + 1)
        np.maximum.at(extent, self._object, np.abs(uv).max(axis=(1, 2)))
        return label_charts(self._vertex, self._corner, uv, group, same_uv=1e-12 * extent[self._object])

    def _find_overlaps(self, group: Int64, uv: Float64, chart: Int64, shared: BoolArray) -> BoolArray:
        """(n,) bool: triangles that overlap others of their chart, at the resolution of a raster; provably injective charts are skipped."""
        used = np.flatnonzero(chart >= 0)
        doubtful = used[~find_plain_charts(self._vertex, uv, chart, shared)[chart[used]]]
        found = np.zeros(len(chart), bool)
        for rows in np.split(doubtful, np.flatnonzero(np.diff(self._object[doubtful])) + 1) if len(doubtful) else []:
            found[rows] = _find_overlaps_in_charts(group[rows], uv[rows])
        return found

    def _take_out(self, bad: BoolArray, alone: BoolArray, group: Int64, uv: Float64) -> Int64:
        """Give each polygon with a bad triangle a chart of its own, in place. Returns the triangles of these, which become `alone`."""
        broken = np.zeros(self._polygon.max(initial=-1) + 1, bool)
        broken[self._polygon[bad]] = True
        again = np.flatnonzero(broken[self._polygon] & (self._area > 0))
        polygon = self._polygon[again]
        uv[again] = _unfold_polygons(
            self._position[again], self._normal[again], self._area[again], polygon, self._corner[again], alone[again]
        )
        group[again] = len(group) + polygon
        alone[again] = True
        return again


def _centre(tri_position: Float64, tri_object: Int64, solid: Int64) -> Float64:
    """Positions relative to the middle of each object's bounding box, which leaves out triangles without area."""
    low, high = find_bounds(tri_position[solid], tri_object[solid], tri_object.max(initial=-1) + 1)
    return tri_position - 0.5 * (low + high)[tri_object][:, None]


def _find_overlaps_in_charts(group: Int64, uv: Float64) -> BoolArray:
    """(n,) bool: triangles that overlap others of their chart, at the resolution of a raster on which all charts are packed on shelves."""
    chart = np.unique(group, return_inverse=True)[1].ravel()
    area = signed_areas(uv)
    overlapping: BoolArray = area == 0
    if overlapping.all():
        return overlapping
    low, high = find_bounds(uv, chart, chart.max() + 1)
    side = (high - low) * 1.01
    order = np.argsort(-side[:, 1], kind="stable")
    along = np.cumsum(side[order, 0]) - side[order, 0]
    shelf = np.floor(along / (float(side.prod(axis=1).sum()) ** 0.5 + float(side[:, 0].max()))).astype(np.int64)
    _, first, shelf = np.unique(shelf, return_index=True, return_inverse=True)
    height = side[order[first], 1]  # the first chart on a shelf is the highest
    origin = np.empty_like(side)
    origin[order] = np.stack([along - along[first][shelf], (np.cumsum(height) - height)[shelf]], axis=1)
    spread = uv + (origin - low)[chart][:, None]
    drawn = ~overlapping
    overlapping[drawn] = find_overlaps(spread[drawn] / float(spread.max()))
    return overlapping


def _torn_corners(group: Int64, uv: Float64, tri_corner: IntArray, used: BoolArray) -> Int64:
    """Triangles, among those used, with a corner that has another UV or chart in another triangle."""
    one, other = pair_corners(tri_corner, used)
    flat_uv = uv.reshape(-1, 2)
    torn = (group[one // 3] != group[other // 3]) | (flat_uv[one] != flat_uv[other]).any(axis=1)
    return np.concatenate([one[torn], other[torn]]) // 3


def _unfold_polygons(position: Float64, normal: Float64, area: Float64, polygon: Int64, tri_corner: IntArray, tried: BoolArray) -> Float64:
    """(n, 3, 2) float64: UVs of polygons, each unfolded on its own: quads are hinged at their diagonal, which is isometric, others are
    projected onto their plane. A polygon that folds over or winds twice about a corner there, or was `tried` before, is laid on a circle.

    Triangles of a polygon are consecutive.
    """
    _, first, polygon, count = np.unique(polygon, return_index=True, return_inverse=True, return_counts=True)
    polygon = polygon.ravel()
    axis = sum_by(polygon, normal * area[:, None], len(first))
    length = np.linalg.norm(axis, axis=1)
    axis = np.where(length[:, None] > 0, axis / np.where(length > 0, length, 1.0)[:, None], normal[first])
    uv = project(position - position[first[polygon], :1], axis[polygon])
    folded = np.bincount(polygon, signed_areas(uv) < _LEAST_STRETCH * area) > 0
    folded |= tried[first] | (np.bincount(polygon, _corner_angles(uv, tri_corner).max(axis=1) > 2.0 * np.pi * (1.0 + 1e-9)) > 0)
    pair = first[count == 2]
    hinged = _unfold_pairs(position, tri_corner, pair, uv)
    folded[polygon[hinged]] = False
    for start, n_tri in zip(first[folded], count[folded], strict=True):
        rows = slice(start, start + n_tri)
        uv[rows] = _lay_on_circle(position[rows], tri_corner[rows], float(area[rows].sum()))
    return uv


def _corner_angles(uv: Float64, tri_corner: IntArray) -> Float64:
    """(n, 3) float64, rad: sum of the angles of all triangles at each corner."""
    after, before = np.roll(uv, -1, axis=1) - uv, np.roll(uv, 1, axis=1) - uv
    cross = after[..., 0] * before[..., 1] - after[..., 1] * before[..., 0]
    angle = np.arctan2(np.abs(cross), (after * before).sum(axis=2))
    corner = np.unique(tri_corner, return_inverse=True)[1].ravel()
    return np.bincount(corner, angle.ravel())[corner].reshape(tri_corner.shape)


def _unfold_pairs(position: Float64, tri_corner: IntArray, first: Int64, uv: Float64) -> Int64:
    """Unfold triangles `first` and `first + 1` about their common side into one plane, writing their UVs. Returns the triangles of `first`
    that have a common side with the next.
    """
    # Side i of one triangle is side j of the other in the opposite direction.
    one, other = tri_corner[first], tri_corner[first + 1]
    match = (one[:, :, None] == np.roll(other, -1, axis=1)[:, None]) & (np.roll(one, -1, axis=1)[:, :, None] == other[:, None])
    hinged = match.any(axis=(1, 2))
    first, match = first[hinged], match[hinged].reshape(-1, 9).argmax(axis=1)
    side_one, side_other = match // 3, match % 3
    start, end = position[first, side_one], position[first, (side_one + 1) % 3]
    length = np.linalg.norm(end - start, axis=1)
    direction = (end - start) / length[:, None]
    uv[first, side_one] = uv[first + 1, (side_other + 1) % 3] = 0.0
    uv[first, (side_one + 1) % 3] = uv[first + 1, side_other] = np.stack([length, np.zeros_like(length)], axis=1)
    for tri, corner, sign in ((first, (side_one + 2) % 3, 1.0), (first + 1, (side_other + 2) % 3, -1.0)):
        height = 2.0 * triangle_normals_areas(position[tri])[1] / length
        uv[tri, corner] = np.stack([((position[tri, corner] - start) * direction).sum(axis=1), sign * height], axis=1)
    return first


def _lay_on_circle(position: Float64, tri_corner: IntArray, area: float) -> Float64:
    """UVs of a polygon's corners on a circle, in order, with arcs proportional to their distances: a convex polygon has no overlap."""
    _, first, index = np.unique(tri_corner, return_index=True, return_inverse=True)
    rim = position.reshape(-1, 3)[first]
    length = np.linalg.norm(np.roll(rim, -1, axis=0) - rim, axis=1)
    length = np.maximum(length, 1e-3 * length.mean())  # coincident corners would make a triangle without area
    angle = 2.0 * np.pi * (np.cumsum(length) - length) / length.sum()
    uv: Float64 = np.stack([np.cos(angle), np.sin(angle)], axis=1)[index.reshape(tri_corner.shape)]
    scale = (area / max(float(np.abs(signed_areas(uv)).sum()), 1e-30)) ** 0.5
    return uv * scale
