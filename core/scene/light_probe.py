"""Rough estimates of irradiance at points before a bake: good enough to distinguish lit from unlit surfaces, too noisy to be shown."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..util.arrays import BoolArray, Float32, Float64, FloatArray, Int32, Int64, IntArray
from ..util.geometry import UnitBox, dot_rows, offset_origin, rotate_to, triangle_normals_areas
from ..util.sampling import square_to_cosine_hemisphere
from .materials import SurfaceMaterials
from .rays import RayScene
from .scene import Light, Material, SceneSnapshot
from .shadow_rays import collapse

MOST_LAMPS = 16  # shadow rays per point; if there are more lamps, so many are chosen at random
_MOST_FORM = 30.0  # bound of area * cosines / distance^2, for points on a glowing surface; a whole surface has at most pi
_FAR = np.float32(4.0)  # length of rays that leave the unit box
_NEAR_ENOUGH = np.float32(1.0 - 1e-4)  # length of a shadow ray over the distance of the lamp, which may lie in a surface


@dataclass(frozen=True)
class Seen:
    """Hits of one ray from each point.

    tri        (n,) int32, -1 for a miss
    distance   (n,) float64, m; inf for a miss
    is_front   (n,) bool: whether the ray meets the front of the triangle
    place      (n, 3) float32, unit box
    side       (n, 3) float32, unit: the triangle's normal on the side that the ray meets
    """

    tri: Int32
    distance: Float64
    is_front: BoolArray
    place: Float32
    side: Float32


class LightProbe:
    """Estimates light at points of a scene, in one channel. Surfaces that transmit any light are left out."""

    def __init__(self, snapshot: SceneSnapshot, seed: int = 0) -> None:
        self.snapshot = snapshot
        self.box = UnitBox.from_points(snapshot.vertex_position)
        self._corner = snapshot.tri_position
        self.normal, self.area = triangle_normals_areas(self._corner)
        blocks = np.array([one.casts_shadow for one in snapshot.objects], bool)[snapshot.tri_object]
        blocks &= ~np.array([_lets_light_pass(one) for one in snapshot.materials], bool)[snapshot.tri_material]
        self._rays = RayScene(collapse(self.box.to_unit(self._corner), blocks))
        dark = np.array([(one.dark_front, one.dark_back) for one in snapshot.materials], np.int8).reshape(-1, 2)[snapshot.tri_material]
        self._glow_side = dark[:, 1] - dark[:, 0]  # 1 in front, -1 behind, 0 both
        self._lamps = [light for light in snapshot.lights if any(light.power_rgb) and light.seen_by[0]]
        sky = snapshot.world_map if snapshot.world_map is not None else np.array(snapshot.world_rgb)
        self._sky = float(np.mean(sky)) if np.isfinite(sky).all() else 0.0
        self._rng = np.random.default_rng(seed)

    @cached_property
    def _surfaces(self) -> SurfaceMaterials:
        return SurfaceMaterials(self.snapshot)

    def spread_points(self, tri: IntArray) -> tuple[Float32, Float32]:
        """Random points on triangles (n,), and normals of their fronts: each (n, 3) float32, the points in the unit box."""
        u = self._rng.random((len(tri), 2))
        over = u.sum(axis=1) > 1.0
        u[over] = 1.0 - u[over]
        one, two, three = np.moveaxis(self._corner[tri], 1, 0)
        return self.box.to_unit(one + u[:, :1] * (two - one) + u[:, 1:] * (three - one)), self.normal[tri].astype(np.float32)

    def spread_evenly(self, tri: IntArray, part: IntArray, each: int) -> tuple[Float32, Float32]:
        """As spread_points, `each` points on every part, on triangles that are stratified by area.

        part   (n,) int: parts of the triangles, ascending from 0
        """
        area = np.cumsum(self.area[tri])
        top = area[np.flatnonzero(np.diff(part, append=part[-1] + 1))]
        low = np.concatenate([[0.0], top[:-1]])
        at = low[:, None] + (top - low)[:, None] * (np.arange(each) + 0.5) / each
        return self.spread_points(tri[np.minimum(np.searchsorted(area, at.ravel()), len(tri) - 1)])

    def trace(self, point: Float32, side: Float32) -> Seen:
        """Hits of cosine-distributed rays from points, on the side of the normals (n, 3)."""
        direction = rotate_to(square_to_cosine_hemisphere(self._rng.random((len(point), 2))), side).astype(np.float32)
        origin = offset_origin(point, side)
        hits = self._rays.closest(origin, direction)
        met = hits.tri >= 0
        normal = self.normal[hits.tri].astype(np.float32)
        is_front = met & (dot_rows(normal, direction) < 0)
        distance = np.where(met, hits.distance, np.inf) / self.box.scale
        place = origin + np.where(met, hits.distance, 0)[:, None].astype(np.float32) * direction
        return Seen(hits.tri, distance, is_front, place, np.where(is_front[:, None], normal, -normal))

    @property
    def has_sky(self) -> bool:
        return self._sky > 0.0

    def find_glowing(self) -> Int64:
        """(n,) int64: triangles that glow."""
        return self._glowing[0]

    def meet(self, origin: Float32, direction: Float32) -> Int32:
        """(n,) int32: the triangle that each ray meets, -1 for none; the origins lie on no surface."""
        return self._rays.closest(origin, direction).tri

    def find_irradiance(self, point: Float32, side: Float32, bounces: int = 1) -> Float64:
        """(n,) float64, W/m^2: from lamps, glowing surfaces and the sky, by one path each with so many bounces."""
        total = np.zeros(len(point))
        throughput, rows = np.ones(len(point)), np.arange(len(point))
        third = np.full(len(point), 1.0 / 3.0, np.float32)
        for bounce in range(bounces + 1):
            total[rows] += throughput * (self._from_lamps(point, side) + self._from_glow(point, side))
            seen = self.trace(point, side)
            total[rows] += throughput * np.pi * self._sky * (seen.tri < 0)
            met = np.flatnonzero(seen.tri >= 0)
            if bounce == bounces or not len(met):
                break
            third = third[: len(met)]
            albedo = self._surfaces.albedo.at(seen.tri[met], third, third).mean(axis=1, dtype=np.float64)
            back = self._surfaces.dim_back(seen.tri[met], seen.is_front[met])
            throughput = throughput[met] * albedo * (1.0 if back is None else back.mean(axis=0))
            rows, point, side = rows[met], seen.place[met], seen.side[met]
            if self._surfaces.has_through:
                through = self._surfaces.through.at(seen.tri[met], third, third).mean(axis=1, dtype=np.float64)
                side = np.where((self._rng.random(len(met)) * albedo < through)[:, None], -side, side)
        return total

    @cached_property
    def _glowing(self) -> tuple[Int64, Float64, Float64]:
        """Triangles that glow, their radiance, and the cumulative sum of their powers, normalised to 1."""
        tri = np.arange(self.snapshot.n_tri)
        third = np.full(len(tri), 1.0 / 3.0, np.float32)
        radiance = self._surfaces.emission.at(tri, third, third).mean(axis=1, dtype=np.float64)
        power = np.cumsum(radiance * self.area)
        tri = np.flatnonzero(radiance * self.area > 0.0)
        return tri, radiance[tri], power[tri] / power[-1] if len(tri) else power[:0]

    def _from_glow(self, point: Float32, side: Float32) -> Float64:
        """(n,) W/m^2, by one shadow ray each to a point of a glowing triangle, chosen by power."""
        tri, radiance, sums = self._glowing
        out = np.zeros(len(point))
        if not len(tri):
            return out
        chosen = np.minimum(np.searchsorted(sums, self._rng.random(len(point))), len(tri) - 1)
        share = np.diff(sums, prepend=0.0)[chosen]
        target, normal = self.spread_points(tri[chosen])
        way = target - point
        distance = np.maximum(np.linalg.norm(way, axis=1), np.float32(1e-9))
        direction = way / distance[:, None]
        facing = dot_rows(direction, side)
        seen = np.flatnonzero(facing > 0.0)
        blocked = self._rays.occluded(offset_origin(point[seen], side[seen]), direction[seen], distance[seen] * _NEAR_ENOUGH)
        seen = seen[~blocked]
        distance_m = distance[seen] / self.box.scale
        sent = -dot_rows(direction[seen], normal[seen])
        only = self._glow_side[tri[chosen[seen]]]
        sent = np.where(only == 0, np.abs(sent), np.maximum(only * sent, 0.0))
        form = facing[seen] * sent / distance_m.astype(np.float64) ** 2
        area = self.area[tri[chosen[seen]]]
        out[seen] = np.minimum(form * area, _MOST_FORM) / share[seen] * radiance[chosen[seen]]
        return out

    def _from_lamps(self, point: Float32, side: Float32) -> Float64:
        total = np.zeros(len(point))
        n_lamp = len(self._lamps)
        if n_lamp <= MOST_LAMPS:
            for lamp in self._lamps:
                total += self._from_lamp(lamp, point, side)
            return total
        chosen = self._rng.integers(0, n_lamp, (MOST_LAMPS, len(point)))
        for row in chosen:
            for number in np.unique(row):
                here = np.flatnonzero(row == number)
                total[here] += self._from_lamp(self._lamps[number], point[here], side[here]) * (n_lamp / MOST_LAMPS)
        return total

    def _from_lamp(self, lamp: Light, point: Float32, side: Float32) -> Float64:
        power = float(np.mean(lamp.power_rgb))
        axis = np.array(lamp.rotation)
        if lamp.kind == "SUN":
            direction = np.broadcast_to(axis[2].astype(np.float32), point.shape)
            reach = np.full(len(point), _FAR, np.float32)
            value = np.full(len(point), power)
        else:
            direction, distance_m = self._aim(lamp, axis, point)
            reach = (distance_m * self.box.scale).astype(np.float32) * _NEAR_ENOUGH
            value = power / (4.0 * np.pi * np.maximum(distance_m, max(lamp.radius_m, 1e-9)) ** 2)
            along = direction.astype(np.float64) @ axis[2]  # the lamp shines along -z
            if lamp.kind == "SPOT":
                value = value * (along > math.cos(lamp.cone_angle_rad / 2))
            elif lamp.kind == "AREA":
                value = 4.0 * value * np.maximum(along, 0.0)
        facing = dot_rows(direction, side).astype(np.float64)
        seen = np.flatnonzero((facing > 0.0) & (value > 0.0))
        if lamp.casts_shadow and len(seen):
            blocked = self._rays.occluded(offset_origin(point[seen], side[seen]), direction[seen], reach[seen])
            seen = seen[~blocked]
        out = np.zeros(len(point))
        out[seen] = value[seen] * facing[seen]
        return out

    def _aim(self, lamp: Light, axis: FloatArray, point: Float32) -> tuple[Float32, Float64]:
        """Directions (n, 3) to random points of a lamp, and their distances (n,), m."""
        target = np.broadcast_to(np.array(lamp.position_m), point.shape)
        if lamp.kind == "AREA":
            across = (
                (self._rng.random((len(point), 2)) - 0.5) * np.array(lamp.size_m) * (1.0 if lamp.shape == "RECTANGLE" else math.sqrt(0.5))
            )
            target = target + across @ axis[:2]
        elif lamp.radius_m > 0.0:
            ball = self._rng.normal(size=point.shape)
            target = target + lamp.radius_m * ball / np.linalg.norm(ball, axis=1, keepdims=True)
        way = self.box.to_unit(target).astype(np.float64) - point
        distance = np.maximum(np.linalg.norm(way, axis=1), 1e-12)
        return (way / distance[:, None]).astype(np.float32), distance / self.box.scale


def _lets_light_pass(material: Material) -> bool:
    return any(material.passing_rgb) or any(material.shadow_passing_rgb or ()) or any(material.glass_rgb)
