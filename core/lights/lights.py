"""Photon emission of Blender's lights: point, spot, sun and area."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..scene.scene import Light
from ..scene.scene_cover import SceneCover
from ..util.arrays import Float32, Float64, FloatArray
from ..util.geometry import UnitBox, combine_vectors, orthonormal_basis, stack_columns
from ..util.sampling import directions_from_height, square_to_cosine_hemisphere, square_to_uniform_cone, square_to_uniform_disk
from ..util.sphere_map import CellTable, find_solid_angles

SMALLEST_SIDE = 1e-6  # unit box; least side of an area light
LAMBERTIAN_SPREAD_RAD = math.pi - 1e-4
SMALLEST_SPREAD_RAD = math.radians(0.1)  # a smaller one looks the same and cannot be integrated
_SHARPEST_RIM = 1e-12  # of a spot, in 1 - cosine: below the resolution of float32
_SPREAD_STEPS = 4096
_CONE_STEPS = 64


@dataclass(frozen=True)
class EmittedPhotons:
    """Emitted photons; best as views of (k, n) rows.

    origin         (n, 3) float32, unit box
    direction      (n, 3) float32, unit
    relative_rgb   (n, 1) or (n, 3) float32   power relative to equal shares of the emitter's; its mean is 1
    soft_radius    (n,) float32, unit box     radius of a disk that faces the receiver; 0 for other lights; for photons that cross a sphere,
                                              minus the distance within which they must hit a surface
    soft_offset    (n,) float32, unit box     distance of the origin from that disk's centre
    """

    origin: Float32
    direction: Float32
    relative_rgb: Float32
    soft_radius: Float32
    soft_offset: Float32


@dataclass(frozen=True)
class Emitter(ABC):
    """Anything that emits photons.

    power_rgb      (3,) float64, W, emitted into the scene
    casts_shadow   if False, its light reaches every surface along a ray, also those behind others
    link           row of LightLinks, -1 for none
    """

    name: str
    power_rgb: Float64
    casts_shadow: bool = field(default=True, kw_only=True)
    link: int = field(default=-1, kw_only=True)

    @abstractmethod
    def emit(self, u: Float32) -> EmittedPhotons:
        """Photons for numbers u (n, 4) float32, uniform in [0, 1)."""


def make_photons(origin: FloatArray, direction: FloatArray, relative: FloatArray | None = None) -> EmittedPhotons:
    """Photons without a soft radius; they have equal power if `relative` is left out."""
    zero = np.zeros(len(origin), np.float32)
    shares = np.ones((len(origin), 1), np.float32) if relative is None else relative.astype(np.float32)
    return EmittedPhotons(origin.astype(np.float32, copy=False), direction.astype(np.float32, copy=False), shares, zero, zero)


def turn(local: FloatArray, axes: FloatArray) -> Float32:
    """Local directions (n, 3) in world space; +Z maps to -axes[2], along which a Blender light shines. axes (3, 3, 1) or (3, 3, n)."""
    shining = axes * np.array([1, 1, -1], np.float32)[:, None, None]
    return combine_vectors(np.asarray(local, np.float32), shining)


def spot_attenuation(cosine: FloatArray, drop: FloatArray | float, blend: FloatArray | float) -> FloatArray:
    """A SpotCone's attenuation; cosine, drop and blend are numbers or (n,)."""
    t = np.clip((drop - (1 - cosine)) / np.maximum(blend * drop, _SHARPEST_RIM), 0, 1)
    return t * t * (3 - 2 * t)


def sample_spot_drop(u: FloatArray, drop: Float64 | float, blend: Float64 | float) -> FloatArray:
    """1 - cosine with density proportional to a SpotCone's attenuation.

    u             (n,) float, uniform in [0, 1)
    drop, blend   numbers, (1,) or (n,) float64
    """
    mass: FloatArray = u * np.asarray(drop * (1 - blend / 2), np.float32)
    if not np.any(blend):
        return mass
    rim = np.maximum(drop * blend, _SHARPEST_RIM)
    full, inner, width = (np.asarray(value, u.dtype) for value in (drop, drop - rim, rim))
    beyond = (mass - inner) / (width / 2)  # share of the rim's flux further inside
    target = np.clip(1 - beyond, 0, 1)
    # 2 t^3 - t^4 is convex, so Newton's iteration converges from the cube root, which is greater than the solution.
    t = np.cbrt(target)
    for _ in range(5):
        t -= (2 * t - t * t - target / np.maximum(t * t, 1e-30)) / (6 - 4 * t)
    return np.where(beyond <= 0, mass, full - width * t)


@dataclass(frozen=True)
class SpotCone:
    """A spot's angular falloff: 1 inside, smoothstep of the cosine in the blended rim, 0 outside.

    drop    1 - cosine of the half angle; 2 is a point light
    blend   share of the drop that is blended
    Source: Cycles, kernel/light/spot.h, spot_light_attenuation; scene/light.cpp, spot_smooth.
    """

    drop: float = 2.0
    blend: float = 0.0

    @classmethod
    def of(cls, light: Light) -> SpotCone:
        if light.kind != "SPOT":
            return cls()
        half_angle = min(max(light.cone_angle_rad, 1e-3), 2 * math.pi) / 2
        return cls(2 * math.sin(half_angle / 2) ** 2, min(max(light.blend, 0.0), 1.0))

    @property
    def mean_drop(self) -> float:
        """Integral of the attenuation over 1 - cosine; smoothstep is half of its width."""
        return self.drop * (1 - self.blend / 2)


@dataclass(frozen=True)
class PointEmitter(Emitter):
    """A point or spot light; with a radius, a disk perpendicular to each photon's path (soft), or a sphere. See emitters.

    centre        (3, 1) float32, unit box
    axes          (3, 3, 1) float32            the light's x, y and z
    drop, blend   (1,) float64                 of its SpotCone
    radius        (1,) float32, unit box
    crowded       whether some surface is nearer to the centre than the radius
    Lines of uniform direction through uniform points of the disk perpendicular to them have exactly the light field of a uniform sphere.
    Source: Cycles, kernel/light/point.h and spot.h; radiance power / (4 pi^2 r^2).
    """

    centre: Float32
    axes: Float32
    drop: Float64
    blend: Float64
    radius: Float32
    soft: bool
    crowded: bool = False

    def choose_direction(self, u: Float32) -> Float32:
        """(n, 3), unit, for numbers (n, 2)."""
        drop = sample_spot_drop(u[:, 0], self.drop, self.blend)
        return turn(directions_from_height(drop, u[:, 1]), self.axes)

    def emit(self, u: Float32) -> EmittedPhotons:
        direction = self.choose_direction(u[:, :2])
        photons = make_photons(np.broadcast_to(self.centre.T, direction.shape), direction)
        if not self.radius.any():
            return photons
        place = u[:, 2:4]
        inside = (u[:, 2] < 0.5) & (self.crowded and not self.soft)
        if self.crowded and not self.soft:
            place = stack_columns(np.where(inside, 2 * u[:, 2], 2 * u[:, 2] - 1), u[:, 3])
        disk = square_to_uniform_disk(place) * self.radius[:, None]
        tangent, bitangent = orthonormal_basis(direction)
        origin = self.centre.T + disk[:, :1] * tangent + disk[:, 1:] * bitangent
        offset_squared = disk[:, 0] ** 2 + disk[:, 1] ** 2
        if not self.soft:
            rise = np.sqrt(np.maximum(self.radius**2 - offset_squared, 0))
            if not self.crowded:
                return make_photons(origin + rise[:, None] * direction, direction)
            # A surface inside the sphere sees its far side. So half of the photons cross the sphere, and count if they hit inside of it.
            toward = np.where(inside, -rise, rise)
            born = (origin + toward[:, None] * direction).astype(np.float32, copy=False)
            reach = np.where(inside, -2 * rise, 0).astype(np.float32)
            return EmittedPhotons(born, direction, 2 * photons.relative_rgb, reach, np.zeros_like(reach))
        radius = np.broadcast_to(self.radius, len(u))
        return EmittedPhotons(origin.astype(np.float32, copy=False), direction, photons.relative_rgb, radius, np.sqrt(offset_squared))


@dataclass(frozen=True)
class ProfileEmitter(PointEmitter):
    """A point light whose intensity differs by direction.

    table   directions in the light's own axes
    """

    table: CellTable = field(kw_only=True)

    def choose_direction(self, u: Float32) -> Float32:
        return combine_vectors(self.table.sample(u)[0], self.axes)


@dataclass(frozen=True)
class AreaEmitter(Emitter):
    """A one-sided rectangle or ellipse. See emitters.

    centre        (3, 1) float32, unit box
    axes          (3, 3, 1) float32            the light's x, y and z
    half_size     (2, 1) float32, unit box     half extents along x and y
    spread_rad    pi is Lambertian
    Source: Cycles, kernel/light/area.h; radiance power / (pi area), area_light_spread_attenuation.
    """

    centre: Float32
    axes: Float32
    half_size: Float32
    ellipse: bool
    spread_rad: float

    def emit(self, u: Float32) -> EmittedPhotons:
        place = (square_to_uniform_disk(u[:, :2]) if self.ellipse else 2 * u[:, :2] - 1) * self.half_size.T
        origin = self.centre.T + combine_vectors(place, self.axes[:2])
        if self.spread_rad > LAMBERTIAN_SPREAD_RAD:
            return make_photons(origin, turn(square_to_cosine_hemisphere(u[:, 2:4]), self.axes))
        theta = sample_spread_angle(u[:, 2], self.spread_rad)
        phi = 2 * math.pi * u[:, 3]
        local = stack_columns(np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta))
        return make_photons(origin, turn(local, self.axes))


def spread_attenuation(cosine: FloatArray, spread_rad: FloatArray | float) -> FloatArray:
    """Radiance of an area light relative to a Lambertian one of equal power, at the cosine to its axis.

    spread_rad   a number, (1,) or (n,) float
    Source: Cycles, kernel/light/area.h, area_light_spread_attenuation; scene/light.cpp, normalize_spread.
    """
    half = np.maximum(spread_rad, SMALLEST_SPREAD_RAD) / 2
    positive = np.maximum(cosine, 1e-6)
    tangent = np.sqrt(np.maximum(1 - cosine * cosine, 0)) / positive
    # For small x, tan x - x is computed by its series, without cancellation.
    difference = np.where(half > 0.05, np.tan(half) - half, half**3 / 3 + 2 * half**5 / 15)
    out = np.maximum(np.tan(half) - tangent, 0) / difference
    return np.where(np.greater(spread_rad, LAMBERTIAN_SPREAD_RAD), 1, out)


def sample_spread_angle(u: FloatArray, spread_rad: float) -> FloatArray:
    """Angles to the axis with density proportional to attenuation * cosine per steradian; u (n,) uniform in [0, 1)."""
    half = max(spread_rad, SMALLEST_SPREAD_RAD) / 2
    theta = np.linspace(0, half, _SPREAD_STEPS + 1)
    # (tan half - tan theta) cos theta sin theta = sin(half - theta) sin(theta) / cos half
    density = np.sin(half - theta) * np.sin(theta)
    cumulative = np.concatenate([[0], np.cumsum(density[1:] + density[:-1])])
    return np.interp(u, cumulative / cumulative[-1], theta)


@dataclass(frozen=True)
class SunEmitter(Emitter):
    """Parallel light, or light from a disk of directions, which enters through the faces of the scene's box.

    axes           (3, 3, 1) float32   the light's x, y and z
    mean_outline   unit box squared: the box's outline, averaged over the disk
    """

    axes: Float32
    half_angle_rad: float
    cover: SceneCover
    mean_outline: float

    def emit(self, u: Float32) -> EmittedPhotons:
        direction = turn(square_to_uniform_cone(u[:, 2:4], self.half_angle_rad), self.axes)
        seen = np.abs(direction) * self.cover.face_area.astype(np.float32)
        across, rest = self.cover.choose_faces(u[:, 0], seen)
        entering_high = (across * direction.T).sum(axis=0) < 0
        relative = self.cover.outline_area(direction)[:, None] / self.mean_outline
        return make_photons(self.cover.place(across, entering_high, rest, u[:, 1]), direction, relative)


def make_light_emitter(
    light: Light, power_rgb: Float64, unit_box: UnitBox, cover: SceneCover, profiles: Sequence[Float32] = (), link: int = -1
) -> Emitter:
    """The emitter of a light; power_rgb is from usable_power, link is its row of LightLinks."""
    axes = np.array(light.rotation, np.float32)[..., None]
    centre = unit_box.to_unit(np.array(light.position_m))[:, None]
    shared: dict[str, Any] = {"casts_shadow": light.casts_shadow, "link": link}
    if light.kind == "SUN":
        half = min(max(light.angle_rad, 0.0), math.pi) / 2
        grid = (np.arange(_CONE_STEPS) + 0.5) / _CONE_STEPS
        square = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
        outline = float(cover.outline_area(turn(square_to_uniform_cone(square, half), axes)).mean())
        # A disk of radiance E / (pi sin^2 half) over 2 pi (1 - cos half) steradians.
        power = power_rgb * (2 / (1 + math.cos(half))) * outline / unit_box.scale**2
        return SunEmitter(light.name, power, axes, half, cover, outline, **shared)
    if light.kind == "AREA":
        half_size = (np.maximum(np.array(light.size_m) * unit_box.scale, SMALLEST_SIDE) / 2).astype(np.float32)[:, None]
        return AreaEmitter(light.name, power_rgb, centre, axes, half_size, light.shape == "ELLIPSE", light.spread_rad, **shared)
    cone = SpotCone.of(light)
    radius = np.array([unit_box.to_unit_length(light.radius_m)], np.float32)
    power = power_rgb * (cone.mean_drop / 2)
    drop, blend = np.array([cone.drop], np.float64), np.array([cone.blend], np.float64)
    if light.profile >= 0:
        profile = profiles[light.profile].astype(np.float64)
        table = CellTable(profile * find_solid_angles(*profile.shape)[:, None])
        return ProfileEmitter(light.name, power, centre, axes, drop, blend, radius, light.soft_falloff, table=table, **shared)
    return PointEmitter(light.name, power, centre, axes, drop, blend, radius, light.soft_falloff, **shared)
