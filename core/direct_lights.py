"""Lights as direct light sees them: unoccluded irradiance in closed form, and points to aim shadow rays at."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from .emitters import EmittingCells, rotate_to, usable_power, usable_world
from .geometry import ORIGIN_OFFSET, UnitBox
from .irradiance import ellipse_irradiance, point_irradiance, polygon_irradiance, sun_irradiance
from .lights import LAMBERTIAN_SPREAD_RAD, SMALLEST_SIDE, Float32, Float64, SpotCone, spread_attenuation, turn
from .sampling import square_to_cosine_hemisphere, square_to_uniform_cone, square_to_uniform_disk, square_to_uniform_triangle
from .scene import FloatArray, Light, SceneSnapshot

_INFINITE = np.float32(1e30)


@dataclass(frozen=True)
class Aim:
    """Shadow rays from receivers.

    direction   (n, 3) float32, of any length
    distance    (n,) float32   in lengths of the direction
    share       (n,) float32   proportional to the ray's part in the closed form
    weight      (n,) float32   share times what the closed form leaves out: a spot's cone, an area light's spread
    """

    direction: Float32
    distance: Float32
    share: Float32
    weight: Float32


class Source(Protocol):
    """One light; irradiance is that of radiance, intensity or facing irradiance rgb."""

    @property
    def rgb(self) -> Float64: ...

    @property
    def casts_shadow(self) -> bool: ...

    @property
    def is_sharp(self) -> bool:
        """Has no extent, so that its shadows have hard edges."""

    def irradiance(self, position: Float32, normal: Float32) -> Float64:
        """(n,) float64: unoccluded, for rgb = 1, at points (n, 3), unit box, with unit normals (n, 3)."""

    def aim(self, position: Float32, normal: Float32, u: Float32) -> Aim:
        """Rays from points (n, 3) for numbers u (n, 2), uniform in [0, 1)."""


def _aim_at(target: FloatArray, position: Float32, normal: Float32, light_normal: FloatArray) -> Aim:
    """Rays to points of a surface chosen uniformly by area, seen from its front."""
    direction: Float32 = np.subtract(target, position, dtype=np.float32)
    square = np.maximum((direction * direction).sum(axis=1), np.float32(1e-20))
    cosines = np.maximum((direction * normal).sum(axis=1), 0) * np.maximum(-(direction * light_normal).sum(axis=1), 0)
    share = cosines / (square * square)
    return Aim(direction, np.ones(len(square), np.float32), share, share)


@dataclass(frozen=True)
class PointSource:
    """POINT and SPOT; rgb in W/sr times the unit box's scale squared, so that its lengths serve."""

    rgb: Float64
    casts_shadow: bool
    centre: Float32
    axis: Float32
    cone: SpotCone
    radius: float
    soft: bool

    @property
    def is_sharp(self) -> bool:
        return self.radius == 0

    def irradiance(self, position: Float32, normal: Float32) -> Float64:
        return point_irradiance(self.centre - position, normal, self.radius, self.soft)

    def aim(self, position: Float32, normal: Float32, u: Float32) -> Aim:
        to_centre = self.centre - position
        length = np.sqrt(np.maximum((to_centre * to_centre).sum(axis=1), np.float32(1e-20)))
        axis = to_centre / length[:, None]
        if self.radius == 0:
            share = np.maximum((axis * normal).sum(axis=1), 0)
            aim = Aim(to_centre, np.ones(len(length), np.float32), share, share)
        elif self.soft:
            disk = square_to_uniform_disk(u) * np.float32(self.radius)
            aim = _aim_at(self.centre + rotate_to(np.column_stack([disk, np.zeros_like(length)]), axis), position, normal, -axis)
        else:
            aim = self._aim_at_sphere(axis, length, normal, u)
        if self.cone.drop >= 2:
            return aim
        direction = aim.direction / np.sqrt((aim.direction**2).sum(axis=1, keepdims=True))
        weight = aim.share * self.cone.attenuation(-(direction @ self.axis))
        return Aim(aim.direction, aim.distance, aim.share, weight.astype(np.float32))

    def _aim_at_sphere(self, axis: Float32, length: Float32, normal: Float32, u: Float32) -> Aim:
        """Uniform per steradian of the sphere; from within it, cosine-distributed, as in Cycles."""
        share = np.minimum(np.float32(self.radius) ** 2 / length**2, 1)
        drop = u[:, 0] * (share / (1 + np.sqrt(1 - share)))  # of 1 - cos without its cancellation
        across, phi = np.sqrt(drop * (2 - drop)), np.float32(2 * math.pi) * u[:, 1]
        direction = rotate_to(np.stack([across * np.cos(phi), across * np.sin(phi), 1 - drop], axis=1), axis)
        inside = length <= self.radius
        direction = np.where(inside[:, None], rotate_to(square_to_cosine_hemisphere(u), normal), direction)
        along = (direction * axis).sum(axis=1) * length
        half_chord = np.sqrt(np.maximum(np.float32(self.radius) ** 2 - length**2 + along**2, 0))
        cosine = np.where(inside, 1, np.maximum((direction * normal).sum(axis=1), 0)).astype(np.float32)
        return Aim(direction, np.where(inside, along + half_chord, along - half_chord), cosine, cosine)


@dataclass(frozen=True)
class AreaSource:
    """AREA; rgb is the radiance. axes are the light's, half_size its half extents in the unit box."""

    rgb: Float64
    casts_shadow: bool
    centre: Float32
    axes: Float32
    half_size: Float32
    ellipse: bool
    spread_rad: float
    is_sharp: bool = False

    def irradiance(self, position: Float32, normal: Float32) -> Float64:
        x, y = self.axes[:2].astype(np.float64) * self.half_size[:, None]
        # It shines along -z, so who stands there sees (x, y) clockwise: take y first.
        if self.ellipse:
            signed = ellipse_irradiance(self.centre, np.stack([y, x]), position, normal)
        else:
            signed = polygon_irradiance(self.centre + np.stack([-x - y, y - x, x + y, x - y]), position, normal)
        return np.maximum(signed, 0)

    def aim(self, position: Float32, normal: Float32, u: Float32) -> Aim:
        place = (square_to_uniform_disk(u) if self.ellipse else 2 * u - 1) * self.half_size
        # Off its plane, so that a ceiling the light lies in does not cover it.
        target = (self.axes[:2].T @ place.T).T + (self.centre - np.float32(ORIGIN_OFFSET) * self.axes[2])
        aim = _aim_at(target, position, normal, -self.axes[2])
        if self.spread_rad > LAMBERTIAN_SPREAD_RAD:
            return aim
        length = np.sqrt((aim.direction**2).sum(axis=1))
        cosine = (aim.direction @ self.axes[2]) / np.maximum(length, np.float32(1e-20))
        return Aim(aim.direction, aim.distance, aim.share, (aim.share * spread_attenuation(cosine, self.spread_rad)).astype(np.float32))


@dataclass(frozen=True)
class SunSource:
    """SUN; rgb is the irradiance facing it."""

    rgb: Float64
    casts_shadow: bool
    axes: Float32
    half_angle_rad: float

    @property
    def is_sharp(self) -> bool:
        return self.half_angle_rad == 0

    def irradiance(self, position: Float32, normal: Float32) -> Float64:
        return sun_irradiance(normal @ self.axes[2], self.half_angle_rad)

    def aim(self, position: Float32, normal: Float32, u: Float32) -> Aim:
        direction = -turn(square_to_uniform_cone(u, self.half_angle_rad), self.axes)
        cosine = np.maximum((direction * normal).sum(axis=1), 0)
        return Aim(direction, np.full(len(u), _INFINITE), cosine, cosine)


@dataclass(frozen=True)
class TriangleSource:
    """A triangle of constant radiance rgb, two-sided. corners (3, 3) float32, unit box; normal (3,) float32, unit."""

    rgb: Float64
    casts_shadow: bool
    corners: Float32
    normal: Float32
    is_sharp: bool = False

    def irradiance(self, position: Float32, normal: Float32) -> Float64:
        return np.abs(polygon_irradiance(self.corners, position, normal))

    def aim(self, position: Float32, normal: Float32, u: Float32) -> Aim:
        weight = square_to_uniform_triangle(u)
        side = np.where((position - self.corners[0]) @ self.normal >= 0, 1, -1).astype(np.float32)[:, None] * self.normal
        edges = self.corners[1:] - self.corners[0]
        target = (edges.T @ weight.T).T + self.corners[0] + np.float32(ORIGIN_OFFSET) * side
        return _aim_at(target, position, normal, side)


@dataclass(frozen=True)
class WorldSource:
    """Uniform radiance rgb from everywhere."""

    rgb: Float64
    casts_shadow: bool = True
    is_sharp: bool = False

    def irradiance(self, position: Float32, normal: Float32) -> Float64:
        return np.full(len(position), math.pi)

    def aim(self, position: Float32, normal: Float32, u: Float32) -> Aim:
        one = np.ones(len(u), np.float32)
        return Aim(rotate_to(square_to_cosine_hemisphere(u), normal).astype(np.float32), one * _INFINITE, one, one)


def make_sources(snapshot: SceneSnapshot, unit_box: UnitBox) -> list[Source]:
    """Sources of the lamps and of the world."""
    sources: list[Source] = []
    for light in snapshot.lights:
        power = usable_power(light)[0]
        if power.any():
            sources.append(_make_lamp(light, power, unit_box))
    world = usable_world(snapshot)
    return [*sources, WorldSource(world)] if world.any() else sources


def _make_lamp(light: Light, power: Float64, unit_box: UnitBox) -> Source:
    axes = np.array(light.rotation, np.float32)
    centre = unit_box.to_unit(np.array(light.position_m))
    if light.kind == "SUN":
        return SunSource(power, light.casts_shadow, axes, min(max(light.angle_rad, 0.0), math.pi) / 2)
    if light.kind == "AREA":
        half_size = (np.maximum(np.array(light.size_m) * unit_box.scale, SMALLEST_SIDE) / 2).astype(np.float32)
        ellipse = light.shape == "ELLIPSE"
        area = 4 * float(np.prod(half_size.astype(np.float64))) * (math.pi / 4 if ellipse else 1)
        radiance = power * unit_box.scale**2 / (math.pi * area)
        return AreaSource(radiance, light.casts_shadow, centre, axes, half_size, ellipse, light.spread_rad)
    intensity = power / (4 * math.pi) * unit_box.scale**2
    radius = unit_box.to_unit_length(light.radius_m)
    return PointSource(intensity, light.casts_shadow, centre, -axes[2], SpotCone.of(light), radius, light.soft_falloff)


def make_triangle_sources(cells: EmittingCells, corner_unit: Float32, normal: Float32) -> list[Source]:
    """Sources of cells that are whole triangles of constant radiance."""
    return [TriangleSource(rgb, True, corner_unit[tri], normal[tri]) for tri, rgb in zip(cells.tri, cells.mean_rgb, strict=True)]
