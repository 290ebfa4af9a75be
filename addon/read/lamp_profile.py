"""Lamps whose light differs by direction -> maps of their intensity, evaluated by Cycles: IES files, images, square cones, any node tree.

Cycles bakes the light of a copy of the lamp, without extent, on a ball around it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from mathutils import Matrix
from numpy.typing import NDArray

from ...core.util.arrays import FloatArray
from ...core.util.brightness import weigh_channels
from ...core.util.sphere_map import find_solid_angles
from ..nodes.node_colors import Rgb, to_rgb
from ..nodes.node_ports import uses_nodes
from .world_map import LAMP_SIZE, choose_size, open_world, walk_nodes

_ALIKE = 1e-3  # of the brightest direction: an intensity that differs less is even
_GREY = 5e-3  # of its brightness: channels that differ less from each other have one map
_BY_DISTANCE = ("LIGHT_FALLOFF", "LIGHT_PATH")
_KEPT = ("Quadratic",)  # outputs of a falloff that are as without it
_AREA_PIXELS, _MOST_TILES = 64, 64  # of an area lamp: those that are evaluated, a side; and rectangles of one emission each
_EVEN_TILES = 0.003  # of the squared mean emission: variance within rectangles that is left
_INNER = 0.95  # of an ellipse's radii: pixels that its edge does not cross
_EVEN_POWER_W = 4.0 * math.pi**2  # which gives a `lighting` of 1 at 1 m


@dataclass(frozen=True)
class Profile:
    """An intensity by direction.

    mean_rgb   over the sphere, relative to an even lamp of the same power, in linear colours
    index      of the map of each channel in ProfileTable.maps; -1 where the intensity is even
    """

    mean_rgb: Rgb
    index: tuple[int, int, int]


@dataclass
class ProfileTable:
    """The profiles of an export, each evaluated once.

    maps   (h, w) float32 each, as in SceneSnapshot.profiles
    """

    scene: Any
    view_layer: Any = None
    maps: list[NDArray[np.float32]] = field(default_factory=list)
    _known: dict[tuple[Any, ...], Profile] = field(default_factory=dict)

    def find(self, data: Any, scale: tuple[float, float, float]) -> Profile:
        """The profile of a point or spot lamp's data, on an object of that scale.

        Raises RuntimeError where Cycles cannot evaluate it.
        """
        key = (data.session_uid, *(round(value, 6) for value in scale))
        if key not in self._known:
            self._known[key] = self._evaluate(data, scale)
        return self._known[key]

    def _evaluate(self, data: Any, scale: tuple[float, float, float]) -> Profile:
        size, samples = choose_size(data, LAMP_SIZE)
        if size == LAMP_SIZE and data.type == "POINT":  # an IES file has no edges, nor has a small image
            samples = 1
        with open_world(None, self.scene, self.view_layer) as baker:
            found = baker.bake_lamp(_make_even(baker.copy(data)), Matrix.Diagonal((*scale, 1.0)), size, samples)
        weight = find_solid_angles(*found.shape[:2])[:, None, None] / (4.0 * math.pi)
        mean = (found * weight).sum(axis=(0, 1), dtype=np.float64)
        if not mean.any() or np.ptp(found, axis=(0, 1)).max() <= _ALIKE * found.max():
            return Profile(to_rgb(mean), (-1, -1, -1))
        shapes = [found[..., channel] / mean[channel] if mean[channel] > 0.0 else None for channel in range(3)]
        grey = weigh_channels(found.reshape(-1, 3)).reshape(found.shape[:2]) / weigh_channels(mean[None])[0]
        if all(shape is None or np.abs(shape - grey).max() <= _GREY * grey.max() for shape in shapes):
            shapes = [grey]
        first = len(self.maps)
        index = []
        for shape in shapes:
            index.append(len(self.maps) if shape is not None else -1)
            if shape is not None:
                self.maps.append(np.ascontiguousarray(shape, np.float32))
        return Profile(to_rgb(mean), (first,) * 3 if len(shapes) == 1 else (index[0], index[1], index[2]))


def find_tiles(
    data: Any, size_m: tuple[float, float], scene: Any, view_layer: Any = None
) -> list[tuple[FloatArray, tuple[float, float], FloatArray]]:
    """Rectangles that together send what an area lamp of that size does whose emission differs over it; the whole lamp if it does not.

    Each is (centre by the lamp's own x and y, m; extents, m; mean emission, (3,), to which what lies beside an ellipse adds 0).

    Raises RuntimeError where Cycles cannot evaluate it.
    """
    with open_world(None, scene, view_layer) as baker:
        copy = baker.copy(data)
        is_round = data.shape in ("DISK", "ELLIPSE")
        copy.shape, copy.size, copy.size_y = "ELLIPSE" if is_round else "RECTANGLE", *size_m
        area_m2 = size_m[0] * size_m[1] * (math.pi / 4.0 if is_round else 1.0)
        copy.energy, copy.color, copy.exposure, copy.diffuse_factor = math.pi * area_m2, (1.0, 1.0, 1.0), 0.0, 1.0
        copy.use_temperature, copy.normalize, copy.spread = False, True, math.pi
        copy.cycles.use_multiple_importance_sampling = True
        found = baker.bake_area(copy, size_m, _AREA_PIXELS).astype(np.float64)
    across = (np.arange(_AREA_PIXELS) + 0.5) * 2.0 / _AREA_PIXELS - 1.0
    inside = np.hypot(across, across[:, None]) < (_INNER if is_round else 2.0)
    if np.ptp(found[inside], axis=0).max() <= _ALIKE * found.max():
        return [(np.zeros(2), size_m, found[inside].mean(axis=0))]
    enough = _EVEN_TILES * float(np.square(found.mean(axis=(0, 1))).sum()) * found.shape[0] ** 2
    tiles = [found]
    corners = [(0, 0)]
    while len(tiles) < _MOST_TILES:
        spread = [float(np.square(tile - tile.mean(axis=(0, 1))).sum()) for tile in tiles]
        worst = int(np.argmax(spread))
        half = len(tiles[worst]) // 2
        if sum(spread) <= enough or not half:
            break
        tile, (row, column) = tiles.pop(worst), corners.pop(worst)
        for down, aside in ((0, 0), (0, half), (half, 0), (half, half)):
            tiles.append(tile[down : down + half, aside : aside + half])
            corners.append((row + down, column + aside))
    pixel = np.array(size_m) / _AREA_PIXELS
    return [
        (pixel * (np.array(corner[::-1]) + len(tile) / 2) - np.array(size_m) / 2, tuple(pixel * len(tile)), tile.mean(axis=(0, 1)))
        for tile, corner in zip(tiles, corners, strict=True)
    ]


def needs_profile(data: Any, scale: tuple[float, float, float], replaced: list[str]) -> bool:
    """Whether a lamp's light differs by direction in a way that only Cycles tells; replaced: what reading its nodes gave up."""
    if data.type not in ("POINT", "SPOT"):
        return False
    oval = data.type == "SPOT" and (data.use_square or not math.isclose(scale[0], scale[1], rel_tol=1e-3))
    return oval or bool(replaced)


def describe_distance(data: Any) -> str:
    """What nodes say of the distance, that a profile has as at 1 m; "" for nothing."""
    if not uses_nodes(data):
        return ""
    for node in walk_nodes(data.node_tree, set()):
        used = [output.name for output in node.outputs if output.is_linked and output.name not in _KEPT]
        smooth = node.type == "LIGHT_FALLOFF" and node.inputs["Smooth"].default_value > 0.0
        if node.type in _BY_DISTANCE and (used or smooth):
            return f"node {node.label or node.name} is taken as at 1 m, and light falls off with the square of the distance"
    return ""


def _make_even(data: Any) -> Any:
    """The lamp without extent, colour and power of its own, so that its nodes and cone alone are seen."""
    data.shadow_soft_size, data.energy, data.color, data.exposure, data.diffuse_factor = 0.0, _EVEN_POWER_W, (1.0, 1.0, 1.0), 0.0, 1.0
    data.use_temperature, data.normalize = False, True
    return data
