"""A baked scene as .glb, imported again: textures, UV sets, pixels, and nothing of the user's changed."""

import json
import sys

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blend_rooms import bake, list_files, make_material, open_room, read_pixels, read_report, save_scene
from leaflight.addon.app import session
from leaflight.addon.app.arguments import BakeRequest
from leaflight.addon.app.job import library_paths
from leaflight.addon.gltf.export_gltf import export_gltf
from leaflight.addon.gltf.gltf_file import read_document
from leaflight.addon.read import uv_layer
from leaflight.addon.show import restore
from leaflight.core.bake.bake import run_bake
from leaflight.core.util.settings import Settings

STEP = 0.51 / 255  # half a step of 8 bits, and rounding


@pytest.fixture
def room(monkeypatch):
    """The cube wears wood, the floor nothing, a third object is not baked; the floor's UV layer is stretched."""
    open_room()
    monkeypatch.setattr(sys, "path", [*sys.path, *library_paths()])
    bpy.ops.mesh.primitive_uv_sphere_add(segments=8, ring_count=4, location=(0, 0, 1.5), radius=0.2)
    bpy.context.object.name = "Ball"
    wood = make_material("Wood")
    wood.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (0.4, 0.3, 0.2, 1.0)
    bpy.data.objects["Cube"].data.materials.append(wood)
    bpy.data.scenes.new("A scene before it")
    return bpy.context.scene


def bake_room(tmp_path, *passes, atlas=True, names=("Floor", "Cube"), size=32, layer=""):
    """Bakes these objects and puts the bake on them."""
    folder = tmp_path / "job"
    folder.mkdir()
    settings = Settings(size=size, error=0.5, max_photons=5000, workers=1, passes=passes, atlas=atlas)
    request = BakeRequest(settings, objects=names, uv_layer=layer, output=tmp_path / "maps")
    work = session.prepare(bpy.context, request, folder)
    run_bake(folder, lambda message: None, lambda: False)
    result = session.read_result(work)
    session.finish_files(bpy.context.scene, result)
    assert session.assign(bpy.context, work, result) == []


def baked_pixels(tmp_path, name):
    return read_pixels(tmp_path / "maps" / f"lightmap_0.{name}.exr")[..., :3]


def import_again(path):
    """Images of the file, by name, as stored, in [0, 1]."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.import_scene.gltf(filepath=str(path))
    found = {}
    for image in bpy.data.images:
        if image.size[0]:
            pixels = np.empty(len(image.pixels), np.float32)
            image.pixels.foreach_get(pixels)
            found[image.name] = pixels.reshape(image.size[1], image.size[0], -1)[..., :3]
    return found


def to_srgb(linear):
    linear = np.clip(linear, 0.0, 1.0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def uv_of(obj, layer):
    """Places of the corners in the layer, each once: the file holds triangles."""
    uv = np.empty(2 * len(obj.data.loops), np.float32)
    obj.data.uv_layers[layer].uv.foreach_get("vector", uv)
    return np.unique(np.round(uv.reshape(-1, 2), 5), axis=0)


def corners_of(obj):
    """The cube's eight corners in the world, each once."""
    return np.unique([(obj.matrix_world @ vertex.co).to_tuple(4) for vertex in obj.data.vertices], axis=0)


def snapshot():
    """What the file holds: data-blocks with their users, what objects wear, layers, visibility, and what is shown."""
    blocks = {}
    for kind in ("scenes", "objects", "meshes", "materials", "images", "node_groups", "collections", "worlds", "lights"):
        for block in getattr(bpy.data, kind):
            tree = getattr(block, "node_tree", None) if kind == "materials" else None
            nodes = sorted((node.name, node.bl_idname) for node in tree.nodes) if tree else []
            blocks[kind, block.name] = (block.users, nodes, len(tree.links) if tree else 0)
    for obj in bpy.data.objects:
        slots = [(slot.link, slot.material.name if slot.material else "") for slot in obj.material_slots]
        layers = [(layer.name, layer.active_render) for layer in obj.data.uv_layers] if obj.type == "MESH" else []
        blocks["worn", obj.name] = (slots, layers, obj.hide_viewport, obj.hide_render, obj.select_get())
    active = bpy.context.view_layer.objects.active
    return blocks, bpy.context.scene.name, bpy.context.window.scene.name, active.name if active else "", bpy.context.scene.frame_current


def export(tmp_path, **options):
    """The document of an export that leaves the file as it was."""
    before = snapshot()
    assert export_gltf(bpy.context, tmp_path / "room.glb", **options) == []
    assert snapshot() == before
    return read_document((tmp_path / "room.glb").read_bytes())


def find(document, kind, name):
    return next(entry for entry in document[kind] if entry["name"] == name)


def primitive_of(document, name):
    return document["meshes"][find(document, "nodes", name)["mesh"]]["primitives"][0]


def test_combined_light_is_an_unlit_colour(room, tmp_path):
    bake_room(tmp_path, "combined")
    uv = uv_of(bpy.data.objects["Floor"], "Leaflight")
    document = export(tmp_path)
    assert list_files(tmp_path) == ["job", "maps", "room.glb"]
    assert document["extensionsUsed"] == ["KHR_materials_unlit"]
    assert {node["name"] for node in document["nodes"]} == {"Floor", "Cube", "Ball"}
    assert document["scenes"][0]["name"] == room.name
    for name, worn in (("Floor", "Leaflight"), ("Cube", "Wood")):
        primitive = primitive_of(document, name)
        material = document["materials"][primitive["material"]]
        assert material["name"] == worn
        assert "KHR_materials_unlit" in material["extensions"]
        assert material["pbrMetallicRoughness"]["baseColorTexture"].get("texCoord", 0) == 0
        assert [key for key in primitive["attributes"] if key.startswith("TEXCOORD")] == ["TEXCOORD_0"]
    assert "material" not in primitive_of(document, "Ball")
    expected = to_srgb(baked_pixels(tmp_path, "combined"))
    assert expected.max() > 0.5
    images = import_again(tmp_path / "room.glb")
    np.testing.assert_allclose(images["lightmap_0.combined"], expected, atol=STEP)
    np.testing.assert_allclose(uv_of(bpy.data.objects["Floor"], "UVMap"), uv, atol=2e-5)


def test_lighting_is_a_lightmap_on_the_second_uv_set(room, tmp_path):
    bake_room(tmp_path, "lighting")
    own, ours = (uv_of(bpy.data.objects["Floor"], name) for name in ("UVMap", "Leaflight"))
    document = export(tmp_path)
    assert list_files(tmp_path) == ["job", "maps", "room.glb", "room.lightmap.json"]
    assert "extensionsUsed" not in document
    wood = document["materials"][primitive_of(document, "Cube")["material"]]
    assert wood["name"] == "Wood"
    assert wood["occlusionTexture"]["texCoord"] == 1
    assert wood["pbrMetallicRoughness"]["baseColorFactor"][:3] == pytest.approx([0.4, 0.3, 0.2])
    assert {"TEXCOORD_0", "TEXCOORD_1"} <= primitive_of(document, "Cube")["attributes"].keys()

    manifest = json.loads((tmp_path / "room.lightmap.json").read_text(encoding="utf-8"))
    assert manifest["irradiance_factor"] == pytest.approx(np.pi)
    assert sorted(material["name"] for material in manifest["materials"]) == ["Leaflight", "Wood"]
    assert {material["texcoord"] for material in manifest["materials"]} == {1}
    (image,) = manifest["images"]
    light = baked_pixels(tmp_path, "lighting")
    assert image["range"] == pytest.approx(light.max())

    images = import_again(tmp_path / "room.glb")
    np.testing.assert_allclose(images[image["name"]], to_srgb(light / image["range"]), atol=STEP)
    floor = bpy.data.objects["Floor"]
    for layer, expected in zip(floor.data.uv_layers, (own, ours), strict=True):
        np.testing.assert_allclose(uv_of(floor, layer.name), expected, atol=2e-5)


@pytest.mark.parametrize("transform", ["Standard", "AgX"])
def test_the_scenes_view_goes_into_unlit_colours(room, tmp_path, transform):
    """One stop up: with the Standard transform that is the sRGB curve of twice the light."""
    room.view_settings.view_transform, room.view_settings.exposure = transform, 1.0
    bake_room(tmp_path, "combined")
    export(tmp_path, view_transform="scene")
    shown = import_again(tmp_path / "room.glb")["lightmap_0.combined"]
    difference = np.abs(shown - to_srgb(2 * baked_pixels(tmp_path, "combined")))
    if transform == "Standard":
        assert difference.max() <= STEP
    else:
        assert difference.max() > 0.1


def test_a_material_on_two_pages_is_two_with_their_own_ranges(room, tmp_path):
    bpy.data.objects["Floor"].data.materials.append(bpy.data.materials["Wood"])
    bake_room(tmp_path, "lighting", atlas=False)
    document = export(tmp_path)
    manifest = json.loads((tmp_path / "room.lightmap.json").read_text(encoding="utf-8"))
    ranges = {image["image"]: image["range"] for image in manifest["images"]}
    found = {material["name"]: ranges[material["image"]] for material in manifest["materials"]}
    for name in ("Floor", "Cube"):
        light = read_pixels(tmp_path / "maps" / f"{name}.lighting.exr")[..., :3]
        assert found[document["materials"][primitive_of(document, name)["material"]]["name"]] == pytest.approx(light.max())
    assert sorted(found) == ["Wood", "Wood_"]


def test_a_hidden_bake_is_exported_and_hidden_again(room, tmp_path):
    bake_room(tmp_path, "combined")
    restore.toggle_preview(room, False)
    document = export(tmp_path)
    assert not restore.is_preview_on(room)
    assert len(document["images"]) == 1


def test_results_of_modifiers_and_instances_are_in_the_file_once(room, tmp_path):
    bpy.data.objects["Cube"].modifiers.new("Thick", "ARRAY").count = 2
    bake_room(tmp_path, "combined")
    assert "Cube.Leaflight" in bpy.data.objects
    document = export(tmp_path)
    assert sorted(node["name"] for node in document["nodes"]) == ["Ball", "Cube", "Floor"]
    count = document["accessors"][primitive_of(document, "Cube")["attributes"]["POSITION"]]["count"]
    assert count >= 2 * 24


def test_a_skewed_object_is_in_the_file_as_it_stands(room, tmp_path):
    parent, cube = bpy.data.objects.new("Stretched", None), bpy.data.objects["Cube"]
    room.collection.objects.link(parent)
    parent.scale = (3.0, 1.0, 0.5)
    cube.parent, cube.rotation_euler = parent, (0.4, 0.3, 0.7)
    bpy.context.view_layer.update()
    before = corners_of(cube)
    bake_room(tmp_path, "combined")
    export(tmp_path)
    import_again(tmp_path / "room.glb")
    bpy.context.view_layer.update()
    np.testing.assert_allclose(corners_of(bpy.data.objects["Cube"]), before, atol=1e-4)


def test_linked_duplicates_have_their_own_part_of_the_page_in_the_file(room, tmp_path):
    cube = bpy.data.objects["Cube"]
    twin = cube.copy()
    twin.name, twin.location.x = "Twin", 1.5
    room.collection.objects.link(twin)
    bake_room(tmp_path, "lighting", names=("Floor", "Cube", "Twin"), size=128)  # all on one page
    assert twin.data == cube.data
    places = {name: np.array(bpy.data.objects[name][uv_layer.PLACE]) for name in ("Cube", "Twin")}
    own = uv_of(cube, "Leaflight")
    expected = {name: np.unique(np.round(own * place[:2] + place[2:], 5), axis=0) for name, place in places.items()}
    assert not np.allclose(expected["Cube"], expected["Twin"])
    export(tmp_path)
    import_again(tmp_path / "room.glb")
    for name in ("Cube", "Twin"):
        mesh = bpy.data.objects[name].data
        assert len(mesh.uv_layers) == 2
        np.testing.assert_allclose(uv_of(bpy.data.objects[name], mesh.uv_layers[-1].name), expected[name], atol=2e-5)


def test_copies_of_instances_bear_their_sources_names(room, tmp_path):
    shown = bpy.data.collections.new("Shown")
    shown.objects.link(bpy.data.objects["Cube"])
    room.collection.objects.unlink(bpy.data.objects["Cube"])
    for x in (-1.0, 1.0):
        empty = bpy.data.objects.new("Place", None)
        empty.instance_type, empty.instance_collection, empty.location.x = "COLLECTION", shown, x
        room.collection.objects.link(empty)
    bake_room(tmp_path, "combined", names=("Floor", "Place", "Place.001"))
    document = export(tmp_path)
    assert sorted(node["name"] for node in document["nodes"]) == ["Ball", "Cube", "Cube.001", "Floor"]


def test_materials_that_use_the_baked_layer_find_it_at_texcoord_0_too(room, tmp_path):
    """The only layer of the floor is the user's own and carries the bake."""
    bake_room(tmp_path, "lighting", names=("Floor",), layer="UVMap")
    export(tmp_path)
    import_again(tmp_path / "room.glb")
    floor = bpy.data.objects["Floor"]
    first, second = (uv_of(floor, layer.name) for layer in floor.data.uv_layers)
    np.testing.assert_array_equal(first, second)
    assert np.ptp(first) == 1.0


def test_textures_and_occlusion_of_the_users_stay_theirs_but_on_baked_objects(room, tmp_path):
    dirt = bpy.data.images.new("dirt", 4, 4)
    dirt.pack()
    wood = bpy.data.materials["Wood"]
    group = bpy.data.node_groups.new("glTF Material Output", "ShaderNodeTree")
    group.interface.new_socket("Occlusion", in_out="INPUT", socket_type="NodeSocketFloat")
    node, texture = wood.node_tree.nodes.new("ShaderNodeGroup"), wood.node_tree.nodes.new("ShaderNodeTexImage")
    node.node_tree, texture.image = group, dirt
    wood.node_tree.links.new(node.inputs[0], texture.outputs["Color"])
    wood.node_tree.links.new(wood.node_tree.nodes["Principled BSDF"].inputs["Base Color"], texture.outputs["Color"])
    bpy.data.objects["Ball"].data.materials.append(wood)
    bake_room(tmp_path, "lighting")
    document = export(tmp_path)
    of_cube, of_ball = (document["materials"][primitive_of(document, name)["material"]] for name in ("Cube", "Ball"))
    names = [document["images"][document["textures"][m["occlusionTexture"]["index"]]["source"]]["name"] for m in (of_cube, of_ball)]
    assert names == ["lightmap_0.lighting", "dirt"]
    assert of_cube["pbrMetallicRoughness"]["baseColorTexture"].get("texCoord", 0) == 0
    manifest = json.loads((tmp_path / "room.lightmap.json").read_text(encoding="utf-8"))
    assert [image["name"] for image in manifest["images"]] == ["lightmap_0.lighting"]


def make_shader(material, kind):
    """A tree of one shader, that feeds the output."""
    tree = material.node_tree
    tree.nodes.clear()
    shader, output = tree.nodes.new(kind), tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(output.inputs["Surface"], shader.outputs[0])
    return tree, shader


def make_striped():
    """An image of red over green."""
    image = bpy.data.images.new("stripes", 4, 2)
    image.pixels.foreach_set(np.repeat(np.array([[1, 0, 0, 1], [0, 1, 0, 1]], np.float32), 4, axis=0).ravel())
    image.pack()
    return image


def read_factors(document, name):
    material = document["materials"][primitive_of(document, name)["material"]]
    pbr = material["pbrMetallicRoughness"]
    return material, pbr.get("baseColorFactor", [1, 1, 1, 1])[:3], pbr.get("metallicFactor", 1)


@pytest.mark.parametrize("passes", ["lighting", "combined"])
def test_a_diffuse_shader_keeps_its_colour(room, tmp_path, passes):
    """The exporter knows the Principled BSDF alone; anything else was white metal."""
    green = bpy.data.materials["Wood"]
    _, shader = make_shader(green, "ShaderNodeBsdfDiffuse")
    shader.inputs["Color"].default_value = (0.1, 0.7, 0.1, 1.0)
    bpy.data.objects["Ball"].data.materials.append(green)
    bake_room(tmp_path, passes)
    document = export(tmp_path)
    for name in ("Ball", "Cube") if passes == "lighting" else ("Ball",):
        _, color, metallic = read_factors(document, name)
        np.testing.assert_allclose(color, (0.1, 0.7, 0.1), atol=1e-6)
        assert metallic == 0
    assert find(document, "materials", "Wood")


def test_colours_of_mixes_and_lamps_are_those_that_were_read(room, tmp_path):
    mixed, lamp = bpy.data.materials["Wood"], bpy.data.materials.new("Lamp")
    if lamp.node_tree is None:  # Blender 4.5
        lamp.use_nodes = True
    tree, mix = make_shader(mixed, "ShaderNodeMixShader")
    mix.inputs[0].default_value = 0.5
    for number, color in enumerate([(0.8, 0.2, 0.0, 1), (0.0, 0.2, 0.4, 1)]):
        part = tree.nodes.new("ShaderNodeBsdfDiffuse")
        part.inputs["Color"].default_value = color
        tree.links.new(mix.inputs[1 + number], part.outputs[0])
    _, glow = make_shader(lamp, "ShaderNodeEmission")
    glow.inputs["Color"].default_value, glow.inputs["Strength"].default_value = (1.0, 0.5, 0.25, 1.0), 6.0
    bpy.data.objects["Floor"].data.materials.append(lamp)
    bake_room(tmp_path, "lighting")
    document = export(tmp_path)
    _, color, metallic = read_factors(document, "Cube")
    np.testing.assert_allclose([*color, metallic], (0.4, 0.2, 0.2, 0.0), atol=1e-6)
    material, color, metallic = read_factors(document, "Floor")
    np.testing.assert_allclose([*color, metallic], 0.0, atol=1e-6)
    strength = material["extensions"]["KHR_materials_emissive_strength"]["emissiveStrength"]
    np.testing.assert_allclose(np.array(material["emissiveFactor"]) * strength, (6.0, 3.0, 1.5), rtol=1e-5)


def test_glass_is_seen_through(room, tmp_path):
    pane = bpy.data.materials.new("Pane")
    _, glass = make_shader(pane, "ShaderNodeBsdfGlass")
    glass.inputs["Color"].default_value, glass.inputs["Roughness"].default_value = (0.9, 0.5, 0.4, 1.0), 0.25
    bpy.data.objects["Ball"].data.materials.append(pane)
    bake_room(tmp_path, "lighting")
    material, color, metallic = read_factors(export(tmp_path), "Ball")
    np.testing.assert_allclose([*color, metallic], (0.9, 0.5, 0.4, 0.0), atol=1e-6)
    assert material["extensions"]["KHR_materials_transmission"]["transmissionFactor"] == 1
    assert material["pbrMetallicRoughness"]["roughnessFactor"] == pytest.approx(0.25)


@pytest.mark.parametrize("name", ["combined", "lighting"])
def test_gaps_that_an_unlit_file_closes_are_told(room, tmp_path, name):
    leaf = bpy.data.materials["Wood"]
    tree, mix = make_shader(leaf, "ShaderNodeMixShader")
    image, clear, paint = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("TexImage", "BsdfTransparent", "BsdfDiffuse"))
    image.image = bpy.data.images.new("Leaf", 4, 4, alpha=True)
    image.image.pixels.foreach_set([0.5, 0.5, 0.5, 0.0] * 8 + [0.5, 0.5, 0.5, 1.0] * 8)
    image.image.pack()
    for number, output in enumerate((image.outputs["Alpha"], clear.outputs[0], paint.outputs[0])):
        tree.links.new(mix.inputs[number], output)
    bake_room(tmp_path, name)
    told = [sentence for _, sentence in export_gltf(bpy.context, tmp_path / "room.glb") if "gaps are closed" in sentence]
    assert len(told) == (name == "combined")
    assert ("alphaMode" in find(read_document((tmp_path / "room.glb").read_bytes()), "materials", "Wood")) == (name == "lighting")


def test_what_nodes_make_of_an_image_is_a_texture_on_its_own_layer(room, tmp_path):
    wood = bpy.data.materials["Wood"]
    tree, shader = make_shader(wood, "ShaderNodeBsdfPrincipled")
    texture, invert, move = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("TexImage", "Invert", "Mapping"))
    texture.image = make_striped()
    move.inputs["Scale"].default_value, move.inputs["Location"].default_value = (2, 3, 1), (0.25, 0.5, 0)
    coordinate = tree.nodes.new("ShaderNodeTexCoord")
    tree.links.new(move.inputs["Vector"], coordinate.outputs["UV"])
    tree.links.new(texture.inputs["Vector"], move.outputs["Vector"])
    tree.links.new(invert.inputs["Color"], texture.outputs["Color"])
    tree.links.new(shader.inputs["Base Color"], invert.outputs["Color"])
    bake_room(tmp_path, "lighting")
    document = export(tmp_path)
    material, _, _ = read_factors(document, "Cube")
    slot = material["pbrMetallicRoughness"]["baseColorTexture"]
    assert slot.get("texCoord", 0) == 0
    np.testing.assert_allclose(slot["extensions"]["KHR_texture_transform"]["scale"], (2, 3))
    name = document["images"][document["textures"][slot["index"]]["source"]]["name"]
    picture = import_again(tmp_path / "room.glb")[name]
    np.testing.assert_allclose(picture[:, 0], [(0, 1, 1), (1, 0, 1)], atol=STEP)


def test_a_colour_on_no_uv_layer_is_its_mean_with_a_sentence(room, tmp_path):
    wood = bpy.data.materials["Wood"]
    tree, shader = make_shader(wood, "ShaderNodeBsdfDiffuse")
    texture, gamma, coordinate = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("TexImage", "Gamma", "TexCoord"))
    texture.image = make_striped()
    tree.links.new(texture.inputs["Vector"], coordinate.outputs["Generated"])
    tree.links.new(gamma.inputs["Color"], texture.outputs["Color"])
    tree.links.new(shader.inputs["Color"], gamma.outputs["Color"])
    bake_room(tmp_path, "lighting")
    warnings = export_gltf(bpy.context, tmp_path / "room.glb")
    assert [subject for subject, _ in warnings] == ["Wood"]
    assert warnings[0][1].endswith("so the .glb has their mean; bake the pass combined to keep them.")
    _, color, _ = read_factors(read_document((tmp_path / "room.glb").read_bytes()), "Cube")
    np.testing.assert_allclose(color, (0.5, 0.5, 0.0), atol=1e-6)


def test_what_cannot_be_exported_is_a_sentence_and_changes_nothing(room, tmp_path, monkeypatch):
    with pytest.raises(ValueError, match="nothing is baked yet: bake the scene first"):
        export_gltf(bpy.context, tmp_path / "room.glb")
    bake_room(tmp_path, "combined")
    before = snapshot()
    (tmp_path / "maps" / "lightmap_0.combined.exr").rename(tmp_path / "away.exr")
    bpy.data.images["lightmap_0.combined"].buffers_free()
    with pytest.raises(ValueError, match=r"lightmap_0\.combined\.exr is missing; bake again\."):
        export_gltf(bpy.context, tmp_path / "room.glb")
    (tmp_path / "away.exr").rename(tmp_path / "maps" / "lightmap_0.combined.exr")
    bpy.data.images["lightmap_0.combined"].reload()
    with pytest.raises(OSError, match=r"room\.glb: cannot be written \(No such file"):
        export_gltf(bpy.context, tmp_path / "none" / "room.glb")
    monkeypatch.setattr("addon_utils.check", lambda name: (False, False))
    with pytest.raises(ValueError, match="glTF exporter is switched off"):
        export_gltf(bpy.context, tmp_path / "room.glb")
    assert snapshot() == before
    assert list_files(tmp_path) == ["job", "maps"]


def test_a_fault_of_blenders_exporter_is_told(room, tmp_path, monkeypatch):
    bake_room(tmp_path, "combined")
    before = snapshot()

    def fail(*_):
        raise AssertionError("a picture has no pixels.")

    monkeypatch.setattr("io_scene_gltf2.ExportGLTF2.execute", fail)
    with pytest.raises(ValueError, match="glTF exporter failed") as caught:
        export_gltf(bpy.context, tmp_path / "room.glb")
    assert str(caught.value) == (
        "Blender's glTF exporter failed (AssertionError: a picture has no pixels): export the scene by File > Export in Blender to see why."
    )
    assert snapshot() == before


@pytest.mark.parametrize("how", ["empty", "packed"])
def test_a_udim_image_that_is_in_no_file_is_named(room, tmp_path, how):
    """Blender's exporter tells an AssertionError without a word."""
    tiled = bpy.data.images.new("Wood", 8, 8, tiled=True)
    if how == "packed":
        tiled.filepath_raw, tiled.file_format = str(tmp_path / "Wood.<UDIM>.png"), "PNG"
        tiled.save()
        tiled.pack()
        (tmp_path / "Wood.1001.png").unlink()
    material = make_material("Planks")
    group = bpy.data.node_groups.new("Look", "ShaderNodeTree")
    group.interface.new_socket("Color", in_out="OUTPUT", socket_type="NodeSocketColor")
    picture, end = group.nodes.new("ShaderNodeTexImage"), group.nodes.new("NodeGroupOutput")
    picture.image = tiled
    group.links.new(picture.outputs[0], end.inputs[0])
    tree = material.node_tree
    within = tree.nodes.new("ShaderNodeGroup")
    within.node_tree = group
    tree.links.new(within.outputs[0], tree.nodes["Principled BSDF"].inputs["Base Color"])
    bpy.data.objects["Floor"].data.materials.append(material)
    bake_room(tmp_path, "lighting")
    with pytest.raises(ValueError, match=r"^Wood: has a UDIM tile without a file, .*; save the image .* of the material Planks\.$"):
        export_gltf(bpy.context, tmp_path / "room.glb")


def test_command_line_exports_and_saves_what_was_asked(room, tmp_path):
    scene = save_scene(tmp_path / "room.blend")
    words = (
        "--gltf",
        str(tmp_path / "out" / "room.glb"),
        "--save",
        str(tmp_path / "saved.blend"),
        "--no-assign",
        "--pass",
        "lighting",
        "--error",
        "0.5",
    )
    assert bake(scene, *words) == 0
    assert list_files(tmp_path / "out") == ["room.glb", "room.lightmap.json"]
    assert read_report(scene)["warnings"] == []
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "saved.blend"))
    assert not restore.has_bake(bpy.context.scene)


def test_command_line_refuses_another_ending_before_it_bakes(room, tmp_path, capsys):
    scene = save_scene(tmp_path / "room.blend")
    assert bake(scene, "--gltf", str(tmp_path / "room.gltf")) == 1
    assert "give it a name that ends in .glb." in capsys.readouterr().err
    assert list_files(tmp_path) == ["room.blend"]


def read_floats(path):
    """All numbers of the file's accessors of floats."""
    data = path.read_bytes()
    document = read_document(data)
    binary = data[len(data) - document["buffers"][0]["byteLength"] :]
    views = [document["bufferViews"][one["bufferView"]] for one in document["accessors"] if one["componentType"] == 5126]
    return np.concatenate([np.frombuffer(binary, "<f4", view["byteLength"] // 4, view.get("byteOffset", 0)) for view in views])


def test_what_is_no_number_is_zero_in_the_file_and_told(room, tmp_path):
    """Coordinates, UVs and colours of the user's stay as they are."""
    cube, ball = bpy.data.objects["Cube"].data, bpy.data.objects["Ball"].data
    ball.vertices[0].co.x = np.nan
    cube.uv_layers["UVMap"].uv[0].vector = (np.inf, 0.0)
    cube.color_attributes.new("Paint", "FLOAT_COLOR", "CORNER").data[0].color[1] = np.nan
    bake_room(tmp_path, "lighting")
    told = dict(export_gltf(bpy.context, tmp_path / "room.glb"))
    for name in ("Cube", "Ball"):
        assert told[name] == f"{name}: has values that are no numbers, which are 0 in the .glb; mend them."
    assert np.isfinite(read_floats(tmp_path / "room.glb")).all()
    assert np.isnan(ball.vertices[0].co.x)


def test_nodes_that_feed_themselves_are_exported(room, tmp_path):
    """Blender's exporter follows them without end."""
    tree = bpy.data.materials["Wood"].node_tree
    first, second = tree.nodes.new("ShaderNodeNormalMap"), tree.nodes.new("ShaderNodeBump")
    shader = tree.nodes["Principled BSDF"]
    tree.links.new(shader.inputs["Normal"], second.outputs[0])
    tree.links.new(second.inputs["Normal"], first.outputs[0])
    tree.links.new(first.inputs["Color"], first.outputs[0])
    shader.inputs["Roughness"].default_value = np.nan
    shader.inputs["Base Color"].default_value = (0.5, np.inf, 0.5, 1.0)
    bpy.data.objects["Ball"].data.materials.append(bpy.data.materials["Wood"])
    bake_room(tmp_path, "lighting")
    links = len(tree.links)
    export_gltf(bpy.context, tmp_path / "room.glb")
    assert {one["name"] for one in read_document((tmp_path / "room.glb").read_bytes())["nodes"]} >= {"Cube", "Ball"}
    assert len(tree.links) == links
