"""Copies that stand for what cannot carry a lightmap, and meshes that objects no longer share."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blend_rooms import add_copy, add_object
from leaflight.addon.read import baked_copies, uv_layer
from leaflight.addon.show import images, materials_write, restore

pytestmark = pytest.mark.usefixtures("empty_file")


def make_mesh(name, material=None):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [], [(0, 1, 2, 3)])
    mesh.uv_layers.new(name="UVMap")
    mesh.materials.append(material or bpy.data.materials.new(f"{name} paint"))
    return mesh


def block_names():
    kinds = ("objects", "meshes", "materials", "images", "collections", "curves")
    return {kind: [(block.name, block.users, list(block.keys())) for block in getattr(bpy.data, kind)] for kind in kinds}


def visible_meshes():
    depsgraph = bpy.context.evaluated_depsgraph_get()
    return sorted(
        (i.object.name, tuple(round(x, 3) for x in i.matrix_world.translation)) for i in depsgraph.object_instances if i.object.data
    )


def copy_evaluated(obj):
    depsgraph = bpy.context.evaluated_depsgraph_get()
    copy = baked_copies.make_copy(bpy.context.scene, obj, obj.evaluated_get(depsgraph), obj.matrix_world)
    baked_copies.set_copies_visible(bpy.context.scene, True)
    return copy


def world_corners(obj):
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    return np.array([evaluated.matrix_world @ evaluated.data.vertices[loop.vertex_index].co for loop in evaluated.data.loops])


def show_bake(obj):
    uv_layer.write_layer(obj.data, np.zeros((len(obj.data.loops), 2)))
    return materials_write.assign([(obj, images.preview_image("page", 2, 2))])


def test_modifier_result_takes_the_sources_place():
    source = add_object("Fence", make_mesh("Fence"))
    source.modifiers.new("Array", "ARRAY").count = 3
    source.location.x = 5
    bpy.context.view_layer.update()
    before = block_names()
    copy = copy_evaluated(source)
    assert copy.name == "Fence.Leaflight"
    assert len(copy.data.polygons) == 3
    assert copy.matrix_world == source.matrix_world
    assert copy.material_slots[0].material == source.material_slots[0].material
    assert visible_meshes() == [("Fence.Leaflight", (5, 0, 0))]
    assert source.hide_render
    assert show_bake(copy) == []
    restore.remove_bake()
    assert block_names() == before
    assert visible_meshes() == [("Fence", (5, 0, 0))]
    assert not source.hide_render


def test_object_level_materials_and_flags_are_the_copys():
    paint = bpy.data.materials.new("Object paint")
    source = add_object("Fence", make_mesh("Fence"))
    source.material_slots[0].link = "OBJECT"
    source.material_slots[0].material = paint
    source.modifiers.new("Array", "ARRAY")
    source.visible_camera = False
    copy = copy_evaluated(source)
    assert copy.material_slots[0].material == paint
    assert not copy.visible_camera


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_skewed_object_is_copied_as_it_stands(mirrored):
    parent, source = add_object("Stretched", None), add_object("Fence", make_mesh("Fence"))
    parent.scale = (-3.0 if mirrored else 3.0, 1.0, 0.5)
    source.parent, source.rotation_euler, source.location = parent, (0.4, 0.3, 0.7), (1.0, 2.0, 3.0)
    source.modifiers.new("Array", "ARRAY").count = 2
    bpy.context.view_layer.update()
    before = world_corners(source)
    copy = copy_evaluated(source)
    bpy.context.view_layer.update()
    np.testing.assert_allclose(world_corners(copy), before, atol=1e-5)
    assert source.data.vertices[2].co.to_tuple() == (1.0, 1.0, 0.0)


def test_each_instance_of_a_collection_gets_a_copy():
    collection = bpy.data.collections.new("Chair")
    chair = add_object("Chair", make_mesh("Chair"), collection)
    empties = []
    for x in (1.0, 2.0):
        empty = add_object(f"Seat{x:.0f}", None)
        empty.instance_type, empty.instance_collection, empty.location.x = "COLLECTION", collection, x
        empties.append(empty)
    bpy.context.view_layer.update()
    before = visible_meshes()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    found = [(i.parent.original, i.object.original, i.matrix_world.copy()) for i in depsgraph.object_instances if i.is_instance]
    copies = [baked_copies.make_copy(bpy.context.scene, p, o.evaluated_get(depsgraph), m) for p, o, m in found]
    baked_copies.set_copies_visible(bpy.context.scene, True)
    assert [name for name, _ in visible_meshes()] == ["Chair.Leaflight", "Chair.Leaflight.001"]
    assert [place for _, place in visible_meshes()] == [place for _, place in before]
    assert len({copy.data for copy in copies}) == 2
    restore.remove_bake()
    assert visible_meshes() == before
    assert [chair.name, *sorted(empty.name for empty in empties)] == sorted(obj.name for obj in bpy.data.objects)


def test_geometry_nodes_instances_are_copied_while_iterating():
    source = add_object("Scatter", make_mesh("Scatter"))
    group = bpy.data.node_groups.new("Scatter", "GeometryNodeTree")
    group.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    group.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    start, end = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    instance, cube, paint = (group.nodes.new(f"GeometryNode{kind}") for kind in ("InstanceOnPoints", "MeshCube", "SetMaterial"))
    paint.inputs["Material"].default_value = bpy.data.materials.new("Instance paint")
    group.links.new(instance.inputs["Points"], start.outputs[0])
    group.links.new(paint.inputs["Geometry"], cube.outputs["Mesh"])
    group.links.new(instance.inputs["Instance"], paint.outputs["Geometry"])
    group.links.new(end.inputs[0], instance.outputs["Instances"])
    source.modifiers.new("Scatter", "NODES").node_group = group
    depsgraph = bpy.context.evaluated_depsgraph_get()
    before, names = visible_meshes(), block_names()
    copies = [
        baked_copies.make_copy(bpy.context.scene, i.parent.original, i.object, i.matrix_world)
        for i in depsgraph.object_instances
        if i.is_instance
    ]
    baked_copies.set_copies_visible(bpy.context.scene, True)
    assert [len(copy.data.polygons) for copy in copies] == [6] * 4
    assert {copy.data.materials[face.material_index].name for copy in copies for face in copy.data.polygons} == {"Instance paint"}
    assert visible_meshes() == sorted((copy.name, tuple(copy.matrix_world.translation)) for copy in copies)
    assert all(show_bake(copy) == [] for copy in copies)
    restore.remove_bake()
    assert (visible_meshes(), block_names()) == (before, names)


def test_curve_becomes_a_mesh_copy():
    curve = bpy.data.curves.new("Pipe", "CURVE")
    curve.dimensions, curve.bevel_depth = "3D", 0.1
    curve.splines.new("POLY").points.add(1)
    curve.splines[0].points[1].co = (1, 0, 0, 1)
    before = block_names()
    source = add_object("Pipe", curve)
    copy = copy_evaluated(source)
    assert copy.type == "MESH"
    assert len(copy.data.polygons) > 3
    restore.remove_bake()
    bpy.data.objects.remove(source)
    assert block_names()["meshes"] == before["meshes"]


@pytest.mark.parametrize("flags", [(False, True), (True, False)])
def test_both_visibility_flags_return(flags):
    source = add_object("Fence", make_mesh("Fence"))
    depsgraph = bpy.context.evaluated_depsgraph_get()
    source.hide_viewport, source.hide_render = flags
    baked_copies.make_copy(bpy.context.scene, source, source.evaluated_get(depsgraph), source.matrix_world)
    for on in (False, True, False, True):
        restore.toggle_preview(bpy.context.scene, on)
        assert (source.hide_viewport, source.hide_render) == ((True, True) if on else flags)
    restore.remove_bake()
    assert (source.hide_viewport, source.hide_render) == flags


def test_users_duplicate_of_a_copy_and_guests_in_our_collection_stay():
    source = add_object("Fence", make_mesh("Fence"))
    paint = source.material_slots[0].material
    copy = copy_evaluated(source)
    show_bake(copy)
    duplicate = copy.copy()
    duplicate.data = copy.data.copy()
    collection = copy.users_collection[0]
    collection.objects.link(duplicate)
    twin = add_copy(source)
    restore.remove_bake()
    assert sorted(obj.name for obj in bpy.data.objects) == ["Fence", "Fence.001", "Fence.Leaflight.001"]
    assert duplicate.material_slots[0].material == paint
    assert [layer.name for layer in duplicate.data.uv_layers] == ["UVMap"]
    assert not twin.hide_viewport
    assert [list(block.keys()) for block in (*bpy.data.objects, *bpy.data.meshes, collection)] == [[]] * 6


def test_user_deleted_the_source_or_the_copy():
    for delete in ("Fence", "Fence.Leaflight"):
        source = add_object("Fence", make_mesh("Fence"))
        copy_evaluated(source)
        bpy.data.objects.remove(bpy.data.objects[delete])
        restore.toggle_preview(bpy.context.scene, False)
        restore.toggle_preview(bpy.context.scene, True)
        restore.remove_bake()
        assert [obj.name for obj in bpy.data.objects] == ([] if delete == "Fence" else ["Fence"])
        assert not any(obj.hide_render for obj in bpy.data.objects)


def test_linked_source_is_refused_with_a_sentence(tmp_path):
    source = add_object("Fence", make_mesh("Fence"))
    bpy.data.libraries.write(str(tmp_path / "library.blend"), {source})
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (_, target):
        target.objects = ["Fence"]
    bpy.context.scene.collection.objects.link(target.objects[0])
    with pytest.raises(ValueError, match=r"Fence: is linked from another file"):
        copy_evaluated(target.objects[0])


def test_linked_duplicates_get_meshes_of_their_own_and_share_again():
    mesh = make_mesh("Chair")
    objects = [add_object(name, mesh) for name in ("A", "B", "C")]
    before = block_names()
    assert len({baked_copies.give_own_mesh(obj) for obj in objects}) == 3
    for obj in objects:
        assert show_bake(obj) == []
        baked_copies.give_own_mesh(obj)
    assert len({obj.data for obj in objects}) == 3
    restore.remove_bake()
    assert {obj.data for obj in objects} == {mesh}
    assert block_names() == before


@pytest.mark.parametrize("edited", ["", "copy", "shared", "gone"])
def test_the_users_mesh_is_the_shared_one_while_the_copy_is_like_it(edited):
    shared = make_mesh("Chair")
    objects = [add_object(name, shared) for name in ("A", "B")]
    own = baked_copies.give_own_mesh(objects[0])
    if edited == "gone":
        bpy.data.meshes.remove(shared)
    elif edited:
        (own if edited == "copy" else shared).vertices[0].co.z = 1.0
    assert baked_copies.find_users_mesh(objects[0]) == (own if edited else shared)
    if edited != "gone":
        assert baked_copies.find_users_mesh(objects[1]) == shared


def test_own_mesh_that_the_user_edited_becomes_theirs():
    mesh = make_mesh("Chair")
    objects = [add_object(name, mesh) for name in ("A", "B")]
    own = baked_copies.give_own_mesh(objects[0])
    show_bake(objects[0])
    own.vertices[0].co.z = 1
    restore.remove_bake()
    assert objects[0].data == own
    assert [layer.name for layer in own.uv_layers] == ["UVMap"]
    assert list(own.keys()) == []
    assert own.materials[0] == mesh.materials[0] == objects[0].material_slots[0].material
