"""Connectivity of meshes: shared corners, shared sides and connected sets of triangles."""

from threading import Lock

import numpy as np
from numpy.typing import NDArray

from ..util.arrays import BoolArray, Float64, Int64, IntArray
from .scene import SceneSnapshot

_MIX = np.uint64(0x9E3779B97F4A7C15)  # odd, near 2^64 over the golden ratio. Source: Knuth 1998, 6.4 (Fibonacci hashing)


def pair_corners(tri_corner: IntArray, used: BoolArray) -> tuple[Int64, Int64]:
    """Pairs of indices, in the flattened array, of one corner in two used triangles; enough pairs to connect all triangles of a corner.

    tri_corner   (n, 3) int
    used         (n,) bool
    """
    corner = tri_corner.ravel()
    order = np.argsort(corner, kind="stable")
    order = order[used[order // 3]]
    here, after = order[:-1], order[1:]
    same = corner[here] == corner[after]
    return here[same], after[same]


def pair_sides(tri_vertex: IntArray, tri_group: IntArray, tri_uv: Float64 | None = None) -> tuple[Int64, Int64, Int64]:
    """Pairs of sides that two triangles of one group share; if an edge has more than two sides, successive ones are paired.

    tri_vertex   (n, 3) int
    tri_group    (n,) int         -1 for triangles without a group
    tri_uv       (n, 3, 2) float64: orders the sides of an edge that has more than two
    out          (2, 3 n) int64 ends of every side, as indices of flattened corners, that of the lower vertex first; (m,) int64 side of one
                 triangle and (m,) int64 of the other; side k starts at corner k
    """
    start = np.arange(tri_vertex.size)
    ends = np.stack([start, start - start % 3 + (start + 1) % 3])
    vertex = tri_vertex.ravel().astype(np.int64)
    ends = np.where(vertex[ends[0]] > vertex[ends[1]], ends[::-1], ends)
    edge = vertex[ends[0]] * (int(vertex.max(initial=0)) + 1) + vertex[ends[1]]  # one number is sorted faster than two
    group = np.repeat(tri_group, 3)
    order = np.lexsort((edge, group))
    order = order[np.count_nonzero(group < 0) :]
    edge, group = edge[order], group[order]
    same = (edge[:-1] == edge[1:]) & (group[:-1] == group[1:])
    if tri_uv is not None:
        run = np.cumsum(np.append(np.zeros(len(order[:1]), bool), ~same))
        crowded = np.flatnonzero(np.bincount(run)[run] > 2)
        sides = order[crowded]
        u, v = tri_uv.reshape(-1, 2)[ends[0, sides]].T
        order[crowded] = sides[np.lexsort((v, u, run[crowded]))]
    return ends, order[:-1][same], order[1:][same]


def find_ends(vertex_position: Float64, ends: IntArray) -> Int64:
    """(2, m) int64: numbers of the positions where sides, given by vertices ends (2, m), end; the lower one first.

    Files often have a vertex once for each of its normals or texture coordinates, so edges are identified by position.
    """
    vertex, row = np.unique(ends, return_inverse=True)
    position = vertex_position[vertex]
    order = np.lexsort(position.T[::-1])
    number = np.zeros(len(vertex), np.int64)
    number[order[1:]] = np.cumsum((np.diff(position[order], axis=0) != 0.0).any(axis=1))
    return np.sort(number[row.reshape(np.shape(ends))], axis=0)


def join_open_sides(vertex_position: Float64, tri_vertex: IntArray, tri_group: IntArray) -> Int64:
    """(n, 3) int64: tri_vertex, with vertices merged where open sides coincide, so that the surface is connected there.

    Files often have a vertex once for each of its normals or texture coordinates. Touching bodies that are closed by their own vertices
    stay separate.

    vertex_position   (n_vertex, 3) float64, m
    tri_vertex        (n, 3) int
    tri_group         (n,) int, not negative   groups have no vertices in common, and their sides stay separate
    """
    vertex = tri_vertex.astype(np.int64)
    place = _number_places(vertex_position, vertex, tri_group)
    doubtful = np.flatnonzero(_find_crowded(place, vertex, tri_group)[tri_group])
    ends, one, other = pair_sides(vertex[doubtful], tri_group[doubtful])
    is_alone = np.ones(ends.shape[1], bool)
    is_alone[one] = is_alone[other] = False
    alone = np.flatnonzero(is_alone)
    side = vertex[doubtful].ravel()[ends[:, alone]]
    start, end = place[side]
    edge = np.minimum(start, end) * len(vertex_position) + np.maximum(start, end)  # one number is sorted faster than two
    order = np.argsort(edge, kind="stable")
    here, after = order[:-1], order[1:]
    same = edge[here] == edge[after]
    here, after = here[same], after[same]
    met = np.where(start[here] != start[after], side[::-1, after], side[:, after])
    return join_sets(len(vertex_position), side[:, here].ravel(), met.ravel())[vertex]


def find_groups_with_twins(vertex_position: Float64, tri_vertex: IntArray, tri_group: IntArray) -> BoolArray:
    """(n_group,) bool: groups with two vertices at one position.

    Arguments as in join_open_sides.
    """
    return _find_crowded(_number_places(vertex_position, tri_vertex, tri_group), tri_vertex, tri_group)


def _find_crowded(place: Int64, tri_vertex: IntArray, tri_group: IntArray) -> BoolArray:
    """(n_group,) bool: groups with vertices that share their position; place (n_vertex,) from _number_places."""
    crowd = np.bincount(place[place >= 0]) > 1
    out = np.zeros(int(tri_group.max(initial=-1)) + 1, bool)
    out[tri_group[crowd[place[tri_vertex]].any(axis=1)]] = True
    return out


def _number_places(vertex_position: Float64, tri_vertex: IntArray, tri_group: IntArray) -> Int64:
    """(n_vertex,) int64: number_points of vertices by the group of their triangles; -1 for those of no triangle."""
    group, number = np.full((2, len(vertex_position)), -1)
    group[tri_vertex] = tri_group[:, None]
    used = np.flatnonzero(group >= 0)
    number[used] = number_points(vertex_position[used], group[used])
    return number


def number_points(point: Float64, group: IntArray) -> Int64:
    """(n,) int64, below n: numbers of points (n, k), equal for those of one group (n,) at one position.

    Hash collisions may give different numbers to a position, with a probability of 10^-6 among millions of points.
    """
    order = np.argsort(hash_points(point, group))
    here, group_here = point[order], group[order]
    differs = (here[1:] != here[:-1]).any(axis=1) | (group_here[1:] != group_here[:-1])
    number = np.zeros(len(point), np.int64)
    number[order[1:]] = np.cumsum(differs)
    return number


def hash_points(point: Float64, group: IntArray | int = 0) -> NDArray[np.uint64]:
    """(...): hashes of points (..., k) of groups (...), which are sorted several times faster than coordinates."""
    mixed = np.full(point.shape[:-1], group, np.uint64)
    for axis in range(point.shape[-1]):
        mixed = (mixed ^ (point[..., axis] + 0.0).view(np.uint64)) * _MIX  # -0.0 becomes 0.0
        mixed ^= mixed >> np.uint64(32)
    return mixed


def join_sets(count: int, one: Int64, other: Int64) -> Int64:
    """(count,) int64: the least member of each number's set, after one[i] and other[i] are joined for all i.

    Source: Shiloach & Vishkin 1982, "An O(log n) parallel connectivity algorithm".
    """
    label = np.arange(count)
    while True:
        apart = np.flatnonzero(one != other)
        if not len(apart):
            return label
        one, other = one[apart], other[apart]
        np.minimum.at(label, np.maximum(one, other), np.minimum(one, other))
        while not np.array_equal(above := label[label], label):
            label = above
        one, other = label[one], label[other]  # a set joined to theirs is joined to their labels


class LooseParts:
    """Compares the loose parts of triangles, as in Blender's Separate by Loose Parts. Those of an object are computed when needed.

    Artists join objects that only stand on each other, and files often have a whole house as one mesh. So a body that divides a surface is
    taken to be any other loose part, of the same object or of another. Thread-safe.
    """

    def __init__(self, snapshot: SceneSnapshot) -> None:
        self._snapshot = snapshot
        self._part, self._lock = np.full(snapshot.n_tri, -1), Lock()

    def are_apart(self, one: IntArray, other: IntArray) -> BoolArray:
        """(m,) bool: whether triangles one (m,) and other (m,) belong to different objects or loose parts."""
        thing = self._snapshot.tri_object
        apart: BoolArray = thing[one] != thing[other]
        rows = np.flatnonzero(~apart)
        with self._lock:  # the parts of an object are computed all at once
            self._look_into(thing[one[rows][self._part[one[rows]] < 0]])
        apart[rows] = self._part[one[rows]] != self._part[other[rows]]
        return apart

    def _look_into(self, things: IntArray) -> None:
        if len(things):
            asked = np.zeros(len(self._snapshot.objects), bool)
            asked[things] = True
            tri = np.flatnonzero(asked[self._snapshot.tri_object])
            self._part[tri] = tri[find_loose_parts(self._snapshot, tri)]


def find_loose_parts(snapshot: SceneSnapshot, tri: IntArray) -> Int64:
    """(m,) int64: a label for each triangle (m,): the least index in `tri` among the triangles that are connected with it.

    Triangles that share a side are connected, see topology.join_open_sides.
    """
    thing = snapshot.tri_object[tri]
    _, one, other = pair_sides(join_open_sides(snapshot.vertex_position, snapshot.tri_vertex[tri], thing), thing)
    return join_sets(len(tri), one // 3, other // 3)
