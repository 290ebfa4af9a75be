"""A whole bake: the folder that goes in, the files and the result that come out, and what is left when it fails."""

import math
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from boxes import bake_folder, lamp_scene, list_files
from leaflight.core.bake import bake, preview
from leaflight.core.bake.checkpoint import read_info
from leaflight.core.bake.deadline import Deadline
from leaflight.core.output import resolve
from leaflight.core.output.image_file import read_image
from leaflight.core.parallel import executors
from leaflight.core.scene.scene import Light
from leaflight.core.scene.snapshot import save_snapshot
from leaflight.core.util.encodings import ENCODINGS
from leaflight.core.util.job import RESULT_FILE, SNAPSHOT_FILE, Job
from leaflight.core.util.messages import Done, Preview, Progress, Status, Warning_
from leaflight.core.util.settings import IMAGE_FORMATS, PASSES, Settings
from scenes import make_scene, moved, quad_mesh, shade_smooth, sphere_mesh

pytestmark = pytest.mark.usefixtures("open_image_io")
QUICK = Settings(size=32, padding=1, workers=1, error=0.3, max_photons=20_000)
FIRST_STAGES = ["load", "charts", "texels", "scene", "contacts"]
LIGHT_STAGES = ["photons", "direct", "photons", "write"]


@pytest.fixture
def patient(monkeypatch):
    """However slow the machine is, nobody is asked before there is light."""
    monkeypatch.setattr("leaflight.core.util.progress.SECONDS_BETWEEN_WORDS", math.inf)


def test_files_and_result_say_the_same(tmp_path, patient):
    settings = replace(QUICK, passes=("combined", "indirect"), formats=("exr", "png"))
    messages, result = bake_folder(tmp_path, lamp_scene(), settings)
    names = [f"room_0.{name}.{kind}" for name in ("combined", "indirect") for kind in ("exr", "png")]
    assert [Path(file["path"]).name for file in result["files"]] == names
    assert list_files(tmp_path / "images") == names
    assert [(file["pass_name"], file["kind"], file["page"], file["objects"]) for file in result["files"]] == [
        (name, kind, 0, [0, 1]) for name in ("combined", "indirect") for kind in ("exr", "png")
    ]
    assert [message.stage for message in messages if isinstance(message, Status)] == FIRST_STAGES + LIGHT_STAGES
    assert list(result["seconds"]) == [*FIRST_STAGES, "photons", "direct", "write"]
    assert messages[-1] == Done(str(tmp_path / RESULT_FILE), False)
    last = [message for message in messages if isinstance(message, Progress)][-1]
    assert (last.photons, last.estimated_error, last.leaves) == (result["photons"], result["estimated_error"], result["leaves"])
    assert result["stopped_by"] in ("error", "max_photons")
    assert (result["page_size"], result["pages"]) == (32, 1)


def test_seams_are_closed_and_told_unless_they_are_off_or_have_no_margin(tmp_path):
    lamp = Light("AREA", "Lamp", (0.0, 0.0, 4.0), power_rgb=(50.0, 50.0, 50.0), size_m=(1.0, 1.0))
    scene, settings = shade_smooth(make_scene([sphere_mesh()], [lamp])), replace(QUICK, size=64, passes=("direct",))
    told, pages = {}, {}
    for name, knobs in {"on": {}, "off": {"seams": False}, "bare": {"margin": 0}}.items():
        _, result = bake_folder(tmp_path / name, scene, replace(settings, **knobs))
        told[name], pages[name] = result["seams"], read_image(Path(result["files"][0]["path"]))[0]
    assert told["on"]["edges"] > 20
    assert told["on"]["step_after"] < 0.5 * told["on"]["step_before"]
    assert told["off"] == told["bare"] == {"edges": 0, "texels": 0, "step_before": 0.0, "step_after": 0.0}
    covered = pages["off"][..., 3] > 0
    np.testing.assert_array_equal(pages["bare"][covered], pages["off"][covered])
    changed = (pages["on"] != pages["off"]).any(axis=2)
    assert changed[covered].any()
    assert changed[~covered].any()


def test_every_pass_and_kind_of_a_bake_can_be_read(tmp_path):
    """Debug passes among them; their numbers are those of the bake."""
    _, result = bake_folder(tmp_path, lamp_scene(), replace(QUICK, passes=PASSES, formats=IMAGE_FORMATS))
    assert len(result["files"]) == len(PASSES) * len(IMAGE_FORMATS)
    found = {}
    for file in result["files"]:
        pixels, _ = read_image(Path(file["path"]))
        assert np.isfinite(pixels).all()
        found[file["pass_name"], file["kind"]] = pixels
    covered = found["charts", "exr"][..., 3] > 0
    assert np.unique(found["charts", "exr"][covered, 0]).tolist() == list(range(8))  # seven faces, and what the block stands on
    assert 0 < found["photons", "exr"][covered, 0].max() <= result["photons"]
    lighting = found["lighting", "exr"][..., :3]
    for kind in ENCODINGS:
        np.testing.assert_allclose(found["lighting", kind], lighting, atol=0.022 * lighting.max())


def test_a_folder_can_be_used_again(tmp_path):
    """What a process keeps open must not outlive the bake: the second scene is another one."""
    bright = lamp_scene()
    dark = replace(bright, lights=(replace(bright.lights[0], power_rgb=(1.0, 0.5, 0.25)),))
    means = []
    for scene in (bright, dark):
        bake_folder(tmp_path, scene, replace(QUICK, direct="photons", passes=("lighting",)))
        means.append(read_image(tmp_path / "images" / "room_0.lighting.exr")[0][..., 0].mean())
    assert means[0] == pytest.approx(10 * means[1], rel=0.01)


@pytest.mark.parametrize("stage", ["charts", "contacts"])
def test_a_bake_that_is_stopped_before_there_is_light_has_nothing_to_show(tmp_path, monkeypatch, stage):
    monkeypatch.setattr("leaflight.core.util.progress.SECONDS_BETWEEN_WORDS", -1.0)
    save_snapshot(tmp_path / SNAPSHOT_FILE, lamp_scene())
    Job(QUICK, str(tmp_path / "images"), "room").save(tmp_path)
    messages = []
    bake.run_bake(tmp_path, messages.append, lambda: messages[-1].stage == stage)
    assert messages[-1] == Done("", True)
    assert [message.stage for message in messages[:-1]][-1] == stage
    assert list_files(tmp_path / "images") == []


def test_how_far_texels_and_contacts_have_come_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr("leaflight.core.util.progress.SECONDS_BETWEEN_WORDS", -1.0)
    messages, _ = bake_folder(tmp_path, lamp_scene(), QUICK)
    for stage, text in (("texels", "Measuring texels"), ("contacts", "Looking for contacts")):
        said = [message for message in messages if isinstance(message, Status) and message.stage == stage]
        assert said[0].text == text
        assert [message.text for message in said[1:]] == [f"{text}, {message.share:.0%}" for message in said[1:]]
        assert len(said) > 10


def test_how_far_the_unwrapping_has_come_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr("leaflight.core.util.progress.SECONDS_BETWEEN_WORDS", -1.0)
    sun = Light("SUN", "Sun", power_rgb=(1.0, 1.0, 1.0))
    messages, _ = bake_folder(tmp_path, make_scene([quad_mesh("One"), moved(quad_mesh("Two"), (2.0, 0.0, 0.0))], [sun]), QUICK)
    told = [message.text for message in messages if isinstance(message, Status) and message.stage == "charts"]
    assert told == ["Unwrapping", "Unwrapping, 0%: One", "Unwrapping, 50%: Two"]


@pytest.mark.parametrize(("end", "raises"), [("whole", None), ("stopped", None), ("failed", OSError)])
def test_whoever_traces_is_sent_home_however_the_bake_ends(tmp_path, monkeypatch, end, raises):
    ended = []

    class Traced(executors.InlineExecutor):
        def shutdown(self, wait=True, *, cancel_futures=False):
            ended.append(cancel_futures)

    if end == "stopped":
        monkeypatch.setattr("leaflight.core.util.progress.SECONDS_BETWEEN_WORDS", -1.0)
    if end == "failed":
        monkeypatch.setattr(resolve.Resolver, "page", lambda *_: (_ for _ in ()).throw(OSError("the disk is full")))
    save_snapshot(tmp_path / SNAPSHOT_FILE, lamp_scene())
    Job(QUICK, str(tmp_path / "images"), "room").save(tmp_path)
    with pytest.raises(raises) if raises else nullcontext():
        bake.run_bake(tmp_path, lambda message: None, lambda: end == "stopped", lambda settings: Traced())
    assert ended == [True]


@pytest.mark.parametrize("place", ["file", "below a file", "/proc/self/images", "/proc/self"])
def test_an_output_that_cannot_be_written_is_told_before_the_work(tmp_path, place):
    (tmp_path / "note.txt").write_text("a user's own")
    output = {"file": tmp_path / "note.txt", "below a file": tmp_path / "note.txt" / "images"}.get(place, Path(place))
    save_snapshot(tmp_path / SNAPSHOT_FILE, lamp_scene())
    Job(QUICK, str(output), "room").save(tmp_path)
    before, messages = list_files(tmp_path), []
    with pytest.raises(OSError, match=r": images cannot be written there \(.+\); choose a folder that can be written to\.") as caught:
        bake.run_bake(tmp_path, messages.append, lambda: False)
    assert str(caught.value).startswith(str(output))
    assert messages == []
    assert list_files(tmp_path) == before


def test_the_result_tells_the_error_of_each_object_and_whose_error_ended_the_bake(tmp_path):
    _, result = bake_folder(tmp_path, lamp_scene(), replace(QUICK, error=0.2, max_photons=10**6, error_of="objects"))
    errors = [row["estimated_error"] for row in result["objects"]]
    assert result["error_of"] == "objects"
    assert min(errors) > 0.0
    assert result["estimated_error"] == pytest.approx(max(errors), rel=0.5)  # which holds against it by how much it may be off


def test_the_result_tells_the_light_of_each_object_over_its_lit_texels(tmp_path):
    _, result = bake_folder(tmp_path, lamp_scene(), replace(QUICK, size=64, atlas=False, passes=("lighting",)))
    assert len(result["files"]) == len(result["objects"]) == 2
    for file, row in zip(result["files"], result["objects"], strict=True):
        pixels, _ = read_image(file["path"])
        light = pixels[..., :3][pixels[..., 3] > 0.0].mean(axis=1)
        assert row["lighting"] == pytest.approx(light[light > 0.0].mean(), rel=0.05)


def test_stopped_before_direct_light_is_done_a_bake_still_shows_all_light(tmp_path, patient):
    """One round of photons then carries what the shadow rays had not finished."""
    said, result = bake_folder(tmp_path, lamp_scene(), replace(QUICK, direct="rays"), should_stop=lambda: True)
    pixels, _ = read_image(result["files"][0]["path"])
    assert said[-1].interrupted
    assert (result["stopped_by"], result["rounds"]) == ("interrupted", 1)
    assert pixels[..., :3][pixels[..., 3] > 0].mean() > 0.05


def test_a_time_limit_that_ends_before_direct_light_is_done_states_no_error(tmp_path, monkeypatch):
    """Photons alone had said 6 % of a page that was 150 % off."""
    monkeypatch.setattr(Deadline, "foresee", lambda self, steps: lambda: True)
    messages, result = bake_folder(tmp_path, lamp_scene(), replace(QUICK, direct="rays", error=0.5, max_photons=10**9, time_limit=2.0))
    assert result["stopped_by"] == "time_limit"
    assert math.isnan(result["estimated_error"])
    assert all(row["estimated_error"] is None for row in result["objects"])
    assert any("the lightmap is coarse" in message.text for message in messages if isinstance(message, Warning_))


def test_previews_come_first_and_change_no_byte(tmp_path, monkeypatch, patient):
    monkeypatch.setattr(preview, "LEAST_PAUSE_S", 0.0)
    monkeypatch.setattr(preview, "PAUSE_OF_COST", 0.0)
    settings, files = replace(QUICK, error=0.02, max_photons=600_000), []
    for name, with_preview in (("with", True), ("without", False)):
        messages, result = bake_folder(tmp_path / name, lamp_scene(), settings, preview=with_preview)
        files.append((tmp_path / name / "images" / "room_0.combined.exr").read_bytes())
        shown = [message for message in messages if isinstance(message, Preview)]
        assert len(shown) == (result["rounds"] if with_preview else 0)  # the first light, and each round but the last
        if with_preview:
            stages = [message.stage for message in messages if isinstance(message, Status)]
            assert stages == [*FIRST_STAGES, "preview", *LIGHT_STAGES]
            kinds = [type(message) for message in messages]
            assert kinds.index(Preview) < kinds.index(Progress)
    assert files[0] == files[1]


def test_a_stopped_bake_goes_on_to_the_bytes_of_a_whole_one(tmp_path, patient):
    settings, kept = replace(QUICK, error=0.01, max_photons=600_000), str(tmp_path / "kept")
    _, whole = bake_folder(tmp_path / "whole", lamp_scene(), settings)
    asked = []

    def stop_in_the_first_round():
        asked.append(True)
        return len(asked) > 1  # the first time is that of direct light's only shard

    _, part = bake_folder(tmp_path / "part", lamp_scene(), settings, should_stop=stop_in_the_first_round, keep=kept)
    assert part["stopped_by"] == "interrupted"
    assert read_info(Path(kept)).photons == part["photons"] < whole["photons"]
    messages, rest = bake_folder(tmp_path / "rest", lamp_scene(), settings, resume=kept, keep=kept, preview=True)
    images = [(tmp_path / name / "images" / "room_0.combined.exr").read_bytes() for name in ("whole", "part", "rest")]
    assert images[0] == images[2] != images[1]
    assert (rest["photons"], rest["rays"], rest["energy_audit_w"]) == (whole["photons"], whole["rays"], whole["energy_audit_w"])
    assert "direct" not in rest["seconds"]
    assert [message.stage for message in messages if isinstance(message, Status)][-2:] == ["write", "keep"]
    assert read_info(Path(kept)).photons == whole["photons"]


def test_a_bake_that_has_no_state_leaves_none_of_an_earlier_one(tmp_path):
    kept = tmp_path / "kept"
    for passes, has_state in (("combined", True), ("albedo", False)):
        bake_folder(tmp_path / passes, lamp_scene(), replace(QUICK, passes=(passes,)), keep=str(kept))
        assert (read_info(kept) is not None) == has_state


def test_a_state_that_cannot_be_kept_is_a_warning(tmp_path):
    (tmp_path / "kept").touch()
    messages, result = bake_folder(tmp_path, lamp_scene(), QUICK, keep=str(tmp_path / "kept"))
    assert [message.text for message in messages if isinstance(message, Warning_)] == [
        f"{tmp_path / 'kept'}: the bake's state cannot be kept there (File exists); make room, or bake again."
    ]
    assert Path(result["files"][0]["path"]).is_file()
