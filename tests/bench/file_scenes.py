"""Small scenes of what artists' files have beside sky, lamps and matter: ways to map images, to instance, hide and move things."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from light_scenes import _add_block, _add_picture
from matter_scenes import Scene

_Node = Callable[[Any], Any]
_UPRIGHT = (math.pi / 2, 0.0, 0.0)
_RED = (0.9, 0.3, 0.2)


def _link(tree: Any, kind: str, inputs: dict[Any, Any], output: Any = 0, **properties: Any) -> Any:
    """An output of a new node; its inputs are values or sockets."""
    node = tree.nodes.new(f"ShaderNode{kind}")
    for name, value in properties.items():
        setattr(node, name, value)
    for name, value in inputs.items():
        if isinstance(value, bpy.types.NodeSocket):
            tree.links.new(value, node.inputs[name])
        else:
            node.inputs[name].default_value = value
    return node.outputs[output]


def _wall(make: Callable[[Scene], _Node], solid: bool = False, after: Callable[[Any], None] = lambda wall: None) -> Callable[[], None]:
    """A wall of 2 m, or a turned block, lit by a sun that the floor sees little of."""

    def build() -> None:
        scene = Scene()
        material = scene.shade("Wall", make(scene))
        if solid:
            wall = _add_block(material, 1.4)
            wall.location, wall.rotation_euler = (0, 1.5, 1.2), (0.4, 0.5, 0.6)
        else:
            wall = scene.add_square("Wall", material, 1.0, (0, 1.5, 1), _UPRIGHT)
        scene.add_light("SUN", 5.0, (0, 0, 5), (1.5, 0, 0), 0.02)
        after(wall)

    return build


def _around(change: Callable[[Scene, Any], None], sky: bool = False) -> Callable[[], None]:
    """A red block on the floor in a sun, and what is done with it."""

    def build() -> None:
        scene = Scene()
        block = _add_block(scene.shade("Red", scene.diffuse(*_RED)), 0.6)
        scene.add_light("SUN", 3.0, (0, 0, 5), (0.5, 0.3, 0), 0.1)
        if sky:
            scene.add_sky(0.3, 0.4, 0.6)
        change(scene, block)

    return build


def _fields(alpha: bool = False) -> np.ndarray:
    """(32, 32, 4): four fields of other colours; alpha from 0 to 1, or 1."""
    fields = np.array([[(0.9, 0.1, 0.1), (0.1, 0.8, 0.2)], [(0.1, 0.2, 0.9), (0.9, 0.8, 0.2)]]).repeat(16, axis=0).repeat(16, axis=1)
    return np.dstack([fields, np.linspace(0.0 if alpha else 1.0, 1.0, 32)[None] * np.ones((32, 1))])


def _picture() -> Any:
    return _add_picture("Fields", _fields()[..., :3])


def _save(kind: str, depth: str, alpha_mode: str = "STRAIGHT", dull: bool = False) -> Any:
    """An image that was saved to a file, and packed; with `dull` of colours that any primaries have."""
    image = bpy.data.images.new("Saved", 32, 32, alpha=True, float_buffer=depth != "8")
    fields = _fields(True)
    if dull:
        fields[..., :3] = 0.2 + 0.3 * fields[..., :3]
    image.pixels.foreach_set(fields.astype(np.float32).ravel())
    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder) / f"Fields.{kind[-3:].lower()}")
        settings = bpy.context.scene.render.image_settings
        settings.file_format, settings.color_depth, settings.color_mode = kind, depth, "RGBA"
        bpy.context.scene.view_settings.view_transform = "Raw"
        image.save_render(path)
        image = bpy.data.images.load(path)
        image.pack()
    image.name, image.alpha_mode = "Fields", alpha_mode
    return image


def _saved(*how: str, uses_alpha: bool = True) -> Callable[[Scene], _Node]:
    """Painted with an image from a file, through whose alpha light passes."""

    def make(tree: Any) -> Any:
        image = _link(tree, "TexImage", {}, image=_save(*how))
        inputs = {"Base Color": image, **({"Alpha": image.node.outputs["Alpha"]} if uses_alpha else {})}
        return _link(tree, "BsdfPrincipled", inputs).node

    return lambda scene: make


def _colored(color: _Node) -> Callable[[Scene], _Node]:
    return lambda scene: scene.node("BsdfDiffuse", Color=color)


def _mapped(output: str, **properties: Any) -> _Node:
    return lambda tree: _link(tree, "TexImage", {"Vector": _link(tree, "TexCoord", {}, output)}, image=_picture(), **properties)


def _other_layer(tree: Any) -> Any:
    return _link(tree, "TexImage", {"Vector": _link(tree, "UVMap", {}, uv_map="Other")}, image=_picture())


def _add_other_layer(wall: Any) -> None:
    wall.data.uv_layers.new(name="Other").uv.foreach_set("vector", np.float32([0.5, 0, 1, 0, 1, 0.5, 0.5, 0.5]))


def _ramp(tree: Any) -> Any:
    image = _link(tree, "TexImage", {}, image=_add_picture("Ramp", np.linspace(0, 1, 256)[None, :, None] * np.ones((256, 256, 3))))
    out = _link(tree, "ValToRGB", {"Fac": image})
    ramp = out.node.color_ramp
    ramp.interpolation = "CONSTANT"
    ramp.elements.new(0.4).color = (*_RED, 1)
    return out


def _curves(tree: Any) -> Any:
    out = _link(tree, "RGBCurve", {"Color": _link(tree, "TexImage", {}, image=_picture()), 0: 0.8})
    mapping = out.node.mapping
    mapping.curves[3].points.new(0.3, 0.7)
    mapping.curves[0].points.new(0.5, 0.2)
    mapping.update()
    return out


def _nested(tree: Any) -> Any:
    """A group in a group: the inner one has the picture, the outer one turns its hue."""
    inner, outer = (bpy.data.node_groups.new(name, "ShaderNodeTree") for name in ("Inner", "Outer"))
    for group in (inner, outer):
        group.interface.new_socket("Color", in_out="OUTPUT", socket_type="NodeSocketColor")
    outer.interface.new_socket("Hue", in_out="INPUT", socket_type="NodeSocketFloat")
    inner.links.new(_link(inner, "TexImage", {}, image=_picture()), inner.nodes.new("NodeGroupOutput").inputs[0])
    held = _link(outer, "Group", {}, 0, node_tree=inner)
    hue = _link(outer, "HueSaturation", {"Color": held, "Hue": outer.nodes.new("NodeGroupInput").outputs[0]})
    outer.links.new(hue, outer.nodes.new("NodeGroupOutput").inputs[0])
    return _link(tree, "Group", {"Hue": 0.7}, node_tree=outer)


def _wear(wall: Any) -> None:
    """The material is linked to the object; that of the mesh is almost black."""
    own, black = wall.data.materials[0], wall.data.materials[0].copy()
    black.node_tree.nodes["Diffuse BSDF"].inputs[0].default_value = (0.01, 0.01, 0.01, 1)
    wall.data.materials[0] = black
    wall.material_slots[0].link = "OBJECT"
    wall.material_slots[0].material = own


def _instance_on(kind: str, **flags: Any) -> Callable[[Scene, Any], None]:
    def change(scene: Scene, block: Any) -> None:
        bpy.ops.mesh.primitive_grid_add(x_subdivisions=3, y_subdivisions=3, size=2.5, location=(0, 0, 0.3))
        grid = bpy.context.object
        grid.data.materials.append(scene.shade("Blue", scene.diffuse(0.2, 0.3, 0.9)))
        block.scale, block.parent, block.location = (0.5, 0.5, 0.5), grid, (0, 0, 0.2)
        grid.instance_type = kind
        for name, value in flags.items():
            setattr(grid, name, value)

    return change


def _nest(scene: Scene, block: Any) -> None:
    """Instances of a collection of instances of a collection, one of them mirrored."""

    def place(collection: Any, content: Any, **where: Any) -> None:
        empty = bpy.data.objects.new("Instance", None)
        empty.instance_type, empty.instance_collection = "COLLECTION", content
        for name, value in where.items():
            setattr(empty, name, value)
        collection.objects.link(empty)

    inner, outer = (bpy.data.collections.new(name) for name in ("Inner", "Outer"))
    inner.objects.link(block)
    bpy.context.scene.collection.objects.unlink(block)
    place(outer, inner, location=(0.5, 0, 0.3), scale=(0.5, 0.5, 0.5))
    place(outer, inner, location=(-0.5, 0.5, 0), rotation_euler=(0.3, 0, 1), scale=(1, 0.5, 0.5))
    for number in range(2):
        place(bpy.context.scene.collection, outer, location=(0.2, 1.2 * number - 0.6, 0.1), scale=(1, 1 - 2 * number, 1))


def _set_collection(**flags: bool) -> Callable[[Scene, Any], None]:
    """The block is in a collection that the view layer shows in another way, or is a shadow catcher."""

    def change(scene: Scene, block: Any) -> None:
        collection = bpy.data.collections.new("Set")
        bpy.context.scene.collection.children.link(collection)
        collection.objects.link(block)
        bpy.context.scene.collection.objects.unlink(block)
        layer = bpy.context.view_layer.layer_collection.children["Set"]
        for name, value in flags.items():
            setattr(layer if hasattr(layer, name) else block, name, value)

    return change


def _bumpy(kind: str) -> Callable[[Scene, Any], None]:
    """The floor is mirrored and has a normal map, or the displacement of its material is a bump."""

    def change(scene: Scene, block: Any) -> None:
        def make(tree: Any) -> Any:
            shader = tree.nodes.new("ShaderNodeBsdfDiffuse")
            if kind == "mirrored":
                tree.links.new(scene.waves(tree), shader.inputs["Normal"])
                return shader
            waves = _link(tree, "TexWave", {"Vector": _link(tree, "TexCoord", {}, "Object"), "Scale": 0.5}, "Fac")
            output = next(node for node in tree.nodes if node.type == "OUTPUT_MATERIAL")
            tree.links.new(_link(tree, "Displacement", {"Height": waves, "Scale": 0.2}), output.inputs["Displacement"])
            return shader

        scene.floor.data.materials[0] = scene.shade("Bumpy", make)
        scene.floor.data.materials[0].displacement_method = "BUMP"
        if kind == "mirrored":
            scene.floor.scale, scene.floor.rotation_euler = (-1, 1, 1), (0, 0, 0.5)

    return change


def _random_colours(wall: Any) -> None:
    for number in range(8):
        other = wall.copy()
        other.scale = (0.3, 0.3, 0.3)
        other.name, other.location = f"Block {number}", (number % 3 - 1, number // 3 - 1, 0.4)
        bpy.context.scene.collection.objects.link(other)


def _random(tree: Any) -> Any:
    return _link(tree, "CombineColor", {"Red": _link(tree, "ObjectInfo", {}, "Random"), "Green": 0.3, "Blue": 0.1})


def _store_tone(wall: Any) -> None:
    """Geometry nodes store a colour on the wall's points, where these are."""
    group = bpy.data.node_groups.new("Nodes", "GeometryNodeTree")
    for way in ("INPUT", "OUTPUT"):
        group.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    store = group.nodes.new("GeometryNodeStoreNamedAttribute")
    store.data_type, store.inputs["Name"].default_value = "FLOAT_COLOR", "tone"
    group.links.new(group.nodes.new("NodeGroupInput").outputs[0], store.inputs[0])
    place = group.nodes.new("GeometryNodeInputPosition").outputs[0]
    group.links.new(place, next(one for one in store.inputs if one.name == "Value" and one.enabled))
    group.links.new(store.outputs[0], group.nodes.new("NodeGroupOutput").inputs[0])
    wall.modifiers.new("Nodes", "NODES").node_group = group


def _tone(tree: Any) -> Any:
    return _link(tree, "VectorMath", {0: _link(tree, "Attribute", {}, "Color", attribute_name="tone")}, operation="ABSOLUTE")


def _move(kind: str) -> Callable[[Scene, Any], None]:
    """A shape key, a driver, or an armature moves the block."""

    def change(scene: Scene, block: Any) -> None:
        if kind == "shape key":
            block.shape_key_add(name="Basis")
            key = block.shape_key_add(name="Key")
            for point in key.data:
                point.co.z += 0.8 * (point.co.z > 0)
            key.value = 0.7
        elif kind == "driver":
            drive = block.driver_add("location", 2).driver
            drive.type, target = "SUM", drive.variables.new().targets[0]
            target.id, target.data_path = scene.floor, "rotation_euler.z"
            scene.floor.rotation_euler = (0, 0, 0.9)
        else:
            bpy.ops.object.armature_add(location=(0, 0, 0))
            rig = bpy.context.object
            block.vertex_groups.new(name="Bone").add(list(range(8)), 1.0, "REPLACE")
            block.modifiers.new("Rig", "ARMATURE").object = rig
            rig.pose.bones[0].rotation_mode = "XYZ"
            rig.pose.bones[0].rotation_euler, rig.pose.bones[0].location = (0.5, 0.6, 0), (0.3, 0.4, 0)

    return change


def _scale(factor: float, away: float = 0.0) -> Callable[[Scene, Any], None]:
    """All of the scene is enlarged, or moved."""

    def change(scene: Scene, block: Any) -> None:
        scene.add_light("AREA", 60.0 * factor**2, (0.8, 0.3, 2.0), (0.2, 0.3, 0), 0.5)
        for obj in bpy.context.scene.objects:
            obj.location = [factor * x + away for x in obj.location]
            if obj.type != "LIGHT" or obj.data.type == "AREA":
                obj.scale = (factor,) * 3

    return change


def _sun(degrees: float) -> Callable[[Scene, Any], None]:
    return lambda scene, block: setattr(bpy.data.lights[0], "angle", math.radians(degrees))


def _hang_glow(scene: Scene, block: Any) -> None:
    """A square that glows from its back, downwards."""

    def back(tree: Any) -> Any:
        return _link(tree, "NewGeometry", {}, "Backfacing")

    scene.add_square("Panel", scene.shade("Panel", scene.node("Emission", Strength=back)), 0.5, (0, 0, 1.2))
    bpy.data.lights[0].energy = 0.1


SCENES: dict[str, Callable[[], None]] = {
    "box projection, blended": _wall(_colored(_mapped("Object", projection="BOX", projection_blend=0.4)), solid=True),
    "sphere projection": _wall(_colored(_mapped("Object", projection="SPHERE"))),
    "Generated": _wall(_colored(_mapped("Generated")), solid=True),
    "UV Map of another layer": _wall(_colored(_other_layer), after=_add_other_layer),
    "alpha, unused": _wall(_saved("PNG", "8", uses_alpha=False)),
    "alpha, premultiplied": _wall(_saved("PNG", "8", "PREMUL")),
    "alpha, channel packed": _wall(_saved("PNG", "8", "CHANNEL_PACKED", uses_alpha=False)),
    "PNG of 16 bits": _wall(_saved("PNG", "16")),
    "EXR": _wall(_saved("OPEN_EXR", "32")),
    "ramp of steps": _wall(_colored(_ramp)),
    "curves": _wall(_colored(_curves)),
    "groups in groups": _wall(_colored(_nested)),
    "material of the object": _wall(lambda s: s.diffuse(*_RED), after=_wear),
    "no material": _wall(lambda s: s.diffuse(0.1), after=lambda wall: wall.data.materials.clear()),
    "random colours": _wall(_colored(_random), solid=True, after=_random_colours),
    "attribute of geometry nodes": _wall(_colored(_tone), after=_store_tone),
    "instances on vertices": _around(_instance_on("VERTS")),
    "instances on faces": _around(_instance_on("FACES", show_instancer_for_render=False, use_instance_faces_scale=True)),
    "collections in collections": _around(_nest),
    "indirect only": _around(_set_collection(indirect_only=True), sky=True),
    "holdout": _around(_set_collection(holdout=True), sky=True),
    "shadow catcher": _around(_set_collection(is_shadow_catcher=True), sky=True),
    "mirrored floor, normal map": _around(_bumpy("mirrored")),
    "bump by displacement": _around(_bumpy("displaced")),
    "shape key": _around(_move("shape key")),
    "armature": _around(_move("armature")),
    "driver": _around(_move("driver")),
    "sun of 90 degrees": _around(_sun(90.0)),
    "sun of 0 degrees": _around(_sun(0.0)),
    "400 m": _around(_scale(100.0)),
    "4 cm": _around(_scale(0.01)),
    "10 km away": _around(_scale(1.0, 1e4)),
    "glowing back": _around(_hang_glow),
}
