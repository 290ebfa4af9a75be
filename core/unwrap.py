"""Charts for the triangles of one object, in metres: xatlas's, and what it leaves out or gets wrong polygon by polygon."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from .geometry import orthonormal_basis, triangle_normals_areas
from .layer_check import find_overlaps, join_sets, label_charts, pair_corners, signed_areas
from .scene import IntArray
from .unfolding import unfold_meshes
from .xatlas_process import Mesh

Float64: TypeAlias = NDArray[np.float64]
Int64: TypeAlias = NDArray[np.int64]
Bool: TypeAlias = NDArray[np.bool_]

_LARGEST_COORDINATE = 1e5  # float32 then still tells 1 % of a triangle of median size
_FLATNESS = 1e-5  # of a chart's extent: nearer to its plane it is projected, in float64
_LEAST_STRETCH = 1e-3  # a triangle whose UV area is less of its area in space is unfolded by itself


class Unwrapping:
    """Charts of one object's triangles: xatlas begins with them when it is made, and `finish` takes them from it."""

    def __init__(self, tri_position: Float64, tri_vertex: IntArray, tri_polygon: IntArray, tri_corner: IntArray) -> None:
        """tri_position   (n, 3, 3) float64, m
        tri_vertex     (n, 3) int
        tri_polygon    (n,) int
        tri_corner     (n, 3) int
        """
        self._vertex, self._polygon, self._corner = tri_vertex, tri_polygon, tri_corner
        self._normal, self._area = triangle_normals_areas(tri_position)
        self._solid = np.flatnonzero(self._area > 0)
        self._position = tri_position[self._solid]
        self._asked: _Asked | None = None
        if len(self._solid):
            self._position -= 0.5 * (self._position.min(axis=(0, 1)) + self._position.max(axis=(0, 1)))
            self._asked = _Asked(self._position, tri_vertex[self._solid], self._area[self._solid])

    def cancel(self) -> None:
        """Nobody will ask for the charts any more."""
        if self._asked:
            self._asked.answer.cancel()

    def finish(self) -> tuple[Int64, Float64, Bool]:
        """Charts without overlap, each with the area in UV that it has in space; corners that are one have one UV.

        (n,) int64 chart, -1 without area; (n, 3, 2) float64 UV, m; (n, 3) bool whether side k is shared within its chart
        Raises ValueError when xatlas cannot be loaded, UnfolderDied when it crashes.
        """
        area, solid = self._area, self._solid
        group, uv = np.full(len(area), -1, np.int64), np.zeros((len(area), 3, 2))
        if self._asked:
            found = self._asked.read()
            group[solid], uv[solid] = _mend_charts(
                *found, self._position, self._normal[solid], area[solid], self._polygon[solid], self._corner[solid]
            )
        extent = float(np.abs(uv).max(initial=0.0))
        chart, shared = label_charts(self._vertex, self._corner, uv, group, same_uv=1e-12 * extent)
        used = chart >= 0
        # What was taken out of a chart was not stretched as the rest is.
        sums = [np.bincount(chart[used], values[used]) for values in (area, np.abs(signed_areas(uv)))]
        uv[used] *= np.sqrt(sums[0] / sums[1])[chart[used], None, None]
        return chart, uv, shared


def _mend_charts(
    group: Int64, uv: Float64, position: Float64, normal: Float64, area: Float64, tri_polygon: IntArray, tri_corner: IntArray
) -> tuple[Int64, Float64]:
    """Charts of xatlas, -1 where it left a triangle out, as they are to be, and a chart for what has none."""
    placed = group >= 0
    uv[placed] = _restore_proportions(position[placed], uv[placed], area[placed], group[placed])
    uv[placed] = _project_flat_charts(position[placed], normal[placed], area[placed], uv[placed], group[placed])
    polygon = np.unique(tri_polygon, return_inverse=True)[1].ravel()
    alone = np.zeros(polygon.max() + 1, bool)
    bad = ~placed | (signed_areas(uv) < _LEAST_STRETCH * area)
    bad[_torn_corners(group, uv, tri_corner)] = True
    bad[placed] |= _find_overlaps_in_charts(group[placed], uv[placed])
    for _ in range(3):  # out of its chart, then out of its plane; by then nothing can overlap
        if not bad.any():
            break
        broken = np.zeros(len(alone), bool)
        broken[polygon[bad]] = True
        again = np.flatnonzero(broken[polygon])
        tried = alone[polygon[again]]
        uv[again] = _unfold_polygons(position[again], normal[again], area[again], polygon[again], tri_corner[again], tried)
        group[again] = len(group) + polygon[again]
        alone |= broken
        bad = _find_overlaps_in_charts(group, uv)
    return group, uv


def _find_overlaps_in_charts(group: Int64, uv: Float64) -> Bool:
    """Triangles that lie over others of their chart, as far as a raster tells; the charts are put on shelves to see them all at once."""
    chart = np.unique(group, return_inverse=True)[1].ravel()
    area = signed_areas(uv)
    overlapping: Bool = area == 0
    apart = _find_hinged(chart, uv, area)
    if (overlapping | apart).all():
        return overlapping
    low, high = np.full((chart.max() + 1, 2), np.inf), np.full((chart.max() + 1, 2), -np.inf)
    for axis in range(2):
        np.minimum.at(low[:, axis], chart, uv[..., axis].min(axis=1))
        np.maximum.at(high[:, axis], chart, uv[..., axis].max(axis=1))
    side = (high - low) * 1.01
    order = np.argsort(-side[:, 1], kind="stable")
    along = np.cumsum(side[order, 0]) - side[order, 0]
    shelf = np.floor(along / (float(side.prod(axis=1).sum()) ** 0.5 + float(side[:, 0].max()))).astype(np.int64)
    _, first, shelf = np.unique(shelf, return_index=True, return_inverse=True)
    height = side[order[first], 1]  # the first on a shelf is the highest
    origin = np.empty_like(side)
    origin[order] = np.stack([along - along[first][shelf], (np.cumsum(height) - height)[shelf]], axis=1)
    spread = uv + (origin - low)[chart][:, None]
    drawn = ~overlapping
    overlapping[drawn] = find_overlaps(spread[drawn] / float(spread.max()), apart[drawn])
    return overlapping


def _find_hinged(chart: Int64, uv: Float64, area: Float64) -> Bool:
    """(n,) bool: triangles of charts of one or two, the two on different sides of a side that they share; most charts are such, and the
    triangles of none lie over each other."""
    order = np.argsort(chart, kind="stable")
    first = np.flatnonzero(np.diff(chart[order], prepend=-1))
    count = np.diff(first, append=len(chart))
    hinged = np.zeros(len(chart), bool)
    hinged[order[first[count == 1]]] = True
    one, other = order[first[count == 2]], order[first[count == 2] + 1]
    start, end = uv[one], np.roll(uv[one], -1, axis=1)
    meets = np.zeros(len(one), bool)
    for turn in range(3):  # side k of the one is a side of the other, walked the other way
        other_end, other_start = np.roll(uv[other], turn, axis=1), np.roll(uv[other], turn - 1, axis=1)
        meets |= ((start == other_start) & (end == other_end)).all(axis=2).any(axis=1)
    meets &= (area[one] > 0) & (area[other] > 0)
    hinged[one[meets]] = hinged[other[meets]] = True
    return hinged


class _Asked:
    """A question to xatlas, and how its answer is read."""

    def __init__(self, position: Float64, tri_vertex: IntArray, area: Float64) -> None:
        _, first, vertex = np.unique(tri_vertex, return_index=True, return_inverse=True)
        vertex = vertex.reshape(-1, 3)
        label = join_sets(len(first), vertex.ravel(), np.roll(vertex, -1, axis=1).ravel())[vertex[:, 0]]
        order = np.argsort(label, kind="stable")
        # Loose parts go in apart, each centred and scaled: a teaspoon in a hall would drown in float32.
        self._parts = np.split(order, np.flatnonzero(np.diff(label[order])) + 1)
        meshes: list[Mesh] = []
        scaled_area = 0.0
        for part in self._parts:
            points = position[part]
            points = points - 0.5 * (points.min(axis=(0, 1)) + points.max(axis=(0, 1)))
            # xatlas leaves out triangles by an absolute area, so the usual one has area 1.
            scale = min(float(np.median(area[part])) ** -0.5, _LARGEST_COORDINATE / float(np.abs(points).max()))
            scaled_area += float(area[part].sum()) * scale**2
            _, first, index = np.unique(vertex[part], return_index=True, return_inverse=True)
            points = points.reshape(-1, 3)[first] * scale
            meshes.append((np.ascontiguousarray(points, np.float32), np.ascontiguousarray(index.reshape(-1, 3), np.uint32)))
        self.answer = unfold_meshes(meshes, scaled_area)
        self._count = len(area)

    def read(self) -> tuple[Int64, Float64]:
        """Chart of each triangle, -1 where xatlas leaves it out, and UVs of any scale and proportion."""
        group, uv = np.full(self._count, -1, np.int64), np.zeros((self._count, 3, 2))
        for part, unfolded in zip(self._parts, self.answer.result(), strict=True):
            group[part], uv[part] = unfolded
        return group, uv


def _restore_proportions(position: Float64, uv: Float64, area: Float64, group: Int64) -> Float64:
    """Charts as they were before xatlas stretched them to whole texels: as conformal as a scale along u and v can make them, not
    mirrored, and of their area in space."""
    edge, uv_edge = position[:, 1:] - position[:, :1], uv[:, 1:] - uv[:, :1]
    uv_area = signed_areas(uv)
    steep = np.abs(uv_area) > 1e-9 * (uv_edge**2).sum(axis=(1, 2))  # others have no derivative
    weight = np.where(steep, area / np.where(steep, uv_area**2, 1.0), 0.0)
    along_u = ((edge[:, 0] * uv_edge[:, 1, 1:] - edge[:, 1] * uv_edge[:, 0, 1:]) ** 2).sum(axis=1)
    along_v = ((edge[:, 1] * uv_edge[:, 0, :1] - edge[:, 0] * uv_edge[:, 1, :1]) ** 2).sum(axis=1)
    n_chart = group.max() + 1
    sums = [np.bincount(group, values, n_chart) for values in (weight * along_u, weight * along_v, area, uv_area)]
    known = (sums[0] > 0) & (sums[1] > 0)
    ratio = np.sqrt(np.where(known, sums[0], 1.0) / np.where(known, sums[1], 1.0)) ** 0.5
    size = np.sqrt(sums[2] / np.where(sums[3] != 0, np.abs(sums[3]), 1.0))
    scale = np.stack([np.where(sums[3] < 0, -1.0, 1.0) * size * ratio, size / ratio], axis=1)
    restored: Float64 = uv * scale[group][:, None]
    return restored


def _project_flat_charts(position: Float64, normal: Float64, area: Float64, uv: Float64, group: Int64) -> Float64:
    """Flat charts projected onto their planes, which is exact; the others as they are."""
    n_chart = group.max() + 1
    axis = _sum_by(group, normal * area[:, None], n_chart)
    length = np.linalg.norm(axis, axis=1)
    axis = axis / np.where(length > 0, length, 1.0)[:, None]
    centre = _sum_by(group, position.mean(axis=1), n_chart) / np.maximum(np.bincount(group, minlength=n_chart), 1)[:, None]
    offset = position - centre[group][:, None]
    height, extent = np.zeros(n_chart), np.zeros(n_chart)
    np.maximum.at(height, group, np.abs(_dot(offset, axis[group][:, None])).max(axis=1))
    np.maximum.at(extent, group, np.abs(offset).max(axis=(1, 2)))
    facing = (normal * axis[group]).sum(axis=1) > 0
    is_flat: Bool = (height <= _FLATNESS * extent)[group] & (np.bincount(group, ~facing, n_chart) == 0)[group]
    return np.where(is_flat[:, None, None], _project(offset, axis[group]), uv)


def _project(position: Float64, axis: Float64) -> Float64:
    tangent, bitangent = orthonormal_basis(axis)
    return np.stack([_dot(position, tangent[:, None]), _dot(position, bitangent[:, None])], axis=2)


def _dot(one: Float64, other: Float64) -> Float64:
    """Products summed term by term: the same for the same vectors wherever they stand, which einsum does not promise."""
    x, y, z = (one[..., k] * other[..., k] for k in range(3))
    return np.asarray(x + y + z)


def _sum_by(group: Int64, values: Float64, count: int) -> Float64:
    return np.stack([np.bincount(group, values[:, k], count) for k in range(3)], axis=1)


def _torn_corners(group: Int64, uv: Float64, tri_corner: IntArray) -> Int64:
    """Triangles with a corner that has another UV or chart in another triangle."""
    one, other = pair_corners(tri_corner, np.ones(len(tri_corner), bool))
    flat_uv = uv.reshape(-1, 2)
    torn = (group[one // 3] != group[other // 3]) | (flat_uv[one] != flat_uv[other]).any(axis=1)
    torn_tri: Int64 = np.concatenate([one[torn], other[torn]]) // 3
    return torn_tri


def _unfold_polygons(position: Float64, normal: Float64, area: Float64, polygon: Int64, tri_corner: IntArray, tried: Bool) -> Float64:
    """Each polygon by itself: quads over their diagonal, which is isometric; others projected onto their plane.

    Triangles of a polygon are consecutive. A polygon that its plane folds, or winds twice about a corner, or that was
    tried in vain, is laid out on a circle.
    """
    _, first, polygon, count = np.unique(polygon, return_index=True, return_inverse=True, return_counts=True)
    polygon = polygon.ravel()
    axis = _sum_by(polygon, normal * area[:, None], len(first))
    length = np.linalg.norm(axis, axis=1)
    axis = np.where(length[:, None] > 0, axis / np.where(length > 0, length, 1.0)[:, None], normal[first])
    uv = _project(position - position[first[polygon], :1], axis[polygon])
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
    """(n, 3) float64, rad: all that triangles take up together about each corner."""
    after, before = np.roll(uv, -1, axis=1) - uv, np.roll(uv, 1, axis=1) - uv
    cross = after[..., 0] * before[..., 1] - after[..., 1] * before[..., 0]
    angle = np.arctan2(np.abs(cross), (after * before).sum(axis=2))
    corner = np.unique(tri_corner, return_inverse=True)[1].ravel()
    total: Float64 = np.bincount(corner, angle.ravel())[corner].reshape(tri_corner.shape)
    return total


def _unfold_pairs(position: Float64, tri_corner: IntArray, first: Int64, uv: Float64) -> Int64:
    """Writes the UVs of triangles `first` and `first + 1`, turned about their common side into one plane.

    Gives those of `first` that have a common side.
    """
    # Side i of the one triangle is side j of the other, walked the other way.
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
    """A polygon's corners in their order on a circle, as far apart as in space: in convex position no triangulation overlaps."""
    _, first, index = np.unique(tri_corner, return_index=True, return_inverse=True)
    rim = position.reshape(-1, 3)[first]
    length = np.linalg.norm(np.roll(rim, -1, axis=0) - rim, axis=1)
    length = np.maximum(length, 1e-3 * length.mean())  # corners in one place would leave a triangle without area
    angle = 2.0 * np.pi * (np.cumsum(length) - length) / length.sum()
    uv: Float64 = np.stack([np.cos(angle), np.sin(angle)], axis=1)[index.reshape(tri_corner.shape)]
    scale = (area / max(float(np.abs(signed_areas(uv)).sum()), 1e-30)) ** 0.5
    scaled: Float64 = uv * scale
    return scaled
