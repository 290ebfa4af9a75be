"""Copies of node groups that hand out what is inside them, so that nodes of a material can use it."""

from __future__ import annotations

import bpy

from ..nodes.node_ports import Port
from ..read.tags import is_made, mark_made, remove_unused, suffixed_name

_SOCKET_TYPES = {"VALUE": "NodeSocketFloat", "RGBA": "NodeSocketColor", "VECTOR": "NodeSocketVector", "SHADER": "NodeSocketShader"}


def bring_out(tree: bpy.types.NodeTree, port: Port) -> bpy.types.NodeSocket:
    """The output socket in `tree` that gives what an output port inside its groups gives.

    tree   of a material of ours; each group on the way is replaced there by a copy of ours with one output more
    """
    nodes = []
    for group in port.groups:
        node = tree.nodes[group.name]
        if not is_made(node.node_tree):
            node.node_tree = _copy_group(node.node_tree)
        nodes.append(node)
        tree = node.node_tree
    wanted = port.socket.identifier
    socket = next(output for output in tree.nodes[port.node.name].outputs if output.identifier == wanted)
    for node in reversed(nodes):
        socket = _hand_out(node, socket)
    return socket


def remove_unused_groups() -> None:
    """Deletes our copies of groups that nothing uses any more; those inside of others come after them."""
    while any(is_made(group) and group.users == 0 for group in bpy.data.node_groups):
        remove_unused(bpy.data.node_groups)


def _copy_group(group: bpy.types.NodeTree) -> bpy.types.NodeTree:
    copy = group.copy()
    copy.name = suffixed_name(group.name)
    copy.use_fake_user = False
    mark_made(copy)
    return copy


def _hand_out(node: bpy.types.Node, socket: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
    """A new output of a group node, fed by a socket inside of the group."""
    tree = node.node_tree
    item = tree.interface.new_socket(socket.name, in_out="OUTPUT", socket_type=_SOCKET_TYPES.get(socket.type, "NodeSocketFloat"))
    identifier = item.identifier
    output = next(inner for inner in tree.nodes if inner.type == "GROUP_OUTPUT" and inner.is_active_output)
    tree.links.new(next(entry for entry in output.inputs if entry.identifier == identifier), socket)
    return next(entry for entry in node.outputs if entry.identifier == identifier)
