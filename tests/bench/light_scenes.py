"""Small scenes of one kind of sky, lamp, geometry or texture each, as of matter_scenes."""

import math
from collections.abc import Callable
from typing import Any

import bpy
import numpy as np
from matter_scenes import Scene

_Node = Callable[[Any], Any]


def _find_socket(node: Any, identifier: str, is_output: bool = False) -> Any:
    return next(socket for socket in (node.outputs if is_output else node.inputs) if socket.identifier == identifier)


def _add_picture(name: str, pixels: np.ndarray) -> Any:
    """An image of linear pixels (h, w, 3), packed."""
    height, width, _ = pixels.shape
    image = bpy.data.images.new(name, width, height, float_buffer=True)
    image.colorspace_settings.name = "Linear Rec.709"
    image.pixels.foreach_set(np.concatenate([pixels, np.ones((height, width, 1))], axis=2).astype(np.float32).ravel())
    image.pack()
    return image


def _below_a_sky(fill: Callable[[Any], Any]) -> Callable[[], None]:
    """A block of 0.8 m stands on the floor under a sky whose colour is an output that `fill` adds to the world's tree."""

    def build() -> None:
        scene = Scene()
        scene.add_sky(1.0, 1.0, 1.0)
        tree = bpy.context.scene.world.node_tree
        background = next(node for node in tree.nodes if node.type == "BACKGROUND")
        tree.links.new(fill(tree), background.inputs["Color"])
        _add_block(scene.shade("White", scene.diffuse(0.8)))

    return build


def _add_block(material: Any, side: float = 0.8) -> Any:
    bpy.ops.mesh.primitive_cube_add(size=side, location=(0, 0, side / 2 + 0.1))
    bpy.context.object.data.materials.append(material)
    return bpy.context.object


def _even(tree: Any) -> Any:
    node = tree.nodes.new("ShaderNodeRGB")
    node.outputs[0].default_value = (0.3, 0.5, 1.0, 1.0)
    return node.outputs[0]


def _panorama(tree: Any) -> Any:
    """A dim sky with a wide and a small bright lamp in it."""
    v, u = (np.mgrid[0:128, 0:256] + 0.5) / 128
    pixels = np.array([0.2, 0.25, 0.4]) * v[..., None]
    for place, radius, rgb in (((0.7, 0.75), 0.02, (300, 270, 200)), ((1.3, 0.7), 0.1, (8, 2, 1))):
        pixels[np.hypot(u - place[0], v - place[1]) < radius] = rgb
    node, place, turn = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("TexEnvironment", "TexCoord", "Mapping"))
    node.image = _add_picture("Panorama", pixels)
    turn.inputs["Rotation"].default_value = (0.0, 0.1, 0.8)
    tree.links.new(place.outputs["Generated"], turn.inputs["Vector"])
    tree.links.new(turn.outputs["Vector"], node.inputs["Vector"])
    return node.outputs["Color"]


def _sky_texture(**properties: Any) -> Callable[[Any], Any]:
    def fill(tree: Any) -> Any:
        node = tree.nodes.new("ShaderNodeTexSky")
        for name, value in {"sun_elevation": 0.7, "sun_rotation": 2.0, **properties}.items():
            setattr(node, name, value)
        return node.outputs["Color"]

    return fill


def _gradient(tree: Any) -> Any:
    node, place = tree.nodes.new("ShaderNodeTexGradient"), tree.nodes.new("ShaderNodeTexCoord")
    tree.links.new(place.outputs["Generated"], node.inputs["Vector"])
    return node.outputs["Color"]


def _by_ray(tree: Any) -> Any:
    """Blue for the camera, another colour for light."""
    mix, path = tree.nodes.new("ShaderNodeMix"), tree.nodes.new("ShaderNodeLightPath")
    mix.data_type = "RGBA"
    _find_socket(mix, "A_Color").default_value = (1.0, 0.8, 0.5, 1.0)
    _find_socket(mix, "B_Color").default_value = (0.0, 0.0, 1.0, 1.0)
    tree.links.new(path.outputs["Is Camera Ray"], mix.inputs[0])
    return _find_socket(mix, "Result_Color", is_output=True)


def _below_a_lamp(change: Callable[[Any], None] = lambda data: None, kind: str = "POINT", power: float = 60.0) -> Callable[[], None]:
    """A lamp 2 m above the floor, beside a block."""

    def build() -> None:
        scene = Scene()
        scene.add_light(kind, power, (0.5, 0.3, 2.0), (0.2, 0.1, 0), 0.1)
        data = bpy.data.lights[0]
        change(data)
        _add_block(scene.shade("White", scene.diffuse(0.8)), 0.4)

    return build


def _use_tree(data: Any) -> tuple[Any, Any]:
    """A lamp's node tree, and its Emission node."""
    data.use_nodes = True
    return data.node_tree, next(node for node in data.node_tree.nodes if node.type == "EMISSION")


def _use_profile(data: Any) -> None:
    down = np.arange(0, 181, 10.0)
    candela = (60 + 50 * np.cos(np.radians(down))).round(2)
    rows = [f"1 1000 0.1 {len(down)} 1 1 2 0.1 0.1 0.1", "1 1 20", " ".join(map(str, down)), "0", " ".join(map(str, candela))]
    tree, emission = _use_tree(data)
    node = tree.nodes.new("ShaderNodeTexIES")
    node.ies = bpy.data.texts.new("lamp.ies")
    node.ies.from_string("\n".join(["IESNA:LM-63-1995", "TILT=NONE", *rows, ""]))
    tree.links.new(node.outputs[0], emission.inputs["Strength"])


def _use_gobo(data: Any) -> None:
    """A spot that throws a picture of bars."""
    data.spot_size, data.spot_blend = 1.2, 0.2
    tree, emission = _use_tree(data)
    node, place, turn = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("TexImage", "TexCoord", "Mapping"))
    bars = np.where(np.arange(64)[:, None, None] // 8 % 2, (1.0, 0.6, 0.2), (0.1, 0.1, 0.4)) * np.ones((64, 64, 1))
    node.image = _add_picture("Bars", bars)
    turn.inputs["Location"].default_value, turn.inputs["Scale"].default_value = (0.5, 0.5, 0.0), (0.8, 0.8, 0.8)
    tree.links.new(place.outputs["Normal"], turn.inputs["Vector"])
    tree.links.new(turn.outputs["Vector"], node.inputs["Vector"])
    tree.links.new(node.outputs["Color"], emission.inputs["Color"])


def _use_picture(data: Any) -> None:
    """A picture of four fields over an area lamp."""
    tree, emission = _use_tree(data)
    node, place = tree.nodes.new("ShaderNodeTexImage"), tree.nodes.new("ShaderNodeNewGeometry")
    fields = np.array([[(1.0, 0.2, 0.1), (0.1, 0.3, 2.0)], [(1.0, 0.2, 0.1), (5.0, 5.0, 5.0)]])
    node.image = _add_picture("Fields", fields.repeat(8, axis=0).repeat(8, axis=1))
    tree.links.new(place.outputs["Parametric"], node.inputs["Vector"])
    tree.links.new(node.outputs["Color"], emission.inputs["Color"])
    data.size = 1.0


def _use_falloff(data: Any) -> None:
    tree, emission = _use_tree(data)
    node = tree.nodes.new("ShaderNodeLightFalloff")
    node.inputs["Strength"].default_value = 0.5
    tree.links.new(node.outputs["Quadratic"], emission.inputs["Strength"])


def _use_strength(data: Any) -> None:
    tree, emission = _use_tree(data)
    node = tree.nodes.new("ShaderNodeBlackbody")
    node.inputs[0].default_value = 3000.0
    tree.links.new(node.outputs[0], emission.inputs["Color"])
    emission.inputs["Strength"].default_value = 2.5


def _use_exposure(data: Any) -> None:
    data.color = (1.0, 0.6, 0.3)
    if hasattr(data, "exposure"):  # Blender 4.5 and later
        data.exposure = 1.0


def _lit_by(make: Callable[[Scene], _Node]) -> Callable[[], None]:
    """A glowing square of 1 m above the floor."""

    def build() -> None:
        scene = Scene()
        scene.add_square("Panel", scene.shade("Panel", make(scene)), 0.5, (0, 0, 1.2), (math.pi, 0, 0))

    return build


def _beside_colours(make: Callable[[Scene], _Node]) -> Callable[[], None]:
    """A wall of 2 m lit by a sun that the floor sees little of."""

    def build() -> None:
        scene = Scene()
        scene.add_square("Wall", scene.shade("Wall", make(scene)), 1.0, (0, 1.5, 1), (math.pi / 2, 0, 0))
        scene.add_light("SUN", 5.0, (0, 0, 5), (1.5, 0, 0), 0.02)

    return build


def _checker(tree: Any) -> Any:
    node, place = tree.nodes.new("ShaderNodeTexChecker"), tree.nodes.new("ShaderNodeTexCoord")
    node.inputs["Color1"].default_value, node.inputs["Color2"].default_value = (0.9, 0.2, 0.1, 1.0), (0.1, 0.3, 0.9, 1.0)
    node.inputs["Scale"].default_value = 2.0
    tree.links.new(place.outputs["UV"], node.inputs["Vector"])
    return node.outputs["Color"]


def _noise(tree: Any) -> Any:
    node = tree.nodes.new("ShaderNodeTexNoise")
    node.inputs["Scale"].default_value = 2.0
    return node.outputs["Color"]


def _picture(tree: Any) -> Any:
    y, x = np.mgrid[:32, :32] / 32
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image = _add_picture("Picture", np.stack([x, y, x * y], axis=-1))
    return node.outputs["Color"]


def _front_only(tree: Any) -> Any:
    """1 on fronts, 0 on backs."""
    node, one = tree.nodes.new("ShaderNodeNewGeometry"), tree.nodes.new("ShaderNodeMath")
    one.operation, one.inputs[0].default_value = "SUBTRACT", 1.0
    tree.links.new(node.outputs["Backfacing"], one.inputs[1])
    return one.outputs[0]


def _bumpy_floor() -> None:
    """The floor itself has a normal map of waves."""
    scene = Scene()
    x = np.arange(64) / 64 * 8 * np.pi
    slope = np.stack([0.5 + 0.25 * np.sin(x), np.full(64, 0.5), 0.5 + 0.5 * np.sqrt(1 - 0.25 * np.sin(x) ** 2)], axis=-1)

    def make(tree: Any) -> Any:
        shader, node, image = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("BsdfDiffuse", "NormalMap", "TexImage"))
        image.image = _add_picture("Waves", np.repeat(slope[None], 64, axis=0))
        image.image.colorspace_settings.name = "Non-Color"
        node.uv_map = "UVMap"
        tree.links.new(image.outputs["Color"], node.inputs["Color"])
        tree.links.new(node.outputs["Normal"], shader.inputs["Normal"])
        return shader

    scene.floor.data.materials[0] = scene.shade("Waves", make)
    scene.add_light("SUN", 3.0, (0, 0, 5), (0.6, 0.4, 0), 0.1)
    _add_block(scene.shade("White", scene.diffuse(0.8)), 0.5)


def _leaf() -> None:
    """The floor's corner normals lean to a sun that stands below it."""
    scene = Scene()
    scene.floor.data.normals_split_custom_set([(0.0, 0.95, 0.3)] * 4)
    scene.add_light("SUN", 3.0, (0, 0, 5), (-2.2143, 0, 0), 0.1)
    _add_block(scene.shade("White", scene.diffuse(0.8)), 0.5)


def _hill(glow: float) -> Callable[[], None]:
    """The floor is a coarse hill with smooth normals, below a low sun; or it glows, below a block."""

    def build() -> None:
        scene = Scene()
        corner = np.linspace(-1, 1, 6)
        mesh = bpy.data.meshes.new("Hill")
        points = [(2 * x, 2 * y, 0.6 * (1 - x * x) * (1 - y * y)) for y in corner for x in corner]
        mesh.from_pydata(points, [], [(k, k + 1, k + 7, k + 6) for k in range(30) if k % 6 < 5])
        mesh.uv_layers.new(name="UVMap").uv.foreach_set(
            "vector", np.array([mesh.vertices[loop.vertex_index].co[:2] for loop in mesh.loops]).ravel() / 4 + 0.5
        )
        mesh.shade_smooth()
        mesh.materials.append(scene.floor.material_slots[0].material)
        scene.floor.data = mesh
        if glow:
            glowing = scene.principled(Base_Color=(0.5, 0.5, 0.5, 1.0), Emission_Color=(1.0, 0.8, 0.6, 1.0), Emission_Strength=glow)
            mesh.materials[0] = scene.shade("Glow", glowing)
            _add_block(scene.shade("White", scene.diffuse(0.8)))
        else:
            scene.add_light("SUN", 3.0, (0, 0, 5), (1.25, 0, 0.5), 0.0)

    return build


def _particles(kind: str) -> Callable[[], None]:
    """Hair on a small square, or balls around it."""

    def build() -> None:
        scene = Scene()
        ground = scene.add_square("Ground", scene.shade("Straw", scene.diffuse(0.7, 0.6, 0.3)), 0.6, (0, 0, 0.3))
        settings = ground.modifiers.new("Particles", "PARTICLE_SYSTEM").particle_system.settings
        if kind == "HAIR":
            settings.type, settings.count, settings.hair_length, settings.render_step = "HAIR", 150, 0.5, 3
            settings.root_radius, settings.tip_radius, settings.radius_scale = 1.0, 0.5, 0.02
        else:
            bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=2, radius=0.1, location=(0, 0, -5))
            settings.count, settings.frame_start, settings.frame_end, settings.lifetime = 30, 0, 0, 100
            settings.physics_type, settings.render_type, settings.instance_object = "NO", "OBJECT", bpy.context.object
            settings.particle_size = 1.0
        scene.add_light("SUN", 3.0, (0, 0, 5), (0.5, 0.3, 0), 0.1)

    return build


def _curves() -> None:
    """A bevelled curve, a text and a metaball."""
    scene = Scene()
    material = scene.shade("White", scene.diffuse(0.8))
    bpy.ops.curve.primitive_bezier_circle_add(radius=0.8, location=(0, 0, 0.6))
    bpy.context.object.data.bevel_depth = 0.05
    bpy.context.object.data.materials.append(material)
    bpy.ops.object.text_add(location=(-0.6, -0.6, 0.5))
    bpy.context.object.data.extrude = 0.05
    bpy.context.object.data.materials.append(material)
    bpy.ops.object.metaball_add(type="BALL", radius=0.4, location=(0, 0.4, 0.8))
    bpy.context.object.data.materials.append(material)
    scene.add_light("SUN", 3.0, (0, 0, 5), (0.5, 0.3, 0), 0.1)


SCENES: dict[str, Callable[[], None]] = {
    "sky, even": _below_a_sky(_even),
    "sky, picture": _below_a_sky(_panorama),
    "Sky Texture": _below_a_sky(_sky_texture(sun_disc=False)),
    "Sky Texture, sun": _below_a_sky(_sky_texture(sun_size=0.05)),
    "sky, gradient": _below_a_sky(_gradient),
    "sky, Light Path": _below_a_sky(_by_ray),
    "point lamp": _below_a_lamp(),
    "sun lamp": _below_a_lamp(kind="SUN", power=3.0),
    "area lamp, disk": _below_a_lamp(lambda data: setattr(data, "shape", "DISK"), "AREA"),
    "area lamp, spread": _below_a_lamp(lambda data: setattr(data, "spread", 1.5), "AREA"),
    "area lamp with a picture": _below_a_lamp(_use_picture, "AREA"),
    "IES lamp": _below_a_lamp(_use_profile, power=1.0),
    "spot with a picture": _below_a_lamp(_use_gobo, "SPOT", 200.0),
    "Light Falloff": _below_a_lamp(_use_falloff),
    "lamp nodes": _below_a_lamp(_use_strength),
    "lamp colour and exposure": _below_a_lamp(_use_exposure),
    "glowing picture": _lit_by(lambda s: s.node("Emission", Color=_picture, Strength=10.0)),
    "glowing front": _lit_by(lambda s: s.node("Emission", Strength=lambda tree: _front_only(tree))),
    "image": _beside_colours(lambda s: s.node("BsdfDiffuse", Color=_picture)),
    "checker": _beside_colours(lambda s: s.node("BsdfDiffuse", Color=_checker)),
    "noise": _beside_colours(lambda s: s.node("BsdfDiffuse", Color=_noise)),
    "normal map": _bumpy_floor,
    "normals of a leaf": _leaf,
    "low sun on a coarse hill": _hill(0.0),
    "glow of a smooth hill": _hill(0.3),
    "hair": _particles("HAIR"),
    "particles": _particles("OBJECT"),
    "curve, text, metaball": _curves,
}
