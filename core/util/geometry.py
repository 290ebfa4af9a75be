"""Triangles, barycentric coordinates, frames, and the unit box, in which rays are traced."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from .arrays import BoolArray, Float32, Float64, FloatArray, IntArray

# Length in the unit box: 40 micrometres in a room of 20 m. Points interpolated from corners lie within 8e-8 of their triangle's plane, and
# 2.5e-7 was enough for 1e6 rays in a box and in a sphere down to 1e-5 above the surface; the rest is a safety margin (test_rays.py).
ORIGIN_OFFSET = 2e-6

_Scalar = TypeVar("_Scalar", bound=np.generic)

_SMALLEST_EXTENT_M = 1e-30  # below this, 1 / extent exceeds float32
_COLLINEAR = 8 * float(np.finfo(np.float64).eps)  # sine of the angle below which an area is rounding error in float64


@dataclass(frozen=True)
class UnitBox:
    """Maps world space to a box of side 1 around the origin, where float32 rays are equally precise for every scene.

    centre_m   (3,) float64, m
    scale      unit-box lengths per metre
    """

    centre_m: Float64
    scale: float

    @classmethod
    def from_points(cls, points_m: FloatArray) -> UnitBox:
        """The smallest cube around the points.

        points_m   (n, 3) float, m, finite; if they have no extent, the scale is 1
        """
        points = np.asarray(points_m, np.float64).reshape(-1, 3)
        if not len(points):
            return cls(np.zeros(3), 1.0)
        low, high = points.min(axis=0), points.max(axis=0)
        extent = float((high - low).max())
        return cls(0.5 * low + 0.5 * high, 1.0 / extent if extent > _SMALLEST_EXTENT_M else 1.0)

    def to_unit(self, points_m: FloatArray) -> Float32:
        """(..., 3) float32, unit box: the points, centred and scaled in float64 before rounding."""
        return ((np.asarray(points_m, np.float64) - self.centre_m) * self.scale).astype(np.float32)

    def to_unit_length(self, length_m: float) -> float:
        """A length of world space, in the unit box."""
        return length_m * self.scale


def triangle_normals_areas(corners: FloatArray) -> tuple[Float64, Float64]:
    """Geometric unit normals and areas, precise even for needles; normal and area are zero if the corners are collinear.

    corners   (n, 3, 3) float, any unit of length
    normal    (n, 3) float64, unit, right-handed about the corners' order
    area      (n,) float64, that unit squared
    Source: the cross product of the two shorter edges has the least cancellation; Kahan 2014, "Miscalculating area and angles of a
    triangle".
    """
    corner = np.asarray(corners, np.float64)
    edge = np.roll(corner, -1, axis=1) - corner  # edge k runs from corner k to k + 1
    length_squared = (edge**2).sum(axis=2)
    longest = length_squared.argmax(axis=1)
    row = np.arange(len(corner))
    first, second = edge[row, (longest + 1) % 3], edge[row, (longest + 2) % 3]  # consecutive: the cross product keeps its sign
    lengths = np.sqrt(length_squared)
    product = lengths[row, (longest + 1) % 3] * lengths[row, (longest + 2) % 3]
    cross = np.cross(first, second)
    double_area = np.sqrt((cross**2).sum(axis=1))
    solid = double_area > _COLLINEAR * product
    normal = np.where(solid[:, None], cross / np.where(solid, double_area, 1.0)[:, None], 0.0)
    return normal, np.where(solid, 0.5 * double_area, 0.0)


def orthonormal_basis(normal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Tangent and bitangent that form right-handed frames with unit normals, without branches.

    normal               (n, 3) float, unit
    tangent, bitangent   (n, 3) float, unit
    Source: Duff et al. 2017, "Building an Orthonormal Basis, Revisited", listing 3.
    """
    x, y, z = normal[:, 0], normal[:, 1], normal[:, 2]
    sign = np.copysign(np.ones_like(z), z)
    a = -1.0 / (sign + z)
    b = x * y * a
    tangent = stack_columns(1.0 + sign * x * x * a, sign * b, -sign * x)
    return tangent, stack_columns(b, sign + y * y * a, -y)


def rotate_to(local: FloatArray, normal: FloatArray) -> FloatArray:
    """Directions (n, 3) around +Z, rotated to be around unit normals (n, 3)."""
    tangent, bitangent = orthonormal_basis(normal)
    out: FloatArray = tangent * local[:, :1]
    out += bitangent * local[:, 1:2]
    out += normal * local[:, 2:]
    return out


def offset_origin(position: FloatArray, normal: FloatArray) -> FloatArray:
    """Ray origins moved off their surface to the side of the normals, so that rays do not hit the surface where they start.

    position, normal   (n, 3) or (3, n) float, unit box; normals are unit, geometric, on the side of the new ray
    Source: the idea of Waechter & Binder 2019 (Ray Tracing Gems, ch. 6); in the unit box their scale is a constant.
    """
    return position + np.float32(ORIGIN_OFFSET) * normal


def locate_hits(tri_frame: FloatArray, tri: IntArray, u: FloatArray, v: FloatArray) -> FloatArray:
    """(k, n) float: points on triangles.

    Computed from barycentric coordinates they lie on the surface for any ray; origin + distance * direction might lie beyond a wall.

    tri_frame   (3, k, n_tri) float   from `triangle_frames`
    tri         (n,) int
    u, v        (n,) float            weights of corners 1 and 2
    """
    corner, edge1, edge2 = gather(tri_frame, tri)
    edge1 *= u
    edge2 *= v
    corner += edge1
    corner += edge2
    return corner


def triangle_frames(corners: FloatArray) -> FloatArray:
    """(3, k, n) float: corner 0 and the edges from it to corners 1 and 2, of triangles (n, 3, k)."""
    frame = np.stack([corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]])
    return np.ascontiguousarray(frame.transpose(0, 2, 1))


def stack_columns(*columns: FloatArray) -> FloatArray:
    """(n, k) view of (k, n) rows: numpy is many times faster on long rows than on short ones."""
    return np.stack(columns).T


def combine_vectors(weight: FloatArray, vectors: FloatArray) -> FloatArray:
    """weight (n, k) @ vectors (k, 3), as a view of (3, n) rows; BLAS would start threads, which compete with the other workers.

    vectors   (k, 3) float, or (k, 3, n) with vectors for each row of weights
    """
    columns = vectors.reshape(*vectors.shape[:2], -1)
    out: FloatArray = weight[:, 0] * columns[0]
    for k in range(1, len(columns)):
        out += weight[:, k] * columns[k]
    return out.T


def select(flag: BoolArray, yes: FloatArray, no: FloatArray) -> FloatArray:
    """np.where for finite numbers, without branches: measured, np.where takes eight times as long on random flags."""
    return flag * yes + ~flag * no


def dot_rows(a: NDArray[_Scalar], b: NDArray[_Scalar]) -> NDArray[_Scalar]:
    """(n,): dot products of rows (n, 3) and (n or 1, 3)."""
    return np.multiply(a, b).sum(axis=1)


def lay_rows(values: NDArray[_Scalar]) -> NDArray[_Scalar]:
    """(n, ...) values as a view of contiguous rows (..., n), from which take_rows takes without a copy of them all."""
    return np.ascontiguousarray(values.T).T


def gather(values: NDArray[_Scalar], index: IntArray) -> NDArray[_Scalar]:
    """values[..., index] without bounds checks, with which numpy takes up to twice as long."""
    return values.take(index, axis=-1, mode="wrap")


def take_rows(values: NDArray[_Scalar], index: IntArray) -> NDArray[_Scalar]:
    """values[index] for (n, k) views of (k, n) rows; the result is such a view. Without bounds checks, as gather."""
    return gather(values.T, index).T
