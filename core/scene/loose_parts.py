"""Loose parts of objects: triangles connected by edges, as in Blender's Separate by Loose Parts.

Artists join objects that only stand on each other, and files often have a whole house as one mesh. So a body that divides a surface is
taken to be any other loose part, of the same object or of another.
"""

from __future__ import annotations

from threading import Lock

import numpy as np

from ..util.arrays import BoolArray, Int64, IntArray
from .scene import SceneSnapshot
from .topology import join_open_sides, join_sets, pair_sides


class LooseParts:
    """Compares the loose parts of triangles; the parts of an object are computed when two of its triangles are first compared.

    Thread-safe.
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
