"""The lights of a scene as sources of direct light: single ones, and joined by kind."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np

from ..scene.scene import Light, SceneSnapshot
from ..util.arrays import BoolArray, Float32, Float64, Int64
from ..util.geometry import UnitBox, triangle_normals_areas
from .direct_lights import AreaSource, PointSource, ProfileSource, Source, SunSource, TriangleSource, WorldSource, source_values
from .emitters import usable_power, usable_world
from .emitting_cells import EmittingCells
from .lights import LAMBERTIAN_SPREAD_RAD, SMALLEST_SIDE, SpotCone


def make_lamps(snapshot: SceneSnapshot, unit_box: UnitBox, lights: Iterable[Light] | None = None) -> list[Source]:
    """Sources of one point, spot or area light each, for the lights with power among `lights`, or among all."""
    every = snapshot.lights if lights is None else lights
    return [
        _make_lamp(light, power, unit_box, snapshot.profiles)
        for light, power in _usable_lights(light for light in every if light.kind != "SUN")
    ]


def make_suns(snapshot: SceneSnapshot, lights: Iterable[Light] | None = None) -> list[Source]:
    """As make_lamps, for suns."""
    every = snapshot.lights if lights is None else lights
    return [_make_sun(light, power) for light, power in _usable_lights(light for light in every if light.kind == "SUN")]


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
        flags = tuple(value for name, value in source_values(source).items() if isinstance(value, bool))
        groups.setdefault((type(source), *flags), []).append(number)
    joined = []
    for numbers in groups.values():
        parts = [source_values(sources[number]) for number in numbers]
        arrays = {name: np.concatenate([part[name] for part in parts]) for name, one in parts[0].items() if isinstance(one, np.ndarray)}
        joined.append((replace(cast(Any, sources[numbers[0]]), **arrays), np.array(numbers)))
    return joined


def _make_sun(light: Light, power: Float64) -> SunSource:
    x_axis, y_axis, z_axis = np.array(light.rotation, np.float32)[:, None]
    half_angle = min(max(light.angle_rad, 0.0), math.pi) / 2
    return SunSource(power[None], light.casts_shadow, x_axis, y_axis, z_axis, _one(half_angle), half_angle == 0)


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
    own = {**source_values(plain), "rgb": plain.rgb * most[light.profile]}
    return ProfileSource(**own, x_axis=x_axis, y_axis=y_axis, z_axis=z_axis, profile=np.array([light.profile]), profiles=tuple(profiles))


def _one(value: float) -> Float32:
    return np.array([value], np.float32)


def make_triangle_sources(cells: EmittingCells, corner_unit: Float32, normal: Float32, tri_sealed: BoolArray | None = None) -> list[Source]:
    """Sources of one triangle each, for the triangles of cells of constant radiance.

    tri_sealed   (n_tri,) bool: as in emitters.EmittingMeshes; None for none
    """
    own, first = np.unique(cells.tri, return_index=True)
    rgb, area = cells.mean_rgb[first], triangle_normals_areas(corner_unit[own])[1].astype(np.float32)
    sealed = np.zeros(len(area), bool) if tri_sealed is None else tri_sealed[own]
    return [
        TriangleSource(rgb[i : i + 1], True, corner_unit[tri][None], normal[tri][None], area[i : i + 1], sealed[i : i + 1])
        for i, tri in enumerate(own)
    ]
