"""The command line's output options: encodings, names, folders beside the .blend, packing."""

from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blend_rooms import bake, list_files, read_pixels, read_report


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
