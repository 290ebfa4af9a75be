"""Meshes of our own for what cannot carry a lightmap itself: results of modifiers, instances, and meshes that objects share.

A copy takes its source's place in a marked collection while the source is hidden; its two flags are remembered on it.
"""

from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Container, Hashable, Iterable, Sequence

import bpy
from mathutils import Matrix

from ..nodes.mesh_arrays import read_corner_vertices, read_positions
from .tags import MADE, NAME, is_made, local_objects, mark_made, remove_blocks, remove_mark, remove_unused, suffixed_name

COPIES = "leaflight_copies"  # on our collection: the copies in it; a copy that the user duplicated is not among them
SOURCE = "leaflight_source"  # on a copy: the object it stands for
HIDDEN = "leaflight_hidden"  # on a source: its two visibility flags before we hid it
SHARED_MESH = "leaflight_shared_mesh"  # on an object with a mesh of its own from us: the mesh it shared
SHAPE = "leaflight_shape"  # on that mesh: digest of its shape when we made it
MOST_ROUNDING = 1e-4  # of an object's size; more is skew
LOOK_FLAGS = ("visible_camera", "visible_diffuse", "visible_glossy", "visible_transmission", "visible_volume_scatter", "visible_shadow")


def make_copy(scene: bpy.types.Scene, source: bpy.types.Object, evaluated: bpy.types.Object, matrix: Matrix) -> bpy.types.Object:
    """A mesh object "<name>.Leaflight" with the evaluated object's mesh and materials; set_copies_visible hides the source.

    source      the object to hide; for an instance the object that makes it (inst.parent.original)
    evaluated   evaluated object, or an instance's inst.object, while the iteration stands on it
    matrix      its world matrix
    Raises ValueError with a sentence when the source cannot be hidden.
    """
    if source.library or source.override_library:
        raise ValueError(f"{source.name}: is linked from another file and cannot be hidden behind its baked copy; make it local.")
    name = suffixed_name(evaluated.name)
    mesh = bpy.data.meshes.new_from_object(evaluated)  # further arguments would evaluate the original again and lose instances' meshes
    mesh.name = name
    _take_object_materials(mesh, evaluated)
    copy = bpy.data.objects.new(name, mesh)
    mark_made(mesh)
    mark_made(copy)
    copy[SOURCE] = source
    place_copy(copy, matrix)
    for flag in LOOK_FLAGS:
        setattr(copy, flag, getattr(evaluated, flag))
    copy.color, copy.pass_index = evaluated.color, evaluated.pass_index
    _register_copy(_our_collection(scene), copy)
    return copy


def place_copy(copy: bpy.types.Object, matrix: Matrix) -> None:
    """Puts a copy with a mesh of its own where `matrix` says; what place, rotation and scale cannot hold goes into the mesh.

    Such a matrix is skewed, as that of a child which is turned below a parent of unlike scales.
    """
    copy.matrix_world = matrix
    held = copy.matrix_basis
    if not held.determinant():
        return
    rest = held.inverted() @ matrix
    if max((rest.col[k] - Matrix.Identity(4).col[k]).length for k in range(3)) > MOST_ROUNDING:
        copy.data.transform(rest)


def part_meshes(wearers: Sequence[tuple[bpy.types.Object, Hashable]], taken: Container[bpy.types.Mesh]) -> list[bpy.types.Object]:
    """Sees to it that no mesh has to hold the UVs of two layouts, and gives the objects that lost the mesh they shared.

    wearers   object, and what tells its layout from others; the one that most of a mesh's objects wear keeps it, the others get a copy each
    taken     meshes that hold the layout of another bake, and keep it
    """
    layouts: dict[bpy.types.Mesh, Counter[Hashable]] = {}
    for obj, layout in wearers:
        layouts.setdefault(obj.data, Counter())[layout] += 1
    kept = {mesh: count.most_common(1)[0][0] for mesh, count in layouts.items() if mesh not in taken}
    copies: dict[tuple[bpy.types.Mesh, Hashable], bpy.types.Mesh] = {}
    left: list[bpy.types.Object] = []
    for obj, layout in wearers:
        if obj.data in kept and layout == kept[obj.data]:
            continue
        key = (obj.data, layout)
        copies[key] = give_own_mesh(obj, copies.get(key))
        left.append(obj)
    return left


def give_own_mesh(obj: bpy.types.Object, copy: bpy.types.Mesh | None = None) -> bpy.types.Mesh:
    """Gives an object that shares its mesh a copy of it, new or one of ours, to hold other UVs; restore_shared_mesh takes it back."""
    if obj.data.users == 1 or is_made(obj.data):
        return obj.data
    shared = obj.data
    mesh = copy or _copy_mesh(shared)
    obj[SHARED_MESH] = shared
    obj.data = mesh
    return mesh


def _copy_mesh(shared: bpy.types.Mesh) -> bpy.types.Mesh:
    mesh = shared.copy()
    mesh.name = suffixed_name(shared.name)
    remove_mark(mesh, SHAPE)
    mark_made(mesh)
    mesh[SHAPE] = _shape_digest(mesh)
    return mesh


def find_users_mesh(obj: bpy.types.Object) -> bpy.types.Mesh:
    """The mesh that the user gave an object: the shared one while a copy of ours stands for it and both are alike, else its own."""
    own, shared = obj.data, obj.get(SHARED_MESH)
    if shared is None or not is_made(own):
        return own
    return shared if own.get(SHAPE) == _shape_digest(own) == _shape_digest(shared) else own


def restore_shared_mesh(obj: bpy.types.Object) -> None:
    """Gives the shared mesh back, unless the user edited the copy since: then the copy is theirs."""
    if SHARED_MESH not in obj:
        return
    own, shared = obj.data, obj[SHARED_MESH]
    remove_mark(obj, SHARED_MESH)
    if not is_made(own):
        return
    if shared is None or own.get(SHAPE) != _shape_digest(own):
        remove_mark(own, SHAPE)
        remove_mark(own, MADE)
        return
    obj.data = shared
    if own.users == 0:
        bpy.data.meshes.remove(own)


def hide_source(source: bpy.types.Object | None) -> None:
    """Hides a source from viewport and render and remembers both flags."""
    if source is None or HIDDEN in source:
        return
    source[HIDDEN] = {"viewport": source.hide_viewport, "render": source.hide_render}
    source.hide_viewport = source.hide_render = True


def unhide_sources(objects: Iterable[bpy.types.Object]) -> None:
    """Gives sources their flags again; one that the user showed meanwhile stays visible."""
    for source in local_objects(objects):
        if HIDDEN not in source:
            continue
        flags = source[HIDDEN]
        source.hide_viewport = source.hide_viewport and bool(flags["viewport"])
        source.hide_render = source.hide_render and bool(flags["render"])
        remove_mark(source, HIDDEN)


def set_copies_visible(scene: bpy.types.Scene, visible: bool) -> None:
    """Shows the copies and hides their sources, or the other way round."""
    unhide_sources(scene.objects)
    for copy in _copies(_our_collections(scene)):
        copy.hide_viewport = copy.hide_render = not visible
        if visible:
            hide_source(copy.get(SOURCE))


def find_source(obj: bpy.types.Object) -> bpy.types.Object:
    """The user's object that a copy of ours stands for; any other object is its own."""
    return obj.get(SOURCE) or obj


def remove_copies(scene: bpy.types.Scene | None = None, part: Container[bpy.types.Object] | None = None) -> bool:
    """Deletes our copies and their collection, of one scene or of all; what the user put into it, or duplicated, stays.

    Gives whether there were any: Blender 5.2 lists those as None until the view layer is updated.

    part   only the copies of these objects
    """
    collections = _our_collections(scene)
    copies = [copy for copy in _copies(collections) if part is None or find_source(copy) in part]
    meshes = {copy.data for copy in copies}
    remove_blocks(copies)
    remove_unused(meshes)
    for collection in collections:
        if _copies([collection]):
            continue
        remove_mark(collection, COPIES)
        if not collection.objects and not collection.children:
            bpy.data.collections.remove(collection)
    return bool(copies)


def _our_collections(scene: bpy.types.Scene | None) -> list[bpy.types.Collection]:
    candidates = bpy.data.collections if scene is None else scene.collection.children_recursive
    return [collection for collection in candidates if COPIES in collection and not collection.library]


def _our_collection(scene: bpy.types.Scene) -> bpy.types.Collection:
    ours = _our_collections(scene)
    if ours:
        return ours[0]
    collection = bpy.data.collections.new(NAME)
    mark_made(collection)
    collection[COPIES] = {}
    scene.collection.children.link(collection)
    return collection


def _register_copy(collection: bpy.types.Collection, copy: bpy.types.Object) -> None:
    registry = collection[COPIES]
    registry[str(len(registry))] = copy
    collection.objects.link(copy)


def _copies(collections: list[bpy.types.Collection]) -> list[bpy.types.Object]:
    """The copies that are left; a deleted one reads as None."""
    return [copy for collection in collections for copy in collection[COPIES].to_dict().values() if copy is not None]


def _take_object_materials(mesh: bpy.types.Mesh, evaluated: bpy.types.Object) -> None:
    """Slots linked to the object hold their material there, not on the mesh."""
    for index, slot in enumerate(evaluated.material_slots):
        if slot.link == "OBJECT" and index < len(mesh.materials):
            mesh.materials[index] = slot.material.original if slot.material else None


def _shape_digest(mesh: bpy.types.Mesh) -> str:
    return f"{zlib.crc32(read_corner_vertices(mesh), zlib.crc32(read_positions(mesh))):08x}"
