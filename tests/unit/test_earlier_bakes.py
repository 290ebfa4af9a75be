"""Whose images a bake writes over, and which pages of an earlier one it leaves over; what is not certain is never called our own."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from leaflight.core import bake, earlier_bakes, kept_bake
from leaflight.core.earlier_bakes import find_others, read_notes
from leaflight.core.job import RESULT_FILE, SNAPSHOT_FILE, Job
from leaflight.core.messages import Status, Warning_
from leaflight.core.scene import Light
from leaflight.core.settings import Settings
from leaflight.core.snapshot import save_snapshot
from scenes import make_scene, moved, quad_mesh

pytestmark = pytest.mark.usefixtures("open_image_io")
QUICK = Settings(size=32, padding=1, margin=0, workers=1, error=0.9, max_photons=2000, density=10.0)
LARGE = replace(QUICK, density=28.0)  # a page for each of three quads
SUN = Light("SUN", "Sun", power_rgb=(1.0, 1.0, 1.0))
SCENE = make_scene([moved(quad_mesh(f"Quad {k}"), (0.0, 0.0, 2.0 * k)) for k in range(3)], [SUN])
PAGES = ["room_0.combined.exr", "room_1.combined.exr", "room_2.combined.exr"]


@pytest.fixture
def run(tmp_path):
    """Bakes into one folder; gives what is left over, as names, and the messages."""
    (tmp_path / "room.blend").touch()
    images = tmp_path / "images"

    def run(settings=QUICK, name="room", blend="room.blend", should_stop=lambda: False):
        save_snapshot(tmp_path / SNAPSHOT_FILE, SCENE)
        Job(settings, str(images), name, blend=str(tmp_path / blend) if blend else "").save(tmp_path)
        messages = []
        bake.run_bake(tmp_path, messages.append, should_stop)
        left = json.loads((tmp_path / RESULT_FILE).read_text())["left_over"]
        assert all(Path(path).parent == images for path in left["own"] + left["doubtful"])
        return {key: [Path(path).name for path in paths] for key, paths in left.items()}, messages

    return run


def list_warnings(messages):
    return [message.text for message in messages if isinstance(message, Warning_)]


def test_pages_that_a_smaller_bake_has_no_more_are_left_over(run, tmp_path):
    assert run(LARGE)[0] == {"own": [], "doubtful": []}
    assert sorted(path.name for path in (tmp_path / "images").glob("*.exr")) == PAGES
    assert run()[0] == {"own": PAGES[1:], "doubtful": []}
    assert (tmp_path / "images" / PAGES[2]).is_file(), "nobody but Blender knows whether they are still used"


def test_what_is_left_over_once_is_doubtful_later(run):
    run(LARGE)
    run()
    assert run(replace(QUICK, seed=2))[0] == {"own": [], "doubtful": PAGES[1:]}, "the last note does not have it"


def test_a_bake_that_is_stopped_leaves_over_what_a_whole_one_would(run):
    run(LARGE)
    left, messages = run(replace(QUICK, error=1e-4, max_photons=10**9), should_stop=lambda: True)
    assert messages[-1].interrupted
    assert left["own"] == PAGES[1:]


def test_a_bake_that_is_kept_leaves_nothing_over(run, tmp_path):
    run(LARGE)
    run()
    kept = kept_bake.find_kept_bake(SCENE, Job.load(tmp_path))
    assert kept.result["left_over"] == {"own": [], "doubtful": []}


def test_images_of_other_passes_formats_and_names_are_nobodys_further_pages(run):
    run(replace(LARGE, passes=("combined", "albedo"), formats=("exr", "hdr")))
    run(LARGE, "other")
    assert run()[0] == {"own": PAGES[1:], "doubtful": []}


@pytest.mark.parametrize(("first", "then"), [(replace(LARGE, atlas=False), QUICK), (LARGE, replace(QUICK, atlas=False))])
def test_images_of_single_objects_are_nobodys_further_pages(run, first, then):
    run(first)
    assert run(then)[0] == {"own": [], "doubtful": []}


def test_single_objects_that_are_called_like_pages_are_doubtful(run, monkeypatch):
    names = [replace(one, name=name) for one, name in zip(SCENE.objects, ("room_0", "room_1", "room_2"), strict=True)]
    monkeypatch.setitem(globals(), "SCENE", replace(SCENE, objects=tuple(names)))
    run(replace(LARGE, atlas=False))
    assert run()[0] == {"own": [], "doubtful": PAGES[1:]}


def _change(images, blend):
    with open(images / PAGES[1], "ab") as file:
        file.write(b"painted on")


def _replace_by_link(images, blend):
    (images / PAGES[1]).rename(images / "kept elsewhere.exr")
    (images / PAGES[1]).symlink_to(images / "kept elsewhere.exr")


def _lose_note(images, blend):
    kept_bake.find_note(Job(QUICK, str(images), "room")).unlink()


def _damage_note(images, blend):
    kept_bake.find_note(Job(QUICK, str(images), "room")).write_bytes(b"no archive")


def _forget_blend(images, blend):
    _rewrite(images, lambda header: header.pop("blend"))


def _lose_contents(images, blend):
    _rewrite(images, lambda header: header.update(contents=[]))


def _note_elsewhere(images, blend):
    note = kept_bake.find_note(Job(QUICK, str(images), "room"))
    note.with_name(".leaflight_copy.npz").write_bytes(note.read_bytes())


def _rewrite(images, change):
    note = kept_bake.find_note(Job(QUICK, str(images), "room"))
    with np.load(note) as stored:
        arrays = dict(stored)
    header = json.loads(arrays["header"].tobytes())
    change(header)
    np.savez(note, **{**arrays, "header": np.frombuffer(json.dumps(header).encode(), np.uint8)})


@pytest.mark.parametrize(
    ("doubt", "is_own"),
    [
        (_change, [False, True]),
        (_replace_by_link, [False, True]),
        (_lose_note, [False, False]),
        (_damage_note, [False, False]),
        (_forget_blend, [False, False]),
        (_lose_contents, [False, False]),
        (_note_elsewhere, [False, False]),
    ],
)
def test_what_is_not_certainly_our_own_is_doubtful(run, tmp_path, doubt, is_own):
    run(LARGE)
    doubt(tmp_path / "images", tmp_path / "room.blend")
    left = run()[0]
    assert [name in left["own"] for name in PAGES[1:]] == is_own
    assert [name in left["doubtful"] for name in PAGES[1:]] == [not one for one in is_own]


@pytest.mark.parametrize("blends", [("room.blend", "copy.blend"), ("room.blend", ""), ("", "room.blend"), ("", "")])
def test_pages_of_another_blend_or_of_none_are_doubtful(run, blends):
    run(LARGE, blend=blends[0])
    assert run(blend=blends[1])[0] == {"own": [], "doubtful": PAGES[1:]}


def test_a_note_that_names_files_elsewhere_is_not_followed(run, tmp_path):
    run(LARGE)
    (tmp_path / "mine.exr").write_bytes((tmp_path / "images" / PAGES[2]).read_bytes())
    _rewrite(tmp_path / "images", lambda header: header["result"]["files"][2].update(path="../mine.exr"))
    assert run()[0] == {"own": PAGES[1:2], "doubtful": PAGES[2:]}
    assert [list(bake.files) for bake in read_notes(tmp_path / "images")] == [PAGES[:1]]


def test_images_of_another_blend_that_are_written_over_are_told_before_there_is_light(run, tmp_path):
    run(LARGE)
    _, messages = run(blend="copy.blend")
    images, blend = tmp_path / "images", tmp_path / "room.blend"
    assert len(list_warnings(messages)) == 1
    assert list_warnings(messages)[0].startswith(
        f"{PAGES[0]} in {images}: of the bake of {blend}, which this one writes over; choose another"
    )
    told = next(i for i, message in enumerate(messages) if isinstance(message, Warning_))
    assert isinstance(messages[told + 1], Status)
    assert messages[told + 1].stage == "texels"


def test_names_of_single_objects_are_alike_in_two_blends(run, tmp_path):
    """Each has a note of its own, and what has been written over is the first one's no more."""
    single = replace(QUICK, atlas=False)
    (tmp_path / "copy.blend").touch()
    run(single)
    told = list_warnings(run(replace(single, density=9.0), "copy", "copy.blend")[1])
    assert len(told) == 1
    assert told[0].startswith("Quad 0.combined.exr, Quad 1.combined.exr, Quad 2.combined.exr in ")
    assert list_warnings(run(replace(single, density=8.0), "copy", "copy.blend")[1]) == []
    assert "copy.blend" in list_warnings(run(single)[1])[0]


@pytest.mark.parametrize(
    "blends", [("room.blend", "room.blend"), ("gone.blend", "room.blend"), ("", "room.blend"), ("sub/../room.blend", "room.blend")]
)
def test_nothing_is_told_of_images_of_the_same_blend_or_of_one_that_is_no_more(run, blends):
    run(blend=blends[0])
    assert list_warnings(run(replace(QUICK, seed=2), blend=blends[1])[1]) == []


def test_a_folder_that_is_moved_with_its_blend_is_the_same(run, tmp_path):
    run(LARGE)
    moved = tmp_path / "moved"
    moved.mkdir()
    (tmp_path / "images").rename(moved / "images")
    (tmp_path / "room.blend").rename(moved / "room.blend")
    job = Job(QUICK, str(moved / "images"), "room", blend=str(moved / "room.blend"))
    assert find_others(job, PAGES) == {}
    assert earlier_bakes.find_left_over(job, [], 1).own == []
    other = replace(job, blend=str(tmp_path / "room.blend"))
    assert find_others(other, PAGES) == {moved / "room.blend": PAGES}


def test_more_files_than_three_are_counted():
    assert earlier_bakes.name_some(["a"]) == "a"
    assert earlier_bakes.name_some(list("abcde")) == "a, b, c and 2 more"
