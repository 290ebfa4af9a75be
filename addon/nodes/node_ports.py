"""Walking a node tree: what feeds a socket, through reroutes, muted nodes and groups."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Port:
    """A socket, and the group nodes it lies in from the outside in."""

    socket: Any
    groups: tuple[Any, ...] = ()

    @property
    def node(self) -> Any:
        return self.socket.node

    @property
    def is_value(self) -> bool:
        """Whether the socket's own value holds, since nothing feeds it."""
        return not self.socket.is_output

    def sibling(self, name: str) -> Port | None:
        """The source of the node's input of that name or identifier, None where there is none."""
        inputs = self.node.inputs
        socket = next((s for s in inputs if s.identifier == name), None) or inputs.get(name)
        return None if socket is None else find_source(Port(socket, self.groups))


def find_source(port: Port) -> Port:
    """The output that feeds an input, or the unlinked input whose value holds."""
    while not port.socket.is_output:
        links = _list_links(port.socket)
        if not links:
            return port
        source = Port(links[0].from_socket, port.groups)
        if source.node.mute:
            inner = next((link for link in source.node.internal_links if link.to_socket == source.socket), None)
            if inner is None or not _list_links(inner.from_socket):
                return port  # Blender takes a muted node out with the link from it, unless something feeds what it hands on
            port = Port(inner.from_socket, port.groups)
        else:
            port = _pass_through(source)
    return port


def walk_sources(port: Port) -> Iterator[Any]:
    """All nodes that an output may depend on, those of groups among them."""
    pending, seen = [port.node], set()
    for group in port.groups:
        pending.append(group)
    while pending:
        node = pending.pop()
        if node.as_pointer() in seen:
            continue
        seen.add(node.as_pointer())
        yield node
        if node.type == "GROUP" and node.node_tree:
            pending.extend(node.node_tree.nodes)
        pending.extend(link.from_node for socket in node.inputs for link in socket.links)


def is_used(output: Any) -> bool:
    """Whether an output leads to an output of its tree: Cycles drops nodes that lead nowhere."""
    pending, seen = [output], set()
    while pending:
        for link in pending.pop().links:
            node = link.to_node
            if link.is_muted or node.as_pointer() in seen:
                continue
            if node.type == "GROUP_OUTPUT" or node.type.startswith("OUTPUT_"):
                return True
            seen.add(node.as_pointer())
            pending.extend(node.outputs)
    return False


def _list_links(socket: Any) -> list[Any]:
    """The links to an input that count. Blender marks one link of a ring as not valid, but not that of a node to itself."""
    return [link for link in socket.links if link.is_valid and not link.is_muted and link.from_node != link.to_node]


def list_shaders(port: Port) -> Iterator[Port]:
    """The outputs that feed a port with shaders, inside groups too, nearest first along each branch."""
    waiting, seen = [port], set()
    while waiting:
        port = find_source(waiting.pop())
        key = (port.node.name, *(group.name for group in port.groups))
        if port.is_value or key in seen:
            continue
        seen.add(key)
        yield port
        waiting += [Port(entry, port.groups) for entry in reversed(port.node.inputs) if entry.type == "SHADER"]


def _pass_through(port: Port) -> Port:
    """The port of an output that is not muted, or the input it merely hands on."""
    node = port.node
    if node.type == "REROUTE":
        return Port(node.inputs[0], port.groups)
    if node.type == "GROUP" and node.node_tree:
        output = next((n for n in node.node_tree.nodes if n.type == "GROUP_OUTPUT" and n.is_active_output), None)
        socket = _find_identifier(output.inputs, port.socket) if output else None
        return Port(socket, (*port.groups, node)) if socket else port
    if node.type == "GROUP_INPUT" and port.groups:
        socket = _find_identifier(port.groups[-1].inputs, port.socket)
        return Port(socket, port.groups[:-1]) if socket else port
    return port


def _find_identifier(sockets: Any, wanted: Any) -> Any:
    return next((socket for socket in sockets if socket.identifier == wanted.identifier), None)


def describe(node: Any) -> str:
    return f"node {node.label or node.name}"


def uses_nodes(owner: Any) -> bool:
    """Whether a material, light or world is described by its nodes."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # from Blender 6 on the property is gone, and always true
        return owner.node_tree is not None and getattr(owner, "use_nodes", True)


def give_nodes(owner: Any) -> None:
    """Makes sure that a material or world is described by nodes, as it always is from Blender 5.0 on.

    The only place that sets the property, which Blender 6.0 removes.
    """
    if not uses_nodes(owner):
        owner.use_nodes = True


def find_surface(owner: Any) -> tuple[Any, Port | None]:
    """The active output node for Cycles and what feeds its surface; None where there is no such thing."""
    output = owner.node_tree.get_output_node("CYCLES") or owner.node_tree.get_output_node("ALL")
    if output is None:
        return None, None
    source = find_source(Port(output.inputs["Surface"]))
    return output, None if source.is_value else source
