"""Closed solids whose inside is never seen: light that their faces emit inwards never leaves and reaches no texel.

Only certain cases count: loose parts that are closed and convex, have outward normals, and contain nothing else. A closed part that is not
convex may intersect itself, so that a back is visible from outside.
"""

from collections.abc import Iterator

import numpy as np

from ..util.ablation import uses
from ..util.arrays import BoolArray, Float64, IntArray
from ..util.geometry import triangle_normals_areas
from .scene import SceneSnapshot
from .topology import find_loose_parts, join_open_sides

_TOLERANCE = 1e-5  # of a solid's extent; points nearer than this to a face's plane lie on it
_MOST_WORK = 1 << 28  # heights over planes to compute, about a second; further solids count as open
_BOX_WORK = 16  # work to compare a box, in heights
_AT_ONCE = 1 << 18


def find_sealed(snapshot: SceneSnapshot, tri_wanted: BoolArray, tri_passes: BoolArray | None = None) -> BoolArray:
    """(n_tri,) bool: triangles of sealed solids.

    tri_wanted   (n_tri,) bool: only solids with such a triangle are examined
    tri_passes   (n_tri,) bool: triangles that light may pass through; their objects have no sealed solids, nor have two-sided objects
    """
    sealed = np.zeros(snapshot.n_tri, bool)
    keeps_light = np.array([one.casts_shadow and not one.two_sided for one in snapshot.objects], bool)
    if tri_passes is not None:
        keeps_light[snapshot.tri_object[tri_passes]] = False
    wanted = np.zeros(len(snapshot.objects), bool)
    wanted[snapshot.tri_object[tri_wanted]] = True
    tri = np.flatnonzero((wanted & keeps_light)[snapshot.tri_object])
    if not len(tri) or not uses("sealed_solids"):
        return sealed
    vertex = join_open_sides(snapshot.vertex_position, snapshot.tri_vertex[tri], snapshot.tri_object[tri])
    part = find_loose_parts(snapshot, tri)
    search: _Search | None = None
    order = np.argsort(part, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(part[order])) + 1):
        if search and search.is_over:
            break
        if tri_wanted[tri[rows]].any() and _is_closed(vertex[rows]):
            search = search or _Search(snapshot, tri, part)
            sealed[tri[rows]] = search.is_convex_and_empty(tri[rows])
    return sealed


def _is_closed(tri_vertex: IntArray) -> bool:
    """Whether each edge of the triangles (n, 3) has exactly two triangles, with consistent winding."""
    start, end = tri_vertex.ravel(), np.roll(tri_vertex, -1, axis=1).ravel()
    count = int(tri_vertex.max()) + 1
    sides = np.unique(start * count + end)
    return len(sides) == len(start) and np.array_equal(sides, np.unique(end * count + start))


class _Search:
    """Boxes around the scene's triangles and around groups of them (loose parts, or other objects), and the remaining work.

    tri    (n,) int     triangles whose loose part is known
    part   (n,) int64   from find_loose_parts
    """

    def __init__(self, snapshot: SceneSnapshot, tri: IntArray, part: IntArray) -> None:
        self._position = snapshot.tri_position
        self._low, self._high = self._position.min(axis=1), self._position.max(axis=1)
        group = snapshot.tri_object.astype(np.int64)
        group[tri] = len(snapshot.objects) + part
        self._order = np.argsort(group, kind="stable")
        self._start = np.flatnonzero(np.diff(group[self._order], prepend=-1))
        self._end = np.append(self._start[1:], snapshot.n_tri)
        self._group_low = np.minimum.reduceat(self._low[self._order], self._start)
        self._group_high = np.maximum.reduceat(self._high[self._order], self._start)
        self._left = _MOST_WORK

    @property
    def is_over(self) -> bool:
        """Whether the work limit is used up."""
        return self._left < 0

    def is_convex_and_empty(self, tri: IntArray) -> bool:
        """Whether no corner of the solid's triangles (n,), ascending, is in front of any of their planes, and no other triangle is behind
        all of them.
        """
        corners = self._position[tri]
        low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
        gap = _TOLERANCE * float((high - low).max())
        normal, area = triangle_normals_areas(corners)
        normal, base = normal[area > 0], corners[area > 0, 0]
        points = np.unique(corners.reshape(-1, 3), axis=0)
        if not all((height <= gap).all() for height in self._measure(points, normal, base)):
            return False
        near = np.flatnonzero(_overlap(self._group_low, self._group_high, low + gap, high - gap))
        others = np.concatenate([np.zeros(0, np.int64), *(self._order[self._start[i] : self._end[i]] for i in near)])
        self._left -= _BOX_WORK * (len(self._start) + len(others))
        others = np.setdiff1d(others[_overlap(self._low[others], self._high[others], low + gap, high - gap)], tri)
        heights = self._measure(self._position[others].reshape(-1, 3), normal, base)
        return all((height.reshape(len(normal), -1, 3).min(axis=2) >= -gap).any(axis=0).all() for height in heights)

    def _measure(self, points: Float64, normal: Float64, base: Float64) -> Iterator[Float64]:
        """Heights (n, k) of successive chunks of points (m, 3) over the planes through base (n, 3) with normals (n, 3); nan once the work
        limit is used up.
        """
        level = (normal * base).sum(axis=1)[:, None]
        at_once = max(_AT_ONCE // len(normal) // 3, 1) * 3
        for start in range(0, len(points), at_once):
            some = points[start : start + at_once]
            self._left -= len(normal) * len(some)
            yield normal @ some.T - level if self._left >= 0 else np.full((len(normal), len(some)), np.nan)


def _overlap(low: Float64, high: Float64, other_low: Float64, other_high: Float64) -> BoolArray:
    """(n,) bool: whether the interiors of boxes (n, 3) intersect that of another (3,)."""
    return ((low < other_high) & (high > other_low)).all(axis=1)
