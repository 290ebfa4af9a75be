"""Materials that Blender's glTF exporter turns into an unlit colour, or into a lightmap in the occlusion slot."""

from __future__ import annotations

import math
from collections.abc import Iterator

import bpy

from ..nodes.node_ports import give_nodes, uses_nodes
from ..read.tags import NAME
from .gltf_colors import GltfColors

GROUP_NAME = "glTF Material Output"  # the exporter knows the group by its name


def make_unlit(original: bpy.types.Material | None, texture: bpy.types.Image, uv_layer: str) -> bpy.types.Material:
    """A material that shows the texture and nothing else."""
    material = bpy.data.materials.new(NAME)
    give_nodes(material)
    if original is not None:
        material.use_backface_culling = original.use_backface_culling
    tree = material.node_tree
    tree.nodes.clear()
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(output.inputs["Surface"], _add_texture(tree, texture, uv_layer))  # a colour without a shader is what "unlit" means
    return material


def make_lightmapped(
    original: bpy.types.Material | None, texture: bpy.types.Image, uv_layer: str, group: bpy.types.NodeTree, colors: GltfColors
) -> bpy.types.Material:
    """A copy of the original with the texture as its occlusion."""
    material = original.copy() if original is not None else bpy.data.materials.new(NAME)
    if original is None and not uses_nodes(material):
        give_nodes(material)
        material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = material.diffuse_color
    elif original is not None and colors.needs(original):
        colors.write(material, original)
    tree = material.node_tree
    mend_tree(tree)
    sockets = list(_occlusion_sockets(tree))
    if not sockets:
        node = tree.nodes.new("ShaderNodeGroup")
        node.node_tree = group
        sockets = list(_occlusion_sockets(tree))
    color = _add_texture(tree, texture, uv_layer)
    for socket in sockets:
        tree.links.new(socket, color)
    return material


def make_plain(original: bpy.types.Material | None, colors: GltfColors) -> bpy.types.Material | None:
    """The original where the exporter reads it, else a copy with the colours that were read of it."""
    if original is None or not (colors.needs(original) or is_broken(original)):
        return original
    copy = original.copy()
    if colors.needs(original):
        colors.write(copy, original)
    mend_tree(copy.node_tree)
    return copy


def is_broken(material: bpy.types.Material) -> bool:
    """Whether nodes feed themselves, which the exporter would follow without end, or hold what is no number, on which it fails."""
    tree = material.node_tree
    return tree is not None and (any(map(_closes_ring, tree.links)) or any(True for _ in _list_odd_sockets(tree)))


def mend_tree(tree: bpy.types.NodeTree) -> None:
    """Takes the links away by which nodes feed themselves, through which nothing flows, and sets to 0 what is no number."""
    for link in [link for link in tree.links if _closes_ring(link)]:
        tree.links.remove(link)
    for socket in list(_list_odd_sockets(tree)):
        if isinstance(socket.default_value, float):
            socket.default_value = 0.0
        else:
            socket.default_value = [value if math.isfinite(value) else 0.0 for value in socket.default_value]


def _list_odd_sockets(tree: bpy.types.NodeTree) -> Iterator[bpy.types.NodeSocket]:
    for socket in (socket for node in tree.nodes for socket in (*node.inputs, *node.outputs)):
        value = getattr(socket, "default_value", None)
        numbers = [value] if isinstance(value, float) else value if socket.type in ("RGBA", "VECTOR") and value is not None else []
        if not all(map(math.isfinite, numbers)):
            yield socket


def _closes_ring(link: bpy.types.NodeLink) -> bool:
    return not link.is_valid or link.from_node == link.to_node


def make_group() -> bpy.types.NodeTree:
    """The exporter's node group, of which the name and the sockets count."""
    group = bpy.data.node_groups.new(GROUP_NAME, "ShaderNodeTree")
    group.interface.new_socket("Occlusion", in_out="INPUT", socket_type="NodeSocketFloat")
    return group


def _occlusion_sockets(tree: bpy.types.NodeTree) -> Iterator[bpy.types.NodeSocket]:
    for node in tree.nodes:
        if node.type == "GROUP" and node.node_tree is not None and node.node_tree.name.startswith(GROUP_NAME):
            yield from (socket for socket in node.inputs if socket.name == "Occlusion")


def _add_texture(tree: bpy.types.NodeTree, texture: bpy.types.Image, uv_layer: str) -> bpy.types.NodeSocket:
    uv_map = tree.nodes.new("ShaderNodeUVMap")
    uv_map.uv_map = uv_layer
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image, node.interpolation, node.extension = texture, "Linear", "EXTEND"
    tree.links.new(node.inputs["Vector"], uv_map.outputs["UV"])
    return node.outputs["Color"]
