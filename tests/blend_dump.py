"""All of an open .blend as plain values, to compare before and after."""

import json
import zlib

import bpy
import numpy as np

BLOCKS = ("objects", "meshes", "materials", "images", "collections", "scenes", "node_groups", "lights", "worlds", "textures", "actions")
# changes with every session, or when the viewport evaluates
VOLATILE = {"session_uid", "is_updated", "is_updated_data", "is_evaluated", "has_data", "is_dirty", "is_runtime_data", "bindcode"}
VOLATILE |= {"is_library_indirect"}  # of another file's data-blocks: found anew with every save


def rna_values(struct):
    """All of a struct's own values; pointers to data-blocks as their names."""
    values = {}
    for prop in struct.bl_rna.properties:
        name = prop.identifier
        if name in VOLATILE or prop.type == "COLLECTION":
            continue
        value = getattr(struct, name)
        if prop.type == "POINTER":
            if isinstance(value, bpy.types.ID):
                values[name] = value.name
        elif getattr(prop, "is_array", False):
            if name != "pixels":
                values[name] = np.array(value).ravel().tolist()
        else:
            values[name] = sorted(value) if isinstance(value, set) else value
    return values


def dump_tree(tree):
    nodes = {}
    for node in tree.nodes:
        inputs = [[socket.identifier, rna_values(socket).get("default_value")] for socket in node.inputs]
        nodes[node.name] = [rna_values(node), inputs, sorted(node.keys())]
    links = sorted([li.from_node.name, li.from_socket.identifier, li.to_node.name, li.to_socket.identifier] for li in tree.links)
    return [nodes, links]


def dump_object(obj):
    slots = []
    for slot in obj.material_slots:
        link = slot.link
        slot.link = "OBJECT"
        at_object = slot.material.name if slot.material else None
        slot.link = link
        slots.append([link, slot.material.name if slot.material else None, at_object])
    return [slots, [rna_values(modifier) for modifier in obj.modifiers], sorted(c.name for c in obj.users_collection)]


def dump_mesh(mesh):
    attributes = {}
    for attribute in mesh.attributes:
        kind = {"FLOAT_VECTOR": ("vector", 3, "f4"), "FLOAT2": ("vector", 2, "f4"), "INT": ("value", 1, "i4")}.get(attribute.data_type)
        content = ""
        if kind:
            content = np.empty(len(attribute.data) * kind[1], kind[2])
            attribute.data.foreach_get(kind[0], content)
            content = zlib.crc32(content.tobytes())
        attributes[attribute.name] = [attribute.data_type, attribute.domain, content]
    layers = [[layer.name, layer.active, layer.active_render] for layer in mesh.uv_layers]
    return [[m.name if m else None for m in mesh.materials], layers, attributes]


def plain(value):
    """A custom property without addresses."""
    if isinstance(value, bpy.types.ID):
        return value.name
    return {key: plain(entry) for key, entry in value.items()} if hasattr(value, "items") else str(value)


def dump():
    """Everything in the file, as plain values."""
    special = {"objects": dump_object, "meshes": dump_mesh}
    result = {}
    for kind in BLOCKS:
        for block in getattr(bpy.data, kind):
            entry = [rna_values(block), {key: plain(block[key]) for key in block.keys() if key != "cycles"}]  # noqa: SIM118
            if kind in special:
                entry.append(special[kind](block))
            if getattr(block, "node_tree", None) and kind == "materials":
                entry.append(dump_tree(block.node_tree))
            if kind == "collections":
                entry.append(sorted(obj.name for obj in block.objects))
            result[f"{kind}/{block.name}"] = entry
    return json.loads(json.dumps(result, default=str))


def differences(before, after):
    """Readable list of what differs; [] when nothing does."""
    missing = [f"missing {key}" for key in before if key not in after]
    extra = [f"extra {key}" for key in after if key not in before]
    changed = []
    for key in before.keys() & after.keys():
        for old, new in zip(before[key], after[key], strict=True):
            if isinstance(old, dict):
                changed += [f"{key}.{name}: {old.get(name)!r} -> {new.get(name)!r}" for name in old | new if old.get(name) != new.get(name)]
            elif old != new:
                changed.append(f"{key}: {old} -> {new}")
    return missing + extra + changed
