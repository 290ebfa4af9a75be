"""Scenes from files: each format that is promised, light for models without any, and sentences for what cannot be read."""

import json
import os

import pytest

bpy = pytest.importorskip("bpy")

from blend_rooms import add_object, make_material, open_room, save_scene
from leaflight.addon.read.blender_output import hold_output
from leaflight.addon.read.scene_file import choose_scene, open_scene

EXPORTERS = {
    ".glb": lambda path: bpy.ops.export_scene.gltf(filepath=path, export_format="GLB", export_lights=True),
    ".gltf": lambda path: bpy.ops.export_scene.gltf(filepath=path, export_format="GLTF_SEPARATE", export_lights=True),
    ".obj": lambda path: bpy.ops.wm.obj_export(filepath=path),
    ".fbx": lambda path: bpy.ops.export_scene.fbx(filepath=path),
    ".usda": lambda path: bpy.ops.wm.usd_export(filepath=path),
    ".usdc": lambda path: bpy.ops.wm.usd_export(filepath=path),
}
KEEP_LIGHTS = [kind for kind in EXPORTERS if kind != ".obj"]


@pytest.fixture(autouse=True)
def _room():
    open_room()


def paint(strength, color):
    """A material for the cube that glows so."""
    material = make_material("Paint")
    inputs = material.node_tree.nodes["Principled BSDF"].inputs
    inputs["Emission Strength"].default_value, inputs["Emission Color"].default_value = strength, (*color, 1.0)
    bpy.data.objects["Cube"].data.materials.append(material)
    return material


def remove_lamp():
    bpy.data.objects.remove(bpy.data.objects["Lamp"])


def write(folder, kind):
    path = folder / f"model{kind}"
    EXPORTERS[kind](str(path))
    return path


def world_light():
    """Strength times colour of the open scene's world, None without one."""
    world = bpy.context.scene.world
    if world is None:
        return None
    background = next(node for node in world.node_tree.nodes if node.type == "BACKGROUND")
    return [background.inputs["Strength"].default_value * value for value in background.inputs["Color"].default_value[:3]]


def test_blend_is_opened_as_it_is(tmp_path):
    remove_lamp()
    path = save_scene(tmp_path / "room.blend")
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    assert open_scene(path) == []
    assert bpy.data.filepath == str(path)
    assert set(bpy.data.objects.keys()) == {"Floor", "Cube"}
    assert world_light() is None  # a scene that its maker left dark


@pytest.mark.parametrize("kind", EXPORTERS)
def test_model_without_light_gets_a_world(tmp_path, kind):
    remove_lamp()
    paint(1.0, (0.0, 0.0, 0.0))  # importers leave strength 1 beside black: no light
    path = write(tmp_path, kind)
    warnings = open_scene(path)
    assert [subject for subject, _ in warnings] == [path.name]
    assert "has no light, so a white world" in warnings[0][1]
    assert world_light() == [1.0, 1.0, 1.0]
    assert {obj.name for obj in bpy.data.objects if obj.type == "MESH"} == {"Floor", "Cube"}
    assert bpy.data.filepath == ""


@pytest.mark.parametrize("kind", KEEP_LIGHTS)
def test_model_with_a_lamp_gets_no_world(tmp_path, kind):
    assert open_scene(write(tmp_path, kind)) == []
    assert any(obj.type == "LIGHT" for obj in bpy.data.objects)
    assert world_light() is None


@pytest.mark.parametrize("kind", [".glb", ".obj"])
def test_model_that_glows_gets_no_world(tmp_path, kind):
    remove_lamp()
    paint(2.0, (1.0, 0.5, 0.0))
    assert open_scene(write(tmp_path, kind)) == []
    assert world_light() is None


def test_emission_node_and_driven_emission_count_as_light(tmp_path):
    """As in files of other makers; ours come through the importer only."""
    from leaflight.addon.read import scene_file

    remove_lamp()
    material = paint(0.0, (1.0, 1.0, 1.0))
    assert scene_file._light_by_world(tmp_path / "model.glb") != []
    bpy.context.scene.world = None
    nodes = material.node_tree.nodes
    value = nodes.new("ShaderNodeValue")
    link = material.node_tree.links.new(value.outputs[0], nodes["Principled BSDF"].inputs["Emission Strength"])
    assert scene_file._light_by_world(tmp_path / "model.glb") == []
    material.node_tree.links.remove(link)
    nodes.new("ShaderNodeEmission")
    assert scene_file._light_by_world(tmp_path / "model.glb") == []


@pytest.mark.parametrize("kind", [".glb", ".obj", ".usdc", ".blend"])
def test_damaged_file(tmp_path, kind):
    path = tmp_path / f"model{kind}"
    path.write_bytes(b"\x07garbage\n" * 40)
    with pytest.raises(ValueError, match=rf"^model\{kind}: Blender (cannot read it, the file seems damaged|finds no mesh in it)"):
        open_scene(path)


def test_what_blender_prints_is_kept_back_and_dropped_where_it_fails(capfd):
    with hold_output():
        os.write(1, b"well\n")
        os.write(2, b"done\n")
        assert capfd.readouterr() == ("", "")
    assert capfd.readouterr() == ("", "well\ndone\n")

    @hold_output()
    def fail():
        os.write(2, b"Traceback\n")
        raise ValueError("so")

    with pytest.raises(ValueError, match="so"):
        fail()
    os.write(1, b"after")
    assert capfd.readouterr() == ("after", "")


def test_fault_inside_an_importer_is_told_without_its_traceback(tmp_path):
    path = tmp_path / "model.gltf"
    path.write_text('{"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [5]}], "nodes": []}')
    with pytest.raises(ValueError, match=r"^model\.gltf: Blender cannot read it, .* \(\w+Error: .*\); save it again\.$"):
        open_scene(path)


def test_model_without_mesh(tmp_path):
    for name in ("Floor", "Cube"):
        bpy.data.objects.remove(bpy.data.objects[name])
    with pytest.raises(ValueError, match=r"^model\.glb: Blender finds no mesh in it;"):
        open_scene(write(tmp_path, ".glb"))


def test_missing_file_folder_and_unknown_kind(tmp_path):
    with pytest.raises(ValueError, match=r"none\.glb: no such file; check the path\.$"):
        open_scene(tmp_path / "none.glb")
    (tmp_path / "folder.blend").mkdir()
    with pytest.raises(ValueError, match=r"folder\.blend: is a folder, not a scene;"):
        open_scene(tmp_path / "folder.blend")
    (tmp_path / "scene.max").write_text("")
    with pytest.raises(ValueError, match=r"^scene\.max: is not a kind of scene .* \.blend, \.glb, .*\.usdc\.$"):
        open_scene(tmp_path / "scene.max")
    assert "Cube" in bpy.data.objects  # what was open stays


def test_ending_in_capitals(tmp_path):
    path = write(tmp_path, ".glb").rename(tmp_path / "MODEL.GLB")
    open_scene(path)
    assert "Cube" in bpy.data.objects


def write_glb(path, extension):
    document = json.dumps({"asset": {"version": "2.0"}, "extensionsUsed": [extension], "extensionsRequired": [extension]}).encode()
    document += b" " * (-len(document) % 4)
    head = b"glTF" + (2).to_bytes(4, "little") + (20 + len(document)).to_bytes(4, "little")
    path.write_bytes(head + len(document).to_bytes(4, "little") + b"JSON" + document)


@pytest.mark.parametrize(
    ("extension", "name"), [("EXT_meshopt_compression", "meshopt"), ("KHR_draco_mesh_compression", "Draco"), ("KHR_none", "")]
)
def test_a_compressed_file_is_not_called_damaged(tmp_path, extension, name):
    write_glb(tmp_path / "room.glb", extension)
    with pytest.raises(ValueError, match=r"^room\.glb: ") as caught:
        open_scene(tmp_path / "room.glb")
    told = str(caught.value)
    assert (f"its meshes are compressed by {name}, which this Blender cannot unpack" in told) == bool(name)
    assert ("damaged" in told or "no mesh" in told) == (not name)


def test_a_driver_that_needs_python_is_named_unless_scripts_may_run(tmp_path):
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    for name, expression in (("Python", "len(str(frame))"), ("Simple", "frame * 2")):
        lamp = add_object(name, bpy.data.lights.new(name, "POINT"))
        lamp.driver_add("location", 2).driver.expression = expression
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "driven.blend"))
    ((subject, text),) = open_scene(tmp_path / "driven.blend")
    assert subject == "Python"
    assert "needs Python" in text
    assert "--enable-scripts" in text
    assert open_scene(tmp_path / "driven.blend", scripts=True) == []


def test_scene_view_layer_and_frame_are_chosen(tmp_path):
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    night = bpy.data.scenes.new("Night")
    night.view_layers.new("Walls")
    choose_scene(bpy.context, "Night", "Walls", 7)
    assert (bpy.context.scene.name, bpy.context.view_layer.name, night.frame_current) == ("Night", "Walls", 7)
    choose_scene(bpy.context, "", "", None)
    assert (bpy.context.scene.name, night.frame_current) == ("Night", 7)
    with pytest.raises(ValueError, match=r"^--scene Day: there is no such scene; the file has: Night, Scene\.$"):
        choose_scene(bpy.context, "Day", "", None)
    with pytest.raises(ValueError, match=r"^--view-layer Roof: Night has no such one; it has: ViewLayer, Walls\.$"):
        choose_scene(bpy.context, "Night", "Roof", None)
