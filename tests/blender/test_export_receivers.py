"""Which pieces get a lightmap, and which on a baked copy."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blend_rooms import add_object, add_plane, make_geometry_nodes
from leaflight.addon.read.export_pieces import walk_pieces
from leaflight.addon.read.export_scene import export_scene
from leaflight.addon.read.render_levels import evaluate_for_render

pytestmark = pytest.mark.usefixtures("empty_file")


def add_modifier(obj, kind, **properties):
    modifier = obj.modifiers.new(kind, kind)
    for key, value in properties.items():
        setattr(modifier, key, value)
    return modifier


def add_instancer(collection, name="Holder"):
    return add_object(name, None, instance_type="COLLECTION", instance_collection=collection, location=(0, 0, 3))


def make_points_group(*, keep=True, instanced=None):
    """Geometry nodes that put a cube, or an object, on each vertex."""
    group = bpy.data.node_groups.new("Points", "GeometryNodeTree")
    for in_out in ("INPUT", "OUTPUT"):
        group.interface.new_socket("Geometry", in_out=in_out, socket_type="NodeSocketGeometry")
    names = ("NodeGroupInput", "NodeGroupOutput", "GeometryNodeInstanceOnPoints", "GeometryNodeJoinGeometry")
    inside, outside, points, join = (group.nodes.new(name) for name in names)
    if instanced:
        source = group.nodes.new("GeometryNodeObjectInfo")
        source.inputs["Object"].default_value = instanced
        source.inputs["As Instance"].default_value = True
        geometry = source.outputs["Geometry"]
    else:
        geometry = group.nodes.new("GeometryNodeMeshCube").outputs[0]
    group.links.new(inside.outputs[0], points.inputs["Points"])
    group.links.new(geometry, points.inputs["Instance"])
    group.links.new(points.outputs[0], join.inputs[0])
    if keep:
        group.links.new(inside.outputs[0], join.inputs[0])
    group.links.new(join.outputs[0], outside.inputs[0])
    return group


def export(**arguments):
    return export_scene(bpy.context, **arguments)


def by_name(result):
    return {exported.name: (scene_object, exported) for scene_object, exported in zip(result.snapshot.objects, result.objects, strict=True)}


def corners(result, name):
    index = list(by_name(result)).index(name)
    return result.snapshot.tri_corner[result.snapshot.tri_object == index]


def test_an_object_that_is_there_for_its_instances_is_not_told_to_have_no_faces():
    """Its nodes put out instances alone: they get the light, and nothing is left out."""
    add_modifier(add_plane("Points"), "NODES", node_group=make_points_group(keep=False))
    result = export()
    assert sum(exported.source == "Points" for exported in result.objects) == 4
    assert not [text for _, text in result.warnings if "no faces" in text]


@pytest.mark.parametrize(
    ("kind", "properties"), [("SIMPLE_DEFORM", {"angle": 0.5}), ("DISPLACE", {}), ("CAST", {}), ("WEIGHTED_NORMAL", {})]
)
def test_modifiers_that_only_move_vertices_need_no_copy(kind, properties):
    add_modifier(add_plane("Plane"), kind, **properties)
    _, exported = by_name(export())["Plane"]
    assert (exported.needs_copy, exported.n_corner, exported.n_polygon) == (False, 4, 1)


@pytest.mark.parametrize("kind", ["ARRAY", "MIRROR", "SOLIDIFY", "SUBSURF", "BEVEL", "NODES"])
def test_modifiers_that_make_faces_need_a_copy(kind):
    obj = add_plane("Fence")
    wanted = {"affect": "VERTICES"} if kind == "BEVEL" else {}
    if kind == "NODES":
        wanted["node_group"], _ = make_geometry_nodes("GeometryNodeSubdivideMesh")
    add_modifier(obj, kind, **wanted)
    result = export()
    scene_object, exported = by_name(result)["Fence"]
    assert exported.needs_copy
    assert scene_object.receives
    assert exported.reason.startswith("its modifiers change its faces; a copy")
    assert ("Fence", exported.reason) in result.warnings
    assert exported.n_corner > 4
    assert corners(result, "Fence").max() == exported.n_corner - 1


def test_only_what_wears_its_own_mesh_shares_it():
    fence = add_plane("Fence")
    add_modifier(fence, "ARRAY")
    for name in ("A", "B"):
        add_object(name, fence.data)
    assert {name: one.mesh for name, (one, _) in by_name(export()).items()} == {"A": 0, "B": 0, "Fence": -1}


def test_a_modifier_off_in_render_needs_no_copy():
    add_modifier(add_plane("Plane"), "ARRAY", show_render=False)
    assert not by_name(export())["Plane"][1].needs_copy


@pytest.mark.parametrize(
    ("kind", "properties", "has_layer", "needs_copy"),
    [
        ("SUBSURF", {"levels": 1, "render_levels": 1}, True, False),
        ("TRIANGULATE", {}, True, False),
        ("ARRAY", {}, False, True),
        ("ARRAY", {"offset_u": 1.0}, True, False),
        ("MIRROR", {}, False, True),
        ("MIRROR", {"use_mirror_u": True}, True, False),
        ("CAST", {}, True, False),
    ],
)
def test_an_existing_layer_on_a_modified_mesh(kind, properties, has_layer, needs_copy):
    obj = add_plane("Plane")
    try:
        add_modifier(obj, kind, **properties)
    except AttributeError:
        pytest.skip("this Blender's modifier has no such setting")
    add_plane("Other")
    result = export(uv_layer="UVMap")
    scene_object, exported = by_name(result)["Plane"]
    assert (scene_object.has_layer, exported.needs_copy) == (has_layer, needs_copy)
    uv = result.snapshot.tri_uv[result.snapshot.tri_object == list(by_name(result)).index("Plane")]
    if not needs_copy:
        assert (exported.n_corner, exported.n_polygon) == (4, 1)
    if kind == "SUBSURF":
        assert len(np.unique(uv.reshape(-1, 2), axis=0)) == 9
    assert bool(uv.any()) == has_layer


def test_instances_of_a_collection_are_copies():
    parts = bpy.data.collections.new("Parts")
    add_plane("Chair", parts)
    add_plane("Hidden", parts, hide_render=True)
    add_plane("Screen", parts, hide_viewport=True)
    deep = bpy.data.collections.new("Deep")
    deep.hide_render = True
    parts.children.link(deep)
    add_plane("Deep", deep)
    add_instancer(parts)
    result = export()
    assert set(by_name(result)) == {"Holder.Chair", "Holder.Screen"}
    scene_object, exported = by_name(result)["Holder.Chair"]
    assert (exported.source, exported.needs_copy, scene_object.receives, scene_object.mesh) == ("Holder", True, True, -1)
    assert result.snapshot.vertex_position[:, 2] == pytest.approx(3.0)
    assert {o.receives for o in export(objects=["Holder"]).snapshot.objects} == {True}


def test_geometry_nodes_instances_are_copies_and_hidden_sources_count():
    obj = add_plane("Points")
    hidden = add_plane("Leaf", hide_render=True)
    add_modifier(obj, "NODES", node_group=make_points_group(instanced=hidden))
    result = export()
    assert set(by_name(result)) == {"Points", "Points.Leaf", "Points.Leaf.002", "Points.Leaf.003", "Points.Leaf.004"}
    assert all(exported.needs_copy for exported in result.objects)
    assert len({exported.key for exported in result.objects}) == 5
    assert [subject for subject, _ in result.warnings] == ["Points"]


def test_too_many_instances_only_cast(monkeypatch):
    monkeypatch.setattr("leaflight.addon.read.export_receivers.MAX_INSTANCES", 3)
    add_modifier(add_plane("Points"), "NODES", node_group=make_points_group())
    result = export()
    assert {name: o.receives for name, (o, _) in by_name(result).items() if name != "Points"} == dict.fromkeys(
        ("Points.instance", "Points.instance.002", "Points.instance.003", "Points.instance.004"), False
    )
    assert not by_name(result)["Points"][1].needs_copy
    assert "4 instances" in dict(result.warnings)["Points"]


def test_what_instances_without_a_lightmap_are_made_of_has_none_either(monkeypatch):
    monkeypatch.setattr("leaflight.addon.read.export_receivers.MAX_INSTANCES", 3)
    leaf = add_plane("Leaf")
    add_modifier(add_plane("Points"), "NODES", node_group=make_points_group(instanced=leaf))
    result = export()
    assert {name for name, (o, _) in by_name(result).items() if o.receives} == {"Points"}
    assert "Points makes instances of it that get no lightmap" in dict(result.warnings)["Leaf"]
    asked = export(objects=["Leaf"])
    assert {name for name, (o, _) in by_name(asked).items() if o.receives} == {"Leaf"}
    assert "are shown with its light" in dict(asked.warnings)["Leaf"]
    monkeypatch.setattr("leaflight.addon.read.export_receivers.MAX_INSTANCES", 4)
    assert all(o.receives for o, _ in by_name(export()).values())


def test_what_particles_are_made_of_has_no_lightmap():
    emitter, leaf = add_plane("Emitter"), add_plane("Leaf")
    emitter.modifiers.new("Leaves", "PARTICLE_SYSTEM")
    settings = emitter.particle_systems[0].settings
    settings.type, settings.count, settings.render_type, settings.instance_object = "HAIR", 4, "OBJECT", leaf
    result = export()
    assert len(result.objects) == 6
    assert {name for name, (o, _) in by_name(result).items() if o.receives} == {"Emitter"}
    leaf.hide_render = True
    assert [subject for subject, _ in export().warnings] == ["Emitter"]


def test_objects_of_the_background_scene_only_cast():
    add_plane("Floor")
    behind, deeper = bpy.data.scenes.new("Set"), bpy.data.scenes.new("Deeper")
    add_plane("Wall", behind.collection)
    add_plane("Hidden", behind.collection, hide_render=True)
    add_plane("Hill", deeper.collection)
    behind.background_set = deeper
    assert set(by_name(export())) == {"Floor"}
    bpy.context.scene.background_set = behind
    result = export()
    assert {name: o.receives for name, (o, _) in by_name(result).items()} == {"Floor": True, "Hill": False, "Wall": False}
    assert sorted(subject for subject, text in result.warnings if "Background Scene" in text) == ["Hill", "Wall"]


def test_instances_on_faces_only_cast():
    parent = add_plane("Parent", instance_type="VERTS")
    child = add_plane("Child")
    child.parent = parent
    result = export()
    found = by_name(result)
    assert found["Parent"][0].receives
    assert len(found) == 5
    assert not any(o.receives for name, (o, _) in found.items() if name != "Parent")
    add_plane("Floor")
    parent.show_instancer_for_render = False
    assert "Parent" not in by_name(export())
    parent.show_instancer_for_render, parent.show_instancer_for_viewport = True, False
    assert by_name(export())["Parent"][0].receives
    assert not parent.show_instancer_for_viewport


def test_curves_and_texts_only_cast_with_one_warning():
    add_plane("Plane")
    for name in ("Title", "Sign"):
        text = bpy.data.curves.new(name, "FONT")
        text.body = "i"
        add_object(name, text)
    result = export()
    assert {name: o.receives for name, (o, _) in by_name(result).items()} == {"Plane": True, "Title": False, "Sign": False}
    assert len(result.warnings) == 1
    assert result.warnings[0][1].startswith("Sign, Title: not meshes")
    with pytest.raises(ValueError, match="Title: is a font, not a mesh"):
        export(objects=["Title"])


def test_the_piece_of_a_copy_is_found_again():
    obj = add_plane("Points")
    add_modifier(obj, "NODES", node_group=make_points_group())
    result = export()
    view_layer = bpy.context.view_layer
    with evaluate_for_render(bpy.context.scene, view_layer, []) as depsgraph:
        pieces = {piece.key: (piece.source.name, piece.matrix) for piece in walk_pieces(view_layer, depsgraph)}
    assert set(pieces) == {exported.key for exported in result.objects}
