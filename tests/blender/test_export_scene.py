"""What the export hands to the core: objects, materials on faces, layers, lights, and its sentences."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blend_rooms import add_object, make_quads
from leaflight.addon.nodes.socket_bake import SocketBaker
from leaflight.addon.read.export_scene import export_scene, find_objects
from leaflight.addon.read.materials_read import MaterialTable
from leaflight.addon.read.uv_layer import write_layer
from leaflight.core.scene.materials import SurfaceMaterials

pytestmark = pytest.mark.usefixtures("empty_file")


def add_quads(name, data=None, collection=None, **properties):
    return add_object(name, make_quads(name) if data is None else data, collection, **properties)


def make_material(name, image=None, layer=""):
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    if image:
        texture, uv_map = nodes.new("ShaderNodeTexImage"), nodes.new("ShaderNodeUVMap")
        texture.image, uv_map.uv_map = image, layer
        links.new(uv_map.outputs[0], texture.inputs[0])
        links.new(texture.outputs[0], nodes["Principled BSDF"].inputs["Base Color"])
    return material


def export(**arguments):
    return export_scene(bpy.context, **arguments)


def part(result, name, field):
    index = [item.name for item in result.snapshot.objects].index(name)
    return getattr(result.snapshot, field)[result.snapshot.tri_object == index]


def item(result, name):
    found = next(k for k, exported in enumerate(result.objects) if exported.name == name)
    return result.snapshot.objects[found], result.objects[found]


def test_default_receivers_and_shared_meshes():
    mesh = make_quads("Shared")
    add_quads("B", mesh, location=(5, 0, 0))
    add_quads("A", mesh)
    add_quads("Own")
    result = export()
    assert [o.name for o in result.snapshot.objects] == ["A", "B", "Own"]
    assert [o.mesh for o in result.snapshot.objects] == [0, 0, -1]
    assert all(o.receives and o.casts_shadow for o in result.snapshot.objects)
    assert part(result, "B", "tri_corner").tolist() == part(result, "A", "tri_corner").tolist()
    assert result.snapshot.tri_position[result.snapshot.tri_object == 1][..., 0].min() == pytest.approx(5.0)
    assert not any(exported.needs_copy for exported in result.objects)
    assert find_objects(result.objects[:1]) == [bpy.data.objects["A"]]
    assert result.warnings == ()


def test_the_layer_of_an_earlier_bake_is_none_of_a_textures():
    image = bpy.data.images.new("Wood", 4, 4)
    image.pixels.foreach_set(np.linspace(0.1, 0.9, 64, dtype=np.float32))
    mesh = add_quads("Plank", make_quads("Plank", layers=())).data
    mesh.materials.append(make_material("Wood", image))
    before = export()
    write_layer(mesh, np.random.default_rng(0).random((len(mesh.loops), 2)))
    again = export()
    assert (
        again.warnings
        == before.warnings
        == (("Plank", "has no UV layer, so its texture shows one colour everywhere; unwrap it, or choose another layer in the material"),)
    )
    assert not part(again, "Plank", "tri_albedo_uv").any()
    assert export(uv_layer=mesh.uv_layers[0].name).snapshot.objects[0].has_layer


@pytest.mark.parametrize(
    ("names", "text"),
    [
        (["Flor"], r"Flor: no such object; the scene has: Floor, \.\.\.$"),
        (["Zzz"], r"Zzz: no such object; the scene has: Ceiling, Floor, Hidden, Shut$"),
        (["Hidden"], "Hidden: is hidden in render"),
        (["Shut"], "Shut: is hidden in render"),
        (["Floor", "Sun"], "Sun: is a light, not a mesh"),
    ],
)
def test_names_that_cannot_be_baked(names, text):
    for name in ("Floor", "Ceiling", "Hidden"):
        add_quads(name)
    bpy.data.objects["Hidden"].hide_render = True
    shut = bpy.data.collections.new("Shut")
    bpy.context.scene.collection.children.link(shut)
    add_quads("Shut", collection=shut)
    bpy.context.view_layer.layer_collection.children["Shut"].exclude = True
    add_quads("Sun", bpy.data.lights.new("Sun", "SUN"))
    with pytest.raises(ValueError, match=text):
        export(objects=names)


def test_nothing_to_bake():
    with pytest.raises(ValueError, match="nothing to bake: no mesh object"):
        export()
    add_quads("Empty mesh", bpy.data.meshes.new("Empty mesh"))
    with pytest.raises(ValueError, match="Empty mesh: has no faces"):
        export()
    add_quads("Floor")
    assert ("Empty mesh", "has no faces and is left out") in export().warnings


def test_broken_coordinates_and_duplicates_are_told():
    mesh = make_quads("Broken")
    mesh.vertices[4].co.x = float("nan")
    add_quads("Broken", mesh)
    double = bpy.data.meshes.new("Double")
    double.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0)] * 2, [], [(0, 1, 2), (3, 4, 5)])
    add_quads("Double", double)
    result = export()
    texts = dict(result.warnings)
    assert texts["Broken"].startswith("1 face is left out")
    assert texts["Double"].startswith("1 triangle lies exactly")
    assert part(result, "Broken", "tri_polygon").tolist() == [0, 0]
    for vertex in mesh.vertices:
        vertex.co.y = float("nan")
    assert dict(export().warnings)["Broken"].startswith("every face is left out")
    bpy.data.objects.remove(bpy.data.objects["Double"])
    with pytest.raises(ValueError, match="Broken: every face is left out"):
        export()


def test_materials_by_slot_object_slot_and_empty_slot():
    mesh = make_quads()
    red, green = make_material("Red"), make_material("Green")
    mesh.materials.append(red)
    mesh.materials.append(None)
    mesh.polygons[1].material_index = 1
    add_quads("Data", mesh)
    own = add_quads("Own slot", mesh, location=(0, 3, 0))
    own.material_slots[0].link = "OBJECT"
    own.material_slots[0].material = green
    beyond = make_quads("Beyond")
    beyond.materials.append(green)
    beyond.materials.append(red)
    beyond.polygons.foreach_set("material_index", [6, 6])
    add_quads("Beyond", beyond, location=(0, 6, 0))
    result = export()
    names = np.array([material.name for material in result.snapshot.materials])
    assert names[part(result, "Data", "tri_material")].tolist() == ["Red", "Red", "", ""]
    assert names[part(result, "Own slot", "tri_material")].tolist() == ["Green", "Green", "", ""]
    assert set(names[part(result, "Beyond", "tri_material")]) == {"Red"}
    assert sorted(names) == ["", "Green", "Red"]


def test_texture_coordinates_come_from_their_own_layer():
    mesh = make_quads(layers=("First", "Second"))
    mesh.uv_layers["First"].active_render = True
    image = bpy.data.images.new("Karo", 4, 4)
    for name, layer in (("Default", ""), ("Named", "Second"), ("Lost", "Third")):
        copy = mesh.copy()
        copy.materials.append(make_material(name, image, layer))
        add_quads(name, copy)
    result = export()
    first = part(result, "Default", "tri_albedo_uv")
    corner = part(result, "Default", "tri_corner")
    uv = np.array([loop.uv for loop in mesh.uv_layers["First"].data])
    assert first == pytest.approx(uv[corner])
    assert part(result, "Named", "tri_albedo_uv") == pytest.approx(first + 1.0)
    assert not part(result, "Lost", "tri_albedo_uv").any()
    assert "UV layer Third" in dict(result.warnings)["Lost"]
    assert len(result.snapshot.images) == 1


def make_colored(name, layer="Col", kind="FLOAT_COLOR", domain="CORNER"):
    """A mesh with random colours, and these by corner, linear."""
    mesh = make_quads(name)
    attribute = mesh.attributes.new(layer, kind, domain)
    stored = np.random.default_rng(len(name)).random((len(attribute.data), 4)).astype(np.float32)
    attribute.data.foreach_set("color", stored.ravel())
    attribute.data.foreach_get("color", stored.reshape(-1))  # bytes hold less
    corners = {
        "CORNER": np.arange(len(mesh.loops)),
        "POINT": [loop.vertex_index for loop in mesh.loops],
        "FACE": np.repeat(np.arange(len(mesh.polygons)), 4),
    }
    return mesh, stored[corners[domain], :3]


def make_painted(name, kind="VertexColor", layer="", target="Base Color", output=0):
    """A material whose colour is an attribute."""
    material = make_material(name)
    nodes = material.node_tree.nodes
    node = nodes.new(f"ShaderNode{kind}")
    if kind == "VertexColor":
        node.layer_name = layer
    else:
        node.attribute_name = layer
    material.node_tree.links.new(node.outputs[output], nodes["Principled BSDF"].inputs[target])
    return material, node


def shown(result, name, quantity="albedo", u=1 / 3, v=1 / 3):
    """What surfaces of an object show within their triangles."""
    tri = np.flatnonzero(result.snapshot.tri_object == [item.name for item in result.snapshot.objects].index(name))
    return getattr(SurfaceMaterials(result.snapshot), quantity).at(tri, np.full(len(tri), u, np.float32), np.full(len(tri), v, np.float32))


def within(result, name, color, u=1 / 3, v=1 / 3):
    """The same of colours by corner."""
    return np.array([1 - u - v, u, v]) @ color[part(result, name, "tri_corner")]


@pytest.mark.parametrize("node", [("VertexColor", ""), ("VertexColor", "Col"), ("Attribute", "Col")], ids=str)
@pytest.mark.parametrize("kind", ["FLOAT_COLOR", "BYTE_COLOR"])
@pytest.mark.parametrize("domain", ["CORNER", "POINT"])
def test_vertex_colours_are_those_of_cycles(node, kind, domain):
    mesh, color = make_colored("Plain", kind=kind, domain=domain)
    mesh.attributes.new("Other", "FLOAT_COLOR", "CORNER")
    mesh.color_attributes.render_color_index = [one.name for one in mesh.color_attributes].index("Col")
    other, other_color = make_colored("Of other colours", kind=kind, domain=domain)
    material, _ = make_painted("Paint", *node)
    for data in (mesh, other):
        data.materials.append(material)
    add_quads("Plain", mesh)
    add_quads("Mirrored", mesh, scale=(-1, 1, 1))
    add_quads("Other", other)
    result = export()
    assert result.warnings == ()
    for name, expected in (("Plain", color), ("Mirrored", color), ("Other", other_color)):
        for u, v in ((0.0, 0.0), (0.2, 0.7)):
            assert shown(result, name, u=u, v=v) == pytest.approx(within(result, name, expected, u, v), abs=2e-6)
    assert (len(result.snapshot.images), len(result.snapshot.materials)) == (1, 1)


def test_a_material_of_vertex_colours_is_read_once_for_each_mesh(monkeypatch):
    read, meshes = MaterialTable._read, []
    monkeypatch.setattr(MaterialTable, "_read", lambda table, reader, one: meshes.append(reader.faces.local) or read(table, reader, one))
    material, _ = make_painted("Paint")
    for name in ("One", "Other"):
        mesh, _ = make_colored(name)
        mesh.materials.append(material)
        for copy in ("", " copy"):
            add_quads(name + copy, mesh)
    export()
    assert len(meshes) == len(set(map(id, meshes))) == 2


@pytest.mark.parametrize("node", [("VertexColor", ""), ("Attribute", "Col")], ids=str)
def test_vertex_colours_of_faces_and_of_lamps(node):
    mesh, color = make_colored("Faces", domain="FACE")
    mesh.materials.append(make_painted("Paint", *node)[0])
    add_quads("Faces", mesh)
    lamp, lamp_color = make_colored("Lamp")
    material, _ = make_painted("Glow", target="Emission Color")
    material.node_tree.nodes["Principled BSDF"].inputs["Emission Strength"].default_value = 5.0
    lamp.materials.append(material)
    add_quads("Lamp", lamp)
    result = export()
    assert shown(result, "Faces") == pytest.approx(within(result, "Faces", color), abs=2e-6)
    assert shown(result, "Lamp", "emission") == pytest.approx(5 * within(result, "Lamp", lamp_color), abs=2e-5)


def test_an_attribute_as_a_number_is_the_average_of_its_channels():
    mesh, color = make_colored("Grey")
    mesh.materials.append(make_painted("Paint", "Attribute", "Col", output=2)[0])
    add_quads("Grey", mesh)
    grey = np.repeat(color.mean(axis=1, keepdims=True), 3, axis=1)
    assert shown(export(), "Grey") == pytest.approx(within(export(), "Grey", grey), abs=2e-6)


def test_vertex_colours_of_one_value_need_no_texture():
    mesh, _ = make_colored("Even")
    mesh.attributes["Col"].data.foreach_set("color", np.tile(np.float32([0.5, 0.4, 0.3, 0.5]), len(mesh.loops)))
    mesh.materials.append(make_painted("Paint")[0])
    add_quads("Even", mesh)
    result = export()
    assert shown(result, "Even") == pytest.approx(np.tile([0.5, 0.4, 0.3], (4, 1)))
    assert (result.warnings, result.snapshot.images) == ((), ())


def test_where_vertex_colours_are_missing_it_is_black(monkeypatch):
    monkeypatch.setattr(SocketBaker, "bake", lambda *_, **__: None)  # as where Blender cannot evaluate the nodes
    material, _ = make_painted("Paint", layer="Col")
    painted, color = make_colored("Painted")
    bare, plain = make_quads("Bare"), make_quads("Plain")
    plain.attributes.new("Col", "QUATERNION", "POINT")
    for data in (painted, bare, plain):
        data.materials.append(material)
        add_quads(data.name, data)
    result = export()
    assert shown(result, "Painted") == pytest.approx(within(result, "Painted", color), abs=2e-6)
    assert not shown(result, "Bare").any()
    assert shown(result, "Plain") == pytest.approx(0.5)
    sentences = [text for subject, text in result.warnings if subject == "Paint"]
    assert any("Bare has no colour attribute Col, so it is black there" in text for text in sentences)
    assert any("replaced by a grey of 0.5" in text for text in sentences)
    assert len(sentences) == 2


@pytest.mark.parametrize("first", [True, False])
def test_vertex_colours_times_a_texture_are_their_mean(first, monkeypatch):
    monkeypatch.setattr(SocketBaker, "bake", lambda *_, **__: None)
    mesh, color = make_colored("Floor")
    mesh.vertices[4].co.x = mesh.vertices[5].co.x = 4.0  # the second quad has three quarters of the area
    material, node = make_painted("Paint")
    tree = material.node_tree
    mix, texture = tree.nodes.new("ShaderNodeMix"), tree.nodes.new("ShaderNodeTexImage")
    mix.data_type, mix.blend_type = "RGBA", "MULTIPLY"
    mix.inputs["Factor"].default_value = 1.0
    texture.image = bpy.data.images.new("Karo", 4, 4)
    sockets = [socket for socket in mix.inputs if socket.type == "RGBA"]
    for socket, source in zip(sockets if first else sockets[::-1], (node, texture), strict=True):
        tree.links.new(source.outputs[0], socket)
    tree.links.new(next(s for s in mix.outputs if s.type == "RGBA"), tree.nodes["Principled BSDF"].inputs["Base Color"])
    mesh.materials.append(material)
    add_quads("Floor", mesh)
    result = export()
    (paint,) = result.snapshot.materials
    assert result.snapshot.images[paint.albedo_image].name == "Karo"
    tri_mean = color[part(result, "Floor", "tri_corner")].mean(axis=1)
    assert paint.albedo_rgb == pytest.approx((tri_mean[:2].mean(axis=0) + 3 * tri_mean[2:].mean(axis=0)) / 4, abs=1e-6)
    assert "its vertex colours are baked as their mean" in dict(result.warnings)["Paint"]


def test_mirrored_object_keeps_corner_and_texture_together():
    mesh = make_quads()
    mesh.materials.append(make_material("Paint", bpy.data.images.new("Karo", 4, 4)))
    add_quads("Plain", mesh)
    add_quads("Mirrored", mesh, scale=(-1, 1, 1))
    result = export(uv_layer="UVMap")
    uv = np.array([loop.uv for loop in mesh.uv_layers[0].data])
    for name, sign in (("Plain", 1.0), ("Mirrored", -1.0)):
        corner = part(result, name, "tri_corner")
        assert part(result, name, "tri_uv") == pytest.approx(uv[corner])
        assert part(result, name, "tri_albedo_uv") == pytest.approx(uv[corner])
        index = [o.name for o in result.snapshot.objects].index(name)
        position = result.snapshot.tri_position[result.snapshot.tri_object == index]
        assert position[..., :2] == pytest.approx(uv[corner] * (2 * sign, 2), abs=1e-6)
        normal = np.cross(position[:, 1] - position[:, 0], position[:, 2] - position[:, 0])
        assert (normal[:, 2] > 0).all()


def test_existing_layer():
    add_quads("With")
    add_quads("Without", make_quads("Without", layers=()))
    result = export(uv_layer="UVMap")
    assert item(result, "With")[0].has_layer
    assert not item(result, "Without")[0].has_layer
    assert "unwrapped" in dict(result.warnings)["Without"]
    assert part(result, "With", "tri_uv").max() == 1.0
    assert not export().snapshot.tri_uv.any()
    with pytest.raises(ValueError, match=r"no object has a UV layer named Nope .*: UVMap"):
        export(uv_layer="Nope")


def test_lights_world_and_shadow_flags():
    floor = add_quads("Floor", visible_shadow=False)
    glass = bpy.data.materials.new("Glass")
    glass.use_nodes = True
    glass.node_tree.nodes["Principled BSDF"].inputs["Transmission Weight"].default_value = 1.0
    pane = add_quads("Pane")
    pane.data.materials.append(glass)
    add_quads("Wall")
    add_quads("Sun", bpy.data.lights.new("Sun", "SUN"), rotation_euler=(0.5, 0, 0))
    add_quads("Off", bpy.data.lights.new("Off", "SUN"), hide_render=True)
    add_quads("Prop", visible_shadow=False, visible_diffuse=False, visible_glossy=False, visible_transmission=False)
    group = bpy.data.collections.new("Group")
    add_quads("Bulb", bpy.data.lights.new("Bulb", "POINT"), collection=group)
    add_object("Holder", None, instance_type="COLLECTION", instance_collection=group, location=(0, 0, 4))
    result = export(objects=["Floor", "Pane", "Wall"])
    assert {o.name: o.casts_shadow for o in result.snapshot.objects} == {"Floor": False, "Pane": True, "Wall": True}
    assert [o.name for o in result.snapshot.objects if o.receives] == ["Floor", "Wall"]
    assert ("Pane", "light passes through it and none is reflected, so it gets no lightmap") in result.warnings
    assert [light.name for light in result.snapshot.lights] == ["Bulb", "Sun"]
    assert result.snapshot.lights[0].position_m == (0.0, 0.0, 4.0)
    assert result.snapshot.world_rgb == (0.0, 0.0, 0.0)
    assert floor.visible_shadow is False


def test_the_same_scene_gives_the_same_snapshot_whatever_the_order_of_its_objects():
    def build(names):
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
        for name in names:
            add_quads(name, location=(ord(name), 0, 0))
        return export().snapshot

    first, second = build("ABC"), build("CBA")
    assert np.array_equal(first.vertex_position, second.vertex_position)
    assert first.objects == second.objects


def link_light(thing, kind, **states):
    """A linking collection of a thing with objects by name, included or excluded."""
    collection = bpy.data.collections.new("Linked")
    for name, state in states.items():
        collection.objects.link(bpy.data.objects[name])
        collection.collection_objects[-1].light_linking.link_state = state
    setattr(thing.light_linking, f"{kind}_collection", collection)
    return collection


@pytest.mark.parametrize(
    ("states", "expected"),
    [
        ({}, None),
        ({"Wall": "INCLUDE"}, ("Wall",)),
        ({"Wall": "EXCLUDE"}, ("Floor", "Holder.Tile")),
        ({"Wall": "INCLUDE", "Floor": "EXCLUDE"}, ("Wall",)),
        ({"Holder": "INCLUDE"}, ("Holder.Tile",)),
        ({"Tile": "EXCLUDE"}, ("Floor", "Wall")),
    ],
)
@pytest.mark.parametrize(("kind", "field"), [("receiver", "lights"), ("blocker", "blocked_by")])
def test_a_lamp_is_linked_to_objects_and_instances(kind, field, states, expected):
    add_quads("Floor")
    add_quads("Wall")
    group = bpy.data.collections.new("Group")
    add_quads("Tile", collection=group)
    add_object("Holder", None, instance_type="COLLECTION", instance_collection=group)
    link_light(add_quads("Bulb", bpy.data.lights.new("Bulb", "POINT")), kind, **states)
    result = export()
    (light,) = result.snapshot.lights
    chosen = getattr(light, field)
    assert (None if chosen is None else tuple(result.snapshot.objects[number].name for number in chosen)) == expected
    assert getattr(light, "blocked_by" if field == "lights" else "lights") is None
    assert not [text for _, text in result.warnings if "linking" in text]


def test_collections_within_a_linking_collection_count():
    add_quads("Floor")
    add_quads("Wall")
    outer = link_light(add_quads("Bulb", bpy.data.lights.new("Bulb", "POINT")), "receiver")
    inner, innermost = bpy.data.collections.new("Inner"), bpy.data.collections.new("Innermost")
    innermost.objects.link(bpy.data.objects["Wall"])
    inner.children.link(innermost)
    outer.children.link(inner)
    outer.collection_children[0].light_linking.link_state = "EXCLUDE"
    assert export().snapshot.lights[0].lights == (0,)


def test_what_glows_is_linked_as_lamps_are():
    panel = add_quads("Panel")
    add_quads("Wall")
    link_light(panel, "receiver", Wall="INCLUDE")
    link_light(panel, "blocker", Wall="EXCLUDE")
    of_panel, of_wall = export().snapshot.objects
    assert (of_panel.lights, of_panel.blocked_by, of_wall.lights) == ((1,), (0,), None)
