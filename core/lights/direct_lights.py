"""Sources of direct light: unoccluded irradiance in closed form, and sample points for shadow rays.

A source holds lights of one kind, a row each in its arrays; rows() makes of it one that has a row for each receiver.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self, cast

import numpy as np

from ..scene.scene import Light, SceneSnapshot
from ..util.arrays import BoolArray, Float32, Float64, FloatArray, Int64, IntArray
from ..util.geometry import ORIGIN_OFFSET, UnitBox, dot_rows, rotate_to, take_rows, triangle_normals_areas
from ..util.sampling import directions_from_height, square_to_cosine_hemisphere, square_to_uniform_disk, square_to_uniform_triangle
from ..util.sphere_map import find_cells
from .emitters import usable_power, usable_world
from .emitting_cells import EmittingCells
from .irradiance import ellipse_irradiance, point_irradiance, polygon_irradiance, sun_irradiance
from .lights import LAMBERTIAN_SPREAD_RAD, SMALLEST_SIDE, SpotCone, spot_attenuation, spread_attenuation

INFINITE = np.float32(1e30)


@dataclass(frozen=True)
class Aim:
    """Shadow rays from receivers.

    direction   (n, 3) float32, of any length
    distance    (n,) float32   in lengths of the direction
    share       (n,) float32   the ray's part in the closed form: their mean over all rays is the closed form
    weight      (n,) float32   share times what the closed form leaves out: a spot's cone, an area light's spread
    by_chance   whether they go to what rays in random directions meet too, the sky or a surface: then none start behind a face
    """

    direction: Float32
    distance: Float32
    share: Float32
    weight: Float32
    by_chance: bool = False


@dataclass(frozen=True)
class Source(ABC):
    """Lights of one kind; one of them may shine at many receivers, more need a row for each receiver.

    rgb            (m, 3) float64: radiance, intensity or facing irradiance of each light
    casts_shadow   if False, its light reaches every surface
    is_sharp       whether it has no extent, so that its shadows have hard edges
    """

    rgb: Float64
    casts_shadow: bool
    is_sharp: bool = field(default=False, kw_only=True)

    def rows(self, index: IntArray) -> Self:
        """The lights with these numbers, in their order."""
        arrays = {name: value for name, value in vars(self).items() if isinstance(value, np.ndarray)}
        return replace(cast(Any, self), **{name: take_rows(one, index) if one.ndim == 2 else one[index] for name, one in arrays.items()})

    @abstractmethod
    def irradiance(self, position: Float32, normal: Float32) -> Float64:
        """(n,) float64: unoccluded, for rgb = 1, at points (n, 3), unit box, with unit normals (n, 3)."""

    @abstractmethod
    def aim(self, position: Float32, normal: Float32, u: Float32) -> Aim:
        """Rays from points (n, 3) for numbers u (n, 2), uniform in [0, 1)."""


def _aim_at(target: FloatArray, position: Float32, normal: Float32, light_normal: FloatArray, area: Float32 | float) -> Aim:
    """Rays to points of a surface chosen uniformly by area, seen from its front."""
    direction: Float32 = np.subtract(target, position, dtype=np.float32)
    square = np.maximum(dot_rows(direction, direction), np.float32(1e-20))
    cosines = np.maximum(dot_rows(direction, normal), 0) * np.maximum(-dot_rows(direction, light_normal), 0)
    share = cosines / (square * square) * area
    return Aim(direction, np.ones(len(square), np.float32), share, share)


def _combine(u: FloatArray, x_axis: Float32, y_axis: Float32) -> Float32:
    """(n, 3) view of (3, n) rows: u[:, 0] * x_axis + u[:, 1] * y_axis."""
    return (u[:, 0] * x_axis.T + u[:, 1] * y_axis.T).T


@dataclass(frozen=True)
class PointSource(Source):
    """POINT and SPOT; rgb in W/sr times the unit box's scale squared, so that its lengths serve.

    centre        (m, 3) float32, unit box
    axis          (m, 3) float32, unit        a spot's
    drop, blend   (m,) float32                see SpotCone
    radius        (m,) float32, unit box      0 exactly where is_sharp
    """

    centre: Float32
    axis: Float32
    drop: Float32
    blend: Float32
    radius: Float32
    soft: bool
    is_spot: bool

    def irradiance(self, position: Float32, normal: Float32) -> Float64:
        return point_irradiance(self.centre - position, normal, self.radius, self.soft)

    def aim(self, position: Float32, normal: Float32, u: Float32) -> Aim:
        to_centre = self.centre - position
        square = np.maximum(dot_rows(to_centre, to_centre), np.float32(1e-20))
        length = np.sqrt(square)
        axis = to_centre / length[:, None]
        if self.is_sharp:
            share = np.maximum(dot_rows(axis, normal), 0) / square
            aim = Aim(to_centre, np.ones(len(length), np.float32), share, share)
        elif self.soft:
            disk = square_to_uniform_disk(u) * self.radius[:, None]
            # The radiance is 1 / area.
            aim = _aim_at(self.centre + rotate_to(np.column_stack([disk, np.zeros_like(length)]), axis), position, normal, -axis, 1.0)
        else:
            aim = self._aim_at_sphere(axis, length, normal, u)
        if not self.is_spot:
            return aim
        direction = aim.direction / np.sqrt(dot_rows(aim.direction, aim.direction))[:, None]
        weight = aim.share * spot_attenuation(-dot_rows(direction, self.axis), self.drop, self.blend)
        return Aim(aim.direction, aim.distance, aim.share, weight.astype(np.float32))

    def _aim_at_sphere(self, axis: Float32, length: Float32, normal: Float32, u: Float32) -> Aim:
        """Uniform per steradian of the sphere; from within it, cosine-distributed, as in Cycles."""
        radius_squared = self.radius**2
        covered = np.minimum(radius_squared / length**2, 1)
        drop = covered / (1 + np.sqrt(1 - covered))  # 1 - cos without its cancellation
        direction = rotate_to(directions_from_height(u[:, 0] * drop, u[:, 1]), axis)
        inside = length <= self.radius
        direction = np.where(inside[:, None], rotate_to(square_to_cosine_hemisphere(u), normal), direction)
        along = dot_rows(direction, axis) * length
        half_chord = np.sqrt(np.maximum(radius_squared - length**2 + along**2, 0))
        # A solid angle, or pi where the cosine is in the directions, of radiance 1 / (pi r^2).
        share = np.where(inside, 0.5, drop * np.maximum(dot_rows(direction, normal), 0)) * (2 / radius_squared)
        share = share.astype(np.float32)
        return Aim(direction, np.where(inside, along + half_chord, along - half_chord), share, share)


@dataclass(frozen=True)
class ProfileSource(PointSource):
    """POINT with an intensity that differs by direction; rgb is that of the brightest.

    x_axis, y_axis, z_axis   (m, 3) float32, unit
    profile                  (m,) int64, of profiles
    profiles                 (h, w) float32 each, as in SceneSnapshot
    """

    x_axis: Float32
    y_axis: Float32
    z_axis: Float32
    profile: Int64
    profiles: tuple[Float32, ...]

    def aim(self, position: Float32, normal: Float32, u: Float32) -> Aim:
        aim = super().aim(position, normal, u)
        length = np.maximum(np.sqrt(dot_rows(aim.direction, aim.direction)), np.float32(1e-20))
        local = np.stack([-dot_rows(aim.direction, axis) / length for axis in (self.x_axis, self.y_axis, self.z_axis)], axis=1)
        own = np.broadcast_to(self.profile, (len(local),))
        relative = np.zeros(len(local), np.float32)
        for number in np.unique(own):
            profile, rows = self.profiles[number], np.flatnonzero(own == number)
            relative[rows] = profile.ravel()[find_cells(profile.shape, local[rows])] / profile.max()
        return Aim(aim.direction, aim.distance, aim.share, aim.weight * relative)


@dataclass(frozen=True)
class AreaSource(Source):
    """AREA; rgb is the radiance.

    centre             (m, 3) float32, unit box
    x_axis, y_axis     (m, 3) float32, unit box   half extents
    z_axis             (m, 3) float32, unit       away from what it lights
    area               (m,) float32, unit box squared
    spread_rad         (m,) float32
    """

    centre: Float32
    x_axis: Float32
    y_axis: Float32
    z_axis: Float32
    area: Float32
    spread_rad: Float32
    ellipse: bool
    is_lambertian: bool

    def irradiance(self, position: Float32, normal: Float32) -> Float64:
        x, y = self.x_axis.astype(np.float64), self.y_axis.astype(np.float64)
        # It emits along -z, and seen from there (x, y) is clockwise: take y first.
        if self.ellipse:
            signed = ellipse_irradiance(self.centre, np.stack([y, x], axis=1), position, normal)
        else:
            signed = polygon_irradiance(self.centre[:, None] + np.stack([-x - y, y - x, x + y, x - y], axis=1), position, normal)
        return np.maximum(signed, 0)

    def aim(self, position: Float32, normal: Float32, u: Float32) -> Aim:
        place = square_to_uniform_disk(u) if self.ellipse else 2 * u - 1
        # Off its plane, so that a ceiling the light lies in does not cover it.
        target = _combine(place, self.x_axis, self.y_axis) + (self.centre - np.float32(ORIGIN_OFFSET) * self.z_axis)
        aim = _aim_at(target, position, normal, -self.z_axis, self.area)
        if self.is_lambertian:
            return aim
        length = np.sqrt(dot_rows(aim.direction, aim.direction))
        cosine = dot_rows(aim.direction, self.z_axis) / np.maximum(length, np.float32(1e-20))
        return Aim(aim.direction, aim.distance, aim.share, (aim.share * spread_attenuation(cosine, self.spread_rad)).astype(np.float32))


@dataclass(frozen=True)
class SunSource(Source):
    """SUN; rgb is the irradiance facing it.

    x_axis, y_axis, z_axis   (m, 3) float32, unit   z towards the sun
    half_angle_rad           (m,) float32
    """

    x_axis: Float32
    y_axis: Float32
    z_axis: Float32
    half_angle_rad: Float32

    def irradiance(self, position: Float32, normal: Float32) -> Float64:
        return sun_irradiance(dot_rows(normal, self.z_axis), self.half_angle_rad)

    def aim(self, position: Float32, normal: Float32, u: Float32) -> Aim:
        local = directions_from_height(u[:, 0] * (2 * np.sin(self.half_angle_rad / 2) ** 2), u[:, 1])
        direction = local[:, 2:] * self.z_axis - local[:, :1] * self.x_axis - local[:, 1:2] * self.y_axis
        # A disk of radiance 1 / (pi sin^2) over 2 pi (1 - cos) steradians.
        share = np.maximum(dot_rows(direction, normal), 0) * (2 / (1 + np.cos(self.half_angle_rad)))
        return Aim(direction, np.full(len(u), INFINITE), share, share)


@dataclass(frozen=True)
class TriangleSource(Source):
    """A triangle of constant radiance rgb, two-sided unless its back is never seen from outside: front_only (m,) bool.

    corners   (m, 3, 3) float32, unit box; area (m,) float32, that squared
    normal    (m, 3) float32, unit
    """

    corners: Float32
    normal: Float32
    area: Float32
    front_only: BoolArray

    def irradiance(self, position: Float32, normal: Float32) -> Float64:
        behind = self.front_only & (dot_rows(position - self.corners[:, 0], self.normal) < 0)
        return np.where(behind, 0.0, np.abs(polygon_irradiance(self.corners, position, normal)))

    def aim(self, position: Float32, normal: Float32, u: Float32) -> Aim:
        weight = square_to_uniform_triangle(u)
        first, second, third = self.corners[:, 0], self.corners[:, 1], self.corners[:, 2]
        side = np.where(dot_rows(position - first, self.normal) >= 0, 1, -1).astype(np.float32)[:, None] * self.normal
        target = _combine(weight, second - first, third - first) + first + np.float32(ORIGIN_OFFSET) * side
        return replace(_aim_at(target, position, normal, side, self.area), by_chance=True)


@dataclass(frozen=True)
class WorldSource(Source):
    """Uniform radiance rgb from everywhere."""

    casts_shadow: bool = True

    def irradiance(self, position: Float32, normal: Float32) -> Float64:
        return np.full(len(position), math.pi)

    def aim(self, position: Float32, normal: Float32, u: Float32) -> Aim:
        one = np.ones(len(u), np.float32)
        share = one * np.float32(math.pi)
        return Aim(rotate_to(square_to_cosine_hemisphere(u), normal).astype(np.float32), one * INFINITE, share, share, by_chance=True)


def make_lamps(lights: Iterable[Light], unit_box: UnitBox, profiles: Sequence[Float32]) -> list[Source]:
    """Sources of one point, spot or area light each, for those with power; profiles as in SceneSnapshot."""
    return [_make_lamp(light, power, unit_box, profiles) for light, power in _usable_lights(lights) if light.kind != "SUN"]


def make_suns(lights: Iterable[Light]) -> list[Source]:
    """Sources of one sun each, for those with power."""
    return [_make_sun(light, power) for light, power in _usable_lights(lights) if light.kind == "SUN"]


def _usable_lights(lights: Iterable[Light]) -> list[tuple[Light, Float64]]:
    powers = [(light, usable_power(light)[0]) for light in lights]
    return [(light, power) for light, power in powers if power.any()]


def make_world(snapshot: SceneSnapshot) -> list[Source]:
    """The source of the world, if it shines."""
    world = usable_world(snapshot)
    return [WorldSource(world[None])] if world.any() else []


def join_sources(sources: Sequence[Source]) -> list[tuple[Source, Int64]]:
    """Sources with all lights of a kind joined, and the indices of the given sources in each."""
    groups: dict[tuple[object, ...], list[int]] = {}
    for number, source in enumerate(sources):
        flags = tuple(value for name, value in vars(source).items() if isinstance(value, bool))
        groups.setdefault((type(source), *flags), []).append(number)
    joined = []
    for numbers in groups.values():
        parts = [vars(sources[number]) for number in numbers]
        arrays = {name: np.concatenate([part[name] for part in parts]) for name, one in parts[0].items() if isinstance(one, np.ndarray)}
        joined.append((replace(cast(Any, sources[numbers[0]]), **arrays), np.array(numbers)))
    return joined


def _make_sun(light: Light, power: Float64) -> SunSource:
    x_axis, y_axis, z_axis = np.array(light.rotation, np.float32)[:, None]
    half_angle = min(max(light.angle_rad, 0.0), math.pi) / 2
    return SunSource(power[None], light.casts_shadow, x_axis, y_axis, z_axis, _one(half_angle), is_sharp=half_angle == 0)


def _make_lamp(light: Light, power: Float64, unit_box: UnitBox, profiles: Sequence[Float32]) -> Source:
    x_axis, y_axis, z_axis = np.array(light.rotation, np.float32)[:, None]
    centre = unit_box.to_unit(np.array(light.position_m))[None]
    if light.kind == "AREA":
        half_x, half_y = (np.maximum(np.array(light.size_m) * unit_box.scale, SMALLEST_SIDE) / 2).astype(np.float32)
        ellipse = light.shape == "ELLIPSE"
        area = 4 * float(half_x) * float(half_y) * (math.pi / 4 if ellipse else 1)
        return AreaSource(
            rgb=power[None] * unit_box.scale**2 / (math.pi * area),
            casts_shadow=light.casts_shadow,
            centre=centre,
            x_axis=x_axis * half_x,
            y_axis=y_axis * half_y,
            z_axis=z_axis,
            area=_one(area),
            spread_rad=_one(light.spread_rad),
            ellipse=ellipse,
            is_lambertian=light.spread_rad > LAMBERTIAN_SPREAD_RAD,
        )
    cone, radius = SpotCone.of(light), unit_box.to_unit_length(light.radius_m)
    plain = PointSource(
        rgb=power[None] / (4 * math.pi) * unit_box.scale**2,
        casts_shadow=light.casts_shadow,
        centre=centre,
        axis=-z_axis,
        drop=_one(cone.drop),
        blend=_one(cone.blend),
        radius=_one(radius),
        soft=light.soft_falloff and radius > 0,
        is_sharp=radius == 0,
        is_spot=cone.drop < 2,
    )
    if light.profile < 0:
        return plain
    # The closed form is that of the brightest direction, so that it bounds the light.
    most = np.array([profile.max() for profile in profiles], np.float64)
    own = {**vars(plain), "rgb": plain.rgb * most[light.profile]}
    return ProfileSource(**own, x_axis=x_axis, y_axis=y_axis, z_axis=z_axis, profile=np.array([light.profile]), profiles=tuple(profiles))


def _one(value: float) -> Float32:
    return np.array([value], np.float32)


def make_triangle_sources(cells: EmittingCells, corner_unit: Float32, normal: Float32, tri_sealed: BoolArray) -> list[Source]:
    """Sources of one triangle each, for the triangles of cells of constant radiance; tri_sealed (n_tri,) as in EmittingMeshes."""
    own, first = np.unique(cells.tri, return_index=True)
    rgb, area = cells.mean_rgb[first], triangle_normals_areas(corner_unit[own])[1].astype(np.float32)
    return [
        TriangleSource(rgb[i : i + 1], True, corner_unit[tri][None], normal[tri][None], area[i : i + 1], tri_sealed[tri][None])
        for i, tri in enumerate(own)
    ]
