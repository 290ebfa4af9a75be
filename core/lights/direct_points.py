"""Receivers of direct light: origins of rays within texels, and their sample points on lights."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from random import Random

import numpy as np
from numpy.typing import NDArray

from ..scene.materials import SurfaceMaterials
from ..scene.normal_maps import NormalMaps, shade_bumps
from ..scene.scene import SceneSnapshot
from ..scene.shadow_rays import ShadowRays, Sight
from ..texels.texel_footprint import TexelFootprints
from ..texels.texel_grid import interleave_bits
from ..util.arrays import BoolArray, Float32, FloatArray, Int32, Int64, IntArray
from ..util.geometry import ORIGIN_OFFSET, UnitBox, dot_rows, locate_hits, offset_origin, take_rows, triangle_frames, triangle_normals_areas
from ..util.sampling import to_unit_interval
from .direct_lights import INFINITE, Aim

# Source: Gauss-Legendre, two points a side; their mean is exact for cubic polynomials.
GAUSS_POINTS = np.array([[[x, y]] for y in (-1, 1) for x in (-1, 1)]) * math.sqrt(1 / 12) + 0.5
MIDDLE = np.full((1, 1, 2), 0.5)
STAGES = ((0, 4), (4, 16), (16, 64))  # rays of a texel to a light; each stage is stratified together with the stages before it
# Texels processed at once. With half as many, numpy's calls have 10 % more overhead on a large page, but limited memory may require it.
MOST_TEXELS = 2**15
_RAYS_AT_ONCE = 2**15  # fits the cache
_SMOOTH_DEVIATION = 1e-3  # corner normals nearer to the geometric normal than this are flat shading
_SHORTEST_NORMAL = 1e-6
# Cosine to a smooth face below which rays skim it, and up to twice of which they are moved in part. Source: Cycles' default.
_SKIMMING = np.float32(0.1)
_LEAST_ALBEDO = 1e-9  # where all of a texel is black its points are equally likely


def base_points(count: int) -> NDArray[np.uint32]:
    """(count, 2) uint32: a (0, 2)-sequence; the first 4^k points lie one in each cell of a grid of 2^k by 2^k, and of every other grid with
    as many cells.

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
    random = Random(seed)  # gives the same numbers in every version of Python
    order = [index for first, last in STAGES for index in sorted(range(first, last), key=lambda _: random.random())]
    out = points[order]
    out.flags.writeable = False
    return out


def _order_strata(points: NDArray[np.uint32]) -> dict[tuple[int, int], Int64]:
    """Ranks of each stage's points, and of all points up to its end, in the Morton order of their strata, in which successive points are
    near each other.

    Digital shifts permute whole strata, so this stays true.
    """
    out = {}
    for first, last in {*STAGES, *((0, last) for _, last in STAGES)}:
        order = np.argsort(interleave_bits(*(points[first:last].T >> np.uint32(16)).astype(np.int64)))
        out[first, last] = np.argsort(order)
        out[first, last].flags.writeable = False
    return out


GAUSS_POINTS.flags.writeable = MIDDLE.flags.writeable = False
_TEXEL_POINTS = base_points(STAGES[-1][1])
# Points along the Morton curve, and the rank of each on it. Digital shifts permute whole strata, so neighbours stay near each other.
_CURVE = np.argsort(interleave_bits(*(_TEXEL_POINTS.T >> np.uint32(16)).astype(np.int64)))
_RANK = np.argsort(_CURVE)
# Points on the light have another order, so that they are not correlated with points in the texel; of 2,000 seeds this is the best.
_LIGHT_POINTS = _shuffle_stages(_TEXEL_POINTS, 804)
LIGHT_PLACE = _order_strata(_LIGHT_POINTS)


def shift_points(points: NDArray[np.uint32], shift: NDArray[np.uint32]) -> Float32:
    """(k, m, 2) float32 in [0, 1), a view of (2, k, m) rows: points (k, 2) moved by digital shifts (m, 2), which keep their strata.

    Source: Owen 2003, "Quasi-Monte Carlo sampling", 3.4.
    """
    bits = points.T[:, :, None] ^ shift.T[:, None, :]
    return np.moveaxis(to_unit_interval(bits), 0, -1)


@dataclass(frozen=True)
class Receivers:
    """Points at which light is estimated. Arrays are views of (3, n) rows, on which numpy is several times faster.

    position   (n, 3) float32, unit box, already offset from the surface
    normal     (n, 3) float32, unit       shading normal
    side       (n, 3) float32, unit       geometric normal; the same array as `normal` if all triangles are flat
    bumped     (n,) bool                  whether the shading normal is from a normal map; None if none is
    smooth     (n, 3) float32             normal between the corners', which the map has replaced; None if none is from a map
    places     on their triangles; None if all of these are flat
    """

    position: Float32
    normal: Float32
    side: Float32
    bumped: BoolArray | None = None
    smooth: Float32 | None = None
    places: SmoothPlaces | None = None

    def rows(self, index: IntArray) -> Receivers:
        side = take_rows(self.side, index)
        normal = side if self.normal is self.side else take_rows(self.normal, index)
        bumped, smooth = None if self.bumped is None else self.bumped[index], None if self.smooth is None else take_rows(self.smooth, index)
        places = None if self.places is None else self.places.rows(index)
        return Receivers(take_rows(self.position, index), normal, side, bumped, smooth, places)

    def shade_bumps(self, direction: Float32) -> Float32 | None:
        """(n,) float32 in [0, 1]: share of light from directions (n, 3) that bumps do not hide; None without bumps."""
        if self.bumped is None or self.smooth is None:
            return None
        shade = shade_bumps(self.smooth, self.normal, direction)
        shade[~self.bumped] = 1
        return shade

    def see(self, rays: ShadowRays, aim: Aim) -> Sight:
        """Transmittance along rays; 0 for directions behind the face, but for those to lamps, or hidden by a bump.

        Rays that skim a face whose corners' normals differ start on the smooth surface through the corners, so that a coarse mesh has no
        hard steps at its shadow line. Where that surface is flat, corners' normals may still face a lamp that stands behind the face, as
        those of leaves do that are shaded like a ball; then rays start behind the face. Neither holds for the sky and for emitting meshes,
        which Cycles finds by rays in random directions, too, and these end at the face.
        Source: Cycles, "Shadow Terminator: Geometry Offset" of the Blender manual; see SmoothPlaces.lift.
        """
        sight, shade = self._see_all(rays, aim), self.shade_bumps(aim.direction)
        return sight if shade is None else sight.dim(shade)

    def _see_all(self, rays: ShadowRays, aim: Aim) -> Sight:
        height = (aim.direction * self.side).sum(axis=1)
        # Ends in the receiver's own plane, as on an emitting face itself, are not above it, though both ends have an offset.
        least = np.float32(3 * ORIGIN_OFFSET) if aim.by_chance else np.float32(0)
        sent = (aim.weight > 0) & (height > least)
        position, direction, distance = self.position, aim.direction, aim.distance
        if self.places is not None and not aim.by_chance:
            rows, lifted = self._lift(aim, height)
            if len(rows):
                sent[rows], position, direction, distance = True, position.copy(), direction.copy(), distance.copy()
                position[rows] += lifted
                near = distance[rows] < INFINITE  # the end of the ray stays where it is
                direction[rows[near]] = direction[rows[near]] * distance[rows[near], None] - lifted[near]
                distance[rows[near]] = 1
        live = np.flatnonzero(sent)
        if len(live) == len(sent):
            return rays.see(position, direction, distance)
        return rays.see(take_rows(position, live), take_rows(direction, live), distance[live]).place(live, len(sent))

    def _lift(self, aim: Aim, height: Float32) -> tuple[IntArray, Float32]:
        """Rays (m,) that skim smooth faces or go behind them, and how far their origins move, (m, 3) in the unit box.

        height   (n,) float32: of the ends of the directions over the face
        """
        assert self.places is not None
        square = np.maximum(dot_rows(aim.direction, aim.direction), np.float32(1e-30))
        rows = np.flatnonzero((aim.weight > 0) & (height * np.abs(height) < (2 * _SKIMMING) ** 2 * square))
        rows = rows[self.places.are_smooth(rows)]
        normal, length = self.normal if self.smooth is None else self.smooth, np.sqrt(square[rows])
        over, facing = height[rows] / length, dot_rows(take_rows(normal, rows), take_rows(aim.direction, rows)) / length
        share = np.where(facing < _SKIMMING, 2 - (over + facing) / _SKIMMING, 1 - over / _SKIMMING)
        kept = np.flatnonzero((facing > 0) & (share > 0))
        rows, over = rows[kept], over[kept]
        lifted = self.places.lift(rows) * np.minimum(share[kept], np.float32(1))[:, None]
        is_flat = (over < 0) & (dot_rows(lifted, lifted) <= np.float32(ORIGIN_OFFSET) ** 2)
        lifted[is_flat] = np.float32(-2 * ORIGIN_OFFSET) * take_rows(self.side, rows[is_flat])
        return rows, lifted


@dataclass(frozen=True)
class SmoothPlaces:
    """Places (n,) on elements of footprints (n,), at coordinates a, b (n,) float32.

    faces   1, or -1 on the backs of the triangles
    """

    surfaces: ReceivingSurfaces
    footprints: TexelFootprints
    element: IntArray
    a: Float32
    b: Float32
    faces: int

    def rows(self, index: IntArray) -> SmoothPlaces:
        return replace(self, element=self.element[index], a=self.a[index], b=self.b[index])

    def are_smooth(self, index: IntArray) -> BoolArray:
        """(m,) bool: whether places (m,) are on triangles whose corners' normals differ from the geometric one."""
        return self.surfaces.smooth[self.footprints.tri[self.element[index]]]

    def lift(self, index: IntArray) -> Float32:
        """(m, 3) float32, unit box: from places (m,) to the smooth surface through the corners of their triangles.

        Its height along the normal is a parabola's, whose slopes at the corners are those of the normals there, or half of that where it
        would rise above the planes at the corners.
        Source: Cycles' kernel, light/sample.h, of Blender 4.5; Hanika 2021, "Hacking the shadow terminator" (Ray Tracing Gems II, ch. 4).
        """
        element = self.element[index]
        weight_at = self.footprints.weight.take(element, axis=2)
        second, third = weight_at[0] + self.a[index] * weight_at[1] + self.b[index] * weight_at[2]
        tri, first = self.footprints.tri[element], 1 - second - third
        corner = np.moveaxis(self.surfaces.corner_unit[tri], 1, 0)
        normal = np.moveaxis(self.surfaces.shading_normal[tri], 1, 0) * np.float32(self.faces)
        weight = np.stack([first, second, third])[:, :, None]
        place, between = (weight * corner).sum(axis=0), (weight * normal).sum(axis=0)

        def slope(start: int, end: int) -> Float32:
            return dot_rows(normal[end] - normal[start], corner[start] - corner[end])

        by_third, by_second, by_both = slope(0, 2), slope(1, 2), slope(1, 0)
        height = by_third * first * (first - 1) + (by_third + by_second + by_both) * first * second + by_second * second * (second - 1)
        ceiling = np.full(len(tri), np.inf, np.float32)
        for own in range(3):
            rise = [dot_rows(corner[other] - corner[own], normal[own]) for other in range(3) if other != own]
            ceiling = np.minimum(ceiling, np.maximum(dot_rows(corner[own] - place, normal[own]) + np.maximum(np.maximum(*rise), 0), 0))
        out: Float32 = between * np.maximum(ceiling, height / 2)[:, None]
        return out


@dataclass(frozen=True)
class ReceivingSurfaces:
    """Triangles that receive light.

    corner_unit      (n_tri, 3, 3) float32, unit box
    normal           (n_tri, 3) float32, unit; 0 for triangles without area
    tri_frame        (3, 3, n_tri) float32, unit box   from triangle_frames
    smooth           (n_tri,) bool                     whether the corners' normals differ from the geometric one
    shading_normal   (n_tri, 3, 3) float32
    maps             normal maps, None if there are none
    surfaces         what these surfaces reflect
    tri_patterned    (n_tri,) bool: triangles with a normal map over which the diffuse albedo varies
    """

    corner_unit: Float32
    normal: Float32
    tri_frame: Float32
    smooth: BoolArray
    shading_normal: Float32
    maps: NormalMaps | None
    surfaces: SurfaceMaterials
    tri_patterned: BoolArray

    @classmethod
    def of(cls, snapshot: SceneSnapshot, unit_box: UnitBox, surfaces: SurfaceMaterials) -> ReceivingSurfaces:
        corner_unit = unit_box.to_unit(snapshot.tri_position)
        normal = triangle_normals_areas(snapshot.tri_position)[0].astype(np.float32)
        smooth = np.abs(snapshot.tri_normal - normal[:, None]).max(axis=(1, 2)) > _SMOOTH_DEVIATION
        maps = NormalMaps.of(snapshot)
        patterned = surfaces.find_patterned() & (maps.tri_image >= 0) if maps else np.zeros(snapshot.n_tri, bool)
        return cls(corner_unit, normal, triangle_frames(corner_unit), smooth, snapshot.tri_normal, maps, surfaces, patterned)

    def place(self, tri: IntArray, u: Float32, v: Float32) -> Float32:
        """(n, 3) view of rows, unit box: points at weights of corners 1 and 2."""
        return locate_hits(self.tri_frame, tri, u, v).T

    def follow(self, footprints: TexelFootprints, flip: bool) -> ReceiverFrames:
        """Positions and normals at the elements of footprints; on their backs if `flip`."""
        tri, weight = footprints.tri, footprints.weight
        side = self.normal.T.take(tri, axis=1)
        if flip:
            side *= np.float32(-1)
        position = _follow_axes(self.tri_frame, tri, weight)
        position[0] = offset_origin(position[0], side)
        is_smooth = self.smooth[tri]
        bumped = self.maps.has(tri) if self.maps else np.zeros(len(tri), bool)
        if not is_smooth.any() and not bumped.any():
            return ReceiverFrames(position, side, None, None)
        smooth = np.flatnonzero(is_smooth)
        normal = np.zeros_like(position)
        normal[0] = side
        corners = triangle_frames(self.shading_normal[tri[smooth]])
        normal[:, :, smooth] = _follow_axes(corners, np.arange(len(smooth)), weight[:, :, smooth]) * np.float32(-1 if flip else 1)
        bumps = Bumps(self.maps, self.surfaces, bumped, tri, weight) if self.maps and bumped.any() else None
        return ReceiverFrames(position, side, normal, is_smooth | bumped, bumps)


def _follow_axes(frame: Float32, tri: IntArray, weight: Float32) -> Float32:
    """(3, 3, n) float32: value at the origin of elements, and increments along their two axes, in x, y, z; from triangle_frames."""
    corner, *edges = frame.take(tri, axis=2)
    out = np.empty((3, 3, len(tri)), np.float32)
    for row, (u, v) in zip(out, weight, strict=True):
        np.multiply(edges[0], u, out=row)
        row += edges[1] * v
    out[0] += corner
    return out


@dataclass(frozen=True)
class Bumps:
    """Normal maps on the elements of TexelFootprints.

    bumped   (n,) bool           whether the element has a map
    tri      (n,) int32
    weight   (3, 2, n) float32   of corners 1 and 2, at the origin and along the axes
    """

    maps: NormalMaps
    surfaces: SurfaceMaterials
    bumped: BoolArray
    tri: Int32
    weight: Float32

    def find_albedo(self, element: IntArray, a: FloatArray, b: FloatArray) -> Float32:
        """(k, m) float32: diffuse albedo, the mean of its channels, at coordinates a, b (k, m) of elements (k, m)."""
        own = element.ravel()
        u, v = self._weigh_corners(own, a.ravel(), b.ravel())
        return self.surfaces.diffuse_at(self.tri[own], u, v).reshape(a.shape)

    def _weigh_corners(self, element: IntArray, a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Weights (n,) of corners 1 and 2, at coordinates a, b (n,) of elements (n,)."""
        weight = self.weight.take(element, axis=2)
        u, v = weight[0] + a * weight[1] + b * weight[2]
        return u, v

    def put_normals(self, normal: Float32, element: IntArray, a: FloatArray, b: FloatArray) -> None:
        """Replace normals (3, k, m), those between the corners', by the maps', at coordinates a, b (k, m) of elements (1 or k, m).

        Each point has a normal of its own, since a texel may have many bumps, and the light at their mean normal is not their mean light.
        """
        every = np.broadcast_to(element, a.shape).ravel()
        rows = np.flatnonzero(self.bumped[every])
        own = every[rows]
        u, v = self._weigh_corners(own, a.ravel()[rows], b.ravel()[rows])
        every_normal = normal.reshape(3, -1)
        found, of_maps = self.maps.look_up(self.tri[own], u, v, every_normal[:, rows])
        every_normal[:, rows[found]] = of_maps


@dataclass(frozen=True)
class ReceiverFrames:
    """Receivers on the elements of TexelFootprints, linear in two coordinates: values at the origin, and increments along both axes.

    position   (3, 3, n) float32, unit box    [origin or axis, x y z, element], already offset from the surface
    side       (3, n) float32, unit           geometric normal
    normal     (3, 3, n) float32              shading normal, of any length, indexed as position; None if all are flat
    smooth     (n,) bool                      whether the shading normal differs from the geometric one; None if all are flat
    bumps      normal maps, which replace these normals; None if there are none
    """

    position: Float32
    side: Float32
    normal: Float32 | None
    smooth: BoolArray | None
    bumps: Bumps | None = None

    def at(self, element: IntArray, a: FloatArray, b: FloatArray) -> tuple[Float32, Float32, Float32, Float32]:
        """Positions, shading normals, sides, and normals without maps, each (3, k, m) or (3, 1, m), at coordinates a, b (k, m) of elements
        (1 or k, m).
        """
        side = self.side.take(element, axis=1)
        position = _interpolate(self.position.take(element, axis=2), a, b)
        if self.normal is None or self.smooth is None or not self.smooth[element].any():
            return position, side, side, side
        normal = _interpolate(self.normal.take(element, axis=2), a, b)
        length = np.sqrt(normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2])
        cancelled = length <= _SHORTEST_NORMAL
        if cancelled.any():
            length[cancelled] = 1
            normal = np.where(cancelled, side, normal)
        normal /= length
        smooth = normal
        if self.bumps:
            smooth = normal.copy()
            self.bumps.put_normals(normal, element, a, b)
        return position, normal, side, smooth


def _interpolate(frame: Float32, a: FloatArray, b: FloatArray) -> Float32:
    """(3, k, m): origin + a * first axis + b * second axis, for frame (3, 3, 1 or k, m)."""
    out = np.empty((3, *a.shape), np.float32)
    for row, origin, along_a, along_b in zip(out, *frame, strict=True):
        np.multiply(along_a, a, out=row)
        row += along_b * b
        row += origin
    return out


class TexelChunk:
    """Some texels as receivers, with a random shift of the sample points of each.

    footprints   of n texels
    shift        (n, 2) uint32
    surfaces     the surfaces of the footprints
    flip         whether the backs of the texels receive the light
    """

    def __init__(self, footprints: TexelFootprints, shift: NDArray[np.uint32], surfaces: ReceivingSurfaces, flip: bool) -> None:
        self._footprints, self._shift, self._frames = footprints, shift, surfaces.follow(footprints, flip)
        self._surfaces, self._materials, self._flip = surfaces, surfaces.surfaces, flip
        self._patterned = surfaces.tri_patterned[self.tri]  # texels whose points are chosen by their albedo

    def __len__(self) -> int:
        return len(self._footprints)

    @property
    def tri(self) -> Int32:
        """(n,) int32: triangle of each texel's representative point."""
        return self._footprints.tri[: len(self)]

    def find_side_share(self) -> Float32 | None:
        """(n, 3) float32: share of this side's light that the texels show, see SurfaceMaterials.share_sides; None where they show all."""
        rows = np.flatnonzero(self._materials.tri_both[self.tri])
        if not len(rows):
            return None
        origin, along, up = self._footprints.weight[:, :, rows]
        out = np.ones((len(self), 3), np.float32)
        places = [origin + np.float32(x) * along + np.float32(y) * up for x, y in GAUSS_POINTS[:, 0]]
        shares = [self._materials.share_sides(self.tri[rows], *place)[int(self._flip)] for place in places]
        out[rows] = np.mean(shares, axis=0).T
        return out

    def have_bumps(self, rows: IntArray) -> BoolArray:
        """(m,) bool: whether texels rows (m,) have a normal map."""
        return self._frames.bumps.bumped[rows] if self._frames.bumps else np.zeros(len(rows), bool)

    def receivers(self, rows: IntArray, first: int, last: int) -> Receivers:
        """Origins of rays first ... last - 1 of texels `rows`, ordered by ray: ((last - first) * len(rows), ...)."""
        shift = take_rows(self._shift, rows)
        points = shift_points(_TEXEL_POINTS[first:last], shift)
        patterned = np.flatnonzero(self._patterned[rows])
        if len(patterned):
            chosen = self._chosen_by_albedo[first:last, np.searchsorted(self._patterned_rows, rows[patterned])]
            points[:, patterned] = to_unit_interval(_TEXEL_POINTS[chosen] ^ take_rows(shift, patterned))
        return self.receivers_at(rows, points)

    @cached_property
    def _patterned_rows(self) -> Int64:
        return np.flatnonzero(self._patterned)

    @cached_property
    def _chosen_by_albedo(self) -> NDArray[np.uint8]:
        """(k, n): the sample points at which the k rays of n patterned texels start, more often where the diffuse albedo is high.

        A bump in a dark groove counts by as little as it reflects: the light of a texel is what its surface reflects over its albedo, as
        in Cycles' bake. Where the albedo is the same everywhere each ray starts at its own point, and others are not far from it.
        Source: Carpenter, Clifford & Fearnhead 1999, "Improved particle filter for nonlinear problems", systematic resampling.
        """
        rows, count = self._patterned_rows, len(_CURVE)
        shift = take_rows(self._shift, rows)
        albedo = self._albedo_at(rows, shift_points(_TEXEL_POINTS[_CURVE], shift))
        chance = np.cumsum(np.maximum(albedo, _LEAST_ALBEDO), axis=0, dtype=np.float64).T
        offset = to_unit_interval(shift[:, :1] << np.uint32(16))  # of the low bits, which hardly move the points
        end = np.ceil(count * chance / chance[:, -1:] - offset).astype(np.int64)
        on_curve = np.repeat(np.tile(_CURVE, len(rows)), np.diff(end, axis=1, prepend=0).ravel()).reshape(-1, count)
        return on_curve[:, _RANK].T.astype(np.uint8)

    def _albedo_at(self, rows: IntArray, points: Float32) -> Float32:
        """(k, m): diffuse albedo at points (k, m, 2) of the unit squares of texels `rows` (m,), which have normal maps."""
        assert self._frames.bumps is not None
        element, a, b = np.broadcast_to(rows, points.shape[:2]), points[..., 0], points[..., 1]
        part = self._footprints.part[rows]
        torn = np.flatnonzero(part >= 0)
        if len(torn):
            element, a, b = element.copy(), a.copy(), b.copy()
            element[:, torn], a[:, torn], b[:, torn] = self._footprints.choose(part[torn], points[:, torn])
        return self._frames.bumps.find_albedo(element, a, b)

    def receivers_at(self, rows: IntArray, points: FloatArray) -> Receivers:
        """Receivers at points (k, 1 or len(rows), 2) of the unit squares of texels `rows`, ordered by point."""
        shape = (3, len(points), len(rows))
        a, b = (np.broadcast_to(points[..., axis].astype(np.float32, copy=False), shape[1:]) for axis in (0, 1))
        position, normal, side, smooth = self._frames.at(rows[None], a, b)
        part = self._footprints.part[rows]
        torn = np.flatnonzero(part >= 0)
        if len(torn):
            chosen = self._footprints.choose(part[torn], np.broadcast_to(points, (*shape[1:], 2))[:, torn])
            position[:, :, torn], own_normal, own_side, own_smooth = self._frames.at(*chosen)
            flat = normal is side and own_normal is own_side
            smooth = _replace_columns(smooth, shape, torn, own_smooth) if self._frames.bumps else smooth
            side = _replace_columns(side, shape, torn, own_side)
            normal = side if flat else _replace_columns(normal, shape, torn, own_normal)
        places = None if normal is side else self._find_places(rows, a, b, torn, chosen if len(torn) else None)
        sides = np.broadcast_to(side, shape).reshape(3, -1).T
        normals = sides if normal is side else np.broadcast_to(normal, shape).reshape(3, -1).T
        if not self._frames.bumps:
            return Receivers(position.reshape(3, -1).T, normals, sides, places=places)
        bumped = np.tile(self.have_bumps(rows), len(points))
        return Receivers(position.reshape(3, -1).T, normals, sides, bumped, np.broadcast_to(smooth, shape).reshape(3, -1).T, places)

    def _find_places(
        self, rows: IntArray, a: Float32, b: Float32, torn: Int64, chosen: tuple[IntArray, FloatArray, FloatArray] | None
    ) -> SmoothPlaces:
        """Places of receivers_at, for the same points: coordinates a, b (k, m) of texels (m,), in other elements where these are torn."""
        element = np.broadcast_to(rows, a.shape)
        if chosen is not None:
            element, a, b = element.copy(), a.copy(), b.copy()
            element[:, torn], a[:, torn], b[:, torn] = chosen
        return SmoothPlaces(self._surfaces, self._footprints, element.ravel(), a.ravel(), b.ravel(), -1 if self._flip else 1)


def each_chunk(
    surfaces: ReceivingSurfaces,
    footprints_at: Callable[[IntArray], TexelFootprints],
    texel: IntArray,
    tri_two_sided: BoolArray,
    rng: np.random.Generator,
    most: int,
) -> Iterator[tuple[Int64, TexelChunk]]:
    """Chunks of at most `most` of texels (n,): indices (m,) int64 into `texel`, ascending, and the chunk. Texels on two-sided triangles,
    (n_tri,) bool, come twice, since their backs receive light too.
    """
    for start in range(0, len(texel), most):
        footprints = footprints_at(texel[start : start + most])
        part = start + np.arange(len(footprints))
        yield part, TexelChunk(footprints, random_shift(rng, len(part)), surfaces, False)
        backs = part[tri_two_sided[footprints.tri[: len(footprints)]]]
        if len(backs):
            yield backs, TexelChunk(footprints_at(texel[backs]), random_shift(rng, len(backs)), surfaces, True)


def _replace_columns(values: Float32, shape: tuple[int, int, int], columns: IntArray, others: Float32) -> Float32:
    """A copy of the values, broadcast to a shape (3, k, m), with others (3, k, p) in columns (p,)."""
    out: Float32 = np.broadcast_to(values, shape).copy()
    out[:, :, columns] = others
    return out


def light_points(shift: NDArray[np.uint32], first: int, last: int) -> Float32:
    """((last - first) * m, 2) float32: points of the unit square at which rays first ... last - 1 aim on the light; shift (m, 2) uint32."""
    return shift_points(_LIGHT_POINTS[first:last], shift).reshape(-1, 2)


def random_shift(rng: np.random.Generator, count: int) -> NDArray[np.uint32]:
    """(count, 2) uint32, a view of (2, count) rows."""
    return np.ascontiguousarray(rng.integers(0, 2**32, size=(count, 2), dtype=np.uint32).T).T


def row_pieces(rows: IntArray, rays_each: int) -> list[IntArray]:
    """The rows in pieces, so that with `rays_each` rays per row a piece fits the cache."""
    step = max(1, _RAYS_AT_ONCE // rays_each)
    return [rows[start : start + step] for start in range(0, len(rows), step)]
