"""A bake is kept when scene, settings, code and files are what they were, and is done again when any of them is not."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from boxes import bake_folder, lamp_scene
from leaflight.core.atlas.chart_cache import find_charts_file
from leaflight.core.bake import bake_cache
from leaflight.core.bake.checkpoint import INFO_FILE
from leaflight.core.scene.scene import Material
from leaflight.core.util.job import LAYOUT_FILE, RESULT_FILE, Job
from leaflight.core.util.messages import Warning_
from leaflight.core.util.settings import Settings

pytestmark = pytest.mark.usefixtures("open_image_io")
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
