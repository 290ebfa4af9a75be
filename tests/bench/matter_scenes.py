"""Small scenes of one kind of matter each: a floor with a layer UVMap, and what lights it."""

from collections.abc import Callable
from typing import Any

import bpy
import numpy as np

FLOOR = "Floor"
_SQUARE = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], float)
_TURN_UP = (3.14159265, 0.0, 0.0)
_NOWHERE = (0.0, 0.0, 0.0)


class Scene:
    """The open scene, emptied, with a grey floor of 4 m."""

    def __init__(self) -> None:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self.floor = self.add_square(FLOOR, self.shade("Grey", self.diffuse(0.5)), 2.0)

    def shade(self, name: str, make: Callable[[Any], Any]) -> Any:
        """A material whose surface is the shader that `make` adds to its tree."""
        material = bpy.data.materials.new(name)
        material.use_nodes = True
        tree = material.node_tree
        tree.nodes.clear()
        output = tree.nodes.new("ShaderNodeOutputMaterial")
        tree.links.new(output.inputs["Surface"], make(tree).outputs[0])
        return material

    def node(self, kind: str, **inputs: Any) -> Callable[[Any], Any]:
        """A shader node by its inputs: values, or sockets of nodes made before."""

        def make(tree: Any) -> Any:
            node = tree.nodes.new(f"ShaderNode{kind}")
            for name, value in inputs.items():
                socket = node.inputs[name.replace("_", " ")]
                if callable(value):
                    tree.links.new(socket, value(tree))
                else:
                    socket.default_value = value
            return node

        return make

    def diffuse(self, *rgb: float) -> Callable[[Any], Any]:
        color = rgb if len(rgb) == 3 else rgb * 3
        return self.node("BsdfDiffuse", Color=(*color, 1.0))

    def principled(self, **inputs: Any) -> Callable[[Any], Any]:
        return self.node("BsdfPrincipled", **inputs)

    def once(self, make: Callable[[Any], Any]) -> Callable[[Any], Any]:
        """The shader with the distribution GGX, which loses what its facets scatter more than once."""

        def change(tree: Any) -> Any:
            node = make(tree)
            node.distribution = "GGX"
            return node

        return change

    def mix(self, fraction: Any, first: Callable[[Any], Any], second: Callable[[Any], Any]) -> Callable[[Any], Any]:
        def make(tree: Any) -> Any:
            node = tree.nodes.new("ShaderNodeMixShader")
            if callable(fraction):
                tree.links.new(node.inputs[0], fraction(tree))
            else:
                node.inputs[0].default_value = fraction
            tree.links.new(node.inputs[1], first(tree).outputs[0])
            tree.links.new(node.inputs[2], second(tree).outputs[0])
            return node

        return make

    def leaf_alpha(self, tree: Any) -> Any:
        """The alpha of an image of a round leaf."""
        y, x = np.mgrid[:64, :64] / 32 - 1 + 1 / 64
        pixels = np.ones((64, 64, 4), np.float32)
        pixels[..., 3] = x**2 + y**2 < 0.6
        image = bpy.data.images.new("Leaf", 64, 64, alpha=True, float_buffer=True)
        image.pixels.foreach_set(pixels.ravel())
        image.pack()
        node = tree.nodes.new("ShaderNodeTexImage")
        node.image = image
        return node.outputs["Alpha"]

    def map_image(self, make: Callable[[np.ndarray, np.ndarray], Any]) -> Callable[[Any], Any]:
        """The colour of an image without colour space: what a function makes of its pixels' x and y, from 0 to 1."""

        def build(tree: Any) -> Any:
            y, x = (np.mgrid[:64, :64] + 0.5) / 64
            pixels = np.ones((64, 64, 4), np.float32)
            for channel, values in enumerate(make(x, y)):
                pixels[..., channel] = values
            image = bpy.data.images.new("Map", 64, 64, float_buffer=True)
            image.colorspace_settings.name = "Non-Color"
            image.pixels.foreach_set(pixels.ravel())
            image.pack()
            node = tree.nodes.new("ShaderNodeTexImage")
            node.image = image
            return node.outputs["Color"]

        return build

    def stripes(self, low: float, high: float) -> Callable[[Any], Any]:
        """Four soft upright stripes of two values."""
        return self.map_image(lambda x, y: (low + (high - low) * np.clip(2 * np.cos(4 * np.pi * x) + 0.5, 0, 1),) * 3)

    def waves(self, tree: Any) -> Any:
        """A normal map of waves, 20 degrees steep."""
        node = tree.nodes.new("ShaderNodeNormalMap")

        def lean(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, ...]:
            slope = 0.36 * np.cos(16 * np.pi * x)
            length = np.sqrt(1 + slope**2)
            return 0.5 + 0.5 * slope / length, 0.5 + 0 * y, 0.5 + 0.5 / length

        tree.links.new(self.map_image(lean)(tree), node.inputs["Color"])
        return node.outputs["Normal"]

    def fresnel(self, tree: Any) -> Any:
        return tree.nodes.new("ShaderNodeFresnel").outputs[0]

    def light_path(self, name: str) -> Callable[[Any], Any]:
        return lambda tree: tree.nodes.new("ShaderNodeLightPath").outputs[name]

    def add_square(
        self, name: str, material: Any, half: float, place: tuple[float, ...] = (0, 0, 0), turn: tuple[float, ...] = (0, 0, 0)
    ) -> Any:
        mesh = bpy.data.meshes.new(name)
        mesh.from_pydata((half * _SQUARE).tolist(), [], [(0, 1, 2, 3)])
        layer = mesh.uv_layers.new(name="UVMap")
        layer.uv.foreach_set("vector", np.float32([0, 0, 1, 0, 1, 1, 0, 1]))
        mesh.materials.append(material)
        obj = bpy.data.objects.new(name, mesh)
        obj.location, obj.rotation_euler = place, turn
        bpy.context.scene.collection.objects.link(obj)
        return obj

    def add_light(self, kind: str, power: float, place: tuple[float, ...], turn: tuple[float, ...] = (0, 0, 0), size: float = 0.2) -> Any:
        data = bpy.data.lights.new(kind, kind)
        data.energy = power
        if kind == "AREA":
            data.size = size
        elif kind == "SUN":
            data.angle = size
        else:
            data.shadow_soft_size = size
        if kind == "SPOT":
            data.spot_size, data.spot_blend = 0.9, 0.0
        obj = bpy.data.objects.new(kind, data)
        obj.location, obj.rotation_euler = place, turn
        bpy.context.scene.collection.objects.link(obj)
        return obj

    def add_sky(self, *rgb: float) -> None:
        world = bpy.data.worlds.new("World")
        bpy.context.scene.world = world
        world.use_nodes = True
        node = next(node for node in world.node_tree.nodes if node.type == "BACKGROUND")
        node.inputs[0].default_value = (*rgb, 1.0)


def _under_a_pane(make: Callable[[Scene], Callable[[Any], Any]], sky: bool = False, **flags: bool) -> Callable[[], None]:
    """A square of 1.6 m hangs 0.8 m above the floor."""

    def build() -> None:
        scene = Scene()
        pane = scene.add_square("Pane", scene.shade("Pane", make(scene)), 0.8, (0, 0, 0.8))
        for name, value in flags.items():
            setattr(pane, name, value)
        if sky:
            scene.add_sky(1.0, 0.9, 0.8)
        else:
            scene.add_light("SUN", 3.0, (0, 0, 5), (0.3, 0.2, 0), 0.1)

    return build


def _beside_a_wall(make: Callable[[Scene], Callable[[Any], Any]]) -> Callable[[], None]:
    """A wall of 2 m at the floor's side, lit by a spot that does not see the floor."""

    def build() -> None:
        scene = Scene()
        scene.add_square("Wall", scene.shade("Wall", make(scene)), 1.0, (0, 2, 1), (1.5708, 0, 0))
        scene.add_light("SPOT", 200.0, (0, -1, 2.2), (1.2, 0, 0), 0.05)
        scene.add_light("POINT", 20.0, (0, -1, 2.5), (0, 0, 0), 0.1)

    return build


def _between_lamps(make: Callable[[Scene], Callable[[Any], Any]]) -> Callable[[], None]:
    """The floor itself is of a matter, with a lamp above and another below."""

    def build() -> None:
        scene = Scene()
        scene.floor.data.materials[0] = scene.shade("Sheet", make(scene))
        scene.add_light("AREA", 60.0, (0.4, 0.2, 2.0), size=0.5)
        scene.add_light("AREA", 150.0, (-0.6, 0.3, -1.5), _TURN_UP, 0.5)

    return build


def _closed_room(make: Callable[[Scene], Callable[[Any], Any]]) -> Callable[[], None]:
    """A room of 4 m whose walls and ceiling are of a matter."""

    def build() -> None:
        scene = Scene()
        material, half_turn = scene.shade("Wall", make(scene)), 1.5707963
        scene.add_square("Ceiling", material, 2.0, (0, 0, 4), _TURN_UP)
        for number in range(4):
            x, y = ((2, 0), (0, 2), (-2, 0), (0, -2))[number]
            scene.add_square(f"Wall {number}", material, 2.0, (x, y, 2), (half_turn, 0, number * half_turn - half_turn))
        scene.add_light("POINT", 60.0, (0.5, 0.3, 2.0), (0, 0, 0), 0.2)

    return build


def _through(make: Callable[[Scene], Callable[[Any], Any]], shape: str, light: str = "SUN") -> Callable[[], None]:
    """A solid above the floor: a ball of 0.8 m, or a pane of 1.6 m, 0.1 m thick; or a pane of one face."""

    def build() -> None:
        scene = Scene()
        material = scene.shade("Glass", make(scene))
        if shape == "face":
            scene.add_square("Glass", material, 0.8, (0, 0, 0.8))
        else:
            if shape == "ball":
                bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=32, radius=0.4, location=(0, 0, 0.7))
                bpy.ops.object.shade_smooth()
            else:
                bpy.ops.mesh.primitive_cube_add(size=1.0, location=(0, 0, 0.8), scale=(1.6, 1.6, 0.1))
            bpy.context.object.data.materials.append(material)
        if light == "SKY":
            scene.add_sky(1.0, 0.9, 0.8)
        elif light == "AREA":
            scene.add_light("AREA", 100.0, (0.4, 0.2, 2.5), (0, 0, 0), 0.6)
        else:
            scene.add_light("SUN", 3.0, (0, 0, 5), (0.3, 0.2, 0), 0.1)

    return build


def _around_a_lamp(make: Callable[[Scene], Callable[[Any], Any]]) -> Callable[[], None]:
    """A ball of 0.6 m with a lamp inside."""

    def build() -> None:
        scene = Scene()
        bpy.ops.mesh.primitive_uv_sphere_add(segments=32, ring_count=16, radius=0.3, location=(0, 0, 0.8))
        bpy.context.object.data.materials.append(scene.shade("Shade", make(scene)))
        scene.add_light("POINT", 60.0, (0, 0, 0.85), size=0.05)

    return build


def _before_a_wall(make: Callable[[Scene], Callable[[Any], Any]], lean: float = 0.8) -> Callable[[], None]:
    """A wall of 2 m stands on the floor, in a sun that shines on its front (with -0.8 on its back), and a lamp lights its back."""

    def build() -> None:
        scene = Scene()
        scene.add_square("Wall", scene.shade("Wall", make(scene)), 1.0, (0, 0.5, 1), (1.5708, 0, 0))
        scene.add_light("SUN", 3.0, (0, 0, 5), (lean, 0, 0), 0.1)
        scene.add_light("POINT", 30.0, (0, 1.8, 1.5), size=0.1)

    return build


def _back(tree: Any) -> Any:
    """1 on backs, 0 on fronts."""
    return tree.nodes.new("ShaderNodeNewGeometry").outputs["Backfacing"]


def _facing(tree: Any) -> Any:
    return tree.nodes.new("ShaderNodeLayerWeight").outputs["Facing"]


def _window(scene: Scene) -> Callable[[Any], Any]:
    """A mirror over a Transparent BSDF, by Fresnel."""
    return scene.mix(scene.fresnel, scene.node("BsdfTransparent"), scene.node("BsdfGlossy", Roughness=0.0))


def _trick(scene: Scene) -> Callable[[Any], Any]:
    """Transparent for shadow rays, glass for all others."""
    return scene.mix(scene.light_path("Is Shadow Ray"), scene.node("BsdfGlass"), scene.node("BsdfTransparent"))


def _gold(scene: Scene) -> Callable[[Any], Any]:
    """A Metallic BSDF by its indices of refraction."""

    def make(tree: Any) -> Any:
        node = scene.node("BsdfMetallic", Roughness=0.4)(tree)
        node.fresnel_type = "PHYSICAL_CONDUCTOR"
        node.inputs["IOR"].default_value, node.inputs["Extinction"].default_value = (0.18, 0.42, 1.37), (3.42, 2.35, 1.77)
        return node

    return make


SCENES: dict[str, Callable[[], None]] = {
    "alpha 0.4": _under_a_pane(lambda s: s.principled(Alpha=0.4)),
    "alpha 0.4, sky": _under_a_pane(lambda s: s.principled(Alpha=0.4), sky=True),
    "alpha of an image": _under_a_pane(lambda s: s.principled(Alpha=s.leaf_alpha)),
    "alpha of an image, sky": _under_a_pane(lambda s: s.principled(Alpha=s.leaf_alpha), sky=True),
    "transparent, coloured": _under_a_pane(lambda s: s.node("BsdfTransparent", Color=(0.9, 0.3, 0.1, 1))),
    "mix with transparent": _under_a_pane(
        lambda s: s.mix(0.3, s.node("BsdfTransparent", Color=(0.2, 0.6, 1, 1)), s.diffuse(0.8, 0.2, 0.2))
    ),
    "mix by an image": _under_a_pane(lambda s: s.mix(s.leaf_alpha, s.node("BsdfTransparent"), s.diffuse(0.2, 0.7, 0.1))),
    "Is Shadow Ray": _under_a_pane(lambda s: s.mix(s.light_path("Is Shadow Ray"), s.diffuse(0.8), s.node("BsdfTransparent"))),
    "Is Diffuse Ray": _under_a_pane(lambda s: s.mix(s.light_path("Is Diffuse Ray"), s.diffuse(0.8), s.node("BsdfTransparent")), sky=True),
    "no shadow": _under_a_pane(lambda s: s.diffuse(0.8), visible_shadow=False),
    "unseen by diffuse rays": _under_a_pane(lambda s: s.diffuse(0.8), visible_diffuse=False),
    "unseen by diffuse rays, sky": _under_a_pane(lambda s: s.diffuse(0.8), sky=True, visible_diffuse=False),
    "mirror": _beside_a_wall(lambda s: s.principled(Base_Color=(0.9, 0.7, 0.5, 1), Metallic=1.0, Roughness=0.0)),
    "metal, roughness 0.3": _beside_a_wall(lambda s: s.principled(Base_Color=(0.9, 0.7, 0.5, 1), Metallic=1.0, Roughness=0.3)),
    "metal, roughness 0.8": _beside_a_wall(lambda s: s.principled(Base_Color=(0.9, 0.7, 0.5, 1), Metallic=1.0, Roughness=0.8)),
    "half metal": _beside_a_wall(lambda s: s.principled(Base_Color=(0.9, 0.7, 0.5, 1), Metallic=0.5, Roughness=0.4)),
    "metal, roughness by an image": _beside_a_wall(
        lambda s: s.principled(Base_Color=(0.9, 0.7, 0.5, 1), Metallic=1.0, Roughness=s.stripes(0.2, 0.9))
    ),
    "metal by an image": _beside_a_wall(lambda s: s.principled(Base_Color=(0.9, 0.7, 0.5, 1), Metallic=s.stripes(0, 1), Roughness=0.4)),
    "metal, tinted edge": _beside_a_wall(
        lambda s: s.principled(Base_Color=(0.9, 0.7, 0.5, 1), Metallic=1.0, Roughness=0.5, Specular_Tint=(0.2, 0.8, 0.9, 1))
    ),
    "Metallic BSDF, gold": _beside_a_wall(_gold),
    "metal, normal map": _beside_a_wall(lambda s: s.principled(Base_Color=(0.9, 0.7, 0.5, 1), Metallic=1.0, Roughness=0.6, Normal=s.waves)),
    "metal mixed by an image": _beside_a_wall(
        lambda s: s.mix(s.stripes(0, 1), s.diffuse(0.3), s.node("BsdfGlossy", Color=(0.8, 0.8, 0.8, 1), Roughness=0.6))
    ),
    "Glossy BSDF": _beside_a_wall(lambda s: s.node("BsdfGlossy", Color=(0.8, 0.8, 0.8, 1), Roughness=0.2)),
    "layer, roughness 0.1": _beside_a_wall(lambda s: s.principled(Base_Color=(0.6, 0.6, 0.6, 1), Roughness=0.1)),
    "layer, roughness 0.5": _beside_a_wall(lambda s: s.principled(Base_Color=(0.6, 0.6, 0.6, 1))),
    "layer, black tint, IOR 1000": _beside_a_wall(
        lambda s: s.principled(Base_Color=(0.6, 0.6, 0.6, 1), IOR=1000.0, Specular_Tint=(0, 0, 0, 1))
    ),
    "metal, roughness 0.8, GGX": _beside_a_wall(lambda s: s.once(s.principled(Base_Color=(0.9, 0.7, 0.5, 1), Metallic=1.0, Roughness=0.8))),
    "Glossy BSDF, GGX": _beside_a_wall(lambda s: s.once(s.node("BsdfGlossy", Color=(0.8, 0.8, 0.8, 1), Roughness=0.6))),
    "white room, GGX": _closed_room(lambda s: s.once(s.principled(Base_Color=(0.8, 0.8, 0.8, 1)))),
    "white room, roughness 1, GGX": _closed_room(lambda s: s.once(s.principled(Base_Color=(0.8, 0.8, 0.8, 1), Roughness=1.0))),
    "rough glass pane, GGX": _through(lambda s: s.once(s.node("BsdfGlass", Roughness=0.5)), "pane", "AREA"),
    "white room": _closed_room(lambda s: s.principled(Base_Color=(0.8, 0.8, 0.8, 1))),
    "white room without a layer": _closed_room(lambda s: s.diffuse(0.8)),
    "glass ball, sun": _through(lambda s: s.node("BsdfGlass"), "ball"),
    "glass ball, area lamp": _through(lambda s: s.node("BsdfGlass"), "ball", "AREA"),
    "glass ball, sky": _through(lambda s: s.node("BsdfGlass"), "ball", "SKY"),
    "rough glass ball": _through(lambda s: s.node("BsdfGlass", Roughness=0.4), "ball", "AREA"),
    "glass pane": _through(lambda s: s.node("BsdfGlass"), "pane"),
    "glass pane, sky": _through(lambda s: s.node("BsdfGlass"), "pane", "SKY"),
    "tinted glass pane": _through(lambda s: s.node("BsdfGlass", Color=(0.9, 0.4, 0.2, 1)), "pane"),
    "rough glass pane": _through(lambda s: s.node("BsdfGlass", Roughness=0.5), "pane", "AREA"),
    "Principled glass pane": _through(
        lambda s: s.principled(Base_Color=(0.8, 0.4, 0.2, 1), Transmission_Weight=1.0, Roughness=0.0), "pane"
    ),
    "half transmission": _through(lambda s: s.principled(Base_Color=(0.8, 0.4, 0.2, 1), Transmission_Weight=0.5), "pane", "AREA"),
    "glass of one face": _through(lambda s: s.node("BsdfGlass"), "face", "AREA"),
    "Refraction BSDF": _through(lambda s: s.node("BsdfRefraction", Roughness=0.2, IOR=1.45), "pane", "AREA"),
    "glass that shadow rays pass": _through(_trick, "pane"),
    "translucent": _under_a_pane(lambda s: s.node("BsdfTranslucent", Color=(0.8, 0.5, 0.3, 1))),
    "translucent, sky": _under_a_pane(lambda s: s.node("BsdfTranslucent", Color=(0.8, 0.5, 0.3, 1)), sky=True),
    "half translucent": _under_a_pane(lambda s: s.mix(0.5, s.diffuse(0.7, 0.3, 0.2), s.node("BsdfTranslucent", Color=(0.2, 0.8, 0.3, 1)))),
    "translucent by an image": _under_a_pane(
        lambda s: s.mix(s.leaf_alpha, s.diffuse(0.5), s.node("BsdfTranslucent", Color=(0.2, 0.8, 0.3, 1)))
    ),
    "translucent leaf": _under_a_pane(
        lambda s: s.mix(0.3, s.principled(Base_Color=(0.2, 0.6, 0.1, 1)), s.node("BsdfTranslucent", Color=(0.4, 0.8, 0.1, 1)))
    ),
    "light on translucency": _between_lamps(lambda s: s.node("BsdfTranslucent", Color=(0.8, 0.5, 0.3, 1))),
    "light on half translucency": _between_lamps(
        lambda s: s.mix(0.5, s.diffuse(0.7, 0.3, 0.2), s.node("BsdfTranslucent", Color=(0.2, 0.8, 0.3, 1)))
    ),
    "lampshade": _around_a_lamp(lambda s: s.mix(0.5, s.diffuse(0.8), s.node("BsdfTranslucent", Color=(0.8, 0.7, 0.5, 1)))),
    "subsurface": _beside_a_wall(lambda s: s.principled(Base_Color=(0.8, 0.5, 0.4, 1), Subsurface_Weight=1.0, Subsurface_Scale=0.02)),
    "sheen": _beside_a_wall(lambda s: s.principled(Base_Color=(0.2, 0.2, 0.4, 1), Sheen_Weight=1.0, Sheen_Roughness=0.7)),
    "Sheen BSDF": _beside_a_wall(lambda s: s.node("BsdfSheen", Color=(0.9, 0.7, 0.5, 1), Roughness=0.9)),
    "sheen room": _closed_room(lambda s: s.principled(Base_Color=(0.6, 0.6, 0.6, 1), Sheen_Weight=1.0, Sheen_Roughness=0.7)),
    "coat": _beside_a_wall(lambda s: s.principled(Base_Color=(0.6, 0.6, 0.6, 1), Coat_Weight=1.0, Coat_Roughness=0.3)),
    "tinted coat": _beside_a_wall(
        lambda s: s.principled(Base_Color=(0.8, 0.8, 0.8, 1), Coat_Weight=1.0, Coat_Tint=(0.8, 0.4, 0.2, 1), Coat_Roughness=0.2)
    ),
    "coated metal": _beside_a_wall(
        lambda s: s.principled(Base_Color=(0.8, 0.6, 0.4, 1), Metallic=1.0, Roughness=0.6, Coat_Weight=1.0, Coat_Roughness=0.3)
    ),
    "coated white room": _closed_room(lambda s: s.principled(Base_Color=(0.8, 0.8, 0.8, 1), Coat_Weight=1.0, Coat_Roughness=0.2)),
    "coat, GGX": _beside_a_wall(lambda s: s.once(s.principled(Base_Color=(0.6, 0.6, 0.6, 1), Coat_Weight=1.0, Coat_Roughness=0.3))),
    "coated white room, GGX": _closed_room(
        lambda s: s.once(s.principled(Base_Color=(0.8, 0.8, 0.8, 1), Roughness=0.8, Coat_Weight=1.0, Coat_Roughness=0.6))
    ),
    "coated glass pane": _through(
        lambda s: s.principled(Base_Color=(0.8, 0.4, 0.2, 1), Transmission_Weight=1.0, Roughness=0.3, Coat_Weight=1.0), "pane", "AREA"
    ),
    "tinted coat over glass": _through(
        lambda s: s.principled(
            Base_Color=(1, 1, 1, 1), Transmission_Weight=1.0, Roughness=0.3, Coat_Weight=1.0, Coat_Tint=(0.8, 0.4, 0.2, 1)
        ),
        "pane",
        "AREA",
    ),
    "rough Glossy BSDF": _beside_a_wall(lambda s: s.node("BsdfGlossy", Color=(0.8, 0.5, 0.3, 1), Roughness=0.9)),
    "backs culled, lit in front": _before_a_wall(lambda s: s.mix(_back, s.diffuse(0.7, 0.3, 0.3), s.node("BsdfTransparent"))),
    "backs culled, lit behind": _before_a_wall(lambda s: s.mix(_back, s.diffuse(0.7, 0.3, 0.3), s.node("BsdfTransparent")), -0.8),
    "back of another colour": _before_a_wall(lambda s: s.mix(_back, s.diffuse(0.9, 0.1, 0.1), s.diffuse(0.1, 0.1, 0.9))),
    "window by Fresnel, sun": _under_a_pane(_window),
    "window by Fresnel, sky": _under_a_pane(_window, sky=True),
    "mix by Fresnel": _beside_a_wall(lambda s: s.mix(s.fresnel, s.diffuse(0.6, 0.3, 0.2), s.node("BsdfGlossy", Roughness=0.3))),
    "room, mix by Fresnel": _closed_room(lambda s: s.mix(s.fresnel, s.diffuse(0.8), s.node("BsdfGlossy", Roughness=0.3))),
    "room, mix by Layer Weight": _closed_room(lambda s: s.mix(_facing, s.diffuse(0.8), s.diffuse(0.2))),
    "rough diffuse wall": _beside_a_wall(lambda s: s.node("BsdfDiffuse", Color=(0.9, 0.7, 0.5, 1), Roughness=1.0)),
    "rough diffuse room": _closed_room(lambda s: s.principled(Base_Color=(0.8, 0.8, 0.8, 1), Diffuse_Roughness=1.0)),
    "metal room": _closed_room(lambda s: s.principled(Base_Color=(0.8, 0.6, 0.4, 1), Metallic=1.0, Roughness=0.4)),
}
# Scenes in which much light comes by caustics, which Cycles renders with more noise.
_WORDS = "mirror", "metal,", "metal by", "metal mixed", "half metal", "Metallic", "Glossy", "roughness 0.1", "glass", "Refraction"
CAUSTICS = {name for name in SCENES if any(word in name for word in _WORDS) and not any(word in name for word in ("sky", "shadow"))}
# Samples of these, as a multiple of the others'.
NOISY = {
    "mirror": 128,
    "glass ball, area lamp": 32,
    "Refraction BSDF": 32,
    "lampshade": 32,
    "lamp unseen by diffuse rays": 16,
    "coated glass pane": 16,
    "tinted coat over glass": 16,
}
# Baked by Cycles in so many texels a side of each, whose mean counts: where light is sharper than a texel, the square of half its width
# that Cycles 5.0 samples has other light than the whole.
PARTS = {"glass ball, area lamp": 4}
# Light comes by shadow rays in place of refraction.
WITHOUT_CAUSTICS = ("glass that shadow rays pass",)
