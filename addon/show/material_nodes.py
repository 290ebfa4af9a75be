"""The nodes of a baked material: our UV layer, the image, and what shows them."""

from __future__ import annotations

import bpy

from ..nodes.node_ports import Port, find_source, give_nodes, list_shaders, uses_nodes
from ..read.tags import NAME, mark_made
from .node_groups import bring_out

MODES = ("combined", "lighting", "nodes")
DEFAULT_BASE_RGB = (0.8, 0.8, 0.8)  # Blender's own for a face without a material
DIFFUSE_NODES = {"BSDF_PRINCIPLED", "BSDF_DIFFUSE", "SUBSURFACE_SCATTERING", "BSDF_TRANSLUCENT", "BSDF_TOON", "BSDF_SHEEN"}


def write_nodes(material: bpy.types.Material, image: bpy.types.Image, uv_layer: str, mode: str, place_name: str = "") -> str:
    """Adds our nodes to a material that is ours and gives "" or what could not be shown, to follow the original's name.

    mode         combined: the image is all one sees; lighting: the image lights the base colour; nodes: placed, but linked to nothing
    place_name   the objects' property that holds scale and offset of their UVs, "" without one
    """
    constant_base = _start_tree(material)
    tree = material.node_tree
    outputs = [node for node in tree.nodes if node.type == "OUTPUT_MATERIAL"]
    surface = tree.get_output_node("CYCLES").inputs["Surface"] if outputs else None
    place = _Placer(tree)
    uv = _place_uv(place, uv_layer, place_name)
    texture = place.node("ShaderNodeTexImage", 1)
    texture.image, texture.interpolation, texture.extension = image, "Linear", "EXTEND"
    # The Solid view shows the active image by the mesh's own UVs, and where none is active any that it finds: an empty one keeps it plain.
    tree.nodes.active = place.node("ShaderNodeTexImage", 1) if place_name else texture
    tree.links.new(texture.inputs["Vector"], uv)
    if mode == "nodes":
        return ""
    error, shader = "", _show(place, texture.outputs["Color"])
    if mode == "lighting":
        error, shader = _lit_base(place, texture.outputs["Color"], shader, surface, constant_base)
    shader = _cut_out(place, shader, find_source(Port(surface))) if surface else shader
    for output in outputs or [place.node("ShaderNodeOutputMaterial", 5)]:
        tree.links.new(output.inputs["Surface"], shader)
    return error


class _Placer:
    """Adds marked nodes in a labelled frame below all others, column by column."""

    def __init__(self, tree: bpy.types.NodeTree) -> None:
        bottom = min((node.location.y for node in tree.nodes), default=0.0) - 500.0
        self.tree = tree
        self.frame = tree.nodes.new("NodeFrame")
        self.frame.label = self.frame.name = NAME
        self.frame.location = (0.0, bottom)
        self.rows: dict[int, int] = {}
        mark_made(self.frame)

    def node(self, kind: str, column: int) -> bpy.types.Node:
        node = self.tree.nodes.new(kind)
        row = self.rows[column] = self.rows.get(column, -1) + 1
        node.parent = self.frame
        node.location = (300.0 * column, -200.0 * row)
        node.label = NAME
        mark_made(node)
        return node


def _start_tree(material: bpy.types.Material) -> tuple[float, float, float] | None:
    """Makes sure of nodes; gives the base colour of a material that had none of its own, else None."""
    if uses_nodes(material):
        return None
    give_nodes(material)
    material.node_tree.nodes.clear()
    return tuple(material.diffuse_color[:3])


def _place_uv(place: _Placer, uv_layer: str, place_name: str) -> bpy.types.NodeSocket:
    """The layer's UVs, and where objects share them: times the object's scale, plus its offset."""
    uv_map = place.node("ShaderNodeUVMap", -3 if place_name else 0)
    uv_map.uv_map = uv_layer
    if not place_name:
        return uv_map.outputs["UV"]
    links = place.tree.links
    attribute, split = place.node("ShaderNodeAttribute", -3), place.node("ShaderNodeSeparateXYZ", -2)
    offset, moved = place.node("ShaderNodeCombineXYZ", -1), place.node("ShaderNodeVectorMath", 0)
    attribute.attribute_type, attribute.attribute_name = "OBJECT", place_name
    moved.operation = "MULTIPLY_ADD"
    links.new(split.inputs[0], attribute.outputs["Vector"])
    links.new(offset.inputs["X"], split.outputs["Z"])
    links.new(offset.inputs["Y"], attribute.outputs["Alpha"])
    for socket, value in zip(moved.inputs, (uv_map.outputs["UV"], attribute.outputs["Vector"], offset.outputs[0]), strict=False):
        links.new(socket, value)
    return moved.outputs["Vector"]


def _show(place: _Placer, color: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
    emission = place.node("ShaderNodeEmission", 3)
    emission.inputs["Strength"].default_value = 1.0
    place.tree.links.new(emission.inputs["Color"], color)
    return emission.outputs["Emission"]


def _lit_base(
    place: _Placer,
    light: bpy.types.NodeSocket,
    shader: bpy.types.NodeSocket,
    surface: bpy.types.NodeSocket | None,
    constant_base: tuple[float, float, float] | None,
) -> tuple[str, bpy.types.NodeSocket]:
    """Base colour times light, plus the material's own emission."""
    shaders = list(list_shaders(Port(surface))) if surface else []
    base = next((_read_base(port) for port in shaders if port.node.type in DIFFUSE_NODES), None)
    emission = next(filter(None, map(_read_emission, shaders)), None)
    error = ""
    multiply = place.node("ShaderNodeVectorMath", 2)  # a vector product is not clamped: light may be brighter than 1
    multiply.operation = "MULTIPLY"
    place.tree.links.new(multiply.inputs[1], light)
    if base is not None:
        feed(place.tree, base, multiply.inputs[0])
    elif emission is not None:
        multiply.inputs[0].default_value = (0.0, 0.0, 0.0)
    else:
        multiply.inputs[0].default_value = constant_base or DEFAULT_BASE_RGB
        if shaders:
            error = (
                "no diffuse base colour was found in its nodes, so its light is shown on grey; bake the combined pass to see its colour."
            )
    place.tree.links.new(shader.node.inputs["Color"], multiply.outputs["Vector"])
    if emission is None:
        return error, shader
    glow = place.node("ShaderNodeEmission", 3)
    for source, target in zip(emission, ("Color", "Strength"), strict=True):
        feed(place.tree, source, glow.inputs[target])
    add = place.node("ShaderNodeAddShader", 4)
    place.tree.links.new(add.inputs[0], shader)
    place.tree.links.new(add.inputs[1], glow.outputs["Emission"])
    return error, add.outputs["Shader"]


def _cut_out(place: _Placer, shader: bpy.types.NodeSocket, seen: Port) -> bpy.types.NodeSocket:
    """The shader with the gaps that an alpha texture cuts into leaves and fences; a constant alpha is in the bake already.

    seen   what the original shows there
    """
    node = None if seen.is_value else seen.node
    if node is None or node.type not in ("BSDF_PRINCIPLED", "MIX_SHADER"):
        return shader
    fraction = seen.sibling("Alpha") if node.type == "BSDF_PRINCIPLED" else find_source(Port(node.inputs[0], seen.groups))
    if fraction is None or fraction.is_value:
        return shader
    if node.type == "BSDF_PRINCIPLED":
        return _mix_gaps(place, shader, fraction, 0)
    parts = [find_source(Port(node.inputs[number], seen.groups)) for number in (1, 2)]
    gaps = [number for number, part in enumerate(parts) if not part.is_value and part.node.type == "BSDF_TRANSPARENT"]
    if len(gaps) != 1:
        return shader
    solid = _cut_out(place, shader, parts[1 - gaps[0]])
    return _mix_gaps(place, solid, fraction, gaps[0])


def _mix_gaps(place: _Placer, shader: bpy.types.NodeSocket, fraction: Port, number_of_gaps: int) -> bpy.types.NodeSocket:
    """(1 - fraction) of the first and fraction of the second: of the shader, and of what lets all light through."""
    mix, gap = place.node("ShaderNodeMixShader", 4), place.node("ShaderNodeBsdfTransparent", 3)
    sockets = [shader, shader]
    sockets[number_of_gaps] = gap.outputs[0]
    for socket, source in zip(mix.inputs, (bring_out(place.tree, fraction), *sockets), strict=True):
        place.tree.links.new(socket, source)
    return mix.outputs[0]


def _read_base(port: Port) -> Port | None:
    return port.sibling("Base Color" if port.node.type == "BSDF_PRINCIPLED" else "Color")


def _read_emission(port: Port) -> tuple[Port, Port] | None:
    """Sources of emitted colour and strength; None of a shader that does not shine."""
    prefix = {"EMISSION": "", "BSDF_PRINCIPLED": "Emission "}.get(port.node.type)
    if prefix is None:
        return None
    color, strength = port.sibling("Emission Color" if prefix else "Color"), port.sibling(f"{prefix}Strength")
    if color is None or strength is None:
        return None
    return (color, strength) if not prefix or not strength.is_value or strength.socket.default_value > 0.0 else None


def feed(tree: bpy.types.NodeTree, source: Port, target: bpy.types.NodeSocket) -> None:
    """Feeds target with a source: by a link, or with its constant."""
    if not source.is_value:
        tree.links.new(target, bring_out(tree, source))
    elif source.socket.type == "RGBA" and target.type == "VECTOR":
        target.default_value = source.socket.default_value[:3]
    else:
        target.default_value = source.socket.default_value
