"""What of a scene a bake depends on, as a digest for each object, material and world: two sets of them tell what has changed.

A print is the same whether the scene shows a bake or not, after it was saved and opened again, and after an undo.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field
from typing import Any

import bpy
import numpy as np

from ..nodes.mesh_arrays import read_corner_vertices, read_faces, read_positions
from ..nodes.node_values import list_nodes, list_own_names, list_values, read_value
from ..read import baked_copies
from ..read.light_linking import list_linked
from ..read.object_settings import IGNORE, read_choice
from ..read.render_levels import find_render_objects
from ..read.tags import find_original
from ..read.uv_layer import layer_name

Prints = dict[str, str]  # "OBJECT Lamp", "MATERIAL Wall" or "WORLD World" -> digest

PRINTS = "leaflight_prints"  # on a scene that wears a bake: Baked, as JSON

_UNSEEN = {"CAMERA", "SPEAKER", "LIGHT_PROBE", "ARMATURE", "LATTICE"}  # what they move is printed with what they move
_LOOKS = ("visible_diffuse", "visible_glossy", "visible_transmission", "visible_shadow", "instance_type", "show_instancer_for_render")
_NAMED = 3  # of what has changed, in one line


@dataclass(frozen=True)
class Baked:
    """What a scene was like when it was baked.

    prints   at the last bake
    older    names of what had changed then since the bake that other objects wear, which were not part of the last one
    blender  the version that made the prints: another gives lamps and nodes of the same scene other properties
    """

    prints: Prints
    older: tuple[str, ...] = ()
    blender: str = field(default_factory=lambda: "{}.{}".format(*bpy.app.version))

    @property
    def is_comparable(self) -> bool:
        """Whether this Blender made the prints."""
        return self.blender == Baked({}).blender

    def list_changes(self, now: Prints) -> list[str]:
        """Names of what has changed since; none where that is not known."""
        return list_changes(self.prints, now) if self.is_comparable else []


def mark_prints(scene: bpy.types.Scene, baked: Baked) -> None:
    """Remember what the scene was like."""
    scene[PRINTS] = json.dumps(asdict(baked))


def read_marked(scene: bpy.types.Scene) -> Baked | None:
    """What the scene was like; None where nothing is known, as of a bake by an earlier version."""
    try:
        kept = json.loads(scene[PRINTS]) if PRINTS in scene else None
        if not kept:
            return None
        prints = {str(key): str(value) for key, value in kept["prints"].items()}
        return Baked(prints, tuple(kept["older"]), str(kept.get("blender", "")))
    except (ValueError, KeyError, TypeError, AttributeError):
        return None


def describe_changes(names: Iterable[str]) -> str:
    """The start of a sentence."""
    names = list(names)
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return f"Changed since this bake: {', '.join(names[:_NAMED])}{more}"


def print_scene(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer, meshes: dict[int, str] | None = None) -> Prints:
    """Prints of all that a render of the view layer shows.

    meshes   digests that are known already, by the mesh's session_uid; those that are made are added
    """
    prints: Prints = {}
    for name, digest in walk_prints(scene, view_layer, {} if meshes is None else meshes):
        prints[name] = digest
    return prints


def walk_prints(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer, meshes: dict[int, str]) -> Iterator[tuple[str, str]]:
    """The prints one by one; nothing may change in between."""
    rendered = find_render_objects(view_layer)
    materials: dict[str, bpy.types.Material] = {}
    pending, seen = list(view_layer.objects), set()
    while pending:
        obj = pending.pop()
        hidden = obj.get(baked_copies.HIDDEN)  # behind a copy of ours
        if obj in seen or baked_copies.SOURCE in obj or not (obj in rendered or (hidden and not hidden["render"])):
            continue
        seen.add(obj)
        if obj.type in _UNSEEN or (obj.type == "EMPTY" and obj.instance_type != "COLLECTION") or read_choice(obj).role == IGNORE:
            continue
        worn = [material for slot in obj.material_slots if (material := find_original(slot.material))]
        materials.update((material.name_full, material) for material in worn)
        yield f"OBJECT {obj.name_full}", _digest(_read_object(obj, meshes))
        if obj.instance_type == "COLLECTION" and obj.instance_collection:
            parts = [part for part in obj.instance_collection.all_objects if not part.hide_render]
            rendered |= set(parts)
            pending += parts
    for name, material in materials.items():
        yield f"MATERIAL {name}", _digest(_read_material(material))
    if scene.world:
        yield f"WORLD {scene.world.name_full}", _digest((list_values(scene.world, list_own_names(scene.world)), _read_tree(scene.world)))


def list_changes(before: Prints, now: Prints) -> list[str]:
    """Names of what has changed, is new or is gone, objects first; each once."""
    found: dict[str, None] = {}
    for key in sorted(before.keys() | now.keys(), key=lambda key: (not key.startswith("OBJECT"), key)):
        if before.get(key) != now.get(key):
            name = key.partition(" ")[2]
            found[name if key in before and key in now else f"{name} ({'new' if key in now else 'gone'})"] = None
    return list(found)


def _digest(values: Any) -> str:
    return f"{zlib.crc32(repr(values).encode()):08x}"


def _read_object(obj: bpy.types.Object, meshes: dict[int, str]) -> tuple[Any, ...]:
    choice = read_choice(obj)
    place = _read_place(obj)
    slots = [material.name_full if (material := find_original(slot.material)) else "" for slot in obj.material_slots]
    while slots and not slots[-1]:  # a bake that is shown gives a mesh without slots one
        slots.pop()
    modifiers = [
        (modifier.type, modifier.show_render, _read_modifier(modifier), _read_place(getattr(modifier, "object", None)))
        for modifier in obj.modifiers
    ]
    looks: list[Any] = [getattr(obj, name) for name in _LOOKS]
    looks.append(list_linked(obj))
    return (obj.type, place, looks, slots, modifiers, choice, _read_data(obj, meshes))


def _read_place(obj: bpy.types.Object | None, depth: int = 0) -> list[Any]:
    """Where an object is, from what it was given: Blender does not evaluate one that is hidden behind a copy of ours."""
    if obj is None or depth > 100:
        return []
    own = [read_value(obj.matrix_basis, 0), read_value(obj.delta_location, 0), read_value(obj.delta_scale, 0)]
    if obj.type == "LIGHT" and obj.data.type == "SUN" and not obj.constraints:  # its light is the same wherever it stands
        own = [read_value(obj.matrix_basis.to_3x3(), 0)]
    pose = [read_value(bone.matrix_basis, 0) for bone in obj.pose.bones] if obj.pose else []
    rules = []
    for rule in obj.constraints:
        names = list_own_names(rule, bpy.types.Constraint)
        rules.append(
            (rule.type, rule.mute, rule.influence, list_values(rule, names), _read_place(getattr(rule, "target", None), depth + 1))
        )
    parent = (
        [obj.parent_type, obj.parent_bone, read_value(obj.matrix_parent_inverse, 0), _read_place(obj.parent, depth + 1)]
        if obj.parent
        else []
    )
    return [own, pose, rules, parent]


def _read_data(obj: bpy.types.Object, meshes: dict[int, str]) -> Any:
    if obj.type == "MESH":
        mesh = baked_copies.find_users_mesh(obj)
        if mesh.session_uid not in meshes:
            meshes[mesh.session_uid] = _digest_mesh(mesh)
        return meshes[mesh.session_uid]
    if obj.type == "LIGHT":
        return (list_values(obj.data, list_own_names(obj.data)), _read_tree(obj.data))
    collection = obj.instance_collection.name_full if obj.instance_type == "COLLECTION" and obj.instance_collection else ""
    return (collection, [[f"{number:.5g}" for number in corner] for corner in obj.bound_box]) if obj.data else collection


def _digest_mesh(mesh: bpy.types.Mesh) -> str:
    ours, render = layer_name(mesh), next((layer.name for layer in mesh.uv_layers if layer.active_render), "")
    start = np.empty(len(mesh.polygons), np.int32)
    mesh.polygons.foreach_get("loop_start", start)
    arrays: list[Any] = [read_positions(mesh), read_corner_vertices(mesh), start, read_faces(mesh, "material_index", np.int32)]
    for layer in mesh.uv_layers:
        if layer.name != ours:
            arrays.append(np.empty(2 * len(layer.uv), np.float32))
            layer.uv.foreach_get("vector", arrays[-1])
    for layer in mesh.color_attributes:
        arrays.append(np.empty(4 * len(layer.data), np.float32))
        layer.data.foreach_get("color", arrays[-1])
    names = [layer.name for layer in mesh.uv_layers if layer.name != ours]
    about = (names, "" if render == ours else render, [layer.name for layer in mesh.color_attributes])
    crc = zlib.crc32(repr(about).encode())
    for array in arrays:
        crc = zlib.crc32(array, crc)
    return f"{crc:08x}"


def _read_modifier(modifier: bpy.types.Modifier) -> Any:
    names = list_own_names(modifier, bpy.types.Modifier)
    return (
        list_values(modifier, names),
        _read_inputs(modifier, names) if modifier.type == "NODES" else [],
        list_nodes(modifier.node_group) if modifier.type == "NODES" and modifier.node_group else "",
    )


def _read_inputs(modifier: Any, names: list[str]) -> Any:
    """What a Geometry Nodes modifier is given; Blender 5.3 has no custom properties for it any more."""
    if not hasattr(modifier, "properties"):
        return [(key, read_value(modifier[key], 0)) for key in sorted(set(modifier.keys()) - set(names))]
    if modifier.properties is None:  # without a node group
        return []
    inputs = modifier.properties.inputs
    keys = [about.identifier for about in inputs.bl_rna.properties if about.identifier.startswith("Socket_")]
    asked = ("type", "value", "attribute_name")
    return [(key, [read_value(getattr(getattr(inputs, key), name, None), 0) for name in asked]) for key in keys]


def _read_material(material: bpy.types.Material) -> Any:
    plain = ([f"{number:.5g}" for number in material.diffuse_color], material.use_backface_culling)
    return _read_tree(material) or plain


def _read_tree(block: Any) -> Any:
    """Nodes of a material, world or light; None where they do not count."""
    if bpy.app.version < (5, 0, 0) and not getattr(block, "use_nodes", False):
        return None
    tree = getattr(block, "node_tree", None)
    return list_nodes(tree) if tree else None
