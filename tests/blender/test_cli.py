"""The command line's contract: files, names, report, exit codes, signals, output options; a small room is baked for real."""

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blend_rooms import QUICK, bake, list_files, open_room, read_pixels, read_report, save_scene
from leaflight.addon.app import session
from leaflight.addon.app.job import BakeProcess
from leaflight.addon.read.blender_output import hold_output
from leaflight.addon.ui import cli
from leaflight.core.transport import photons
from leaflight.core.util.messages import Done

# The command line's contract: files, names, report, exit codes, signals; a small room is baked for real.
STAGES = {"open", "export", "load", "charts", "texels", "scene", "contacts", "direct", "photons", "write", "assign", "total"}


def start_process(scene, *words):
    """The command line in a process of its own."""
    argv = [sys.executable, "-m", "leaflight", "bake", str(scene), "--size", "32", *words]
    return subprocess.Popen(argv, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, encoding="utf-8", cwd=scene.parent)


@pytest.mark.own_process
def test_bake_gives_an_image_and_a_report_and_leaves_the_scene_alone(room, capsys):
    before = room.read_bytes()
    assert bake(room, "--error", "0.004") == 0
    assert list_files(room.parent / "maps") == ["room_0.combined.exr"]
    pixels = read_pixels(room.parent / "maps" / "room_0.combined.exr")
    assert pixels.shape == (32, 32, 4)
    assert np.isfinite(pixels).all()
    assert pixels[..., :3].max() > 0.1
    assert room.read_bytes() == before

    report = read_report(room)
    assert set(report["seconds"]) == STAGES
    assert report["seconds"]["total"] >= report["seconds"]["photons"] > 0
    assert (report["photons"], report["stopped_by"], report["interrupted"]) == (20000, "max_photons", False)
    (missed,) = report["warnings"]
    assert missed["subject"] == ""
    assert re.fullmatch(
        r"stopped at --max-photons with an error of [\d.]+ %, where 0.4 % was asked for; raise --max-photons or --error", missed["text"]
    )
    assert (report["scene"], report["blender"]) == (str(room), bpy.app.version_string)
    assert report["rays"] > 20000 / photons.SPLIT  # so many go to the first surface as one
    assert report["leaves"] > 0
    assert 0 < report["estimated_error"] < 1
    assert report["peak_memory_mb"]["core"] > 10
    energy = report["energy_audit_w"]
    assert energy["emitted"] == pytest.approx([100.0] * 3)
    np.testing.assert_allclose(np.add(np.add(energy["absorbed"], energy["escaped"]), energy["remainder"]), energy["emitted"], rtol=1e-12)
    assert [(row["name"], row["charts"], row["warnings"]) for row in report["objects"]] == [("Cube", 6, []), ("Floor", 1, [])]
    assert all(row["texels"] > 0 for row in report["objects"])

    told = capsys.readouterr().err
    assert "leaflight: Tracing photons\n" in told
    assert re.search(r"leaflight: 100%  0\.02 M photons  \d+\.\d\d M/s  error \d+\.\d%  0 s left\n", told)


def test_quiet_says_nothing_of_a_bake_that_goes_well(room, capfd, monkeypatch):
    """Nor does Blender, which reads and saves files for it. The report goes into a folder that is made for it."""
    report, saved = room.parent / "deep" / "er" / "report.json", room.parent / "baked.blend"
    words = ("--quiet", "--error", "0.5", "--report", str(report))
    for number, name in ((1, "stdout"), (2, "stderr")):  # pytest's own go past what a process prints to
        monkeypatch.setattr(sys, name, os.fdopen(number, "w", closefd=False))
    capfd.readouterr()
    assert bake(room, *words, "--save", str(saved), "--gltf", str(saved.with_suffix(".glb"))) == 0
    assert [line for line in "".join(capfd.readouterr()).splitlines() if not line.startswith("ERROR ")] == []  # bpy 5.3 lacks a decoder
    assert json.loads(report.read_text())["photons"] == 20000


def test_quiet_leaves_warnings_and_errors_of_blender(capfd):
    lines = [
        "Info: Saved",
        "Warning: a library is missing",
        "00:01.2  blend  | Read blend",
        "00:01.3  blend  | WARNING Old",
        "ERROR No",
        "",
    ]
    with hold_output(quiet=True):
        os.write(1, "\n".join(lines).encode())
    assert capfd.readouterr().err.splitlines() == [lines[1], lines[3], lines[4]]


def test_a_bake_that_misses_its_error_says_so(room, capsys):
    """Also where it is kept, and quiet."""
    for is_kept in (False, True):
        assert bake(room, "--quiet", "--error", "0.004") == 0
        said = capsys.readouterr().err
        assert re.fullmatch(
            r"leaflight: warning: stopped at --max-photons with an error of [\d.]+ %, where 0.4 % was asked for; raise .*\n", said
        )
        report = read_report(room)
        assert report["skipped"]["bake"] == is_kept
        assert [warning["text"] for warning in report["warnings"]] == [said.removeprefix("leaflight: warning: ").rstrip()]


def test_per_object_passes_and_formats(room):
    words = ("--per-object", "--pass", "lighting", "albedo", "--format", "exr", "hdr", "png")
    assert bake(room, *words) == 0
    expected = [f"{name}.{kind}.{end}" for name in ("Cube", "Floor") for kind in ("albedo", "lighting") for end in ("exr", "hdr", "png")]
    assert list_files(room.parent / "maps") == expected
    files = read_report(room)["files"]
    assert sorted(Path(file["path"]).name for file in files) == expected
    assert {(file["pass_name"], file["kind"]) for file in files} == {(p, k) for p in ("lighting", "albedo") for k in ("exr", "hdr", "png")}


def test_objects_named_get_a_lightmap_and_the_rest_still_cast_light(room):
    assert bake(room, "--objects", "Floor", "--per-object", "--pass", "direct") == 0
    assert list_files(room.parent / "maps") == ["Floor.direct.exr"]
    assert [row["name"] for row in read_report(room)["objects"]] == ["Floor"]
    pixels = read_pixels(room.parent / "maps" / "Floor.direct.exr")
    lit = pixels[..., :3].mean(axis=2)[pixels[..., 3] > 0.5]
    assert lit.min() < 0.05 * lit.max()  # the cube's shadow


def test_existing_uv_layer_is_used_as_it_is(room):
    assert bake(room, "--objects", "Floor", "--uv-layer", "UVMap", "--save", str(room.parent / "baked.blend")) == 0
    pixels = read_pixels(room.parent / "maps" / "room_0.combined.exr")
    assert (pixels[..., 3] == 1.0).all()  # Blender's plane fills the page
    assert [layer.name for layer in bpy.data.objects["Floor"].data.uv_layers] == ["UVMap"]


def test_saved_file_wears_the_bake_and_bakes_alike_again(room):
    before = room.read_bytes()
    saved = room.parent / "far" / "baked.blend"
    assert bake(room, "--save", str(saved)) == 0
    assert room.read_bytes() == before
    assert read_report(room)["scene"] == str(room)
    first = (room.parent / "maps" / "room_0.combined.exr").read_bytes()

    bpy.ops.wm.open_mainfile(filepath=str(saved))
    image = bpy.data.images["room_0.combined"]
    shown = Path(bpy.path.abspath(image.filepath))
    assert shown.read_bytes() == first
    assert image.filepath.startswith("//../maps/")  # both can be moved together
    floor = bpy.data.objects["Floor"]
    assert "Leaflight" in floor.data.uv_layers
    assert any(node.type == "TEX_IMAGE" and node.image == image for node in floor.material_slots[0].material.node_tree.nodes)

    assert bake(saved, output=room.parent / "again") == 0
    assert (room.parent / "again" / "baked_0.combined.exr").read_bytes() == first  # the bake itself gives no light
    assert bake(room, "--size", "48") == 0
    assert (room.parent / "maps" / "room_0.combined.exr").read_bytes() != first
    assert shown.read_bytes() == first  # also where no add-on looks after it


@pytest.mark.own_process
def test_a_time_limit_is_wall_time_from_the_start_of_the_command(room):
    """Contacts, direct light and smoothing of a large page would each take longer than what is asked for here."""
    words = ("--time-limit", "6", "--error", "0.0001", "--max-photons", "100000000000", "--size", "1024", "--workers", "1")
    began, worked = time.monotonic(), sum(os.times()[:4])
    assert bake(room, *words, "--save", str(room.parent / "saved.blend")) == 0
    passed = time.monotonic() - began
    waited = max(passed - (sum(os.times()[:4]) - worked), 0.0)  # for a machine that has much else to do
    report = read_report(room)
    assert report["stopped_by"] == "time_limit"
    assert report["warnings"][-1]["text"].startswith("stopped at --time-limit ")
    assert passed < 6.0 + 2.0 + waited
    assert read_pixels(room.parent / "maps" / "room_0.combined.exr")[..., :3].max() > 0.01


def test_a_time_limit_that_ends_before_there_is_light_is_a_sentence(room, capsys):
    argv = ["bake", str(room), *QUICK, "--output", str(room.parent / "maps"), "--time-limit", "20"]
    assert cli.main(argv, "leaflight", with_scene=True, began=time.monotonic() - 30.0) == 1
    assert "the time limit ended while the scene was read; raise it, or bake fewer objects." in capsys.readouterr().err


def test_a_dry_run_tells_the_plan_and_leaves_nothing(room, capsys):
    assert bake(room, "--dry-run", "--size", "256") == 0
    told = capsys.readouterr().err
    for part in ("2 objects, ", "1 page of 256 x 256", " of memory", "usually ", "Floor takes 73 % of the texels"):
        assert part in told, told
    assert list_files(room.parent) == ["room.blend"]


def test_another_scene_of_the_file_is_baked(tmp_path, capsys):
    open_room()
    other = bpy.data.scenes.new("Other")
    cube = bpy.data.objects["Cube"]
    bpy.context.scene.collection.objects.unlink(cube)
    other.collection.objects.link(cube)
    other.collection.objects.link(bpy.data.objects["Lamp"])
    scene = save_scene(tmp_path / "room.blend")
    assert bake(scene, "--scene", "Other") == 0
    assert [row["name"] for row in read_report(scene)["objects"]] == ["Cube"]
    assert bake(scene, "--scene", "None") == 1
    assert "--scene None: there is no such scene; the file has: Other, Scene." in capsys.readouterr().err


def test_open_scene_is_baked_where_blender_runs_the_command(room, capsys):
    argv = ["bake", *QUICK, "--output", str(room.parent / "maps")]
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    assert cli.main(argv) == 1
    assert "error: no .blend is open" in capsys.readouterr().err
    bpy.ops.wm.open_mainfile(filepath=str(room))
    assert cli.main(argv) == 0
    assert list_files(room.parent / "maps") == ["room_0.combined.exr"]


def test_a_signal_ends_with_the_best_so_far(room):
    """The other one: test_faults.test_a_signal_at_each_stage."""
    process = start_process(room, "--error", "0.0001", "--max-photons", "1000000000000", "--report", "report.json", "--save", "baked.blend")
    assert any("% " in line for line in process.stderr)  # the first round is through
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=60)
    assert process.returncode == 130
    report = read_report(room)
    assert (report["interrupted"], report["stopped_by"], report["warnings"]) == (True, "interrupted", [])
    assert list_files(room.parent / "bake") == ["room_0.combined.exr"]
    assert (room.parent / "baked.blend").is_file()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_before_there_is_light_ends_without_files(room, number, monkeypatch, capsys):
    monkeypatch.setattr(session, "prepare", lambda *_: os.kill(os.getpid(), number))
    before = [signal.getsignal(one) for one in (signal.SIGINT, signal.SIGTERM)]
    assert bake(room) == 130
    assert "interrupted before there was any light" in capsys.readouterr().err
    assert list_files(room.parent) == ["room.blend"]
    assert [signal.getsignal(one) for one in (signal.SIGINT, signal.SIGTERM)] == before


def test_a_bake_that_stopped_before_there_was_light_ends_without_files(room, monkeypatch, capsys):
    """As one whose unwrapping was not waited for."""
    monkeypatch.setattr(BakeProcess, "messages", lambda self: iter([Done("", interrupted=True)]))
    assert bake(room, "--save", str(room.parent / "baked.blend")) == 130
    assert "interrupted before there was any light; nothing was written" in capsys.readouterr().err
    assert list_files(room.parent) == ["maps", "room.blend"]
    assert list_files(room.parent / "maps") == []


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="whether a process blocks signals is seen in /proc")
def test_a_signal_while_blender_starts_is_kept(room):
    """Python's own answer would break into Blender's start, and Blender's is to go on."""
    process = start_process(room, "--max-photons", "20000", "--workers", "1")
    blocked = 0
    while process.poll() is None and not blocked:
        # The one that loads Blender is watched over by the one that was started.
        for pid in Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split():
            with contextlib.suppress(FileNotFoundError, ProcessLookupError):
                status = Path(f"/proc/{pid}/status").read_text()
                blocked |= int(re.search(r"SigBlk:\s*(\w+)", status)[1], 16) & (1 << (signal.SIGTERM - 1))
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=60)
    assert process.returncode == 130
    assert list_files(room.parent) == ["room.blend"]


def test_the_result_is_taken_before_the_process_that_made_it_has_ended():
    def messages():
        yield Done("", interrupted=True)
        pytest.fail("the process was waited for")

    assert cli._follow(messages(), quiet=True) == ("", True, [])


def test_a_bake_of_an_unchanged_scene_is_kept(room, capsys, monkeypatch):
    """Also once the file wears it; the report is as complete as the first one's."""
    saved = room.parent / "room.blend"
    assert bake(room, "--pass", "combined", "albedo", "--save", str(saved)) == 0
    first = read_report(room)
    written = {path: path.stat().st_mtime_ns for path in (room.parent / "maps").iterdir()}
    capsys.readouterr()
    monkeypatch.setattr(BakeProcess, "messages", None)  # no child is told to begin
    assert bake(saved, "--pass", "combined", "albedo", "--save", str(room.parent / "again.blend")) == 0
    told = capsys.readouterr().err.splitlines()
    assert "leaflight: Unchanged since the last bake: 2 files kept" in told
    assert told[-1] == f"leaflight: 2 images in {room.parent / 'maps'}: room_0.combined.exr, room_0.albedo.exr"
    assert {path: path.stat().st_mtime_ns for path in (room.parent / "maps").iterdir()} == written
    report = read_report(room)
    assert report.keys() == first.keys()
    assert (first["skipped"]["bake"], report["skipped"]["bake"]) == (0, 1)
    assert set(report["seconds"]) == STAGES
    changing = ("seconds", "busy_seconds", "skipped", "peak_memory_mb")
    assert {key: value for key, value in report.items() if key not in changing} == {k: v for k, v in first.items() if k not in changing}
    bpy.ops.wm.open_mainfile(filepath=str(room.parent / "again.blend"))
    assert "room_0.combined" in bpy.data.images


def test_what_has_changed_is_baked_again(room, capsys):
    image = room.parent / "maps" / "room_0.combined.exr"

    def is_kept(*words):
        capsys.readouterr()
        assert bake(room, *words) == 0
        return "Unchanged since the last bake: 1 file kept" in capsys.readouterr().err

    assert [is_kept(), is_kept("--force"), is_kept("--workers", "2")] == [False, False, True]
    image.unlink()
    assert [is_kept("--seed", "2"), is_kept("--seed", "2")] == [False, True]
    bpy.ops.wm.open_mainfile(filepath=str(room))
    bpy.data.objects["Lamp"].location.x += 0.01
    save_scene(room)
    assert not is_kept("--seed", "2")
    image.unlink()
    assert not is_kept("--seed", "2")


def test_a_cluster_that_cannot_be_reached_is_a_sentence(room, capsys):
    pytest.importorskip("distributed")
    assert bake(room, "--cluster", "nowhere") == 1
    assert re.search(r"error: --cluster nowhere: no dask scheduler answers there .* host:port\.\n", capsys.readouterr().err)


# The command line's output options: encodings, names, folders beside the .blend, packing.
def test_report_lists_each_file_with_encoding_and_range(room):
    assert bake(room, "--format", "exr", "rgbm", "rgbd", "logluv", "--range", "4", "--pass", "lighting", "photons") == 0
    report = read_report(room)
    assert sorted(Path(file["path"]).name for file in report["files"]) == list_files(room.parent / "maps")
    light = read_pixels(room.parent / "maps" / "room_0.lighting.exr")[..., :3]
    for file in report["files"]:
        if file["pass_name"] == "lighting":
            assert file["maximum"] == pytest.approx(light.max(), rel=1e-3)
            np.testing.assert_allclose(read_pixels(Path(file["path"]))[..., :3], light, atol=0.022 * light.max())
        if file["kind"] in ("rgbm", "rgbd"):
            assert (file["encoding"], file["range"]) == (file["kind"], 4.0)


def test_folders_beside_the_blend(room, monkeypatch, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert bake(room, "--save", "//out/baked.blend", "--report", "//report.json", output=Path("//maps/low")) == 0
    assert list_files(tmp_path / "maps" / "low") == ["room_0.combined.exr"]
    assert (tmp_path / "report.json").is_file()
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "out" / "baked.blend"))
    path = bpy.data.images["room_0.combined"].filepath  # a page that stays when the next bake comes into the folder
    assert path.startswith("//../maps/low/")
    assert read_pixels(bpy.path.abspath(path)).shape == read_pixels(tmp_path / "maps" / "low" / "room_0.combined.exr").shape


def test_folder_beside_a_blend_that_there_is_not(room, tmp_path, capsys):
    bpy.ops.export_scene.gltf(filepath=str(tmp_path / "model.glb"))
    assert bake(tmp_path / "model.glb", output=Path("//maps")) == 1
    assert "error: //maps: is beside the .blend, and no .blend is open" in capsys.readouterr().err


def test_packed_images_need_no_folder(room):
    saved = room.parent / "baked.blend"
    assert bake(room, "--pack", "--save", str(saved)) == 0
    light = read_pixels(room.parent / "maps" / "room_0.combined.exr")
    (room.parent / "maps" / "room_0.combined.exr").unlink()
    bpy.ops.wm.open_mainfile(filepath=str(saved))
    image = bpy.data.images["room_0.combined"]
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    np.testing.assert_allclose(pixels.reshape(light.shape), light, rtol=1e-3)


@pytest.mark.parametrize("words", [("--format", "rgbm", "logluv"), ("--format", "png", "--png-view", "scene")])
def test_files_that_materials_cannot_show_are_told_before_the_bake(room, capsys, words):
    assert bake(room, *words, "--save", str(room.parent / "baked.blend")) == 1
    assert "add EXR to the formats" in capsys.readouterr().err
    assert list_files(room.parent / "maps") == []


def test_any_format_is_written_where_nothing_is_to_show_it(room):
    words = ("--format", "rgbm", "logluv", "--save", str(room.parent / "baked.blend"), "--no-assign")
    assert bake(room, *words, "--per-object", "--pass", "albedo", "direct", "--name-pattern", "{pass}-{name}") == 0
    expected = [f"{kind}-{name}.{end}.png" for kind in ("albedo", "direct") for name in ("Cube", "Floor") for end in ("logluv", "rgbm")]
    assert len(list_files(room.parent / "maps")) == len(expected)
    assert all(name.startswith(("albedo-Cube", "albedo-Floor", "direct-Cube", "direct-Floor")) for name in list_files(room.parent / "maps"))
    floor = bpy.data.objects["Floor"]
    assert [layer.name for layer in floor.data.uv_layers] == ["UVMap"]
    assert len(floor.material_slots) == 0
    assert len(bpy.data.images) == 0
