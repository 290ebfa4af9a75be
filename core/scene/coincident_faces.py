"""Faces that lie in one place: a second face in the plane of a ceiling, a copy that was never moved, the walls of rooms back to back.

A ray meets whichever of them the bvh finds first, so that one would take all light and the others none. Here hits are shared out: among
the faces at a hit those whose front the ray meets, each with the same chance. So photons that a face receives stand for as many as there
are faces; what is reflected stays that of one surface.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..util.arrays import BoolArray, Float32, Float64, Int32, Int64, IntArray
from ..util.coverage import chunk_ranges, expand_ranges
from ..util.geometry import ORIGIN_OFFSET, gather, locate_hits, orthonormal_basis, triangle_frames
from .rays import Hits, RayScene

# Barycentric weights of the points of a triangle from which others in its place are looked for.
_POINTS = np.array([[1, 1, 1], [2.4, 0.3, 0.3], [0.3, 2.4, 0.3], [0.3, 0.3, 2.4]], np.float32) / 3
_PARALLEL = 1 - 1e-5  # least cosine between normals
_PLANE_STEPS = 1 << 11  # of a normal's component, where planes are compared
_PLANE_WIDTH = 4.0  # more than the unit box is wide
_PIECES = 4
_LEAST_OVERLAP = 1e-5  # unit box: neighbours in a plane overlap by rounding
_CELLS = 16  # along each side of the grid over a triangle that marks where other faces lie: most hits need no search
_HAIR = 1e-4  # of a barycentric weight: rounding of the corners of other faces
_MOST_OTHERS = 64  # that face as one triangle does, in its place; one with more takes no part
_TINY = float(np.finfo(np.float32).tiny)


@dataclass(frozen=True)
class CoincidentFaces:
    """Pairs of triangles that lie in one plane, nearer to each other than geometry.ORIGIN_OFFSET, and overlap.

    start        (n_tri + 1,) int64: others of triangle i are other[start[i]:start[i + 1]]
    other        (m,) int32
    row          (n_tri + 1,) int32: row of `near` of each triangle, -1 for one without others, and for a miss, -1
    near         (2, k, _CELLS**2) bool: cells of a triangle, by u and v, where a hit on its back, and on its front, may go to another
    tri_frame    (3, 3, n_tri) float32   of triangle_frames, unit box
    tri_normal   (3, n_tri) float32
    """

    start: Int64
    other: Int32
    row: Int32
    near: BoolArray
    tri_frame: Float32
    tri_normal: Float32

    @classmethod
    def find(cls, rays: RayScene, corners: Float32, tri_normal: Float32, apart: BoolArray) -> CoincidentFaces | None:
        """The pairs of a scene; None where it has none.

        corners      (n_tri, 3, 3) float32, unit box
        tri_normal   (3, n_tri) float32
        apart        (n_tri,) bool: triangles that take no part, for what they let pass goes on to the face behind
        """
        planes = _number_planes(corners, tri_normal)
        shared = np.logical_or.reduce([np.bincount(plane)[plane] > 1 for plane in planes])
        asked = np.flatnonzero(shared & tri_normal.any(axis=0) & ~apart)
        found = asked[_meet_others(rays, corners, tri_normal, asked)]
        if not len(found):
            return None
        pairs = []
        for plane in planes:
            rows = asked[np.isin(plane[asked], plane[found])]
            pairs.append(_find_overlaps(corners, tri_normal, rows, plane[rows]))
        n_tri = len(corners)
        one, other = np.concatenate(pairs, axis=1)
        one, other = np.divmod(np.unique(np.append(one * n_tri + other, other * n_tri + one)), n_tri)
        # A hit on a front goes to faces that face the same way; the undersides of what stands on a floor are not among them.
        alike = np.einsum("kn,kn->n", tri_normal[:, one], tri_normal[:, other]) > 0
        few = np.bincount(one, alike, n_tri) <= _MOST_OTHERS
        kept = few[one] & few[other]
        one, other, alike = one[kept], other[kept], alike[kept]
        if not len(one):
            return None
        own, first = np.unique(one, return_index=True)
        row, frame = np.full(n_tri + 1, -1, np.int32), triangle_frames(corners)
        row[own] = np.arange(len(own))
        places = np.array([_find_places(frame, one, corner.T) for corner in np.moveaxis(corners[other], 1, 0)])
        cells = _cover_cells(places.min(axis=0), places.max(axis=0))
        near = np.stack([np.logical_or.reduceat(cells & of[:, None], first) for of in (np.ones_like(alike), alike)])
        return cls(np.searchsorted(one, np.arange(n_tri + 1)), other.astype(np.int32), row, near, frame, tri_normal)

    def share_out(self, found: Hits, direction: Float32) -> tuple[Hits, Float32]:
        """The hits of rays, shared out; and (n,) float32, among how many faces each.

        direction   (3, n) float32
        """
        count, tri, u, v = np.ones(len(found.tri), np.float32), found.tri, found.u, found.v
        row = self.row.take(tri)
        rows = np.flatnonzero(row >= 0)
        cell = _find_cells(u[rows]) * _CELLS + _find_cells(v[rows])
        on_back, on_front = self.near[:, row[rows], cell]
        rows, alike = rows[on_back], on_front[on_back]  # on_back holds wherever on_front does
        rows = rows[alike | (np.einsum("kn,kn->n", gather(direction, rows), gather(self.tri_normal, tri[rows])) >= 0)]
        if not len(rows):
            return found, count
        point = locate_hits(self.tri_frame, tri[rows], u[rows], v[rows])
        owner, place = expand_ranges(self.start[tri[rows]], self.start[tri[rows] + 1])
        other = self.other[place]
        other_u, other_v = _find_places(self.tri_frame, other, gather(point, owner))
        inside = (other_u >= 0) & (other_v >= 0) & (other_u + other_v <= 1)
        # All faces at each hit, the one that was found among them.
        owner = np.append(np.arange(len(rows)), owner[inside])
        order = np.argsort(owner, kind="stable")
        owner = owner[order]
        tri_at = np.append(tri[rows], other[inside])[order]
        u_at, v_at = np.append(u[rows], other_u[inside])[order], np.append(v[rows], other_v[inside])[order]
        is_front = np.einsum("kn,kn->n", gather(direction, rows[owner]), gather(self.tri_normal, tri_at)) < 0
        kept = np.flatnonzero(is_front | ~(np.bincount(owner, is_front, len(rows)) > 0)[owner])
        first = np.searchsorted(owner[kept], np.arange(len(rows) + 1))
        n_face = np.diff(first)
        chosen = kept[first[:-1] + _draw(found.u[rows], found.v[rows]) % n_face]
        tri, u, v = tri.copy(), u.copy(), v.copy()
        tri[rows], u[rows], v[rows] = tri_at[chosen], u_at[chosen], v_at[chosen]
        count[rows] = n_face
        return replace(found, tri=tri, u=u, v=v), count


def _find_places(tri_frame: Float32, tri: IntArray, point: Float32) -> tuple[Float32, Float32]:
    """(n,) each: barycentric weights of corners 1 and 2 of triangles (n,) at points (3, n) of their planes."""
    corner, one, other = gather(tri_frame, tri).astype(np.float64)
    at = point - corner

    def dot(a: Float64, b: Float64) -> Float64:
        return np.asarray(np.einsum("kn,kn->n", a, b))

    aa, ab, bb, pa, pb = dot(one, one), dot(one, other), dot(other, other), dot(at, one), dot(at, other)
    area2 = aa * bb - ab * ab
    return ((bb * pa - ab * pb) / area2).astype(np.float32), ((aa * pb - ab * pa) / area2).astype(np.float32)


def _find_cells(place: Float32) -> Int64:
    """Cells, counted from 0, at barycentric weights."""
    return np.clip(place * _CELLS, 0, _CELLS - 1).astype(np.int64)


def _cover_cells(low: Float32, high: Float32) -> BoolArray:
    """(m, _CELLS**2): cells of triangles that boxes of barycentric weights, from low (2, m) to high (2, m), overlap."""
    cells = np.arange(_CELLS)
    first, last = _find_cells(low - _HAIR)[..., None], _find_cells(high + _HAIR)[..., None]
    along, up = (first <= cells) & (cells <= last)
    return np.asarray(along[:, :, None] & up[:, None, :]).reshape(-1, _CELLS**2)


def _number_planes(corners: Float32, tri_normal: Float32) -> list[Int64]:
    """(n_tri,) twice: numbers of the triangles' planes. Two in one plane have one number at least once, however they are rounded."""
    normal = tri_normal.T.astype(np.float64)
    flip = np.sign(np.take_along_axis(normal, np.abs(normal).argmax(axis=1)[:, None], axis=1))
    offset = flip[:, 0] * (normal * corners.mean(axis=1, dtype=np.float64)).sum(axis=1) / (4 * ORIGIN_OFFSET)
    steps = np.rint(normal * flip * _PLANE_STEPS).astype(np.int64) + _PLANE_STEPS
    direction = (steps[:, 0] << 26) + (steps[:, 1] << 13) + steps[:, 2]
    planes = [(direction << 20) + np.rint(offset + shift).astype(np.int64) for shift in (0.0, 0.5)]
    return [np.unique(plane, return_inverse=True)[1].ravel() for plane in planes]


def _meet_others(rays: RayScene, corners: Float32, tri_normal: Float32, asked: Int64) -> BoolArray:
    """(k,): triangles (k,) in whose place short rays find others. Of two in one place at least one does, unless they overlap little."""
    normal, met = tri_normal.T[asked], np.zeros(len(asked), bool)
    for weight in _POINTS:
        point = np.einsum("k,nkc->nc", weight, corners[asked])
        for side in (np.float32(1), np.float32(-1)):
            start = point + side * np.float32(ORIGIN_OFFSET) * normal
            found = rays.closest(start, -side * normal, np.full(len(asked), 2 * ORIGIN_OFFSET, np.float32)).tri
            parallel = np.abs((normal * tri_normal.T[found]).sum(axis=1)) > _PARALLEL
            met |= (found >= 0) & (found != asked) & parallel
    return met


def _find_overlaps(corners: Float32, tri_normal: Float32, rows: Int64, plane: Int64) -> Int64:
    """(2, m): pairs of the triangles `rows` (k,) in one plane (k,) that overlap by more than _LEAST_OVERLAP."""
    _, first, place = np.unique(plane, return_index=True, return_inverse=True)
    axes = orthonormal_basis(tri_normal.T[rows[first[place.ravel()]]].astype(np.float64))  # those of the first triangle in the plane
    flat = np.stack([np.einsum("nkc,nc->nk", corners[rows], axis) for axis in axes], axis=2)
    low, high = flat.min(axis=1), flat.max(axis=1) - _LEAST_OVERLAP  # so that what only touches is beside each other
    whose, strip = _cut_into_strips(low[:, 1], high[:, 1])
    line = np.unique(place.ravel()[whose] * (np.ptp(strip) + 1) + strip, return_inverse=True)[1].ravel()
    order = np.lexsort((low[whose, 0], line))
    whose, begin = whose[order], _PLANE_WIDTH * line[order]
    rank = np.arange(len(order))
    # Of each triangle those that follow it along its strip, up to its end.
    end = np.searchsorted(begin + low[whose, 0], begin + high[whose, 0])
    found = [np.zeros((2, 0), np.int64)]
    for part, start, stop in chunk_ranges(rank + 1, end):
        one, other = expand_ranges(start, stop)
        one, other = whose[part[one]], whose[other]
        beside = (low[one, 1] < high[other, 1]) & (low[other, 1] < high[one, 1])
        one, other = one[beside], other[beside]
        kept = _overlap(flat[one], flat[other])
        found.append(np.stack([rows[one[kept]], rows[other[kept]]]))
    return np.concatenate(found, axis=1)


def _cut_into_strips(low: Float64, high: Float64) -> tuple[Int64, Int64]:
    """Intervals (m,) of (n,), and strips (m,) over which they lie: as narrow as the median interval, but m is at most _PIECES * n."""
    step = max(float(np.median(high - low)), 1e-6)
    while ((high - low) / step).sum() > (_PIECES - 2) * len(low):
        step *= 2.0
    first, last = (np.floor((of - low.min()) / step).astype(np.int64) for of in (low, high))
    return expand_ranges(first, last + 1)


def _overlap(one: Float64, other: Float64) -> BoolArray:
    """(m,): whether triangles (m, 3, 2) overlap: no line along a side parts them. Source: the separating axis theorem."""
    meet = np.ones(len(one), bool)
    for of in (one, other):
        for k in range(3):
            side = of[:, (k + 1) % 3] - of[:, k]
            across = np.stack([-side[:, 1], side[:, 0]], axis=1) / np.maximum(np.hypot(side[:, 0], side[:, 1]), _TINY)[:, None]
            a, b = (np.einsum("nkc,nc->nk", part, across) for part in (one, other))
            meet &= np.minimum(a.max(axis=1), b.max(axis=1)) - np.maximum(a.min(axis=1), b.min(axis=1)) > _LEAST_OVERLAP
    return meet


def _draw(u: Float32, v: Float32) -> Int64:
    """(n,): numbers from the bits of where rays hit, so that the same ray always takes the same face."""
    bits = [np.ascontiguousarray(of).view(np.uint32).astype(np.uint64) for of in (u, v)]
    mixed = (bits[0] * np.uint64(0x9E3779B97F4A7C15)) ^ (bits[1] * np.uint64(0xC2B2AE3D27D4EB4F))
    return (mixed >> np.uint64(40)).astype(np.int64)
