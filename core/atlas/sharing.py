"""Sharing of charts between copies of a mesh, and between objects with a common mesh and similar shapes and sizes. The latter are blocks:
their charts are packed once, then moved and scaled as one.
"""

from __future__ import annotations

import math
from bisect import bisect_left, insort
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from hashlib import blake2b
from itertools import pairwise
from operator import itemgetter

import numpy as np

from ..scene.scene import SceneSnapshot
from ..util.arrays import BoolArray, Float64, FloatArray, Int64, IntArray
from ..util.geometry import triangle_normals_areas
from .outlines import Outlines
from .packing import Layout, Page, place_charts, shape_charts

MAX_STRETCH = 2.0  # longest over shortest scale of an object's edges relative to its charts'; beyond it texels are needles
MAX_SIZE_RATIO = 4.0  # greatest ratio of sizes to the owner of the charts, either way; gaps are as wide as the smallest object needs
_SAME_SHAPE = 1e-4  # tolerance of copies' corners, relative to the object's size: float32 is coarse far from the mesh's origin
_SAMPLED_TRIANGLES = 1024
_TRIANGLES_AT_ONCE = 1 << 14
_SHORTEST = 1e-6  # of an object's longest edge; shorter edges count as this long


@dataclass(frozen=True)
class Block:
    """Two or more objects that share charts; the first one is unwrapped.

    size   (n,) float64   square root of each object's area over the first one's, times the ratio of their densities
    """

    members: tuple[int, ...]
    size: Float64


def find_blocks(snapshot: SceneSnapshot) -> list[Block]:
    """All blocks of a scene. An object whose mesh is shared is in none if no other object fits it."""
    rows = [slice(*ends) for ends in pairwise(snapshot.first_tri.tolist())]
    sharing: dict[tuple[int, bytes], list[int]] = {}
    for i, one in enumerate(snapshot.objects):
        if one.mesh >= 0 and one.receives and not one.has_layer:
            # Sorted, since a mirrored object has its corners in the opposite order. Objects that lack triangles may have other charts.
            corners = np.sort(snapshot.tri_corner[rows[i]], axis=1)
            sharing.setdefault((one.mesh, corners.tobytes()), []).append(i)
    blocks: list[Block] = []
    for members in sharing.values():
        if len(members) < 2:
            continue
        position = [snapshot.vertex_position[snapshot.tri_vertex[rows[i]]] for i in members]
        area = np.array([float(triangle_normals_areas(corners)[1].sum()) for corners in position])
        area *= np.array([snapshot.objects[i].density_factor for i in members]) ** 2
        solid = np.flatnonzero(area > 0)
        lengths = [_log_lengths(position[k], snapshot.tri_corner[rows[members[k]]]) for k in solid]
        for group in group_alike(np.stack(lengths)) if lengths else []:
            chosen = solid[group]
            if len(group) > 1:
                blocks.append(Block(tuple(members[k] for k in chosen), np.sqrt(area[chosen] / area[chosen[0]])))
    return blocks


def find_copies(snapshot: SceneSnapshot, tri_vertex: IntArray, objects: list[int]) -> dict[int, tuple[int, float]]:
    """Objects that are copies of an earlier one among `objects`, up to translation, rotation and scale, but not mirrored. Maps each to the
    earlier object and the ratio of their sizes times the ratio of their densities.

    tri_vertex   (n_tri, 3) int   vertices; objects have none in common
    """
    start = snapshot.first_tri
    alike: dict[bytes, list[int]] = {}
    for i in (i for i in objects if start[i] < start[i + 1]):
        rows = slice(int(start[i]), int(start[i + 1]))
        vertex = tri_vertex[rows] - tri_vertex[rows].min()
        parts = (snapshot.tri_corner[rows], vertex)  # corners determine polygons, too
        alike.setdefault(blake2b(b"".join(part.astype(np.int64).tobytes() for part in parts)).digest(), []).append(i)
    copies: dict[int, tuple[int, float]] = {}
    for group in alike.values():
        # The first object of each shape, ordered by the mean of the shape's lengths, which is equal for equal shapes.
        first: list[tuple[float, int, Float64, float]] = []
        for i, shape, size in _measure_shapes(snapshot, start, group) if len(group) > 1 else []:
            mean = float(shape.mean())
            near = slice(*(bisect_left(first, mean + side, key=itemgetter(0)) for side in (-_SAME_SHAPE, _SAME_SHAPE)))
            leaders = [one for one in first[near] if np.abs(shape - one[2]).max() <= _SAME_SHAPE]
            if size > 0 and leaders:
                _, leader, _, of_leader = min(leaders, key=itemgetter(1))
                copies[i] = leader, size / of_leader
            elif size > 0:
                insort(first, (mean, i, shape, size), key=itemgetter(0))
    return copies


def _measure_shapes(snapshot: SceneSnapshot, start: IntArray, group: list[int]) -> Iterator[tuple[int, Float64, float]]:
    """Objects with equal numbers of triangles, their shapes and their sizes. A shape is (n, 6) float64: lengths of the triangles' sides and
    distances of their corners from the mean of all, over sqrt(area). The size is sqrt(area), m, times the density factor.
    """
    n_tri = int(start[group[0] + 1] - start[group[0]])
    at_once = max(_TRIANGLES_AT_ONCE // n_tri, 1)
    for first in range(0, len(group), at_once):
        some = np.array(group[first : first + at_once])
        position = snapshot.vertex_position[snapshot.tri_vertex[start[some][:, None] + np.arange(n_tri)]]
        area = triangle_normals_areas(position.reshape(-1, 3, 3))[1].reshape(len(some), n_tri).sum(axis=1)
        sides = np.linalg.norm(position - np.roll(position, 1, axis=2), axis=3)
        ways = np.linalg.norm(position - position.mean(axis=(1, 2))[:, None, None], axis=3)
        size = np.sqrt(area)
        shape = np.concatenate([sides, ways], axis=2) / np.where(size > 0, size, 1.0)[:, None, None]
        for k, i in enumerate(some.tolist()):
            yield i, shape[k], float(size[k]) * snapshot.objects[i].density_factor


def group_alike(log_length: Float64) -> list[list[int]]:
    """Groups of similar rows: the row nearest to the mean with all rows that fit it, then the same for the rest.

    log_length   (n, n_edge) float64, natural logarithms
    """
    groups: list[list[int]] = []
    left = np.arange(len(log_length))
    while len(left):
        rows = log_length[left]
        distance = ((rows - rows.mean(axis=0)) ** 2).mean(axis=1)
        first = int(np.flatnonzero(distance <= distance.min() + 1e-9)[0])  # the first of equal ones, whatever the rounding
        ratio = rows - rows[first]
        fits = (np.ptp(ratio, axis=1) <= math.log(MAX_STRETCH)) & (np.abs(ratio.mean(axis=1)) <= math.log(MAX_SIZE_RATIO))
        groups.append([int(left[first]), *(int(k) for k in left[fits] if k != left[first])])
        left = left[~fits]
    return groups


def follow_charts(corner: IntArray, leader_corner: IntArray, uv: Float64, shared: BoolArray) -> tuple[Float64, BoolArray]:
    """The UVs and shared sides of an object's triangles, from those of the object that was unwrapped.

    corner, leader_corner   (n, 3) int: the same three in each row, in any order
    uv, shared              (n, 3, 2) float64 and (n, 3) bool, in the order of `leader_corner`
    """
    place = (corner[:, :, None] == leader_corner[:, None, :]).argmax(axis=2)
    opposite = np.roll(place, -2, axis=1)  # the corner opposite to side k, which starts at corner k
    return np.take_along_axis(uv, place[:, :, None], axis=1), np.take_along_axis(shared, (opposite + 1) % 3, axis=1)


def _log_lengths(tri_position: FloatArray, tri_corner: IntArray) -> Float64:
    """(n_edge,) float64: logarithms of the lengths of some sides, in the same order for all objects that share the mesh."""
    step = -(-len(tri_corner) // _SAMPLED_TRIANGLES)
    order = np.argsort(tri_corner[::step], axis=1)
    position = np.take_along_axis(tri_position[::step], order[:, :, None], axis=1)
    length = np.linalg.norm(position - np.roll(position, 1, axis=1), axis=2).ravel()
    return np.log(np.maximum(length, _SHORTEST * length.max()))


_WIDTHS = (0.6, 0.75, 0.95, 1.2)  # candidate widths, relative to the side of a square of the same area as the charts' boxes with padding


@dataclass(frozen=True)
class BlockLayout:
    """The packing of a block at the density of its smallest object.

    low       (2,) float64, texels: lower left corner in the layout
    side      (2,) float64, texels: width and height
    outline   the block as one outline that must not be turned, in metres of its smallest object
    """

    layout: Layout
    low: Float64
    side: Float64
    outline: Outlines

    @classmethod
    def of(cls, outlines: Outlines, layout: Layout) -> BlockLayout:
        edge = layout.place(outlines.edge, outlines.edge_chart)
        low = edge.min(axis=(0, 1))
        side, density = edge.max(axis=(0, 1)) - low, layout.density
        start, area = np.array([0, len(edge)]), outlines.area.sum(keepdims=True)
        return cls(layout, low, side, Outlines((edge - low) / density, start, side[None] / density, area, np.ones(1, bool)))

    def place(self, points: Float64, chart: Int64) -> Float64:
        """As Layout.place, in texels of the block."""
        return self.layout.place(points, chart) - self.low


def lay_block(outlines: Outlines, density: float, page: Page) -> BlockLayout | None:
    """The smallest packing found for the charts of a block's smallest object; None if they do not fit a page.

    The gaps are a texel wider than the padding, since a block may be placed at fractions of a texel.
    """
    inner = Page(page.size + 2, page.padding + 1)
    shapes = shape_charts(outlines, density, inner)
    if shapes is None:
        return None
    room = math.sqrt(float((shapes.side + inner.padding).prod(axis=1).sum()))
    widest = inner.inside // inner.step
    columns = sorted({min(widest, max(1, round(room * share / inner.step))) for share in _WIDTHS})
    tried = (place_charts(shapes, np.full(count + 2 * inner.reach, -inner.padding, np.int32)) for count in columns)
    found = (BlockLayout.of(outlines, layout) for layout in tried if layout is not None)
    return min(found, key=lambda block: float((block.side + page.padding).prod()), default=None)


def join_outlines(parts: Sequence[Outlines]) -> Outlines:
    """The outlines of all parts, concatenated."""
    counts = [0, *(len(part.edge) for part in parts)]
    first = np.cumsum(counts)
    start = [part.start[:-1] + before for part, before in zip(parts, first[:-1], strict=True)]
    return Outlines(
        np.concatenate([part.edge for part in parts]),
        np.append(np.concatenate(start), first[-1]),
        np.concatenate([part.extent for part in parts]),
        np.concatenate([part.area for part in parts]),
        np.concatenate([part.rigid for part in parts]),
    )
