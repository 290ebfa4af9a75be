"""Cuts charts along creases, so that no leaf covers faces of different orientation.

Light is discontinuous across a crease, as between charts. A leaf over both sides represents neither, and a texel that both share would show
their mean, where image filters expect the light of the side that holds its centre. Light is discontinuous, too, at the foot of a wall that
shares an edge with the floor, though the floor is flat there.
"""

import dataclasses
import math

import numpy as np

from ..atlas.charts import ChartAtlas
from ..atlas.layer_check import signed_areas
from ..scene.scene import SceneSnapshot
from ..scene.topology import find_ends, find_groups_with_twins, join_open_sides, join_sets, pair_sides
from ..util.arrays import BoolArray, Float64, FloatArray, IntArray

_CREASE_COSINE = math.cos(math.radians(20.0))  # between shading normals at an edge's end; 2 and 8 degrees bake no better, with more leaves
# texels; adjacent narrower faces form a rough surface whose mean the texels show, since each face alone would receive too few photons
_LEAST_WIDTH = 2.0
_LOST_WIDTH = 4.0  # texels; narrower faces that border mostly on such faces belong to that surface too


def cut_at_creases(snapshot: SceneSnapshot, atlas: ChartAtlas) -> ChartAtlas:
    """The atlas with charts cut at edges where shading normals differ or a wall stands; nothing moves on the pages."""
    used = np.flatnonzero(atlas.tri_chart >= 0)
    thing = snapshot.tri_object[used]
    vertex = join_open_sides(snapshot.vertex_position, snapshot.tri_vertex[used], thing)
    ends, one, other = pair_sides(vertex, atlas.tri_chart[used])
    normal = snapshot.tri_normal[used].reshape(-1, 3)[ends]
    smooth = ~_differ(normal[:, one], normal[:, other]).any(axis=0)
    smooth &= ~_find_feet(snapshot.vertex_position, vertex, thing)[one]
    facet = join_sets(len(used), one[smooth] // 3, other[smooth] // 3)
    narrow = _find_narrow(atlas.tri_uv[used], facet, np.stack([one, other]), smooth)[facet]
    one, other = one // 3, other // 3
    joined = smooth | (narrow[one] & narrow[other])
    _, first, label = np.unique(join_sets(len(used), one[joined], other[joined]), return_index=True, return_inverse=True)
    tri_chart = np.full(len(atlas.tri_chart), -1, np.int32)
    tri_chart[used] = label.ravel()
    whole = atlas.tri_chart[used[first]]
    return dataclasses.replace(atlas, tri_chart=tri_chart, chart_page=atlas.chart_page[whole], chart_object=atlas.chart_object[whole])


def _find_feet(vertex_position: Float64, tri_vertex: IntArray, tri_object: IntArray) -> BoolArray:
    """(3 n,) bool: sides at edges where surfaces of one object meet in three directions or more; all triangles have an area.

    vertex_position   (n_vertex, 3) float64, m
    tri_vertex        (n, 3) int            as topology.join_open_sides has them
    tri_object        (n,) int
    """
    ends, one, other = pair_sides(tri_vertex, tri_object)
    crowded = find_groups_with_twins(vertex_position, tri_vertex, tri_object)
    leads = np.zeros(ends.shape[1], bool)
    leads[one] = True
    crowded[tri_object[other[leads[other]] // 3]] = True  # a side that is in two pairs: its edge has three sides or more
    side = np.flatnonzero(np.repeat(crowded[tri_object], 3))
    foot = np.zeros(ends.shape[1], bool)
    if len(side):
        start, end = find_ends(vertex_position, tri_vertex.ravel()[ends[:, side]])
        # Numbers are sorted several times faster than rows of three.
        place = np.unique(start * len(vertex_position) + end, return_inverse=True)[1].ravel()
        edge = np.unique(place * (int(tri_object.max()) + 1) + tri_object[side // 3], return_inverse=True)[1].ravel()
        foot[side] = _fork(edge, _point_off(vertex_position[tri_vertex[side // 3]], side % 3))[edge]
    return foot


def _point_off(corner: Float64, side: IntArray) -> Float64:
    """(m, 3) float64, unit: inward directions in the planes of triangles, perpendicular to their sides (m,); corner (m, 3, 3)."""
    rows = np.arange(len(side))
    start, end, far = (corner[rows, (side + k) % 3] for k in range(3))
    along = (end - start) / np.linalg.norm(end - start, axis=1)[:, None]
    off = far - start
    off -= (off * along).sum(axis=1)[:, None] * along
    return off / np.linalg.norm(off, axis=1)[:, None]


def _fork(edge: IntArray, direction: Float64) -> BoolArray:
    """(n_edge,) bool: whether an edge has sides in three directions or more; directions (m, 3) of sides at edges (m,), numbered without
    gaps.
    """
    count = np.bincount(edge)
    first = np.unique(edge, return_index=True)[1]
    cosine = (direction * direction[first[edge]]).sum(axis=1)
    least = np.lexsort((cosine, edge))[np.cumsum(count) - count]  # the side that differs most from the first of its edge
    differs = (cosine < _CREASE_COSINE) & ((direction * direction[least[edge]]).sum(axis=1) < _CREASE_COSINE)
    return np.bincount(edge, differs, len(count)) > 0


def _differ(one: FloatArray, other: FloatArray) -> BoolArray:
    """(2, m) bool: whether normals (2, m, 3) form a crease; not where one of them is 0."""
    has_normals = one.any(axis=-1) & other.any(axis=-1)
    return has_normals & ((one * other).sum(axis=-1) < _CREASE_COSINE)


def _find_narrow(tri_uv: FloatArray, facet: IntArray, pair: IntArray, smooth: BoolArray) -> BoolArray:
    """(n,) bool: whether facets belong to a rough surface.

    tri_uv   (n, 3, 2) float64, texels
    facet    (n,) int64, below n: facet of each triangle
    pair     (2, m) int64: sides that share an edge; side 3 i + k starts at corner k of triangle i
    smooth   (m,) bool: whether the edge lies within a facet; else it is a crease
    """
    length = np.linalg.norm(np.roll(tri_uv, -1, axis=1) - tri_uv, axis=2).ravel()
    outer = length.copy()
    outer[pair[:, smooth]] = 0.0
    around = np.bincount(np.repeat(facet, 3), outer, minlength=len(facet))
    area = np.bincount(facet, np.abs(signed_areas(tri_uv)), minlength=len(facet))
    # For a square this is its side, for a long strip twice its width.
    width = np.divide(4.0 * area, around, out=np.zeros(len(facet)), where=around > 0.0)
    narrow = width < _LEAST_WIDTH
    crease = pair[:, ~smooth]
    here, there = np.concatenate([crease, crease[::-1]], axis=1)
    beside = narrow[facet[there // 3]]
    among = np.bincount(facet[here[beside] // 3], length[here[beside]], minlength=len(facet))
    return narrow | ((width < _LOST_WIDTH) & (among > 0.5 * around))
