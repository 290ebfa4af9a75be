"""Materials, lamps and worlds that nobody would make on purpose. Needs bpy."""

from __future__ import annotations

import contextlib
from random import Random
from typing import Any

import bpy
from odd_values import NUMBERS, draw_name, draw_number

_NODES = [
    "ShaderNodeBsdfPrincipled",
    "ShaderNodeBsdfDiffuse",
    "ShaderNodeEmission",
    "ShaderNodeBsdfTransparent",
    "ShaderNodeBsdfGlass",
    "ShaderNodeMixShader",
    "ShaderNodeAddShader",
    "ShaderNodeTexImage",
    "ShaderNodeTexNoise",
    "ShaderNodeTexChecker",
    "ShaderNodeTexVoronoi",
    "ShaderNodeMapping",
    "ShaderNodeMath",
    "ShaderNodeValToRGB",
    "ShaderNodeRGB",
    "ShaderNodeMix",
    "ShaderNodeInvert",
    "ShaderNodeNormalMap",
    "ShaderNodeBump",
    "ShaderNodeTexCoord",
    "ShaderNodeUVMap",
    "ShaderNodeVertexColor",
    "ShaderNodeAttribute",
    "ShaderNodeFresnel",
    "ShaderNodeLayerWeight",
    "ShaderNodeLightPath",
    "ShaderNodeObjectInfo",
    "ShaderNodeGroup",
    "ShaderNodeVectorMath",
    "ShaderNodeSeparateXYZ",
    "ShaderNodeCombineXYZ",
    "ShaderNodeHueSaturation",
    "ShaderNodeGamma",
    "ShaderNodeBlackbody",
    "ShaderNodeBsdfTranslucent",
    "ShaderNodeBsdfRefraction",
    "ShaderNodeSubsurfaceScattering",
    "ShaderNodeHoldout",
    "ShaderNodeBsdfHairPrincipled",
    "ShaderNodeVolumePrincipled",
    "ShaderNodeTexEnvironment",
    "ShaderNodeTexSky",
    "ShaderNodeScript",
    "ShaderNodeAmbientOcclusion",
    "ShaderNodeBsdfSheen",
    "ShaderNodeBsdfAnisotropic",
    "ShaderNodeClamp",
    "ShaderNodeMapRange",
    "ShaderNodeRGBCurve",
    "ShaderNodeTexWave",
    "ShaderNodeTexGradient",
    "NodeReroute",
]


def make_material(rng: Random) -> Any:
    """One with odd nodes, or none."""
    material = bpy.data.materials.new(draw_name(rng))
    if rng.random() < 0.1:
        return material
    tree = _give_tree(material)
    _disturb(rng, tree)
    return material


def _give_tree(block: Any) -> Any:
    if block.node_tree is None:  # Blender 4.5
        block.use_nodes = True
    return block.node_tree


def _disturb(rng: Random, tree: Any) -> None:
    """Odd values, nodes and links; sometimes nothing at all, or no output."""
    kind = rng.random()
    if kind < 0.1:
        tree.nodes.clear()
        return
    if kind < 0.2:
        for node in [node for node in tree.nodes if node.bl_idname.startswith("ShaderNodeOutput")]:
            tree.nodes.remove(node)
    added = []
    for _ in range(rng.choice([0, 1, 3, 8])):
        with contextlib.suppress(RuntimeError):  # a kind that this Blender does not have
            added.append(_add_node(rng, tree))
    nodes = list(tree.nodes)
    for _ in range(2 * len(added)):
        _link(rng, tree, nodes)
    for node in nodes:
        node.mute = rng.random() < 0.1
        for socket in node.inputs:
            if rng.random() < 0.15:
                _set_value(rng, socket)


def _add_node(rng: Random, tree: Any) -> Any:
    node = tree.nodes.new(rng.choice(_NODES))
    if hasattr(node, "image") and rng.random() < 0.8:
        node.image = _make_image(rng)
    if node.bl_idname == "ShaderNodeGroup" and rng.random() < 0.7:
        group = bpy.data.node_groups.new(draw_name(rng), "ShaderNodeTree")
        node.node_tree = group
        if rng.random() < 0.5:
            group.interface.new_socket("Out", in_out="OUTPUT", socket_type=rng.choice(["NodeSocketColor", "NodeSocketShader"]))
            group.nodes.new("NodeGroupOutput")
    if hasattr(node, "operation"):
        kinds = node.bl_rna.properties["operation"].enum_items
        with contextlib.suppress(TypeError):
            node.operation = rng.choice([one.identifier for one in kinds])
    return node


def _link(rng: Random, tree: Any, nodes: list[Any]) -> None:
    """From anywhere to anywhere: rings and wrong kinds too."""
    origin, target = rng.choice(nodes), rng.choice(nodes)
    if origin.outputs and target.inputs:
        tree.links.new(rng.choice(list(origin.outputs)), rng.choice(list(target.inputs)))


def _set_value(rng: Random, socket: Any) -> None:
    with contextlib.suppress(AttributeError, TypeError, ValueError, OverflowError):
        value = socket.default_value
        if isinstance(value, float):
            socket.default_value = draw_number(rng)
        elif not isinstance(value, str | int):
            for place in range(len(value)):
                value[place] = draw_number(rng)


def _make_image(rng: Random) -> Any:
    width, height = rng.choice([(1, 1), (4, 4), (1, 64), (33, 7)])
    image = bpy.data.images.new(draw_name(rng), width, height, float_buffer=rng.random() < 0.3)
    kind = rng.random()
    if kind < 0.3:
        image.pixels.foreach_set([draw_number(rng, 0.1) for _ in range(4 * width * height)])
    elif kind < 0.5:
        image.source, image.filepath = (
            "FILE",
            rng.choice(["//lost.png", "/nowhere/lost.exr", "", "//", "//a\nb.png", "//" + "x" * 300 + ".png"]),
        )
    elif kind < 0.6:
        image.source = rng.choice(["TILED", "SEQUENCE", "MOVIE"])
    elif kind < 0.8:
        image.pack(data=rng.randbytes(50), data_len=50)
        image.source = "FILE"
    return image


def add_lamp(rng: Random) -> Any:
    """A lamp with odd values, linked to the open scene."""
    light = bpy.data.lights.new(draw_name(rng), rng.choice(["POINT", "SUN", "SPOT", "AREA"]))
    light.energy = rng.choice([0.0, -100.0, 1e38, 1e-30, 100.0, 1e6, rng.choice(NUMBERS)])
    if rng.random() < 0.4:
        light.color = [draw_number(rng, 0.4) for _ in range(3)]
    for name in ("shadow_soft_size", "angle", "spot_size", "spot_blend", "size", "size_y", "diffuse_factor", "exposure", "temperature"):
        if hasattr(light, name) and rng.random() < 0.3:
            setattr(light, name, draw_number(rng, 0.7))
    if light.type == "AREA":
        light.shape = rng.choice(["SQUARE", "RECTANGLE", "DISK", "ELLIPSE"])
    if rng.random() < 0.3:
        light.use_nodes = True
        if light.node_tree is not None:
            _disturb(rng, light.node_tree)
    obj = bpy.data.objects.new(draw_name(rng), light)
    obj.location = [rng.uniform(-1.0, 1.0), rng.uniform(-1.0, 1.0), rng.choice([2.0, 2.0, 0.0, rng.choice(NUMBERS)])]
    obj.scale = [rng.choice([1.0, 1.0, 0.0, -1.0, 1e8])] * 3
    bpy.context.scene.collection.objects.link(obj)
    return obj


def add_world(rng: Random, scene: Any) -> None:
    """A world with odd nodes, or none."""
    scene.world = bpy.data.worlds.new(draw_name(rng))
    if rng.random() < 0.8:
        tree = _give_tree(scene.world)
        if rng.random() < 0.6:
            _disturb(rng, tree)
        else:
            for node in tree.nodes:
                for socket in node.inputs:
                    _set_value(rng, socket)
