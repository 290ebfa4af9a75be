"""Receivers of direct light: where in each texel a ray starts, and where on a light it aims."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from random import Random
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from .direct_lights import Aim
from .geometry import UnitBox, interpolate_corners, locate_hits, offset_origin, take_rows, triangle_frames, triangle_normals_areas
from .lights import Float32
from .rays import RayScene
from .scene import FloatArray, IntArray, SceneSnapshot

# Texels (m,) and points (k, m, 2) of the unit square -> triangles (k, m) and weights (k, m, 2) of their corners 1 and 2,
# uniform over the texel's covered part: TexelMap.sub_points.
SubPoints: TypeAlias = Callable[[IntArray, FloatArray], tuple[NDArray[np.int32], NDArray[np.float32]]]

# Source: Gauss-Legendre, two points a side; their mean is exact for cubic polynomials.
GAUSS_POINTS = np.array([[[x, y]] for y in (-1, 1) for x in (-1, 1)]) * math.sqrt(1 / 12) + 0.5
MIDDLE = np.full((1, 1, 2), 0.5)
STAGES = ((0, 4), (4, 16), (16, 64))  # rays of a texel to a light; each is stratified together with those before it
_RAYS_AT_ONCE = 2**15  # what fits the cache
_SMOOTH_DEVIATION = 1e-3  # corner normals nearer to the face's own than this are flat shading
_SHORTEST_NORMAL = 1e-6


def base_points(count: int) -> NDArray[np.uint32]:
    """(count, 2) uint32: a (0, 2)-sequence; any first 4^k points fall one each in a grid of 2^k by 2^k, and in every other
    grid of so many cells.

    Source: Sobol' 1967, the first two dimensions.
    """
    bits = max(1, (count - 1).bit_length())
    index = np.arange(count, dtype=np.uint32)
    out = np.zeros((count, 2), np.uint32)
    steps = np.array([1 << 31, 1 << 31], np.uint32)
    for bit in range(bits):
        out ^= ((index >> np.uint32(bit)) & np.uint32(1))[:, None] * steps
        steps = np.array([steps[0] >> 1, steps[1] ^ (steps[1] >> 1)], np.uint32)
    out.flags.writeable = False
    return out


def _shuffle_stages(points: NDArray[np.uint32], seed: int) -> NDArray[np.uint32]:
    """The points in a random order within each stage."""
    random = Random(seed)  # its numbers are the same in every version of Python
    order = [index for first, last in STAGES for index in sorted(range(first, last), key=lambda _: random.random())]
    out = points[order]
    out.flags.writeable = False
    return out


GAUSS_POINTS.flags.writeable = MIDDLE.flags.writeable = False
_TEXEL_POINTS = base_points(STAGES[-1][1])
# Another order for the light, so that places in the texel and on the light are not tied; of 2,000 seeds this has the least correlation.
_LIGHT_POINTS = _shuffle_stages(_TEXEL_POINTS, 804)


def shift_points(points: NDArray[np.uint32], shift: NDArray[np.uint32]) -> Float32:
    """(k, m, 2) float32 in [0, 1): points (k, 2) moved by digital shifts (m, 2), which keep their strata.

    Source: Owen 2003, "Quasi-Monte Carlo sampling", 3.4.
    """
    bits = points[:, None, :] ^ shift
    return (bits >> np.uint32(8)).astype(np.float32) * np.float32(2.0**-24)


@dataclass(frozen=True)
class Receivers:
    """Points that light is wanted at. Arrays are views of (3, n) rows, which numpy adds and multiplies several times faster.

    position   (n, 3) float32, unit box, already off its surface
    normal     (n, 3) float32, unit       shading normal
    side       (n, 3) float32, unit       geometric normal
    """

    position: Float32
    normal: Float32
    side: Float32

    def rows(self, index: IntArray) -> Receivers:
        return Receivers(take_rows(self.position, index), take_rows(self.normal, index), take_rows(self.side, index))

    def see(self, rays: RayScene, aim: Aim) -> tuple[NDArray[np.bool_], int]:
        """Which rays meet nothing, and how many had to be traced; what comes from behind the face is not seen."""
        seen = (aim.weight > 0) & ((aim.direction * self.side).sum(axis=1) > 0)
        live = np.flatnonzero(seen)
        if len(live) == len(seen):
            return ~rays.occluded(self.position, aim.direction, aim.distance), len(live)
        if len(live):
            seen[live] = ~rays.occluded(take_rows(self.position, live), take_rows(aim.direction, live), aim.distance[live])
        return seen, len(live)


@dataclass(frozen=True)
class ReceivingSurfaces:
    """Triangles that receive.

    corner_unit      (n_tri, 3, 3) float32, unit box
    normal           (n_tri, 3) float32, unit; 0 for triangles without area
    tri_frame        (3, 3, n_tri) float32, unit box   of triangle_frames
    smooth           (n_tri,) bool                     the corners' normals are not the face's own
    shading_normal   (n_tri, 3, 3) float32
    """

    corner_unit: Float32
    normal: Float32
    tri_frame: Float32
    smooth: NDArray[np.bool_]
    shading_normal: Float32

    @classmethod
    def of(cls, snapshot: SceneSnapshot, unit_box: UnitBox) -> ReceivingSurfaces:
        corner_unit = unit_box.to_unit(snapshot.tri_position)
        normal = triangle_normals_areas(snapshot.tri_position)[0].astype(np.float32)
        smooth = np.abs(snapshot.tri_normal - normal[:, None]).max(axis=(1, 2)) > _SMOOTH_DEVIATION
        return cls(corner_unit, normal, triangle_frames(corner_unit), smooth, snapshot.tri_normal)

    def at(self, tri: IntArray, barycentric: Float32, flip: bool) -> Receivers:
        """Receivers at weights (n, 2) of corners 1 and 2 of triangles (n,); on their back when `flip`."""
        u, v = np.ascontiguousarray(barycentric.T)
        first = self.place(tri, u, v).T
        side = self.normal.T.take(tri, axis=1)
        normal = self._shade(tri, u, v, side)
        if flip:
            normal, side = -normal, -side
        return Receivers(offset_origin(first, side).T, normal.T, side.T)

    def place(self, tri: IntArray, u: Float32, v: Float32) -> Float32:
        """(n, 3) view of rows, unit box: points at weights of corners 1 and 2."""
        point: Float32 = locate_hits(self.tri_frame, tri, u, v).T
        return point

    def _shade(self, tri: IntArray, u: Float32, v: Float32, side: Float32) -> Float32:
        """(3, n): the interpolated normals where triangles are smooth."""
        smooth = np.flatnonzero(self.smooth[tri])
        if not len(smooth):
            return side
        shading = interpolate_corners(self.shading_normal[tri[smooth]], u[smooth], v[smooth])
        length = np.sqrt((shading * shading).sum(axis=1))
        usable = np.flatnonzero(length > _SHORTEST_NORMAL)
        normal = side.copy()
        normal[:, smooth[usable]] = (shading[usable] / length[usable, None]).T
        return normal


@dataclass(frozen=True)
class TexelChunk:
    """Some texels, and the random shift of the points inside each.

    texel   (n,) int            as `sub_points` knows them
    shift   (n, 2) uint32
    """

    texel: IntArray
    shift: NDArray[np.uint32]
    sub_points: SubPoints
    surfaces: ReceivingSurfaces
    flip: bool

    def receivers(self, rows: IntArray, first: int, last: int) -> Receivers:
        """Starts of rays first ... last - 1 of some of the texels, ray by ray: ((last - first) * len(rows), ...)."""
        return self.receivers_at(rows, shift_points(_TEXEL_POINTS[first:last], self.shift[rows]))

    def receivers_at(self, rows: IntArray, points: FloatArray) -> Receivers:
        """The same at points (k, 1 or len(rows), 2) of the texels' unit squares."""
        tri, barycentric = self.sub_points(self.texel[rows], points)
        return self.surfaces.at(tri.ravel(), barycentric.reshape(-1, 2), self.flip)


def light_points(shift: NDArray[np.uint32], first: int, last: int) -> Float32:
    """((last - first) * m, 2) float32: where on the light rays first ... last - 1 aim; shift (m, 2) uint32."""
    return shift_points(_LIGHT_POINTS[first:last], shift).reshape(-1, 2)


def random_shift(rng: np.random.Generator, count: int) -> NDArray[np.uint32]:
    """(count, 2) uint32."""
    return rng.integers(0, 2**32, size=(count, 2), dtype=np.uint32)


def row_pieces(rows: IntArray, rays_each: int) -> list[IntArray]:
    """The rows in pieces small enough to take so many rays each at once."""
    step = max(1, _RAYS_AT_ONCE // rays_each)
    return [rows[start : start + step] for start in range(0, len(rows), step)]
