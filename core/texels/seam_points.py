"""Seams that should be invisible: mesh edges on two chart borders across which the shading is continuous.

Light is the same on both sides of smooth-shaded edges, and between flat faces in one plane.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..scene.scene import SceneSnapshot
from ..scene.topology import find_ends, join_open_sides, pair_sides
from ..util.arrays import BoolArray, Float32, Float64, Int32, Int64
from ..util.coverage import expand_ranges

_SAME_NORMAL = 0.9998  # cosine, about a degree: a greater angle between shading normals is intended to be visible
_SHARPEST = 0.5  # cosine between faces, whatever their shading normals: below it one of them faces away from the light of the other
_SAME_PLACE = 1e-3  # texels
_POINTS_PER_TEXEL = 2.0  # along an edge


@dataclass(frozen=True)
class SeamPoints:
    """Points on seams, with their places on both sides.

    n_edge     number of edges
    page       (2, m) int32
    place      (2, m, 2) float64, page texels
    tri        (2, m) int32
    weight     (2, m, 2) float32, of the triangle's corners 1 and 2
    """

    n_edge: int
    page: Int32
    place: Float64
    tri: Int32
    weight: Float32


def find_seams(snapshot: SceneSnapshot, tri_chart: Int32, tri_uv: Float64, tri_page: Int32) -> SeamPoints:
    """Points on edges of the scene that lie on chart borders and across which light is continuous.

    tri_chart   (n_tri,) int32           -1 for triangles without texels
    tri_uv      (n_tri, 3, 2) float64    page texels
    tri_page    (n_tri,) int32
    """
    side, other = _pair_sides(snapshot, tri_chart, tri_uv)
    start, end = side, _next_corner(side)
    # Ends of the other side, in the same order.
    position = snapshot.vertex_position[snapshot.tri_vertex].reshape(-1, 3)
    turned = (position[other] != position[start]).any(axis=1)
    other_start, other_end = np.where(turned, _next_corner(other), other), np.where(turned, other, _next_corner(other))
    normal = snapshot.tri_normal.reshape(-1, 3)
    edge = position.reshape(-1, 3, 3)[:, 1:] - position.reshape(-1, 3, 3)[:, :1]
    flat = np.cross(edge[:, 0], edge[:, 1])
    smooth = _are_near(normal[start], normal[other_start], _SAME_NORMAL) & _are_near(normal[end], normal[other_end], _SAME_NORMAL)
    smooth &= _are_near(flat[start // 3], flat[other_start // 3], _SHARPEST)
    two_sided = np.array([one.two_sided for one in snapshot.objects], bool)[snapshot.tri_object]
    shows_both = two_sided | snapshot.tri_translucent
    smooth &= shows_both[start // 3] == shows_both[other // 3]
    ends = np.stack([[start, end], [other_start, other_end]])[:, :, smooth]  # side, end, edge
    uv = tri_uv.reshape(-1, 2)[ends]
    length = np.linalg.norm(uv[:, 1] - uv[:, 0], axis=2).max(axis=0)
    count = np.ceil(length * _POINTS_PER_TEXEL).astype(np.int64)
    owner, step = expand_ranges(np.zeros_like(count), count)
    along = ((step + 0.5) / count[owner])[None, :, None]
    place = uv[:, 0, owner] * (1.0 - along) + uv[:, 1, owner] * along
    corner_weight = np.eye(3)[ends % 3][..., 1:]
    weight = corner_weight[:, 0, owner] * (1.0 - along) + corner_weight[:, 1, owner] * along
    tri = (ends[:, 0, owner] // 3).astype(np.int32)
    return SeamPoints(ends.shape[2], tri_page[tri], place, tri, weight.astype(np.float32))


def _next_corner(corner: Int64) -> Int64:
    return corner - corner % 3 + (corner + 1) % 3


def _are_near(one: NDArray[Any], other: NDArray[Any], cosine: float) -> BoolArray:
    lengths = np.linalg.norm(one, axis=1) * np.linalg.norm(other, axis=1)
    return ((one * other).sum(axis=1) >= cosine * lengths) & (lengths > 0.0)


def _pair_sides(snapshot: SceneSnapshot, tri_chart: Int32, tri_uv: Float64) -> tuple[Int64, Int64]:
    """Pairs of sides that are one edge in space but lie at two places of the pages; a side is the number of the corner it starts from.

    Edges that more than two sides share are left out.
    """
    joined = join_open_sides(snapshot.vertex_position, snapshot.tri_vertex, snapshot.tri_object)
    corners, one, other = pair_sides(joined, tri_chart)
    uv = tri_uv.reshape(-1, 2)[corners]
    together = (np.abs(uv[:, one] - uv[:, other]) < _SAME_PLACE).all(axis=(0, 2))
    lies_apart = np.repeat(tri_chart >= 0, 3)
    lies_apart[one[together]] = lies_apart[other[together]] = False
    border = np.flatnonzero(lies_apart)
    vertex = snapshot.tri_vertex.ravel()
    low, high = find_ends(snapshot.vertex_position, vertex[np.stack([border, _next_corner(border)])])
    order = np.lexsort((high, low))
    first = np.append(True, (low[order][1:] != low[order][:-1]) | (high[order][1:] != high[order][:-1]))
    begin = np.flatnonzero(first[: len(order)])
    pairs = begin[np.diff(np.append(begin, len(order))) == 2]
    side, other = border[order[pairs]], border[order[pairs + 1]]
    long = low[order[pairs]] != high[order[pairs]]
    return side[long], other[long]
