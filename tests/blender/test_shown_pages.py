"""After undo, redo, opening, reverting or copying a file, objects wear the light that belongs to their UVs, or their own materials."""

import shutil

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blend_rooms import bake as bake_by_command
from blend_rooms import open_room, save_baked, save_scene, use_addon
from leaflight.addon.app import kept_state
from leaflight.addon.show import images, restore, shown_pages
from leaflight.addon.show.layout import worn_folder, worn_result
from leaflight.addon.show.page_store import STORE


@pytest.fixture(scope="module")
def baked(tmp_path_factory):
    """A folder with the room's file, saved with a bake by the button of 48 x 48 texels."""
    with use_addon():
        open_room()
        return save_baked(tmp_path_factory.mktemp("baked"), size=48)


@pytest.fixture(autouse=True)
def first(baked_room):
    """What the objects look like."""
    bpy.ops.ed.undo_push(message="opened")
    return look()


def bake(size):
    """A bake by the button, of another layout than one of another size; gives what the objects then look like."""
    bpy.context.scene.leaflight.size = size
    assert bpy.ops.leaflight.bake() == {"FINISHED"}
    bpy.ops.ed.undo_push(message="bake")
    return look()


def look(names=("Floor", "Cube")):
    """Per object what it shows: UVs and the image's pixels as Blender reads them; None where it wears its own material."""
    seen = {}
    for name in names:
        obj = bpy.data.objects[name]
        trees = [slot.material.node_tree for slot in obj.material_slots if slot.material]
        image = next((node.image for tree in trees for node in tree.nodes if node.type == "TEX_IMAGE" and node.image), None)
        if image is None:
            seen[name] = None
            continue
        uv, pixels = np.empty(2 * len(obj.data.loops), np.float32), np.empty(len(image.pixels), np.float32)
        obj.data.uv_layers["Leaflight"].uv.foreach_get("vector", uv)
        image.pixels.foreach_get(pixels)
        seen[name] = (uv.tobytes(), pixels.tobytes(), len(pixels))
    return seen


def is_bare(names=("Floor", "Cube")):
    return look(names) == dict.fromkeys(names)


def test_undo_and_redo_bring_back_each_bake_with_its_own_light(first):
    scene, second = bpy.context.scene, bake(32)
    assert None not in first.values()
    assert first != second
    told = worn_result(scene)
    bpy.ops.ed.undo()
    scene = bpy.context.scene
    assert look() == first
    assert worn_result(scene) != told, "the panel tells of the bake that is worn"
    assert not kept_state.find_state(scene), "what is kept is the second bake's"
    bpy.ops.ed.redo()
    scene = bpy.context.scene
    assert look() == second
    assert worn_result(scene) == told
    assert kept_state.find_state(scene)


def test_a_bake_of_the_same_layout_is_undone_too(first):
    bpy.data.objects["Lamp"].data.energy = 40.0
    bpy.ops.ed.undo_push(message="lamp")
    second = bake(48)
    assert first["Floor"][0] == second["Floor"][0]
    assert first != second
    bpy.data.objects["Lamp"].data.energy = 10.0
    bpy.ops.ed.undo_push(message="lamp")
    assert bake(48) not in (first, second)
    bpy.ops.ed.undo()
    assert look() == second
    bpy.ops.ed.undo()
    bpy.ops.ed.undo()
    assert look() == first


def test_a_file_that_is_opened_again_wears_what_it_was_saved_with(first, tmp_path):
    bake(32)
    bpy.ops.wm.revert_mainfile()
    assert look() == first
    assert "1 page of 48 x 48 texels" in worn_result(bpy.context.scene).lines
    assert worn_folder(bpy.context.scene) == tmp_path / "maps"
    meter = bpy.context.window_manager.leaflight_meter
    meter.measure(bpy.context)
    least_s, most_s = meter.estimate.seconds
    assert least_s == most_s, "it knows how long the last bake took"


def test_a_copy_of_the_file_keeps_its_light_when_the_first_is_baked_again(first, tmp_path):
    save_scene(tmp_path / "copy.blend")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "room.blend"))
    bake(32)
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "room.blend"))
    bpy.ops.wm.save_mainfile()  # nothing of the first bake is needed by this file any more
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "copy.blend"))
    assert look() == first


def count_kept(tmp_path):
    return len(list((tmp_path / "maps" / STORE).iterdir()))


def test_earlier_pages_go_once_the_file_was_opened_and_saved_without_them(first, tmp_path):
    second = bake(32)
    bpy.ops.wm.save_mainfile()
    assert count_kept(tmp_path) == 2
    bpy.ops.ed.undo()
    assert look() == first, "undo still works after saving"
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "room.blend"))
    bpy.ops.wm.save_mainfile()
    assert count_kept(tmp_path) == 1
    assert look() == second


def test_a_file_without_its_images_shows_its_own_materials_and_says_why(first, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    shutil.copy(tmp_path / "room.blend", tmp_path / "elsewhere" / "room.blend")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "elsewhere" / "room.blend"))
    scene, folder = bpy.context.scene, tmp_path / "elsewhere" / "maps"
    assert is_bare()
    assert scene[shown_pages.MISSING].startswith(f"room_0.combined.exr: the baked image is missing from {folder}, so ")
    assert restore.has_bake(scene)
    bpy.ops.leaflight.toggle_preview()
    assert is_bare(), "not pink"
    shutil.copytree(tmp_path / "maps", folder)
    bpy.ops.leaflight.toggle_preview()
    assert look() == first
    assert shown_pages.MISSING not in scene


def test_an_undo_to_a_page_that_was_deleted_shows_own_materials(tmp_path):
    bake(32)
    shutil.rmtree(tmp_path / "maps" / STORE)
    bpy.ops.ed.undo()
    assert is_bare()
    assert shown_pages.MISSING in bpy.context.scene


def test_images_copied_without_the_hidden_folder_are_enough(first, tmp_path):
    (tmp_path / "elsewhere" / "maps").mkdir(parents=True)
    for name in ("room.blend", "maps/room_0.combined.exr"):
        shutil.copy(tmp_path / name, tmp_path / "elsewhere" / name)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "elsewhere" / "room.blend"))
    assert look() == first


def test_packed_pages_need_no_file(first, tmp_path):
    bpy.context.scene.leaflight.pack = True
    second = bake(32)
    bpy.ops.wm.save_mainfile()
    bpy.ops.ed.undo()
    assert look() == first
    shutil.rmtree(tmp_path / "maps")
    bpy.ops.wm.revert_mainfile()
    assert look() == second


def test_a_file_of_an_earlier_version_is_safe_from_the_next_bake(first, tmp_path):
    """Its image is the very file that a bake overwrites."""
    image = bpy.data.images["room_0.combined"]
    image.filepath = "//maps/room_0.combined.exr"
    del image[images.PAGE]
    bpy.ops.wm.save_mainfile()
    shutil.rmtree(tmp_path / "maps" / STORE)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "room.blend"))
    bpy.ops.ed.undo_push(message="opened")
    bake(32)
    bpy.ops.ed.undo()
    assert look() == first


def test_files_of_two_commands_into_one_folder_keep_their_own_light(tmp_path):
    """Each names a page that the other does not write over: it may be opened without the add-on."""
    bpy.ops.leaflight.remove()
    room = save_scene(tmp_path / "bare.blend")
    seen = []
    for size in ("24", "32"):
        assert bake_by_command(room, "--size", size, "--max-pages", "1", "--save", str(tmp_path / f"{size}.blend")) == 0
        assert bpy.data.images["bare_0.combined"].filepath.startswith("//maps/.leaflight_pages/")
        seen.append(look())
    assert seen[0] != seen[1]
    kept = count_kept(tmp_path)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "24.blend"))
    assert look() == seen[0]
    assert bake_by_command(room, "--size", "28", "--max-pages", "1", "--save", str(tmp_path / "24.blend")) == 0
    assert count_kept(tmp_path) == kept, "the page of the file that was replaced is gone"
