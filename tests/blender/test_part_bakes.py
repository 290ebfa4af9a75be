"""A bake of some objects leaves the others the bake that they carry: in the panel, on the command line, in the .glb."""

import shutil

import pytest

bpy = pytest.importorskip("bpy")

from blend_dump import differences, dump
from blend_rooms import add_twin, list_files, open_room, read_pixels, save_baked, save_scene, use_addon
from blend_rooms import bake as bake_by_command
from leaflight.addon.read import baked_copies
from leaflight.addon.show import materials_write, restore
from leaflight.addon.show.images import find_path

FILES = [f"room_{page}.combined.exr" for page in range(2)]


@pytest.fixture(scope="module")
def baked(tmp_path_factory):
    """A folder with the room's file, all of it baked: the cube, which is mirrored, as a copy; and a twin that shares the floor's mesh."""
    with use_addon():
        open_room()
        bpy.data.objects["Cube"].modifiers.new("Mirror", "MIRROR").use_axis = (False, False, True)
        add_twin()
        return save_baked(tmp_path_factory.mktemp("baked"), size=48)


@pytest.fixture(autouse=True)
def maps(baked_room):
    """The folder of the images; half the light is left."""
    bpy.data.objects["Lamp"].data.energy /= 2.0
    return baked_room / "maps"


def bake(*names):
    """A bake by the button of these objects, or of all."""
    for obj in bpy.context.view_layer.objects:
        obj.select_set(baked_copies.find_source(obj).name in names)
    bpy.context.scene.leaflight.objects = "SELECTED" if names else "ALL"
    assert bpy.ops.leaflight.bake() == {"FINISHED"}


def look(name):
    """What an object shows: the page's folder and name, UVs, and place; None where it wears its own material."""
    obj = bpy.data.objects[name]
    if not materials_write.is_shown(obj):
        return None
    path, layer = find_path(materials_write.find_image(obj)), obj.data.uv_layers["Leaflight"]
    return path.parent.name, path.name, tuple(tuple(one.vector) for one in layer.uv), tuple(obj.get("leaflight_uv", ()))


def test_the_others_keep_their_pages_and_their_files(maps):
    others = ("Floor", "Twin")
    before, content = [look(name) for name in others], (maps / FILES[0]).read_bytes()
    cube = look("Cube.Leaflight")
    bake("Cube")
    assert [look(name) for name in others] == before
    assert None not in before
    assert (maps / FILES[0]).read_bytes() == content
    assert look("Cube.Leaflight")[1] == FILES[1]
    assert cube[1] == FILES[0]
    assert list_files(maps) == ["room.refine", *FILES]
    bpy.data.objects["Lamp"].data.energy *= 3.0
    bake("Cube")
    assert list_files(maps) == ["room.refine", *FILES], "the cube's own page is free for it"
    bake()
    assert {look(name)[1] for name in ("Floor", "Twin", "Cube.Leaflight")} == {FILES[0]}


def test_one_of_two_that_share_a_mesh(maps):
    """And the copy that stands for the cube stays in its place."""
    kept = [look(name) for name in ("Floor", "Cube.Leaflight")]
    mesh = bpy.data.objects["Floor"].data
    bake("Twin")
    assert [look(name) for name in ("Floor", "Cube.Leaflight")] == kept
    assert look("Twin")[1] == FILES[1]
    assert bpy.data.objects["Twin"].data != mesh
    assert bpy.data.objects["Cube"].hide_render
    assert not bpy.data.objects["Cube.Leaflight"].hide_render
    assert bpy.ops.leaflight.remove() == {"FINISHED"}
    assert bpy.data.objects["Twin"].data == mesh
    assert not restore.has_bake(bpy.context.scene)
    assert not bpy.data.objects["Cube"].hide_render


def test_removing_after_a_part_leaves_no_trace(maps):
    bpy.ops.leaflight.remove()
    bpy.context.scene.leaflight.objects = "SELECTED"
    before = dump()
    bake()
    bake("Cube")
    bpy.ops.leaflight.remove()
    for obj in bpy.context.view_layer.objects:
        obj.select_set(False)
    found = [line for line in differences(before, dump()) if "select" not in line]
    assert found == []


def test_refine_goes_on_with_the_objects_of_the_last_bake(maps):
    bpy.context.scene.leaflight.gather = False
    bake("Cube")
    floor = look("Floor")
    bpy.context.scene.leaflight.objects = "ALL"
    assert bpy.ops.leaflight.refine() == {"FINISHED"}
    assert look("Floor") == floor
    assert look("Cube.Leaflight")[1] == FILES[1]


def test_a_part_by_the_command_line(maps, tmp_path):
    before = look("Floor")
    room = save_scene(tmp_path / "room.blend")
    assert bake_by_command(room, "--objects", "Cube", "--save", str(tmp_path / "out.blend"), "--gltf", str(tmp_path / "out.glb")) == 0
    assert list_files(maps) == ["room.refine", *FILES]
    assert look("Floor") == before
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "out.blend"))
    assert look("Floor") == before
    assert look("Cube.Leaflight")[1] == FILES[1]
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.import_scene.gltf(filepath=str(tmp_path / "out.glb"))
    assert sorted(image.name for image in bpy.data.images if image.users and image.size[0]) == ["room_0.combined", "room_1.combined"]


def test_a_part_of_a_scene_without_a_bake_has_the_names_of_any(maps, tmp_path):
    bpy.ops.leaflight.remove()
    shutil.rmtree(maps)
    bake("Cube")
    assert list_files(maps) == ["room.refine", FILES[0]]
    assert read_pixels(maps / FILES[0]).shape[:2] == (48, 48)
    assert look("Floor") is None
