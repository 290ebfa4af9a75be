"""Blender's world -> radiance that is the same everywhere, or a map of it and the suns in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...core.lights.environment_suns import Spot, take_suns_out
from ...core.scene.scene import Light
from ...core.util.arrays import FloatArray
from ..nodes.node_colors import BLACK, Rgb, to_rgb
from ..nodes.node_ports import find_surface, uses_nodes
from .panorama import open_sky, unroll_sky
from .render_levels import Warnings
from .shaders_read import read_shader
from .world_cache import MapCache
from .world_map import choose_size, open_world, walk_nodes

_ALIKE = 1e-4  # of the brightest: a map that differs less is a uniform sky
_ANY_BOUNCES = 1024  # Cycles' own, and its most


@dataclass(frozen=True)
class World:
    """The light of a world; as in SceneSnapshot, and the suns that were taken out of the map."""

    rgb: Rgb = BLACK
    map: NDArray[np.float32] | None = None
    suns: tuple[Light, ...] = ()


def find_world(scene: Any, view_layer: Any = None) -> Any:
    """The world that lights a render of the view layer, None for none."""
    if view_layer is not None and not view_layer.use_sky:
        return None
    return getattr(view_layer, "world_override", None) or scene.world  # overrides are new in Blender 4.5


def is_textured(scene: Any, view_layer: Any = None) -> bool:
    """Whether a scene's world has a picture or a pattern, which may take seconds to read."""
    world = find_world(scene, view_layer)
    return world is not None and uses_nodes(world) and any(node.type.startswith("TEX_") for node in walk_nodes(world.node_tree, set()))


def read_world(scene: Any, warnings: Warnings, view_layer: Any = None, kept: MapCache | None = None) -> World:
    """The light that a scene's world gives to diffuse surfaces; nothing of the user's is changed.

    kept   what earlier bakes have evaluated of it; what is evaluated now is added
    """
    world = find_world(scene, view_layer)
    if world is None or not world.cycles_visibility.diffuse:
        return World()
    if not uses_nodes(world):
        return World(to_rgb(world.color))
    _warn_of_losses(world, warnings)
    _, source = find_surface(world)
    if source is None:
        return World()
    reader = open_sky()
    surface = read_shader(reader, source)
    if not reader.replaced and surface.emission.image < 0 and not any(surface.passing.rgb):
        return World(_clip(surface.emission.mean))
    try:
        return _evaluate(world, unroll_sky(reader, surface), scene, view_layer, kept)
    except RuntimeError as reason:
        cause = str(reason).strip().splitlines()[-1].removeprefix("Error: ")
        warnings.append((world.name, f"the world is baked as a uniform sky, for Cycles could not evaluate it ({cause})"))
        return World(_clip(surface.emission.mean))


def _clip(rgb: Rgb) -> Rgb:
    return max(rgb[0], 0.0), max(rgb[1], 0.0), max(rgb[2], 0.0)


def _evaluate(world: Any, picture: NDArray[np.float32] | None, scene: Any, view_layer: Any, kept: MapCache | None) -> World:
    if picture is not None:

        def look_closer(direction: FloatArray, half_angle_rad: float) -> Spot:
            with open_world(world, scene, view_layer, kept) as baker:
                return baker.bake_spot(direction, half_angle_rad)

        rest, suns = take_suns_out(picture, look_closer, world.name)
        return World(map=rest, suns=suns) if picture.any() else World()
    size, samples = choose_size(world)
    with open_world(world, scene, view_layer, kept) as baker:
        found = baker.bake_sphere(size, samples)
        if np.ptp(found, axis=(0, 1)).max() <= _ALIKE * found.max():
            return World(to_rgb(found.mean(axis=(0, 1), dtype=np.float64)))
        rest, suns = take_suns_out(found, baker.bake_spot, world.name)
    return World(map=rest, suns=suns)


def _warn_of_losses(world: Any, warnings: Warnings) -> None:
    output = world.node_tree.get_output_node("CYCLES") or world.node_tree.get_output_node("ALL")
    if output is not None and output.inputs["Volume"].is_linked:
        warnings.append((world.name, "the world's volume is left out: it neither scatters nor dims light; add fog where you show the bake"))
    if world.cycles.max_bounces < _ANY_BOUNCES:
        text = f"the world's Max Bounces ({world.cycles.max_bounces}) is left out: it bounces as often as all light"
        warnings.append((world.name, f"{text}; lower its strength where that is too bright"))
