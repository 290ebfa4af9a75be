"""Reasons why no light reaches an object: another object encloses the lamps or the object itself."""

import math
from collections.abc import Iterable

import numpy as np

from ..util.arrays import Float32
from .light_probe import LightProbe
from .scene import Light

_POINTS, _BOUNCES = 1024, 4  # number of points that must be dark for the warning, and bounces of their light
_RAYS = 512
_ENCLOSED = 0.995  # share of rays that meet one object from which on it encloses
_MOST_LAMPS = 8  # with more lamps and glowing objects, none is examined


def describe_dark(probe: LightProbe, objects: Iterable[int]) -> list[tuple[str, str]]:
    """(name, sentence) for each of the objects that no light reaches, with the reason if it is found."""
    snapshot, lamps = probe.snapshot, None
    said = []
    for number in objects:
        tri = np.flatnonzero((snapshot.tri_object == number) & (probe.area > 0.0))
        if not len(tri):
            continue
        point, side = probe.spread_evenly(tri, np.zeros_like(tri), _POINTS)
        if probe.find_irradiance(point, side, _BOUNCES).any():
            continue
        lamps = lamps if lamps is not None else _find_enclosed_lamps(probe)
        reason = "; ".join(lamps) or _find_enclosure(probe, number, point, side)
        said.append((snapshot.objects[number].name, f"is reached by no light{': ' if reason else ''}{reason}"))
    return said


def _find_enclosed_lamps(probe: LightProbe) -> list[str]:
    """A sentence for each lamp and glowing object with the object that encloses it; none if any is free, or if there is a sun or sky."""
    snapshot = probe.snapshot
    lamps = [light for light in snapshot.lights if any(light.power_rgb) and light.seen_by[0]]
    near = [light for light in lamps if light.kind != "SUN"]
    glowing = np.unique(snapshot.tri_object[probe.find_glowing()])
    if len(near) < len(lamps) or probe.has_sky or len(near) + len(glowing) > _MOST_LAMPS:
        return []
    shells = [(lamp.name, _find_shell(probe, *_look_around_lamp(probe, lamp), -1)) for lamp in near]
    for number in glowing:
        tri = np.intersect1d(probe.find_glowing(), np.flatnonzero(snapshot.tri_object == number))
        point, side = probe.spread_evenly(tri, np.zeros_like(tri), _RAYS)
        both = np.concatenate([point, point]), np.concatenate([side, -side])
        shells.append((snapshot.objects[number].name, _find_shell(probe, *both, int(number))))
    return [f"{name} is enclosed by {shell}" for name, shell in shells] if all(shell for _, shell in shells) else []


def _look_around_lamp(probe: LightProbe, lamp: Light) -> tuple[Float32, Float32]:
    """Positions (n, 3) of a lamp, unit box, and directions (n, 3) in which it shines."""
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(4 * _RAYS, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    if lamp.kind in ("SPOT", "AREA"):
        least = math.cos(lamp.cone_angle_rad / 2) if lamp.kind == "SPOT" else 0.0
        direction = direction[-direction @ np.array(lamp.rotation[2]) > least]
    place = np.repeat(probe.box.to_unit(np.array([lamp.position_m])), len(direction), axis=0)
    return place, direction.astype(np.float32)


def _find_shell(probe: LightProbe, point: Float32, direction: Float32, own: int) -> str:
    """Name of the object, other than `own`, that nearly all rays meet; "" if there is none."""
    if not len(point):
        return ""
    tri = probe.trace(point, direction).tri if own >= 0 else probe.meet(point, direction)
    met = probe.snapshot.tri_object[tri[tri >= 0]]
    met, lost = met[met != own], np.count_nonzero(tri < 0)
    if not len(met):
        return ""
    count = np.bincount(met)
    shell = int(count.argmax())
    return probe.snapshot.objects[shell].name if count[shell] >= _ENCLOSED * (len(met) + lost) else ""


def _find_enclosure(probe: LightProbe, number: int, point: Float32, side: Float32) -> str:
    """A sentence about what encloses an object, by rays from its points; "" if any ray leaves the scene."""
    tri = probe.trace(point, side).tri
    if (tri < 0).any():
        return ""
    count = np.bincount(probe.snapshot.tri_object[tri], minlength=len(probe.snapshot.objects))
    count[number] = 0
    shell = int(count.argmax())
    if count[shell] < max(_ENCLOSED * count.sum(), len(tri) / 2):
        return "it is closed in by its surroundings, and the light is outside"
    return f"it is enclosed by {probe.snapshot.objects[shell].name}, and the light is outside"
