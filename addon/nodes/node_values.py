"""Values of nodes, modifiers and lights as plain Python values that are printed alike as long as they are alike."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import bpy

# Of nodes, modifiers and lights: what the editors show, and levels of the viewport.
_NOT_READ = {
    "rna_type",
    "name",
    "levels",
    "show_on_cage",
    "show_only_control_edges",
    "use_nodes",
    "preview_render_type",
    "is_active_output",
    "node_warnings",
    "panels",
    "bakes",
    "point_cache",
}
_NESTED = 7  # structs and lists in one another that are looked into: the location of a curve mapping's points is the deepest


def list_nodes(tree: bpy.types.NodeTree, depth: int = 0) -> Any:
    nodes = []
    for node in tree.nodes:
        values = [
            read_value(one.default_value, 0) for one in (*node.inputs, *node.outputs) if hasattr(one, "default_value") and not one.is_linked
        ]
        group = getattr(node, "node_tree", None)
        inner = list_nodes(group, depth + 1) if group and depth < 20 else ""
        nodes.append((node.name, node.bl_idname, node.mute, values, list_values(node, list_own_names(node, bpy.types.Node)), inner))
    links = [(a.from_node.name, a.from_socket.identifier, a.to_node.name, a.to_socket.identifier, a.is_muted) for a in tree.links]
    return (sorted(nodes, key=lambda row: row[0]), sorted(links))


def list_own_names(struct: Any, base: type | None = None) -> list[str]:
    """Names of the properties of a struct that are its own and that a user sets."""
    known = {about.identifier for about in (base or bpy.types.ID).bl_rna.properties} | _NOT_READ
    own = [about for about in struct.bl_rna.properties if about.identifier not in known]
    return [about.identifier for about in own if not about.is_readonly or about.type in ("POINTER", "COLLECTION")]


def list_values(struct: Any, names: Iterable[str], depth: int = 0) -> list[Any]:
    return [(name, read_value(getattr(struct, name, None), depth)) for name in names]


def read_value(value: Any, depth: int) -> Any:
    """Something that is printed alike as long as it is alike."""
    if isinstance(value, float):
        return f"{value:.6g}"
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, (set, frozenset)):
        return sorted(value)
    if isinstance(value, bpy.types.Image):
        file = value.filepath.replace("\\", "/").rpartition("/")[2]  # Blender changes the folder when the .blend is saved elsewhere
        return (value.name_full, file, value.source, value.colorspace_settings.name, value.is_dirty)
    if isinstance(value, bpy.types.ID):
        return value.name_full
    if isinstance(value, bpy.types.bpy_struct):
        if depth >= _NESTED or isinstance(value, (bpy.types.Node, bpy.types.NodeSocket)):
            return ""
        return list_values(value, [about.identifier for about in value.bl_rna.properties if about.identifier not in _NOT_READ], depth + 1)
    if depth < _NESTED and hasattr(value, "__len__") and hasattr(value, "__getitem__"):
        return [read_value(one, depth + 1) for one in value] if len(value) < 1000 else len(value)
    return ""
