"""Refine: a bake goes on from what was kept of it, in Blender and on the command line."""

import shutil
from dataclasses import replace

import pytest

bpy = pytest.importorskip("bpy")

from blend_rooms import bake, open_room, read_report, save_baked, save_scene, use_addon
from leaflight.addon.app import kept_state, session
from leaflight.addon.app.arguments import BakeRequest
from leaflight.addon.show import layout, restore
from leaflight.core.bake.checkpoint import read_info
from leaflight.core.util.settings import Settings


@pytest.fixture(scope="module")
def baked(tmp_path_factory):
    """A folder with the room's file, baked once and coarsely, and its images."""
    with use_addon():
        open_room()
        assert not bpy.ops.leaflight.refine.poll()
        return save_baked(tmp_path_factory.mktemp("baked"), size=32, max_photons=20_000)


@pytest.fixture
def room(baked_room):
    return bpy.context.scene


@pytest.fixture
def kept(tmp_path):
    return tmp_path / "maps" / "room.refine"


def test_refine_goes_on_to_half_the_error_or_to_the_panels(room, state, kept):
    first = read_info(kept)
    assert first.photons == 20_000
    assert kept_state.find_state(room) == kept
    bpy.ops.leaflight.refine()
    second = state.result
    assert first.photons < second["photons"] <= 40_000  # as many again as the panel allows
    assert second["estimated_error"] < first.error
    room.leaflight.error, room.leaflight.max_photons = 0.9 * second["estimated_error"], 10**8
    bpy.ops.leaflight.refine()
    assert state.result["stopped_by"] == "error"
    assert state.result["estimated_error"] <= room.leaflight.error
    assert state.result["photons"] >= second["photons"]
    assert read_info(kept).photons == state.result["photons"]


@pytest.mark.parametrize("pack", [False, True])
def test_refine_works_on_a_file_that_was_saved_elsewhere(room, state, kept, tmp_path, pack):
    """Blender rewrites paths of images then, and no paths in custom properties."""
    if pack:
        room.leaflight.pack = True
        bpy.ops.leaflight.bake()
    (tmp_path / "deep" / "deeper").mkdir(parents=True)
    save_scene(tmp_path / "deep" / "deeper" / "other.blend")
    assert kept_state.find_state(room) == kept
    bpy.ops.leaflight.refine()
    assert state.result["photons"] > 20_000


def test_refine_works_where_the_folder_was_moved(room, tmp_path):
    save_scene(tmp_path / "room.blend")
    moved = tmp_path.with_name(f"{tmp_path.name}_moved")
    tmp_path.rename(moved)
    bpy.ops.wm.open_mainfile(filepath=str(moved / "room.blend"))
    assert kept_state.find_state(bpy.context.scene) == moved / "maps" / "room.refine"


def test_images_that_are_gone_leave_no_state_to_find(room):
    assert kept_state.find_state(room)
    for image in layout.worn_images(room).values():
        bpy.data.images.remove(image)
    assert not kept_state.find_state(room)
    bpy.ops.leaflight.remove()


def test_a_changed_scene_or_method_is_refused_and_the_bake_stays(room, state):
    bpy.data.objects["Lamp"].data.energy = 50.0
    with pytest.raises(RuntimeError, match=r"Changed since this bake: Lamp\. Refine cannot go on from it: press Bake, or undo"):
        bpy.ops.leaflight.refine()
    assert restore.is_preview_on(room)
    bpy.data.objects["Lamp"].data.energy = 100.0
    room.leaflight.size = 48
    with pytest.raises(RuntimeError, match="another size"):
        bpy.ops.leaflight.refine()
    room.leaflight.size = 32
    assert bpy.ops.leaflight.refine() == {"FINISHED"}


def test_remove_deletes_the_state(room, kept):
    assert kept.is_dir()
    bpy.ops.leaflight.remove()
    assert not kept.exists()
    assert not [name for name, _ in room.items() if name.startswith("leaflight_")]
    assert not bpy.ops.leaflight.refine.poll()


def list_state(kept):
    return {path.relative_to(kept): path.read_bytes() for path in kept.rglob("*") if path.is_file()}


@pytest.mark.parametrize("folder", [".", "deep"])
def test_a_file_saved_under_another_name_leaves_the_first_one_s_state_alone(room, state, kept, tmp_path, folder):
    """It goes on from it, keeps its own, and takes away no other."""
    bpy.ops.wm.save_mainfile()
    first = list_state(kept)
    (tmp_path / folder).mkdir(exist_ok=True)
    save_scene(tmp_path / folder / "other.blend")
    bpy.ops.leaflight.refine()
    own = tmp_path / folder / "maps" / "other.refine"
    assert kept_state.find_state(room) == own
    assert list_state(kept) == first
    bpy.ops.leaflight.remove()
    assert not own.exists()
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "room.blend"))
    assert kept_state.find_state(bpy.context.scene) == kept
    save_scene(tmp_path / folder / "third.blend")
    bpy.ops.leaflight.remove()
    assert list_state(kept) == first
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "room.blend"))
    assert bpy.ops.leaflight.refine() == {"FINISHED"}
    assert state.result["photons"] > 20_000


def test_a_copy_of_a_scene_leaves_the_first_one_s_state_alone(room, kept):
    bpy.ops.scene.new(type="FULL_COPY")
    copy = bpy.context.scene
    assert copy != room
    assert kept_state.find_state(copy) == kept
    bpy.ops.leaflight.remove()
    assert kept_state.find_state(room) == kept
    bpy.context.window.scene = room
    bpy.ops.leaflight.remove()
    assert not kept.exists(), "the last one takes it away"


@pytest.mark.parametrize("how", ["remove", "delete"])
def test_an_unchanged_bake_whose_state_is_gone_is_baked_again(room, state, kept, how):
    """Else Refine would be grey for ever. After an undo of Remove, too, the bake is there and its state is not."""
    if how == "remove":
        bpy.ops.leaflight.remove()
    else:
        shutil.rmtree(kept)
    bpy.ops.leaflight.bake()
    assert state.summarize()[0].startswith("Baked in ")
    assert bpy.ops.leaflight.refine() == {"FINISHED"}
    assert state.result["photons"] > 20_000


def test_an_unchanged_bake_that_never_had_a_state_is_kept(room, state, kept):
    room.leaflight.main_pass = "direct"
    bpy.ops.leaflight.bake()
    assert not kept.exists()
    bpy.ops.leaflight.bake()
    assert state.summarize()[0].startswith("Unchanged since the last bake")


def read_tooltip():
    """What the grey button says."""
    assert not bpy.ops.leaflight.refine.poll()
    with pytest.raises(RuntimeError) as found:
        bpy.ops.leaflight.refine()
    return str(found.value)


@pytest.mark.parametrize(
    ("result", "why"),
    [
        ({"stopped_by": "interrupted", "photons": 9}, "it was stopped too early. Press Bake"),
        ({"stopped_by": "time_limit", "photons": 9}, "its time limit ended too early. Press Bake"),
        ({"stopped_by": "error", "photons": 0}, "it has direct light only. Press Bake"),
        ({"stopped_by": "error", "photons": 9}, "that needs more than 1,000 MB, or room on the disk. Press Bake"),
    ],
)
def test_a_grey_refine_says_why(room, tmp_path, result, why):
    kept_state.mark_state(room, BakeRequest(Settings(), keep=tmp_path / "nothing.refine"), result)
    assert why in read_tooltip()
    kept_state.remove_state(room)
    assert "to go on with. Press Bake" in read_tooltip(), "of a file that an earlier version saved"


def test_a_state_of_another_bake_is_a_sentence(room, kept):
    info = next(kept.glob("*.json"))
    info.write_text(info.read_text() + " ")
    assert "The folder room.refine is of another bake" in read_tooltip()


def test_a_state_that_is_gone_is_a_sentence(room, kept):
    next(kept.glob("*.json")).unlink()
    assert "The folder room.refine, which holds what Refine needs, is gone" in read_tooltip()
    with pytest.raises(ValueError, match="bake it again"):
        kept_state.refine_request(room, BakeRequest(Settings()))


def test_the_request_never_asks_for_less_than_there_can_be(room, kept):
    request = BakeRequest(Settings(error=0.3))
    info = read_info(kept)
    half = kept_state.refine_request(room, replace(request, settings=Settings(error=1.0)))
    assert half.settings.error == 0.5 * info.error
    assert kept_state.refine_request(room, replace(request, settings=Settings(error=0.001))).settings.error == 0.001
    assert half.settings.max_photons == Settings().max_photons + info.photons
    assert half.resume == kept


def test_the_command_line_keeps_and_goes_on(tmp_path):
    open_room()
    scene, kept = save_scene(tmp_path / "room.blend"), tmp_path / "kept"
    assert bake(scene, "--keep", str(kept)) == 0
    assert read_info(kept).photons == 20_000
    assert bake(scene, "--resume", str(kept), "--max-photons", "50000") == 0
    report = read_report(scene)
    assert report["photons"] == 50_000
    assert report["rounds"] == 2
    assert read_info(kept).photons == 20_000  # --keep was not said again
    assert bake(scene, "--keep", str(scene)) == 1


def test_a_state_that_is_not_there_is_told_before_the_bake(tmp_path, monkeypatch, capsys):
    open_room()
    scene = save_scene(tmp_path / "room.blend")
    monkeypatch.setattr(session, "prepare", lambda *_: pytest.fail("the scene was exported"))
    assert bake(scene, "--resume", str(tmp_path / "nowhere")) == 1
    assert "nowhere: holds no state of a bake that can be gone on with; bake again." in capsys.readouterr().err


def test_a_saved_scene_of_the_command_line_can_be_refined_in_blender(tmp_path):
    open_room()
    scene, saved = save_scene(tmp_path / "room.blend"), tmp_path / "elsewhere" / "baked.blend"
    assert bake(scene, "--keep", str(tmp_path / "kept"), "--save", str(saved)) == 0
    bpy.ops.wm.open_mainfile(filepath=str(saved))
    assert kept_state.find_state(bpy.context.scene) == tmp_path / "kept"
