"""Small scenes in which things are seen by some kinds of rays alone: ray visibility, Light Path nodes, light linking."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import bpy
from matter_scenes import Scene

_UPRIGHT = (1.5707963, 0.0, 0.0)


def _glow_beside_metal(make: Callable[[Scene], Callable[[Any], Any]], **flags: bool) -> Callable[[], None]:
    """A wall of metal at the floor's side sees the back of a card that stands in front of it, and a spot lights both."""

    def build() -> None:
        scene = Scene()
        metal = scene.shade("Metal", scene.node("BsdfGlossy", Color=(0.9, 0.9, 0.9, 1), Roughness=0.6))
        scene.add_square("Wall", metal, 1.0, (0, 2, 1), _UPRIGHT)
        card = scene.add_square("Card", scene.shade("Card", make(scene)), 0.6, (0, 0.8, 0.8), _UPRIGHT)
        for name, value in flags.items():
            setattr(card, name, value)
        scene.add_light("SPOT", 200.0, (0, -1, 2.2), (1.2, 0, 0), 0.05)
        scene.add_light("POINT", 20.0, (0, 1.5, 2.5), (0, 0, 0), 0.1)

    return build


def _card_over_glass(make: Callable[[Scene], Callable[[Any], Any]], **flags: bool) -> Callable[[], None]:
    """A pane of glass between the floor and a card under a sky."""

    def build() -> None:
        scene = Scene()
        glass = scene.shade("Glass", scene.node("BsdfGlass", Roughness=0.3))
        bpy.ops.mesh.primitive_cube_add(size=1.0, location=(0, 0, 0.6), scale=(1.6, 1.6, 0.1))
        bpy.context.object.data.materials.append(glass)
        card = scene.add_square("Card", scene.shade("Card", make(scene)), 0.6, (0, 0, 1.2))
        for name, value in flags.items():
            setattr(card, name, value)
        scene.add_sky(1.0, 0.9, 0.8)

    return build


def _card(make: Callable[[Scene], Callable[[Any], Any]], **flags: bool) -> Callable[[], None]:
    """A card above the floor under a sky."""

    def build() -> None:
        scene = Scene()
        card = scene.add_square("Card", scene.shade("Card", make(scene)), 0.8, (0, 0, 0.8))
        for name, value in flags.items():
            setattr(card, name, value)
        scene.add_sky(1.0, 0.9, 0.8)

    return build


def _by_ray(name: str) -> Callable[[Scene], Callable[[Any], Any]]:
    """Diffuse, but transparent to a kind of rays."""
    return lambda s: s.mix(s.light_path(name), s.diffuse(0.8), s.node("BsdfTransparent"))


def _glow_by_ray(name: str) -> Callable[[Scene], Callable[[Any], Any]]:
    """It glows, for a kind of rays three times as brightly."""
    return lambda s: s.mix(s.light_path(name), s.node("Emission", Strength=2.0), s.node("Emission", Strength=6.0))


SCENES: dict[str, Callable[[], None]] = {
    "unseen by glossy rays": _glow_beside_metal(lambda s: s.node("Emission", Strength=6.0), visible_glossy=False),
    "unseen by transmission rays": _card_over_glass(lambda s: s.node("Emission", Strength=6.0), visible_transmission=False),
    "glow unseen by diffuse rays": _card(lambda s: s.node("Emission", Strength=6.0), visible_diffuse=False),
    "Is Camera Ray": _card(_by_ray("Is Camera Ray")),
    "Is Reflection Ray": _card(_by_ray("Is Reflection Ray")),
    "Is Glossy Ray": _glow_beside_metal(_by_ray("Is Glossy Ray")),
    "Is Transmission Ray": _card_over_glass(_by_ray("Is Transmission Ray")),
    "glow by Is Camera Ray": _card(_glow_by_ray("Is Camera Ray")),
    "glow by Is Diffuse Ray": _card(_glow_by_ray("Is Diffuse Ray")),
    "glow by Ray Depth": _card(_glow_by_ray("Ray Depth")),
}
