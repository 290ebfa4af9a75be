"""Small scenes in which things are seen by some kinds of rays alone: ray visibility, Light Path nodes, light linking."""

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


def _lamp_beside_metal(**flags: bool) -> Callable[[], None]:
    """A wall of metal and an area lamp, which some rays do not see."""

    def build() -> None:
        scene = Scene()
        metal = scene.shade("Metal", scene.node("BsdfGlossy", Color=(0.9, 0.9, 0.9, 1), Roughness=0.6))
        scene.add_square("Wall", metal, 1.0, (0, 2, 1), _UPRIGHT)
        scene.add_light("AREA", 60.0, (0, -1, 2.0), (0.9, 0, 0), 0.6)
        for name, value in flags.items():
            setattr(bpy.data.objects["AREA"], name, value)
        scene.add_light("POINT", 10.0, (-1, -1, 2.5), (0, 0, 0), 0.1)

    return build


def _lamp_over_glass(**flags: bool) -> Callable[[], None]:
    """A pane of glass between the floor and an area lamp, which some rays do not see."""

    def build() -> None:
        scene = Scene()
        glass = scene.shade("Glass", scene.node("BsdfGlass"))
        bpy.ops.mesh.primitive_cube_add(size=1.0, location=(0, 0, 0.8), scale=(1.6, 1.6, 0.1))
        bpy.context.object.data.materials.append(glass)
        scene.add_light("AREA", 60.0, (0, 0, 2.0), (0, 0, 0), 0.6)
        for name, value in flags.items():
            setattr(bpy.data.objects["AREA"], name, value)

    return build


def _linked(kind: str, name: str, state: str, light: str = "AREA") -> Callable[[], None]:
    """A card and a block between the floor and a lamp that is linked to one of them."""

    def build() -> None:
        scene = Scene()
        scene.add_square("Card", scene.shade("Card", scene.diffuse(0.8, 0.3, 0.2)), 0.5, (0.7, 0, 0.8))
        bpy.ops.mesh.primitive_cube_add(size=0.5, location=(-0.7, 0, 0.4))
        bpy.context.object.name = "Block"
        bpy.context.object.data.materials.append(scene.shade("Block", scene.diffuse(0.2, 0.7, 0.3)))
        if light == "Glow":
            scene.add_square("Glow", scene.shade("Glow", scene.node("Emission", Strength=20.0)), 0.3, (0, 0, 2.2), (0.2, 0.1, 0))
        else:
            scene.add_light(light, 60.0 if light == "AREA" else 3.0, (0, 0, 2.2), (0.2, 0.1, 0), 0.3)
        scene.add_light("POINT", 10.0, (-1, -1, 2.5), (0, 0, 0), 0.1)
        collection = bpy.data.collections.new("Linked")
        collection.objects.link(bpy.data.objects[name])
        collection.collection_objects[0].light_linking.link_state = state
        setattr(bpy.data.objects[light].light_linking, f"{kind}_collection", collection)

    return build


def _card_over_glass(make: Callable[[Scene], Callable[[Any], Any]], **flags: bool) -> Callable[[], None]:
    """A pane of glass between the floor and a card under a sky."""

    def build() -> None:
        scene = Scene()
        glass = scene.shade("Glass", scene.node("BsdfGlass"))
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


def _unsampled(build: Callable[[], None]) -> Callable[[], None]:
    """Cycles sends no rays toward what glows: they carry no kind, and would see another light than diffuse rays do."""

    def change() -> None:
        build()
        bpy.data.materials["Card"].cycles.emission_sampling = "NONE"

    return change


SCENES: dict[str, Callable[[], None]] = {
    "unseen by glossy rays": _glow_beside_metal(lambda s: s.node("Emission", Strength=6.0), visible_glossy=False),
    "unseen by transmission rays": _card_over_glass(lambda s: s.node("Emission", Strength=6.0), visible_transmission=False),
    "lamp unseen by glossy rays": _lamp_beside_metal(visible_glossy=False),
    "lamp unseen by diffuse rays": _lamp_beside_metal(visible_diffuse=False),
    "lamp unseen by transmission rays": _lamp_over_glass(visible_transmission=False),
    "light linking": _linked("receiver", "Floor", "INCLUDE"),
    "light linking, excluded": _linked("receiver", "Block", "EXCLUDE", "SUN"),
    "shadow linking": _linked("blocker", "Block", "INCLUDE"),
    "shadow linking, excluded": _linked("blocker", "Card", "EXCLUDE", "SUN"),
    "light linking of a glow": _linked("receiver", "Floor", "INCLUDE", "Glow"),
    "shadow linking of a glow": _linked("blocker", "Block", "INCLUDE", "Glow"),
    "glow unseen by diffuse rays": _card(lambda s: s.node("Emission", Strength=6.0), visible_diffuse=False),
    "Is Camera Ray": _card(_by_ray("Is Camera Ray")),
    "Is Reflection Ray": _card(_by_ray("Is Reflection Ray")),
    "Is Glossy Ray": _glow_beside_metal(_by_ray("Is Glossy Ray")),
    "Is Transmission Ray": _card_over_glass(_by_ray("Is Transmission Ray")),
    "glow by Is Camera Ray": _card(_glow_by_ray("Is Camera Ray")),
    "glow by Is Diffuse Ray": _unsampled(_card(_glow_by_ray("Is Diffuse Ray"))),
    "glow by Ray Depth": _card(_glow_by_ray("Ray Depth")),
}
