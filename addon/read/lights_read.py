"""Blender's lights -> core lights, in Blender's units.

The factors were found by baking under Cycles 4.5, 5.0 and 5.2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...core.scene.scene import Light
from ...core.util.arrays import FloatArray
from ..nodes.colors_read import ColorReader
from ..nodes.images_read import ImageTable
from ..nodes.node_colors import BLACK, Rgb, multiply_rgb, to_rgb
from ..nodes.node_ports import find_surface, uses_nodes
from .lamp_profile import ProfileTable, describe_distance, find_tiles, needs_profile
from .render_levels import Warnings
from .shaders_read import read_shader

_ELLIPSES = ("DISK", "ELLIPSE")
_ANY_BOUNCES = 1024  # Cycles' own, and its most


@dataclass(frozen=True)
class PendingLight:
    """A light whose profile is still to be evaluated, which cannot be while the scene's instances are walked.

    base    what it would be if its nodes let out 1 W/m^2 everywhere
    data    its data, not evaluated
    plain   what it is if Cycles cannot evaluate it, and what was then told
    """

    base: Light
    data: Any
    scale: Rgb
    plain: Light | None
    told: Warnings

    def resolve(self, profiles: ProfileTable, warnings: Warnings) -> list[Light]:
        """The light, or one for each channel where these differ by direction; none where nothing comes out."""
        try:
            profile = profiles.find(self.data, self.scale)
        except RuntimeError:  # Cycles is missing, or busy
            warnings.extend(self.told)
            return [self.plain] if self.plain else []
        if told := describe_distance(self.data):
            warnings.append((self.base.name, told))
        light = replace(self.base, power_rgb=multiply_rgb(self.base.power_rgb, profile.mean_rgb))
        parts = [replace(light, profile=profile.index[0])]
        if len(set(profile.index)) > 1:
            powers = [to_rgb(np.eye(3)[k] * light.power_rgb[k]) for k in range(3)]
            parts = [replace(light, power_rgb=power, profile=index) for power, index in zip(powers, profile.index, strict=True)]
        return [part for part in parts if max(part.power_rgb) > 0.0]


@dataclass(frozen=True)
class PendingArea:
    """An area light whose emission differs over it, still to be evaluated; fields are as of PendingLight.

    matrix   (4, 4) float, object to world
    """

    base: Light
    data: Any
    matrix: FloatArray
    plain: Light | None
    told: Warnings

    def resolve(self, profiles: ProfileTable, warnings: Warnings) -> list[Light]:
        """Rectangles of one emission each; none where nothing comes out."""
        try:
            tiles = find_tiles(self.data, self.base.size_m, profiles.scene, profiles.view_layer)
        except RuntimeError:  # Cycles is missing, or busy
            warnings.extend(self.told)
            return [self.plain] if self.plain else []
        area_m2 = self.base.size_m[0] * self.base.size_m[1] * (math.pi / 4 if self.base.shape == "ELLIPSE" else 1.0)
        axes = self.matrix[:3, :2] / np.maximum(np.linalg.norm(self.matrix[:3, :2], axis=0), 1e-30)
        whole = self.base.shape if len(tiles) == 1 else "RECTANGLE"
        lights = []
        for centre, size_m, emission in tiles:
            share = 1.0 if len(tiles) == 1 else size_m[0] * size_m[1] / area_m2
            power = to_rgb(np.array(self.base.power_rgb) * emission * share)
            if max(power) > 0.0:
                place = to_rgb(self.matrix[:3, 3] + axes @ centre)
                lights.append(replace(self.base, shape=whole, position_m=place, size_m=size_m, power_rgb=power))
        return lights


def read_lamp(obj: Any, matrix: FloatArray, name: str, warnings: Warnings) -> Light | PendingLight | PendingArea | None:
    """As read_light, or what is still to be evaluated of a light that differs by direction."""
    data = obj.data
    scale = to_rgb(np.linalg.norm(np.asarray(matrix, np.float64)[:3, :3], axis=0))
    replaced = _read_nodes(data)[1] if uses_nodes(data) else []
    is_area = data.type == "AREA" and bool(replaced)
    if not is_area and not needs_profile(data, scale, replaced):
        return read_light(obj, matrix, name, warnings)
    told: Warnings = []
    plain = read_light(obj, matrix, name, told)
    base = read_light(obj, matrix, name, warnings, (1.0, 1.0, 1.0))
    if is_area:
        return PendingArea(base, data.original, np.asarray(matrix, np.float64), plain, told) if base else None
    return PendingLight(base, data.original, scale, plain, told) if base else None


def read_light(obj: Any, matrix: FloatArray, name: str, warnings: Warnings, emission: Rgb | None = None) -> Light | None:
    """The light of an evaluated light object; None where it gives none.

    matrix     (4, 4) float, object to world
    emission   what its nodes and cone let out on average, of a lamp that has a profile, which then is a point unless it is an area light;
               None to read them
    """
    data = obj.data
    matrix = np.asarray(matrix, np.float64)
    seen_by = obj.visible_diffuse, obj.visible_glossy, obj.visible_transmission
    if not any(seen_by) or (data.type == "AREA" and data.cycles.is_portal):
        return None
    scale = np.linalg.norm(matrix[:3, :3], axis=0)
    size = _area_size(data, scale)
    error = _light_error(data, matrix, size)
    power_rgb = multiply_rgb(_read_color(data, name, warnings, emission), (_read_strength(data, size),) * 3)
    if not error and not np.isfinite(power_rgb).all():
        error = "its power is not a finite number; correct strength, colour and exposure"
    if not error and min(power_rgb) < 0.0:
        error = "its power is negative; make strength and colour positive"
    if error:
        warnings.append((name, f"the light is left out: {error}"))
        return None
    if max(power_rgb) <= 0.0:
        return None
    if data.cycles.max_bounces < _ANY_BOUNCES:
        text = f"the light's Max Bounces ({data.cycles.max_bounces}) is left out: it bounces as often as all light"
        warnings.append((name, f"{text}; lower its power where that is too bright"))
    light = Light(
        kind="POINT" if emission and data.type != "AREA" else data.type,
        name=name,
        position_m=to_rgb(matrix[:3, 3]),
        rotation=_find_axes(matrix),
        power_rgb=power_rgb,
        casts_shadow=data.use_shadow,
        seen_by=seen_by,
    )
    if data.type == "AREA":
        shape = "ELLIPSE" if data.shape in _ELLIPSES else "RECTANGLE"
        return replace(light, shape=shape, size_m=size, spread_rad=data.spread)
    if data.type == "SUN":
        return replace(light, position_m=(0.0, 0.0, 0.0), angle_rad=data.angle)  # wherever it stands, it is the same light
    light = replace(light, radius_m=data.shadow_soft_size, soft_falloff=data.use_soft_falloff)
    return light if data.type == "POINT" or emission else _read_cone(light, data, scale, warnings)


def _area_size(data: Any, scale: FloatArray) -> tuple[float, float]:
    """Extents of an area light in the world, m; an object's scale counts."""
    if data.type != "AREA":
        return 0.0, 0.0
    second = data.size_y if data.shape in ("RECTANGLE", "ELLIPSE") else data.size
    return float(data.size * scale[0]), float(second * scale[1])


def _light_error(data: Any, matrix: FloatArray, size: tuple[float, float]) -> str:
    if not np.isfinite(matrix).all():
        return "its position is not finite; correct location, rotation and scale, also of its parents"
    if data.type not in ("POINT", "SPOT", "SUN", "AREA"):
        return f"lights of type {data.type} are not known; choose Point, Sun, Spot or Area"
    if data.type == "AREA" and size[0] * size[1] <= 0.0:
        return "its size is zero; make the size of the lamp and the scale of the object greater"
    return ""


def _read_color(data: Any, name: str, warnings: Warnings, emission: Rgb | None) -> Rgb:
    """Colour, temperature, exposure, diffuse factor and nodes; what the energy is multiplied by."""
    color = multiply_rgb(to_rgb(data.color), (2.0**data.exposure * data.diffuse_factor,) * 3)
    if data.use_temperature:
        color = multiply_rgb(color, to_rgb(data.temperature_color))
    if emission is not None:
        return multiply_rgb(color, emission)
    if not uses_nodes(data):
        return color
    emission, replaced = _read_nodes(data)
    if replaced:
        warnings.append((name, f"the light's nodes are simplified: {'; '.join(replaced)}"))
    return multiply_rgb(color, emission)


def _read_nodes(data: Any) -> tuple[Rgb, list[str]]:
    """What the nodes of a light or a world emit, the mean of it, and what of them was replaced."""
    _, source = find_surface(data)
    if source is None:
        return BLACK, []
    reader = ColorReader(ImageTable())
    emission = read_shader(reader, source).emission
    if emission.image >= 0:
        reader.note("its texture is replaced by its mean")
    return emission.mean, reader.replaced


def _read_strength(data: Any, size: tuple[float, float]) -> float:
    """Power in W, or W/m^2 for a sun; one that is not normalized has its power per area, as Cycles counts it."""
    if data.normalize:
        return float(data.energy)
    if data.type == "AREA":
        return float(data.energy * size[0] * size[1] * (math.pi / 4 if data.shape in _ELLIPSES else 1.0))
    if data.type == "SUN":
        sine = math.sin(min(data.angle, math.pi) / 2)
        return float(data.energy * (math.pi * sine * sine or 1.0))
    return float(data.energy * 4.0 * (math.pi * data.shadow_soft_size**2 or 1.0))


def _find_axes(matrix: FloatArray) -> tuple[Rgb, Rgb, Rgb]:
    """Rows: orthonormal x, y and z of a world matrix, right-handed, z kept."""
    z = _unit(matrix[:3, 2], np.array([0.0, 0.0, 1.0]))
    spare = np.eye(3)[np.abs(z).argmin()]
    x = matrix[:3, 0] - z * (z @ matrix[:3, 0])
    x = _unit(x, _unit(spare - z * (z @ spare), spare))
    return to_rgb(x), to_rgb(np.cross(z, x)), to_rgb(z)


def _unit(vector: FloatArray, otherwise: FloatArray) -> FloatArray:
    length = np.linalg.norm(vector)
    return vector / length if length > 0.0 else otherwise


def _read_cone(light: Light, data: Any, scale: FloatArray, warnings: Warnings) -> Light:
    """A scaled spot has a wider or narrower cone, and the radius it had."""
    if data.use_square:
        warnings.append((light.name, "the square spot is baked as a round one"))
    if not math.isclose(scale[0], scale[1], rel_tol=1e-3):
        warnings.append((light.name, "the spot's oval cone is baked as a round one"))
    half = data.spot_size / 2
    wide = math.atan2(math.sin(half) * (scale[0] + scale[1]) / 2, math.cos(half) * scale[2]) if scale.any() else half
    return replace(light, cone_angle_rad=2.0 * wide, blend=data.spot_blend)
