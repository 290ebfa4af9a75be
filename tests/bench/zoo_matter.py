"""Random matter for scenes of the zoo: shaders of all kinds in place of some of the paints, and a random world. Needs bpy.

Left out is what Cycles itself bakes in two ways at once, such as surfaces that pass shadow rays alone (docs/matter.md).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from random import Random
from typing import Any

_SHARE = 0.35  # of the materials that are replaced
_SKY_STRENGTH = 0.3


class Painter:
    """Adds shaders of one material to its node tree."""

    def __init__(self, tree: Any, random: Random) -> None:
        self.tree, self.random = tree, random

    def color(self) -> tuple[float, float, float, float]:
        red, green, blue = (self.random.uniform(0.1, 0.85) for _ in range(3))
        return red, green, blue, 1.0

    def node(self, kind: str, **inputs: Any) -> Any:
        """A node by its inputs: values, or sockets of nodes made before."""
        made = self.tree.nodes.new(f"ShaderNode{kind}")
        for name, value in inputs.items():
            socket = made.inputs[name.replace("_", " ")]
            if hasattr(value, "is_linked"):
                self.tree.links.new(value, socket)
            else:
                socket.default_value = value
        return made

    def principled(self, **inputs: Any) -> Any:
        return self.node("BsdfPrincipled", **{"Base_Color": self.color(), **inputs})

    def pattern(self, kind: str, least: float, most: float) -> Any:
        """A procedural texture over the object."""
        place = self.node("TexCoord").outputs[self.random.choice(["Object", "Generated"])]
        return self.node(f"Tex{kind}", Vector=place, Scale=self.random.uniform(least, most))

    def ramp(self, socket: Any) -> Any:
        """Two colours by a value."""
        made = self.node("ValToRGB", Fac=socket)
        for element in made.color_ramp.elements:
            element.color = self.color()
        return made.outputs["Color"]

    def mix(self, fraction: Any, first: Any, second: Any) -> Any:
        made = self.node("MixShader", Fac=fraction)
        self.tree.links.new(first.outputs[0], made.inputs[1])
        self.tree.links.new(second.outputs[0], made.inputs[2])
        return made

    def diffuse(self) -> Any:
        return self.node("BsdfDiffuse", Color=self.color())

    def bump(self) -> Any:
        height = self.pattern("Noise", 1.0, 4.0).outputs[0]
        bent = self.node("Bump", Height=height, Strength=self.random.uniform(0.1, 0.5), Distance=0.1)
        return self.principled(Roughness=1.0, Normal=bent.outputs["Normal"])


# Names, and shaders as they are drawn.
KINDS: dict[str, Callable[[Painter], Any]] = {
    "gloss": lambda p: p.principled(Roughness=p.random.uniform(0.05, 0.9)),
    "metal": lambda p: p.principled(Metallic=p.random.choice([0.5, 0.8]), Roughness=p.random.uniform(0.1, 0.6)),
    "alpha": lambda p: p.principled(Alpha=p.random.uniform(0.2, 0.8)),
    "alpha of a checker": lambda p: p.principled(Alpha=p.pattern("Checker", 2.0, 8.0).outputs["Fac"]),
    "translucent": lambda p: p.mix(p.random.uniform(0.2, 0.7), p.node("BsdfTranslucent", Color=p.color()), p.diffuse()),
    "bump": Painter.bump,
    "glow": lambda p: p.principled(
        Emission_Color=p.pattern("Checker", 1.0, 4.0).outputs["Color"], Emission_Strength=p.random.uniform(0.1, 1.0)
    ),
    "subsurface": lambda p: p.principled(Subsurface_Weight=p.random.uniform(0.1, 0.6), Subsurface_Radius=(0.02, 0.01, 0.01)),
    "coat": lambda p: p.principled(Coat_Weight=p.random.uniform(0.3, 1.0), Sheen_Weight=p.random.uniform(0.0, 0.5), Roughness=0.7),
    "bricks": lambda p: p.principled(Base_Color=p.pattern("Brick", 1.0, 5.0).outputs["Color"], Roughness=0.8),
    "noise": lambda p: p.principled(Base_Color=p.ramp(p.pattern("Noise", 1.0, 5.0).outputs[0]), Roughness=0.8),
    "sides": lambda p: p.mix(p.node("NewGeometry").outputs["Backfacing"], p.diffuse(), p.diffuse()),
    "fresnel": lambda p: p.mix(p.node("Fresnel").outputs[0], p.diffuse(), p.node("BsdfAnisotropic", Roughness=p.random.uniform(0.05, 0.5))),
    "glass": lambda p: p.principled(Transmission_Weight=0.5, Roughness=p.random.choice([0.0, 0.3]), IOR=1.45),
}


def dress_scene(random: Random) -> list[str]:
    """Give the open scene random matter; the kinds that were drawn, in the order of the objects. What glows stays."""
    import bpy

    drawn = []
    for obj in sorted(bpy.context.scene.objects, key=lambda one: one.name):
        for slot in obj.material_slots:
            if slot.material is None or _glows(slot.material) or random.random() > _SHARE:
                continue
            kind = random.choice(list(KINDS))
            material = bpy.data.materials.new(f"{kind} {len(drawn)}")
            material.use_nodes = True
            tree = material.node_tree
            tree.nodes.clear()
            output = tree.nodes.new("ShaderNodeOutputMaterial")
            tree.links.new(KINDS[kind](Painter(tree, random)).outputs[0], output.inputs["Surface"])
            slot.material = material
            drawn.append(kind)
    _set_world(random)
    return drawn


def _glows(material: Any) -> bool:
    """Whether it is one of the zoo's lamps."""
    return any(node.type == "BSDF_PRINCIPLED" and node.inputs["Emission Strength"].default_value > 0 for node in material.node_tree.nodes)


def _set_world(random: Random) -> None:
    """A sky texture, a gradient, one colour, or nothing."""
    import bpy

    world = bpy.data.worlds.new("Random World")
    bpy.context.scene.world = world
    world.use_nodes = True
    tree = world.node_tree
    background = next(node for node in tree.nodes if node.type == "BACKGROUND")
    painter, kind = Painter(tree, random), random.choice(["sky", "gradient", "color", "none"])
    background.inputs["Color"].default_value = painter.color()
    background.inputs["Strength"].default_value = {"sky": _SKY_STRENGTH, "none": 0.0}.get(kind, 0.5)
    if kind == "sky":
        sky = painter.node("TexSky")
        sky.sun_elevation, sky.sun_rotation = random.uniform(0.2, 1.3), random.uniform(0.0, 2.0 * math.pi)
        tree.links.new(sky.outputs[0], background.inputs["Color"])
    elif kind == "gradient":
        apart = painter.node("SeparateXYZ", Vector=painter.node("TexCoord").outputs["Generated"])
        tree.links.new(painter.ramp(apart.outputs["Z"]), background.inputs["Color"])
