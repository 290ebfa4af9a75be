"""Footprints of texels. Each is a square on one triangle, or consists of pieces of several triangles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..util.arrays import BoolArray, Float32, Float64, FloatArray, Int32, Int64, IntArray

_ROUNDING = 1e-9  # weight of a corner below 0 that is still on the triangle


@dataclass(frozen=True)
class TexelFootprints:
    """Footprints of n texels. The elements are one square per texel, then m pieces that replace the squares of some. Points of an element
    are linear in two coordinates.

    tri      (n + m,) int32         triangle of each element; for a texel with pieces, that of its representative point
    weight   (3, 2, n + m) float32  weights of the triangle's corners 1 and 2: at the element's origin, and the increments along its axes
    part     (n,) int64             number of a texel among those with pieces; -1 for one with a square
    first    (p + 1,) int64         pieces of part i are first[i]:first[i + 1], counted from the first piece
    after    (m,) float64           for a piece of part i: i plus the cumulative area share up to and including the piece
    """

    tri: Int32
    weight: Float32
    part: Int64
    first: Int64
    after: Float64

    @classmethod
    def of_squares(cls, tri: IntArray, weight: FloatArray) -> TexelFootprints:
        """Footprints that are all squares; arguments are as in the fields."""
        return cls(tri.astype(np.int32), weight.astype(np.float32), np.full(len(tri), -1), np.zeros(1, np.int64), np.zeros(0))

    def with_pieces(self, rows: IntArray, owner: Int64, tri: IntArray, weight: FloatArray, share: Float64) -> TexelFootprints:
        """These squares, with pieces instead for the texels `rows` (p,).

        owner    (m,) int64, ascending: index in rows; each has at least one piece
        tri      (m,) int
        weight   (3, 2, m) float    at one corner of the piece, and increments to the other two
        share    (m,) float64, > 0
        """
        part = np.full(len(self.part), -1)
        part[rows] = np.arange(len(rows))
        after = np.cumsum(share / np.bincount(owner, share, minlength=len(rows))[owner])
        first = np.searchsorted(owner, np.arange(len(rows) + 1))
        weights = np.concatenate([self.weight, weight.astype(np.float32)], axis=2)
        return TexelFootprints(np.concatenate([self.tri, tri.astype(np.int32)]), weights, part, first, after)

    def __len__(self) -> int:
        return len(self.part)

    def choose(self, part: Int64, point: FloatArray) -> tuple[Int64, Float64, Float64]:
        """Points of the unit square mapped to pieces, uniform over each part.

        part    (m,) int64
        point   (k, m, 2) float in [0, 1)
        out     (k, m) int64 element, and (k, m) float64 twice: coordinates along its axes
        """
        # `after` rises by one from part to part, so one search finds the pieces of all parts.
        target = point[..., 0] + part
        piece = np.clip(np.searchsorted(self.after, target, side="right"), self.first[part], self.first[part + 1] - 1)
        before = (piece > 0) * self.after[piece - 1]
        # Source: Turk 1990, "Generating random points in triangles"; the first number is rescaled and used again.
        root = np.sqrt(np.clip((target - before) / (self.after[piece] - before), 0.0, 1.0))
        second = root * point[..., 1]
        return piece + len(self), root - second, second

    def points(self, point: FloatArray) -> tuple[Int32, Float32]:
        """Points of the unit square mapped to every texel: (k, n) int32 triangles and (k, n, 2) float32 weights of corners 1 and 2.

        point   (k, n, 2) or (k, 1, 2) float in [0, 1)
        """
        count = len(self)
        point = np.broadcast_to(point, (len(point), count, 2)).astype(np.float64)
        tri = np.broadcast_to(self.tri[:count], point.shape[:2]).copy()
        weight = self._interpolate(np.arange(count)[None], point[..., 0], point[..., 1])
        rows = np.flatnonzero(self.part >= 0)
        if len(rows):
            element, *along = self.choose(self.part[rows], point[:, rows])
            tri[:, rows], weight[:, :, rows] = self.tri[element], self._interpolate(element, *along)
        return tri, np.moveaxis(weight, 0, -1)

    def _interpolate(self, element: Int64, a: Float64, b: Float64) -> Float32:
        """(2, k, m) float32: weights of corners 1 and 2 at coordinates a, b (k, m) of elements (1 or k, m)."""
        origin, along_a, along_b = self.weight[:, :, element]
        return (origin + a * along_a + b * along_b).astype(np.float32)


def centred_strata(count: int) -> Float64:
    """Centres of count = n * n equal cells of the unit square, for `TexelFootprints.points`.

    out   (count, 1, 2) float64
    """
    side = round(count**0.5)
    if side * side != count or not count:
        raise ValueError(f"count: expected a square number, got {count}")
    line = (np.arange(side) + 0.5) / side
    return np.stack(np.meshgrid(line, line), axis=-1).reshape(count, 1, 2)


def are_inside(weight: Float64) -> BoolArray:
    """(m,) bool: whether squares lie wholly on their triangles; weight (3, 2, m) as in TexelFootprints."""
    inside = np.ones(weight.shape[2], bool)
    for a, b in ((0, 0), (1, 0), (0, 1), (1, 1)):
        u, v = weight[0] + a * weight[1] + b * weight[2]
        inside &= np.minimum(np.minimum(u, v), 1.0 - u - v) >= -_ROUNDING
    return inside
