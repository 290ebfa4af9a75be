"""Attributes of objects and meshes that materials read: found as Cycles shows them."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blend_nodes import add_glow, render_from_above
from blend_rooms import add_copy, add_object
from leaflight.addon.nodes.socket_bake import SocketBaker
from leaflight.addon.read.export_mesh import read_mesh
from leaflight.addon.read.export_scene import export_scene
from leaflight.addon.read.mesh_attributes import list_wanted_attributes
from leaflight.core.scene.materials import SurfaceMaterials

pytestmark = pytest.mark.usefixtures("empty_file")


# Properties of objects that materials show: as a render with Cycles shows them.
def show_property(kind="OBJECT", name="x", output="Color", node_type="ShaderNodeAttribute"):
    """A square that shines with what the node gives."""
    mesh = bpy.data.meshes.new("Square")
    mesh.from_pydata([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], [], [(0, 1, 2, 3)])
    obj = add_object("Square", mesh)
    tree, color = add_glow(mesh)
    node = tree.nodes.new(node_type)
    if node_type == "ShaderNodeAttribute":
        node.attribute_type, node.attribute_name = kind, name
    source = node.outputs[2] if output == "Fac" else node.outputs[output]  # its name differs between versions
    tree.links.new(source, color)
    return obj


def instance(obj):
    """Only an instance of the object is left in the scene; gives what makes it."""
    parts, holder = bpy.data.collections.new("Parts"), bpy.data.objects.new("Holder", None)
    bpy.context.scene.collection.objects.unlink(obj)
    parts.objects.link(obj)
    holder.instance_type, holder.instance_collection = "COLLECTION", parts
    bpy.context.scene.collection.objects.link(holder)
    return holder


def read_glow():
    """By object: what it shines with; and what is told of the material."""
    result = export_scene(bpy.context)
    snapshot = result.snapshot
    tri = np.array([np.flatnonzero(snapshot.tri_object == i)[0] for i in range(len(snapshot.objects))])
    glow = SurfaceMaterials(snapshot).emission.at(tri, np.full(len(tri), 0.3, np.float32), np.full(len(tri), 0.3, np.float32))
    return dict(zip([one.name for one in snapshot.objects], glow.tolist(), strict=True)), dict(result.warnings).get("Glow", "")


def render_glow(folder):
    """What Cycles shows."""
    return render_from_above(folder, 4)[0, 0]


BLUE = (0.2, 0.5, 0.8, 0.25)


@pytest.mark.parametrize(
    ("value", "output", "expected"),
    [
        (0.3, "Color", (0.3, 0.3, 0.3)),
        (2, "Color", (2.0, 2.0, 2.0)),
        (True, "Color", (1.0, 1.0, 1.0)),
        (BLUE[:3], "Color", BLUE[:3]),
        (BLUE[:2], "Color", (0.2, 0.5, 0.0)),
        (BLUE, "Vector", BLUE[:3]),
        (BLUE, "Alpha", (0.25, 0.25, 0.25)),
        (BLUE, "Fac", (0.5, 0.5, 0.5)),
        (0.3, "Alpha", (1.0, 1.0, 1.0)),
    ],
)
def test_numbers_are_shown_as_cycles_shows_them(value, output, expected, tmp_path):
    show_property(output=output)["x"] = value
    glow, told = read_glow()
    assert glow["Square"] == pytest.approx(expected, rel=1e-6)
    assert told == ""
    assert render_glow(tmp_path) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("name", ["x", "y", "nothing", "location[1]"])
def test_where_there_is_no_number_it_is_black(name, tmp_path):
    obj = show_property(name=name)
    obj["x"], obj["y"], obj.location = "a word", (0.1, 0.2, 0.3, 0.4, 0.5), (0.0, 0.1, 0.0)
    glow, told = read_glow()
    assert glow["Square"] == [0.0, 0.0, 0.0]
    assert f"Square has no property {name} of numbers, so it is black there, as in Blender" in told
    assert not any(render_glow(tmp_path))


@pytest.mark.parametrize(("name", "expected"), [("color", BLUE[:3]), ('["x"]', (0.3,) * 3), ("pass_index", (3.0,) * 3), ("y", (0.4,) * 3)])
def test_blenders_own_properties_are_found_by_their_path_and_the_meshs_too(name, expected, tmp_path):
    obj = show_property(name=name)
    obj.color, obj["x"], obj.pass_index, obj.data["y"], obj.data["x"] = BLUE, 0.3, 3, 0.4, 0.9
    assert read_glow()[0]["Square"] == pytest.approx(expected, rel=1e-6)
    assert render_glow(tmp_path) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize(
    ("kind", "own", "holders", "expected"),
    [("OBJECT", 0.3, 0.7, 0.3), ("OBJECT", None, 0.7, 0.0), ("INSTANCER", 0.3, 0.7, 0.7), ("INSTANCER", 0.3, None, 0.3)],
)
def test_an_instance_may_ask_what_makes_it(kind, own, holders, expected, tmp_path):
    obj = show_property(kind)
    holder = instance(obj)
    for block, value in ((obj, own), (holder, holders)):
        if value is not None:
            block["x"] = value
    assert read_glow()[0]["Holder.Square"] == pytest.approx([expected] * 3, rel=1e-6)
    assert render_glow(tmp_path) == pytest.approx([expected] * 3, rel=1e-5)


@pytest.mark.parametrize(("is_instance", "expected"), [(False, BLUE[:3]), (True, (0.9, 0.1, 0.1))])
def test_the_colour_of_object_info_is_the_viewports(is_instance, expected, tmp_path):
    obj = show_property(node_type="ShaderNodeObjectInfo")
    obj.color = BLUE
    if is_instance:
        instance(obj).color = (0.9, 0.1, 0.1, 1.0)
    (glow,) = read_glow()[0].values()
    assert glow == pytest.approx(expected, rel=1e-6)
    assert render_glow(tmp_path) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("numbered", [False, True])
def test_what_geometry_nodes_give_their_instances_is_read(numbered):
    """Each instance glows as a third of its number; with ids of their own, which the instances are known by, as well."""
    obj = show_property("INSTANCER")
    group = bpy.data.node_groups.new("Scatter", "GeometryNodeTree")
    group.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    kinds = ("NodeGroupOutput", "GeometryNodeMeshLine", "GeometryNodeObjectInfo", "GeometryNodeInstanceOnPoints")
    end, line, info, scatter = (group.nodes.new(kind) for kind in kinds)
    info.inputs["Object"].default_value, line.inputs["Count"].default_value = obj, 3
    third, store, number, own = (
        group.nodes.new(kind)
        for kind in ("ShaderNodeMath", "GeometryNodeStoreNamedAttribute", "GeometryNodeInputIndex", "GeometryNodeSetID")
    )
    third.operation, third.inputs[1].default_value = "DIVIDE", 3.0
    store.domain, store.inputs["Name"].default_value = "INSTANCE", "x"
    group.links.new(line.outputs[0], own.inputs[0])
    if numbered:
        shifted = group.nodes.new("ShaderNodeMath")
        shifted.inputs[1].default_value = 5.0
        group.links.new(number.outputs[0], shifted.inputs[0])
        group.links.new(shifted.outputs[0], own.inputs["ID"])
    group.links.new((own if numbered else line).outputs[0], scatter.inputs["Points"])
    group.links.new(info.outputs["Geometry"], scatter.inputs["Instance"])
    group.links.new(number.outputs[0], third.inputs[0])
    group.links.new(scatter.outputs[0], store.inputs[0])
    group.links.new(third.outputs[0], next(one for one in store.inputs if one.name == "Value" and one.enabled))
    group.links.new(store.outputs[0], end.inputs[0])
    holder = add_object("Holder", bpy.data.meshes.new("Nothing"))
    holder.modifiers.new("Scatter", "NODES").node_group = group
    glow, told = read_glow()
    shown = sorted(value[0] for name, value in glow.items() if name.startswith("Holder"))
    if bpy.app.version >= (5, 0, 0):
        assert shown == pytest.approx([0.0, 1 / 3, 2 / 3])
        assert "geometry nodes" not in told
    else:
        assert shown == [0.5] * 3
        assert "what geometry nodes give instances is not read before Blender 5.0" in told


def test_objects_of_one_mesh_and_material_differ():
    obj = show_property()
    obj["x"] = 0.3
    for number in (1, 2):
        twin = add_copy(obj)
        twin.name, twin["x"] = f"Twin {number}", 0.6
    assert read_glow()[0] == {name: pytest.approx([value] * 3) for name, value in (("Square", 0.3), ("Twin 1", 0.6), ("Twin 2", 0.6))}
    snapshot = export_scene(bpy.context).snapshot
    assert len(snapshot.materials) == 2, "those that look alike are one"


@pytest.mark.parametrize("is_instance", [False, True])
def test_the_random_number_of_object_info_is_cycles_own(is_instance, tmp_path):
    obj = show_property(node_type="ShaderNodeObjectInfo", output="Random")
    obj.name = "Chair"
    if is_instance:
        instance(obj)
    (glow,), told = read_glow()[0].values(), read_glow()[1]
    assert told == ""
    assert glow == pytest.approx(render_glow(tmp_path), abs=1 / 128)


def test_instances_have_random_numbers_of_their_own():
    first = instance(show_property(node_type="ShaderNodeObjectInfo", output="Random"))
    add_copy(first)
    assert len({tuple(glow) for glow in read_glow()[0].values()}) == 2


def test_a_property_may_be_the_view_layers(tmp_path):
    show_property("VIEW_LAYER")
    bpy.context.view_layer["x"] = BLUE
    glow, told = read_glow()
    assert (glow["Square"], told) == (pytest.approx(BLUE[:3], rel=1e-6), "")
    assert render_glow(tmp_path) == pytest.approx(BLUE[:3], rel=1e-5)


@pytest.mark.parametrize(
    ("layer", "scene", "world", "expected"), [(0.3, 0.4, 0.5, 0.3), (None, 0.4, 0.5, 0.4), (None, None, 0.5, 0.5), (None, None, None, 0.0)]
)
def test_the_view_layer_is_asked_first_then_the_scene_then_its_world(layer, scene, world, expected, tmp_path):
    obj = show_property("VIEW_LAYER")
    obj["x"] = 0.9
    bpy.context.scene.world = bpy.data.worlds.new("World")
    for block, value in ((bpy.context.view_layer, layer), (bpy.context.scene, scene), (bpy.context.scene.world, world)):
        if value is not None:
            block["x"] = value
    glow, told = read_glow()
    assert glow["Square"] == pytest.approx([expected] * 3, rel=1e-6)
    assert ("the view layer has no property x of numbers, so it is black there, as in Blender" in told) == (expected == 0.0)
    assert render_glow(tmp_path) == pytest.approx([expected] * 3, rel=1e-5)


@pytest.mark.parametrize(
    ("name", "expected"), [("frame_current", (7.0,) * 3), ("world.color", BLUE[:3]), ("camera.location", (0.0, 0.0, 0.5))]
)
def test_the_scenes_own_properties_are_found_by_their_path(name, expected, tmp_path):
    show_property("VIEW_LAYER", name)
    scene = bpy.context.scene
    scene.frame_current, scene.world = 7, bpy.data.worlds.new("World")
    scene.world.color = BLUE[:3]
    assert render_glow(tmp_path) == pytest.approx(expected, rel=1e-5)  # first, for it makes the camera
    assert read_glow()[0]["Square"] == pytest.approx(expected, rel=1e-6)


def test_a_worlds_nodes_may_ask_the_view_layer(tmp_path):
    scene = bpy.context.scene
    scene.world, scene["x"] = bpy.data.worlds.new("World"), BLUE
    if scene.world.node_tree is None:  # Blender 4.5
        scene.world.use_nodes = True
    tree = scene.world.node_tree
    tree.nodes.clear()
    end, glow, node = (tree.nodes.new(name) for name in ("ShaderNodeOutputWorld", "ShaderNodeBackground", "ShaderNodeAttribute"))
    node.attribute_type, node.attribute_name = "VIEW_LAYER", "x"
    tree.links.new(node.outputs["Color"], glow.inputs["Color"])
    tree.links.new(glow.outputs[0], end.inputs["Surface"])
    show_property().location.z = -5.0
    snapshot = export_scene(bpy.context).snapshot
    assert snapshot.world_rgb == pytest.approx(BLUE[:3], rel=1e-6)
    bpy.data.objects["Square"].hide_render = True
    assert render_glow(tmp_path) == pytest.approx(BLUE[:3], rel=1e-5)


# Attributes of meshes that materials show: as a render with Cycles shows them.
SIDE = 8  # pixels
FIELD = {"FLOAT_VECTOR": "vector", "FLOAT2": "vector", "FLOAT_COLOR": "color", "BYTE_COLOR": "color_srgb"}
FIRST = {"FLOAT": 0.125, "FLOAT2": (0.125, 0.5), "FLOAT_VECTOR": (0.125, 0.5, 1.0), "FLOAT_COLOR": (0.125, 0.5, 1.0, 0.75)}
FIRST |= {"BYTE_COLOR": (0.125, 0.5, 0.9, 0.75), "INT": 1, "INT8": 1, "BOOLEAN": True}


def make_values(kind, count):
    """Of each element another, so that the means of edges are no whole numbers."""
    first = FIRST[kind]
    if kind == "BOOLEAN":
        return [k % 4 == 0 for k in range(count)]
    if kind in ("INT", "INT8"):
        return [first + k * k % 5 for k in range(count)]
    return [tuple(np.multiply(first, (1 + k) / count)) if isinstance(first, tuple) else first * (1 + k) for k in range(count)]


def show_attribute(kind, domain, output="Color", node_type="ShaderNodeAttribute"):
    """Two triangles that shine with an attribute; an edge without a face hangs on one of their corners."""
    mesh = bpy.data.meshes.new("Square")
    mesh.from_pydata([(-1, -1, 0), (1, -1, 0), (-1, 1, 0), (1, 1, 0), (0, 0, -3)], [(0, 4)], [(0, 1, 2), (1, 3, 2)])
    add_object("Square", mesh)
    tree, color = add_glow(mesh)
    node = tree.nodes.new(node_type)
    setattr(node, "attribute_name" if node_type == "ShaderNodeAttribute" else "layer_name", "x")
    source = node.outputs[2] if output == "Fac" else node.outputs[output]  # its name differs between versions
    tree.links.new(source, color)
    attribute = mesh.attributes.new("x", kind, domain)
    for element, value in zip(attribute.data, make_values(kind, len(attribute.data)), strict=True):
        setattr(element, FIELD.get(kind, "value"), value)
    return mesh


def read_mesh_glow():
    """(SIDE, SIDE, 3) what it shines with, seen from above, row 0 at the bottom; and what is told of the material."""
    result = export_scene(bpy.context)
    y, x = ((np.mgrid[:SIDE, :SIDE] + 0.5) / SIDE).astype(np.float32)
    tri = np.where(x + y < 1.0, 0, 1)
    corner = {0: (1.0 - x - y, x), 1: (1.0 - y, x + y - 1.0)}  # weights of the first two corners
    weight = [np.where(tri == 0, corner[0][k], corner[1][k]).ravel() for k in (0, 1)]
    glow = SurfaceMaterials(result.snapshot).emission.at(tri.ravel(), weight[1], 1.0 - weight[0] - weight[1])
    return glow.reshape(SIDE, SIDE, 3), dict(result.warnings).get("Glow", "")


def check_against_cycles(folder):
    glow, told = read_mesh_glow()
    assert told == ""
    rendered = render_from_above(folder, SIDE)
    off_diagonal = ~np.fliplr(np.eye(SIDE, dtype=bool))
    np.testing.assert_allclose(glow[off_diagonal], rendered[off_diagonal], atol=2e-3 * max(1.0, rendered.max()))
    return rendered


@pytest.mark.parametrize("kind", FIRST)
@pytest.mark.parametrize("domain", ["EDGE", "POINT", "CORNER", "FACE"])
def test_attributes_are_shown_as_cycles_shows_them(kind, domain, tmp_path):
    show_attribute(kind, domain)
    assert np.ptp(check_against_cycles(tmp_path), axis=(0, 1)).max() > 0.05


@pytest.mark.parametrize("output", ["Fac", "Alpha", "Vector"])
@pytest.mark.parametrize("kind", FIRST)
def test_outputs_of_edges_are_those_of_cycles(kind, output, tmp_path):
    show_attribute(kind, "EDGE", output)
    assert check_against_cycles(tmp_path).any()


@pytest.mark.parametrize("kind", ["FLOAT_COLOR", "BYTE_COLOR"])  # Blender 5.0 crashes where it is no colour
@pytest.mark.parametrize("output", ["Color", "Alpha"])
def test_a_color_attribute_node_shows_edges_too(kind, output, tmp_path):
    show_attribute(kind, "EDGE", output, "ShaderNodeVertexColor")
    check_against_cycles(tmp_path)


@pytest.mark.parametrize("kind", ["INT", "INT8"])
@pytest.mark.parametrize(("edges", "expected"), [((2, 3), 3.0), ((4, 5), 5.0), ((0, 1), 1.0), ((2, 2), 2.0)])
def test_whole_numbers_of_edges_stay_whole(kind, edges, expected):
    mesh = show_attribute(kind, "EDGE")
    for element, edge in zip(mesh.attributes["x"].data, mesh.edges, strict=True):
        element.value = edges[edge.vertices[0] == 1] if 3 in edge.vertices else 0
    rgba = read_mesh(mesh, frozenset("x")).colors["x"]
    assert rgba[[loop.vertex_index == 3 for loop in mesh.loops]].tolist() == [[expected] * 3 + [1.0]]


def test_only_what_is_asked_for_is_read_besides_colours():
    mesh = show_attribute("FLOAT", "POINT")
    mesh.attributes.new("Col", "FLOAT_COLOR", "CORNER")
    mesh.attributes.new("edges", "FLOAT_COLOR", "EDGE")
    assert list_wanted_attributes() == {"x"}
    assert set(read_mesh(mesh).colors) == {"Col", ""}
    assert set(read_mesh(mesh, list_wanted_attributes()).colors) == {"Col", "", "x"}


def test_a_node_within_a_group_asks_too():
    group = bpy.data.node_groups.new("Group", "ShaderNodeTree")
    node = group.nodes.new("ShaderNodeAttribute")
    node.attribute_name = "inner"
    other = group.nodes.new("ShaderNodeAttribute")
    other.attribute_type, other.attribute_name = "OBJECT", "outer"
    group.nodes.new("ShaderNodeVertexColor").layer_name = "color"
    assert list_wanted_attributes() == {"inner", "color"}


def test_what_is_not_read_is_told(monkeypatch):
    monkeypatch.setattr(SocketBaker, "bake", lambda *_, **__: None)
    mesh = show_attribute("FLOAT", "EDGE")
    mesh.attributes.remove(mesh.attributes["x"])
    mesh.attributes.new("x", "QUATERNION", "EDGE")
    glow, told = read_mesh_glow()
    assert glow == pytest.approx(0.5)
    assert "replaced by a grey of 0.5, for attribute x is of a kind that is not read" in told
