"""Two scenes of one file, with meshes and objects that both show: neither bake harms the other."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blend_dump import differences, dump
from blend_rooms import ask_quick_bake, open_room
from leaflight.addon.show import materials_write, restore


@pytest.fixture(autouse=True)
def _scenes(addon, tmp_path):
    """The room, and a scene "B/c" whose only mesh object is a twin of its cube; the lamp is in both."""
    open_room()
    other = bpy.data.scenes.new("B/c")
    twin = bpy.data.objects.new("Twin", bpy.data.objects["Cube"].data)
    for obj in (twin, bpy.data.objects["Lamp"]):
        other.collection.objects.link(obj)
    for scene in bpy.data.scenes:
        ask_quick_bake(tmp_path / "maps", scene)


def run(scene_name, operator):
    bpy.context.window.scene = bpy.data.scenes[scene_name]
    assert getattr(bpy.ops.leaflight, operator)() == {"FINISHED"}


def look(name):
    """What an object shows: its image, and the UVs of its corners in the layer that its material reads."""
    obj = bpy.data.objects[name]
    tree = obj.material_slots[0].material.node_tree
    layer = next(node.uv_map for node in tree.nodes if node.type == "UVMAP")
    uv = np.empty(2 * len(obj.data.loops), np.float32)
    obj.data.uv_layers[layer].uv.foreach_get("vector", uv)
    return next(node.image.filepath for node in tree.nodes if node.type == "TEX_IMAGE"), uv.tolist()


def test_a_bake_of_one_scene_leaves_the_other_s_as_it_is(tmp_path):
    mesh = bpy.data.objects["Cube"].data
    run("Scene", "bake")
    first = look("Cube")
    before = dump()
    run("B/c", "bake")
    told = dict(bpy.context.window_manager.leaflight_state.warnings)
    assert "its mesh shows another bake, so it shows the bake on a copy" in told["Twin"]
    assert look("Cube") == first
    assert look("Twin") != first
    run("B/c", "remove")
    assert bpy.data.objects["Twin"].data == mesh
    assert differences(before, dump()) == []
    files = [path.name for path in (tmp_path / "maps").glob("*.exr")]
    assert sorted(files) == ["lightmap_B_c_0.combined.exr", "lightmap_Scene_0.combined.exr"]


def test_the_panel_tells_of_the_bake_of_its_own_scene():
    state, uid = bpy.context.window_manager.leaflight_state, {scene.name: scene.session_uid for scene in bpy.data.scenes}
    run("Scene", "bake")
    first = state.summarize()
    bpy.data.scenes["B/c"].leaflight.size = 48
    run("B/c", "bake")
    second = state.summarize()
    assert first[-1] != second[-1]
    assert (list(state.describe_worn(uid["Scene"])), list(state.describe_worn(uid["B/c"]))) == (first, second)
    assert [subject for subject, _ in state.list_warnings(uid["B/c"], has_bake=True)] == ["Twin"]
    assert state.list_warnings(uid["Scene"], has_bake=True) == []
    run("Scene", "remove")
    assert state.summarize() == second
    run("B/c", "remove")
    assert state.summarize() == []


def test_a_bake_beside_an_unbaked_twin_keeps_its_layer():
    """The twin is not baked, but its scene is: what is taken off there before a bake must not reach the mesh."""
    run("Scene", "bake")
    first = look("Cube")
    bpy.data.objects["Twin"].leaflight.role = "CAST"
    bpy.data.scenes["B/c"].collection.objects.link(bpy.data.objects["Floor"])
    run("B/c", "bake")
    assert look("Cube") == first
    assert look("Floor")[0] != first[0]  # an object in both scenes shows the latest


def test_a_twin_that_is_in_no_scene_any_more_takes_no_mesh():
    run("B/c", "bake")
    twin = bpy.data.objects["Twin"]
    twin.use_fake_user = True
    bpy.data.scenes["B/c"].collection.objects.unlink(twin)
    assert materials_write.find_worn_meshes() == set()
    run("Scene", "bake")
    assert restore.is_preview_on(bpy.data.scenes["Scene"])
    assert not bpy.context.window_manager.leaflight_state.warnings


def test_an_object_of_both_scenes_wears_the_later_bake(tmp_path):
    """Remove in one of them leaves nothing of the other's bake, which nobody could take off any more."""
    cube, other = bpy.data.objects["Cube"], bpy.data.scenes["B/c"]
    other.collection.objects.unlink(bpy.data.objects["Twin"])
    other.collection.objects.link(cube)
    before = dump()
    run("Scene", "bake")
    assert not [text for _, text in bpy.context.window_manager.leaflight_state.warnings if "scene" in text]
    run("B/c", "bake")
    told = dict(bpy.context.window_manager.leaflight_state.warnings)
    assert told["Cube"].startswith("Cube: is in the scene Scene too, which now shows this bake on it")
    run("Scene", "remove")
    assert not restore.has_bake(other)
    assert differences(before, dump()) == []
