"""A bake is kept when scene, settings, code and files are what they were; whose images it writes over, and which it leaves over."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from boxes import bake_folder, lamp_scene
from leaflight.core.atlas.chart_cache import find_charts_file
from leaflight.core.bake import bake_cache
from leaflight.core.bake.checkpoint import INFO_FILE
from leaflight.core.bake.earlier_bakes import find_others, read_notes
from leaflight.core.scene.scene import Light, Material
from leaflight.core.util.job import LAYOUT_FILE, RESULT_FILE, Job
from leaflight.core.util.messages import Warning_
from leaflight.core.util.settings import Settings
from scenes import make_scene, moved, quad_mesh

pytestmark = pytest.mark.usefixtures("open_image_io")


# A bake is kept when scene, settings, code and files are what they were, and is done again when any of them is not.
SCENE = replace(lamp_scene(), materials=(Material("Snow", (2.0, 2.0, 2.0)),))  # it is clamped, which is a warning
QUICK = Settings(size=16, padding=1, workers=1, error=0.9, max_photons=2000, passes=("combined", "albedo"))


def bake_job(folder, settings=QUICK, should_stop=lambda: False, **more):
    """A bake in `folder` with its images in `folder`/images and `more` in its job; its job, messages and result."""
    messages, result = bake_folder(folder, SCENE, settings, should_stop, "room: 1", **more)
    return Job.load(folder), messages, result


@pytest.fixture
def job(tmp_path):
    return bake_job(tmp_path)[0]


def test_the_same_bake_is_kept_with_all_that_it_gave(tmp_path):
    job, messages, result = bake_job(tmp_path)
    kept = bake_cache.find_kept_bake(SCENE, job)
    assert kept.result == {**result, "seconds": dict.fromkeys(result["seconds"], 0.0), "skipped": {**result["skipped"], "bake": 1}}
    assert result["skipped"]["bake"] == 0
    told = [(message.subject, message.text) for message in messages if isinstance(message, Warning_)]
    assert kept.warnings == tuple(told)
    assert told
    again = tmp_path / "again"
    again.mkdir()
    kept.restore(again)
    assert json.loads((again / RESULT_FILE).read_text()) == kept.result
    with np.load(tmp_path / LAYOUT_FILE) as first, np.load(again / LAYOUT_FILE) as second:
        assert set(first.files) == set(second.files)
        assert all(np.array_equal(first[name], second[name]) for name in first.files)


def test_images_may_be_moved_with_their_note(tmp_path, job):
    moved = replace(job, output=str(tmp_path / "elsewhere"))
    Path(job.output).rename(moved.output)
    files = bake_cache.find_kept_bake(SCENE, moved).result["files"]
    assert files
    assert all(Path(file["path"]).is_file() for file in files)
    assert bake_cache.find_kept_bake(SCENE, job) is None


def test_pictures_through_the_scenes_view_transform_are_made_anew(tmp_path):
    """Exposure may have changed since, which the core does not know of; an earlier picture of that name says nothing."""
    settings = replace(QUICK, formats=("png",), view_transform="scene", passes=("combined",))
    for _ in range(2):
        job, messages, result = bake_job(tmp_path, settings)
        assert not [message.text for message in messages if isinstance(message, Warning_) and "noted" in message.text]
        assert not bake_cache.find_note(job).exists()
        assert bake_cache.find_kept_bake(SCENE, job) is None
        Path(result["files"][0]["path"]).write_bytes(b"what Blender makes of it")


@pytest.mark.parametrize("change", [{"size": 32}, {"seed": 2}, {"passes": ("combined",)}])
def test_other_settings_are_another_bake(job, change):
    assert bake_cache.find_kept_bake(SCENE, replace(job, settings=replace(QUICK, **change))) is None


@pytest.mark.parametrize(("number", "how"), [(0, "missing"), (1, "altered"), (1, "longer")])
def test_missing_or_altered_files_are_baked_again(job, number, how):
    path = Path(bake_cache.find_kept_bake(SCENE, job).result["files"][number]["path"])
    whole = path.read_bytes()
    if how == "missing":
        path.unlink()
    else:
        path.write_bytes(whole + b"!" if how == "longer" else whole[:-1] + bytes([whole[-1] ^ 1]))
    assert bake_cache.find_kept_bake(SCENE, job) is None
    path.write_bytes(whole)
    assert bake_cache.find_kept_bake(SCENE, job) is not None


@pytest.mark.parametrize(
    "damage", [lambda whole: b"", lambda whole: whole[: len(whole) // 2], lambda whole: whole.replace(b"kept-bake", b"kept-cake")]
)
def test_a_damaged_note_is_no_note(job, damage):
    note = bake_cache.find_note(job)
    note.write_bytes(damage(note.read_bytes()))
    assert bake_cache.find_kept_bake(SCENE, job) is None


class Surprise:
    def __reduce__(self):
        return Path.touch, (Path("surprise"),)


def test_a_note_runs_nothing(job, monkeypatch, tmp_path):
    """It lies where other people's files may: what is pickled in it is not unpickled."""
    monkeypatch.chdir(tmp_path)
    note = bake_cache.find_note(job)
    with np.load(note) as stored:
        arrays = dict(stored)
    np.savez(note, **arrays)
    assert bake_cache.find_kept_bake(SCENE, job) is not None
    np.savez(note, **{**arrays, "tri_uv": np.array([Surprise()], object)})
    assert bake_cache.find_kept_bake(SCENE, job) is None
    assert not Path("surprise").exists()


def test_a_bake_that_was_stopped_is_not_kept(tmp_path):
    job, messages, _ = bake_job(tmp_path, replace(QUICK, error=1e-4, max_photons=10**9), should_stop=lambda: True)
    assert messages[-1].interrupted
    assert bake_cache.find_kept_bake(SCENE, job) is None


@pytest.mark.parametrize(("how", "stateless"), [("small", False), ("large", True), ("direct", True), ("disk", False)])
def test_it_is_noted_where_a_bake_has_no_state_to_keep(tmp_path, monkeypatch, how, stateless):
    """One that could not be written is no such bake: the next time there may be room."""
    place = tmp_path / "kept"
    if how == "large":
        monkeypatch.setattr("leaflight.core.bake.checkpoint._count_bytes", lambda _: 3 * 10**6)
    if how == "disk":
        place.write_text("a file, where the folder should be")
    passes = ("direct",) if how == "direct" else QUICK.passes
    job, _, _ = bake_job(tmp_path / "job", replace(QUICK, passes=passes), keep=str(place), keep_mb=2)
    assert bake_cache.find_kept_bake(SCENE, job).stateless is stateless
    assert (place / INFO_FILE).is_file() is (how == "small")


def test_a_note_that_cannot_be_written_costs_a_warning_only(tmp_path, monkeypatch):
    monkeypatch.setattr(bake_cache, "find_note", lambda job: tmp_path / "no folder" / "note.npz")
    job, messages, _ = bake_job(tmp_path)
    assert [message.text for message in messages if isinstance(message, Warning_)][-1].startswith("this bake cannot be noted in ")
    assert list(Path(job.output).glob(".leaflight*")) == [find_charts_file(job)]


# Whose images a bake writes over, and which pages of an earlier one it leaves over.
SPARSE = Settings(size=32, padding=1, margin=0, workers=1, error=0.9, max_photons=2000, density=10.0)
LARGE = replace(SPARSE, density=28.0)  # a page for each of three quads
SUN = Light("SUN", "Sun", power_rgb=(1.0, 1.0, 1.0))
QUADS = make_scene([moved(quad_mesh(f"Quad {k}"), (2.0 * k, 0.0, 0.0)) for k in range(3)], [SUN])
PAGES = ["room_0.combined.exr", "room_1.combined.exr", "room_2.combined.exr"]


@pytest.fixture
def run(tmp_path):
    """Bakes into one folder; gives what is told of files that are left over, and the messages."""
    (tmp_path / "room.blend").touch()

    def run(settings=SPARSE, name="room", blend="room.blend", should_stop=lambda: False):
        messages, _ = bake_folder(tmp_path, QUADS, settings, should_stop, name, blend=str(tmp_path / blend) if blend else "")
        return [text for text in list_warnings(messages) if "old lightmap" in text], messages

    return run


def list_warnings(messages):
    return [message.text for message in messages if isinstance(message, Warning_)]


def left_over(tmp_path, *names):
    return f"{', '.join(names)} in {tmp_path / 'images'}: old lightmap from an earlier bake; you can delete it if no other file uses it"


def test_pages_that_a_smaller_bake_has_no_more_are_told_once_and_stay(run, tmp_path):
    assert run(LARGE)[0] == []
    assert sorted(path.name for path in (tmp_path / "images").glob("*.exr")) == PAGES
    assert run()[0] == [left_over(tmp_path, *PAGES[1:])]
    assert run(replace(SPARSE, seed=2))[0] == [], "it was said once"
    assert (tmp_path / "images" / PAGES[1]).is_file()
    run(LARGE)
    assert run(replace(SPARSE, seed=3))[0] == [left_over(tmp_path, *PAGES[1:])], "these are new ones"


def test_a_bake_that_is_kept_tells_nothing_of_files_that_may_be_gone(run, tmp_path):
    run(LARGE)
    run()
    kept = bake_cache.find_kept_bake(QUADS, Job.load(tmp_path))
    assert kept is not None
    assert not any("old lightmap" in text for _, text in kept.warnings)


def test_images_of_other_passes_formats_and_names_are_nobodys_further_pages(run, tmp_path):
    run(replace(LARGE, passes=("combined", "albedo"), formats=("exr", "hdr")))
    run(LARGE, "other")
    assert run()[0] == [left_over(tmp_path, *PAGES[1:])]


@pytest.mark.parametrize(("first", "then"), [(replace(LARGE, atlas=False), SPARSE), (LARGE, replace(SPARSE, atlas=False))])
def test_images_of_single_objects_are_nobodys_further_pages(run, first, then):
    run(first)
    assert run(then)[0] == []


def test_a_file_called_like_a_page_is_none_of_a_bake_of_single_objects(run, tmp_path):
    (tmp_path / "images").mkdir()
    (tmp_path / "images" / "room_3.combined.exr").touch()
    assert run(replace(LARGE, atlas=False))[0] == []
    assert run(LARGE)[0] == [left_over(tmp_path, "room_3.combined.exr")]


def test_what_another_bake_has_noted_is_not_left_over_until_it_is_changed(run, tmp_path):
    run(LARGE)
    note = bake_cache.find_note(Job(SPARSE, str(tmp_path / "images"), "room"))
    note.with_name(".leaflight_other.npz").write_bytes(note.read_bytes())
    with open(tmp_path / "images" / PAGES[1], "ab") as file:
        file.write(b"painted on")
    assert run()[0] == [left_over(tmp_path, PAGES[1])]


def _lose_note(note):
    note.unlink()


def _lose_contents(note):
    _rewrite(note, lambda header: header.update(contents=[]))


def _rewrite(note, change):
    with np.load(note) as stored:
        arrays = dict(stored)
    header = json.loads(arrays["header"].tobytes())
    change(header)
    np.savez(note, **{**arrays, "header": np.frombuffer(json.dumps(header).encode(), np.uint8)})


@pytest.mark.parametrize("harm", [_lose_note, _lose_contents])
def test_what_is_left_over_is_told_without_a_note(run, tmp_path, harm):
    run(LARGE)
    harm(bake_cache.find_note(Job(SPARSE, str(tmp_path / "images"), "room")))
    assert run()[0] == [left_over(tmp_path, *PAGES[1:])]


def test_a_note_that_names_files_elsewhere_is_not_followed(run, tmp_path):
    run(LARGE)
    note = bake_cache.find_note(Job(SPARSE, str(tmp_path / "images"), "room"))
    _rewrite(note, lambda header: header["result"]["files"][2].update(path="../mine.exr"))
    assert [list(bake.files) for bake in read_notes(tmp_path / "images")] == [PAGES[:2]]


def test_images_of_another_blend_are_not_overwritten(run, tmp_path):
    run(LARGE)
    before = {name: (tmp_path / "images" / name).read_bytes() for name in PAGES}
    (tmp_path / "copy.blend").touch()
    with pytest.raises(
        ValueError, match=rf"^room.blend has its lightmaps in this folder.* {PAGES[0]} in {tmp_path}/images. Choose another"
    ):
        run(blend="copy.blend")
    assert {name: (tmp_path / "images" / name).read_bytes() for name in PAGES} == before
    (tmp_path / "images" / PAGES[0]).unlink()
    assert list_warnings(run(blend="copy.blend")[1]) == [], "it has been deleted, so there is nothing to lose"
    with pytest.raises(ValueError, match=r"^copy.blend has its lightmaps"):
        run()


def test_names_of_single_objects_are_alike_in_two_blends(run, tmp_path):
    single = replace(SPARSE, atlas=False)
    run(single)
    (tmp_path / "copy.blend").touch()
    with pytest.raises(ValueError, match=r"overwrite Quad 0.combined.exr, Quad 1.combined.exr, Quad 2.combined.exr in "):
        run(single, "copy", "copy.blend")


@pytest.mark.parametrize("blends", [("room.blend", "room.blend"), ("gone.blend", "room.blend"), ("sub/../room.blend", "room.blend")])
def test_nothing_is_told_of_images_of_the_same_blend_or_of_one_that_is_no_more(run, blends):
    run(blend=blends[0])
    assert list_warnings(run(replace(SPARSE, seed=2), blend=blends[1])[1]) == []


def test_a_folder_that_is_moved_with_its_blend_is_the_same(run, tmp_path):
    run(LARGE)
    moved = tmp_path / "moved"
    moved.mkdir()
    (tmp_path / "images").rename(moved / "images")
    (tmp_path / "room.blend").rename(moved / "room.blend")
    job = Job(SPARSE, str(moved / "images"), "room", blend=str(moved / "room.blend"))
    assert find_others(job, PAGES) == {}
    other = replace(job, blend=str(tmp_path / "room.blend"))
    assert find_others(other, PAGES) == {moved / "room.blend": PAGES}
