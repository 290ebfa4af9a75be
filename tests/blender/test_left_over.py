"""Images that an earlier bake with more pages leaves: deleted where they are certainly ours and used no more, else told."""

import pytest

bpy = pytest.importorskip("bpy")

import leaflight
from blend_rooms import bake, list_files, open_room, read_report, save_scene
from leaflight.addon.left_over import remove_left_over

FIRST, SECOND = NAMES = ["room_0.combined.exr", "room_1.combined.exr"]
TWO_PAGES, ONE_PAGE = 15.0, 4.0  # texels per metre


@pytest.fixture(autouse=True)
def _registered():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    leaflight.register()
    yield
    leaflight.unregister()


@pytest.fixture
def maps(tmp_path):
    return tmp_path / "maps"


@pytest.fixture
def press(tmp_path):
    """Saves the room and presses Bake with so many texels per metre; gives the warnings."""
    open_room()
    save_scene(tmp_path / "room.blend")
    chosen = bpy.context.scene.leaflight
    chosen.size, chosen.error, chosen.workers, chosen.output = 64, 0.9, 1, "//maps"

    def press(density, **more):
        for name, value in {"density": density, **more}.items():
            setattr(bpy.context.scene.leaflight, name, value)
        assert bpy.ops.leaflight.bake() == {"FINISHED"}
        state = bpy.context.window_manager.leaflight_state
        return [text for subject, text in state.warnings if not subject]

    return press


def list_images(folder):
    return [name for name in list_files(folder) if name.endswith(".exr")]


def test_a_page_that_the_bake_has_no_more_is_deleted_and_told(press, maps):
    assert press(TWO_PAGES) == []
    assert list_images(maps) == NAMES
    told = press(ONE_PAGE)
    assert told == [f"{SECOND} in {maps}: deleted, for the last bake had more pages than this one"]
    assert list_images(maps) == [FIRST]
    assert [image.name for image in bpy.data.images if image.source == "FILE"] == [FIRST.removesuffix(".exr")]
    assert press(ONE_PAGE) == [], "nothing has changed"


def test_what_this_blend_still_uses_stays(press, maps):
    """Whether it is our image, which the user keeps, or one that they have loaded."""
    press(TWO_PAGES)
    bpy.data.images[SECOND.removesuffix(".exr")].use_fake_user = True
    sentence = f"{SECOND} in {maps}: no page of this bake, but this file still uses it; remove the image in Blender, then the file"
    assert press(ONE_PAGE) == [sentence]
    press(TWO_PAGES)
    bpy.data.images[SECOND.removesuffix(".exr")].use_fake_user = False
    texture = bpy.data.textures.new("Mine", "IMAGE")
    texture.image = bpy.data.images.load(f"//maps/{SECOND}")
    assert press(ONE_PAGE) == [sentence]
    assert list_images(maps) == NAMES


def test_what_somebody_has_changed_stays(press, maps):
    press(TWO_PAGES)
    with open(maps / SECOND, "ab") as file:
        file.write(b"painted on")
    assert press(ONE_PAGE) == [f"{SECOND} in {maps}: no page of this bake, but called like one; if nothing else uses it, delete it"]
    assert list_images(maps) == NAMES


def test_what_cannot_be_deleted_is_told(tmp_path):
    held = tmp_path / SECOND
    held.mkdir()
    told = remove_left_over({"left_over": {"own": [str(held)], "doubtful": [str(tmp_path / FIRST)]}})
    assert told == [("", f"{FIRST}, {SECOND} in {tmp_path}: no page of this bake, but called like one; if nothing else uses it, delete it")]
    assert held.is_dir()


def test_the_command_line_deletes_nothing(tmp_path, maps):
    """Who wears its images is another file, which is not at hand."""
    open_room()
    room = save_scene(tmp_path / "room.blend")
    words = ("--size", "64", "--error", "0.9", "--density")
    assert bake(room, *words, str(TWO_PAGES)) == 0
    assert bake(room, *words, str(ONE_PAGE)) == 0
    assert list_images(maps) == NAMES
    sentence = f"{SECOND} in {maps}: no page of this bake, but called like one; if nothing else uses it, delete it"
    report = read_report(room)
    assert sentence in [row["text"] for row in report["warnings"]]
    assert "left_over" not in report
