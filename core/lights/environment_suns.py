"""Suns of an environment map: small bright spots with much of its light are replaced by sun lights of the same size.

Every texel sends shadow rays to a sun light, which keeps shadows sharp; sampled as cells of the map, a sun would add variance.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..scene.scene import Light
from ..util.arrays import Float32, Float64, FloatArray, Int64
from ..util.brightness import weigh_channels
from ..util.geometry import orthonormal_basis
from ..util.sphere_map import find_middles, find_solid_angles

LEAST_SHARE = 0.02  # of the map's power; a spot with less is not a sun
MOST_SUNS = 8
_WIDEST_RAD = math.radians(2.0)  # half angle; larger spots have soft shadows anyway
_FAINT = 0.02  # of the peak's radiance above its surroundings; cells with less are glow, not sun
_GLOW = 1.5  # radius in which the glow around a spot is measured, in radii of the spot plus two cells


@dataclass(frozen=True)
class Spot:
    """Directions on and around a spot of the sky.

    direction     (n, 3) float, unit
    solid_angle   (n,) float64, sr
    radiance      (n, 3) float, W/m^2/sr
    cell_rad      side of a cell
    """

    direction: FloatArray
    solid_angle: Float64
    radiance: FloatArray
    cell_rad: float


# Samples the map around a direction (3,) within a half angle.
LookCloser = Callable[[Float64, float], Spot]


def take_suns_out(world_map: Float32, look_closer: LookCloser | None = None, name: str = "World") -> tuple[Float32, tuple[Light, ...]]:
    """The map (h, w, 3) without its suns, and the suns; together they emit the light of the map.

    look_closer   samples a spot in finer cells than the map's, for the position, size and power of small suns
    """
    height, width, _ = world_map.shape
    toward = find_middles((height, width))
    solid_angle = np.repeat(find_solid_angles(height, width), width)
    cell_rad = math.pi / height
    rest = world_map.reshape(-1, 3).copy()
    brightness = weigh_channels(rest)
    total = float((brightness * solid_angle).sum())
    lights: list[Light] = []
    asked = brightness.copy()  # set to 0 where examined
    for _ in range(4 * MOST_SUNS):
        middle = _find_middle(toward, asked * solid_angle, int(asked.argmax()))
        near = np.flatnonzero(toward @ middle.astype(toward.dtype) > math.cos(_WIDEST_RAD * _GLOW + 2 * cell_rad))
        if len(lights) == MOST_SUNS or (asked[near] * solid_angle[near]).sum() <= LEAST_SHARE * total:
            break
        asked[near] = 0.0
        spot = Spot(toward[near], solid_angle[near], rest[near].astype(np.float64), cell_rad)
        glow, inside = _part_spot(spot, middle)
        above = np.maximum(spot.radiance[inside] - glow, 0.0)
        power = float((weigh_channels(above) * spot.solid_angle[inside]).sum()) if len(inside) else 0.0
        if power < LEAST_SHARE * total:
            continue
        away = np.arccos(np.clip(spot.direction[inside] @ middle, -1, 1))
        if look_closer is not None:
            spot = look_closer(middle, float(away.max()) + 2 * cell_rad)
            closer = np.flatnonzero(weigh_channels(np.maximum(spot.radiance - glow, 0.0)) > 0)
            lights.append(_make_sun(spot, closer, glow, f"{name} sun {len(lights) + 1}"))
        else:
            lights.append(_make_sun(spot, inside, glow, f"{name} sun {len(lights) + 1}"))
        rest[near[inside]] = np.minimum(rest[near[inside]], glow.astype(np.float32))
    return rest.reshape(world_map.shape), tuple(lights)


def _find_middle(toward: FloatArray, power: Float64, peak: int) -> Float64:
    """(3,) unit: mean direction, weighted by power, within a small sun's width of the cell `peak`."""
    middle: Float64 = toward[peak].astype(np.float64)
    for reach in (2 * _WIDEST_RAD, _WIDEST_RAD):
        near = np.flatnonzero(toward @ middle.astype(toward.dtype) > math.cos(reach))  # in double precision it takes a tenth of a second
        middle = (power[near, None] * toward[near]).sum(axis=0)
        middle = middle / max(float(np.linalg.norm(middle)), 1e-300)
    return middle


def _part_spot(spot: Spot, peak: FloatArray) -> tuple[Float64, Int64]:
    """The glow (3,) around a spot, W/m^2/sr, and the cells (k,) of the spot; none if it is not small."""
    away = np.arccos(np.clip(spot.direction @ peak, -1, 1))
    brightness = weigh_channels(spot.radiance)
    ring = away > _WIDEST_RAD
    glow = np.median(spot.radiance[ring], axis=0) if ring.any() else np.zeros(3)
    level = float(weigh_channels(glow[None])[0])
    inside = np.flatnonzero(brightness - level > _FAINT * (brightness.max() - level))
    if not len(inside) or away[inside].max() > _WIDEST_RAD or brightness.max() <= 2 * level:
        return glow, np.zeros(0, np.int64)
    # The glow falls with the distance, so it is measured right beside the spot.
    beside = (away > away[inside].max() + spot.cell_rad) & (away < _GLOW * away[inside].max() + 2 * spot.cell_rad)
    return (np.median(spot.radiance[beside], axis=0) if beside.any() else glow), inside


def _make_sun(spot: Spot, inside: Int64, glow: Float64, name: str) -> Light:
    """A disk of the same power, mean direction and variance as the radiance above the glow."""
    flux = np.maximum(spot.radiance[inside] - glow, 0.0) * spot.solid_angle[inside, None]
    weight, direction = weigh_channels(flux), spot.direction[inside].astype(np.float64)
    middle = (direction * weight[:, None]).sum(axis=0)
    middle /= np.linalg.norm(middle)
    # A disk of half angle a has a mean squared distance of a^2 / 2 from its middle; a cell of side c adds c^2 / 6.
    square = float((((direction - middle) ** 2).sum(axis=1) * weight).sum() / weight.sum())
    half = math.sqrt(max(2 * (square - spot.cell_rad**2 / 6), spot.cell_rad**2 / (4 * math.pi)))
    x_axis, y_axis = (axis[0] for axis in orthonormal_basis(middle[None]))
    rows = tuple(tuple(float(value) for value in axis) for axis in (x_axis, y_axis, middle))
    facing = flux.sum(axis=0) * (1 + math.cos(half)) / 2  # the irradiance of a disk of so much radiance times solid angle
    power = tuple(float(value) for value in facing)
    return Light("SUN", name, rotation=rows, power_rgb=power, angle_rad=2 * half)  # type: ignore[arg-type]
