"""Removes lights without power or reach, and replaces textures of one colour by constants, before any ray is traced."""

import math
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np

from ..util.ablation import uses
from ..util.arrays import Float64
from .scene import TEXTURE_UVS, Light, Material, Rgb, SceneSnapshot, TextureImage


def prune_scene(snapshot: SceneSnapshot) -> tuple[SceneSnapshot, dict[str, int]]:
    """A scene that bakes to the same light with less work, and the numbers of lights and textures that were left out.

    Triangles and objects stay as they are. If no light would be left, all stay, since a scene without lights is an error.
    """
    if not uses("pruning"):
        return snapshot, {}
    points = snapshot.vertex_position[np.unique(snapshot.tri_vertex)]
    powered = [light for light in snapshot.lights if any(light.power_rgb)]
    reaching = [light for light in powered if can_reach(light, points)]
    colour = [_find_colour(image) for image in snapshot.images]
    materials = tuple(_fold_textures(material, colour) for material in snapshot.materials)
    counts = {
        "lights_without_power": len(snapshot.lights) - len(powered),
        "lights_out_of_reach": len(powered) - len(reaching),
        "textures_of_one_colour": sum(_count_images(one) for one in snapshot.materials) - sum(_count_images(one) for one in materials),
    }
    return replace(snapshot, lights=tuple(reaching) or snapshot.lights, materials=materials), counts


def can_reach(light: Light, points_m: Float64) -> bool:
    """Whether a light may reach any of the points (n, 3); true in case of doubt."""
    if not len(points_m) or light.kind not in ("AREA", "SPOT"):
        return True
    axis = -np.array(light.rotation, np.float64)[2]
    position = np.array(light.position_m, np.float64)
    numbers = (*axis, *position, light.radius_m, light.cone_angle_rad)
    if not np.isfinite(numbers).all():
        return True
    if light.kind == "AREA":
        return bool(((points_m - position) @ axis > 0).any())
    low, high = points_m.min(axis=0), points_m.max(axis=0)
    toward = 0.5 * (low + high) - position
    distance, around = float(np.linalg.norm(toward)), 0.5 * float(np.linalg.norm(high - low)) + max(light.radius_m, 0.0)
    if distance <= around:
        return True
    angle = math.acos(min(max(float(toward @ axis) / (distance * float(np.linalg.norm(axis))), -1.0), 1.0))
    return angle <= 0.5 * light.cone_angle_rad + math.asin(around / distance)


def _find_colour(image: TextureImage) -> Rgb | None:
    """The colour of an image of one colour, else None."""
    pixels = image.pixels.reshape(-1, 3)
    if not len(pixels) or image.extension == "CLIP" or not np.isfinite(pixels[0]).all() or (pixels != pixels[0]).any():
        return None
    red, green, blue = map(float, pixels[0])
    return red, green, blue


def _fold_textures(material: Material, colour: list[Rgb | None]) -> Material:
    """The material, with constants alone for constants times images of one colour."""
    changed: dict[str, Any] = {}
    for image in chain.from_iterable(TEXTURE_UVS.values()):
        name, number = image.replace("_image", "_rgb"), getattr(material, image)
        rgb: Rgb | None = getattr(material, name, None)  # normals have no constant
        factor = None if rgb is None or number < 0 else colour[number] if any(rgb) else rgb
        if rgb is not None and factor is not None:
            changed[name], changed[image] = tuple(one * two for one, two in zip(rgb, factor, strict=True)), -1
    return replace(material, **changed)


def _count_images(material: Material) -> int:
    return sum(image >= 0 for image in material.images)
