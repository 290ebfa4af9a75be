"""Bad input: each gets its sentence, none leaves an image that is not whole, none changes the scene's file."""

import math
import shutil
import sys
import tempfile

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blend_rooms import QUICK, add_mesh, add_object, bake, list_files, make_material, open_room, read_pixels, read_report, save_scene
from leaflight.addon.app import spare_images
from leaflight.addon.app.job import BakeProcess
from leaflight.addon.show.layout import worn_images
from leaflight.addon.ui import cli
from leaflight.core.scene import surface_cells

IMAGE = "room_0.combined.exr"
TRIANGLE = [(0.0, 0.0, 1.5), (1.0, 0.0, 1.5), (1.0, 1.0, 1.5)]


def refuse(scene, capsys, *words):
    """The sentence of a bake that must be refused."""
    before = scene.read_bytes() if scene.is_file() else None
    assert bake(scene, *words) == 1
    told = [line for line in capsys.readouterr().err.splitlines() if "error: " in line]
    assert len(told) == 1
    assert list_files(scene.parent / "maps") == []
    assert not (scene.parent / "report.json").exists()
    assert before is None or scene.read_bytes() == before
    return told[0].removeprefix("leaflight: error: ")


def bake_with_warnings(scene):
    """(subject, text) of a bake that must go on, and its pixels."""
    before = scene.read_bytes()
    assert bake(scene, "--error", "0.5") == 0
    assert scene.read_bytes() == before
    pixels = read_pixels(scene.parent / "maps" / IMAGE)
    assert np.isfinite(pixels).all()
    assert pixels[..., :3].max() > 0.01
    return [(warning["subject"], warning["text"]) for warning in read_report(scene)["warnings"]]


# files


@pytest.mark.parametrize("kept", [0.0, 0.95])
def test_blend_that_was_cut_off(room, capsys, kept):
    data = room.read_bytes()
    cut = room.with_name("cut.blend")
    cut.write_bytes(data[: int(kept * len(data))])
    assert refuse(cut, capsys).startswith("cut.blend: Blender cannot read it, the file seems damaged (")


@pytest.mark.parametrize("below", ["file", "file/maps"])
def test_output_folder_that_cannot_be(room, capsys, below):
    (room.parent / "file").write_text("not a folder")
    folder = room.parent / below
    assert refuse(room, capsys, "--output", str(folder)).startswith(f"{folder}: is no folder that can be written (")


@pytest.mark.parametrize("option", ["--report", "--save"])
def test_files_that_cannot_be_written_are_told_before_the_bake(room, capsys, monkeypatch, option):
    monkeypatch.setattr(BakeProcess, "messages", None)  # a bake would begin with it
    (room.parent / "file").write_text("not a folder")
    below = room.parent / "file" / "x.blend"
    assert refuse(room, capsys, option, str(below)).startswith(f"{below.parent}: is no folder that can be written (")
    folder = room.parent / "folder.blend"
    folder.mkdir()
    assert refuse(room, capsys, option, str(folder)) == f"{folder}: is a folder; give the name of a file."


def test_images_that_cannot_be_written_are_kept_elsewhere(room, capsys, monkeypatch):
    """Here for a folder that has the image's name; and what is saved wears them, until they are where they belong."""
    temporary, saved = room.parent / "tmp", room.parent / "saved.blend"
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    (room.parent / "maps" / IMAGE).mkdir(parents=True)
    assert bake(room, "--quiet", "--save", str(saved)) == 1
    told = capsys.readouterr().err.splitlines()
    (spare,) = temporary.iterdir()
    assert f"{IMAGE}: cannot be written (" in told[0]
    assert f"They are safe in {spare}" in told[0]
    assert told[-1] == f"leaflight: error: {room.parent / 'maps'}: the images are not there but in {spare}; make room and move them."
    assert list_files(room.parent / "maps") == [IMAGE]
    assert list_files(room.parent / "maps" / IMAGE) == []
    assert list_files(spare) == [IMAGE]
    assert read_report(room)["spare"] == str(spare)
    bpy.ops.wm.open_mainfile(filepath=str(saved))
    scene = bpy.context.scene
    assert spare_images.find_spare(scene) == spare
    with pytest.raises(OSError, match=r"maps: the images cannot be written there either \(.+\); choose another output folder\.$"):
        spare_images.move_images(scene, spare, room.parent / "maps")
    assert list_files(room.parent / "maps") == [IMAGE]
    assert spare_images.move_images(scene, spare, room.parent / "other") == 1
    (image,) = worn_images(scene).values()
    assert image.filepath.startswith("//other/")
    assert image.filepath.endswith(f"/{IMAGE}")
    assert image.size[0] > 0
    assert not spare.exists()
    assert spare_images.find_spare(scene) is None


def bake_on_small_disk(scene, most_bytes, monkeypatch):
    """Exit code of a bake on a system where no file grows beyond this."""
    resource = pytest.importorskip("resource")
    words = ("--uv-layer", "UVMap", "--quiet", "--objects", "Floor", "--margin", "256", "--size", "512", "--force", "--error", "0.5")
    argv = ["bake", str(scene), *QUICK, "--output", str(scene.parent / "maps"), *words]
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    with monkeypatch.context() as patch:
        patch.setattr(sys, "dont_write_bytecode", True)  # Python leaves a .pyc cut off where the disk is full
        resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, before[1]))
        try:
            return cli.main(argv, "leaflight", with_scene=True)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_full_disk(tmp_path, capsys, monkeypatch):
    """The layer covers little of the page, so the image is the greatest file; a limit just below it hits nothing else."""
    monkeypatch.setattr(surface_cells, "_CELLS", 64)  # light on surfaces without a lightmap is kept, too
    open_room()
    layer = bpy.data.objects["Floor"].data.uv_layers["UVMap"]
    uv = np.empty(2 * len(layer.uv), np.float32)
    layer.uv.foreach_get("vector", uv)
    layer.uv.foreach_set("vector", uv / 64)
    scene = save_scene(tmp_path / "room.blend")
    before = scene.read_bytes()
    image = tmp_path / "maps" / IMAGE
    assert bake_on_small_disk(scene, 10**9, monkeypatch) == 0
    assert capsys.readouterr().err == ""
    whole = image.read_bytes()

    assert bake_on_small_disk(scene, len(whole) - 1, monkeypatch) == 1
    told = capsys.readouterr().err
    assert f"{IMAGE}: cannot be written (" in told
    assert "has room" in told
    assert list_files(image.parent) == [IMAGE]
    assert image.read_bytes() == whole  # the old one, not a part of the new

    shutil.rmtree(image.parent)
    assert bake_on_small_disk(scene, 2000, monkeypatch) == 1  # not even the scene can be handed over
    sentence = "the scene cannot be kept there (File too large); make room, or set TMPDIR to another folder."
    assert sentence in capsys.readouterr().err
    assert list_files(image.parent) == []
    assert scene.read_bytes() == before


# scenes


@pytest.mark.parametrize("power_w", [None, -5.0])
def test_no_light(tmp_path, capsys, power_w):
    open_room(power_w or 0.0)
    if power_w is None:
        bpy.data.objects.remove(bpy.data.objects["Lamp"])
    assert refuse(save_scene(tmp_path / "room.blend"), capsys).startswith("the scene has no light: add a light")


def add_faults(value):
    """Objects, lights and a material that a bake warns of and goes on; `value` is no finite number."""
    for name, power_w in (("Dark", 0.0), ("Negative", -50.0)):
        light = bpy.data.lights.new(name, "POINT")
        light.energy = power_w
        add_object(name, light)
    add_mesh("Empty", [], [])
    add_mesh("Wire", TRIANGLE[:2], [])
    add_mesh("Broken", [*TRIANGLE, (0.0, 0.0, value)], [(0, 1, 2), (0, 2, 3)])
    add_mesh("Hopeless", [(value, 0.0, 0.0), *TRIANGLE[1:]], [(0, 1, 2)])
    add_mesh("Needle", [(0.0, 0.0, 1.0), (1.0, 0.0, 1.0), (2.0, 0.0, 1.0)], [(0, 1, 2)])
    add_mesh("Twice", [(x - 1.5, y, z) for x, y, z in TRIANGLE], [(0, 1, 2), (0, 1, 2), (2, 1, 0)])
    add_mesh("Nothing", TRIANGLE, [(0, 1, 2)]).scale = (0.0, 0.0, 0.0)
    material = make_material("Tiles")
    texture = material.node_tree.nodes.new("ShaderNodeTexImage")
    texture.image = bpy.data.images.new("lost", 4, 4)
    texture.image.source, texture.image.filepath = "FILE", "//lost.png"
    material.node_tree.links.new(texture.outputs[0], material.node_tree.nodes["Principled BSDF"].inputs["Base Color"])
    bpy.data.objects["Floor"].data.materials.append(material)


@pytest.mark.parametrize("value", [math.nan, *(pytest.param(one, marks=pytest.mark.slow) for one in (math.inf, -math.inf))])
def test_each_fault_of_a_scene_is_told_and_the_rest_is_baked(tmp_path, value):
    open_room()
    add_faults(value)
    scene = save_scene(tmp_path / "room.blend")
    warnings = bake_with_warnings(scene)
    for part, subjects in (
        ("power is negative", {"Negative"}),
        ("no faces", {"Empty", "Wire"}),
        ("not a finite number", {"Broken", "Hopeless"}),
        ("lie exactly on others", {"Twice"}),
        ("no face can be baked", {"Needle", "Nothing"}),
        ("image lost is missing", {"Tiles"}),
    ):
        assert {subject for subject, text in warnings if part in text} == subjects, part
    assert any(subject == "Broken" and text.startswith("1 face is left out") for subject, text in warnings)
    assert [row["texels"] > 0 for row in read_report(scene)["objects"] if row["name"] == "Broken"] == [True]


# options


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--size", "4"), "The 7 charts of 2 objects do not fit a page of 4 texels: choose a greater page size or less padding."),
        (("--uv-layer", "Nope"), "no object has a UV layer named Nope that can be used: the layers there are: UVMap."),
        (("--objects", "Cubus"), "Cubus: no such object; the scene has: Cube, ..."),
        (("--objects", "Lamp"), "Lamp: is a light, not a mesh; convert it to a mesh, or leave it out of the bake."),
    ],
)
def test_options_that_cannot_be_met(room, capsys, words, sentence):
    assert refuse(room, capsys, *words) == sentence
