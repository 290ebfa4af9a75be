"""The command line's words: what they mean, and what is said of those that cannot be."""

import dataclasses
from pathlib import Path, PureWindowsPath

import pytest
from leaflight.addon.app import arguments
from leaflight.addon.app.arguments import BakeRequest, parse_arguments
from leaflight.core.util.settings import Settings


def parse(*words, with_scene=True):
    scene = ["room.blend"] if with_scene else []
    return parse_arguments(["bake", *scene, *words], "leaflight", with_scene)


def test_without_options_everything_has_its_default():
    assert parse() == BakeRequest(Settings(), scene=Path("room.blend"))
    assert parse(with_scene=False) == BakeRequest(Settings())


@pytest.mark.parametrize(
    ("words", "knob", "value"),
    [
        ("--size 64", "size", 64),
        ("--per-object", "atlas", False),
        ("--atlas", "atlas", True),
        ("--own-meshes", "share_meshes", False),
        ("--pass lighting direct", "passes", ("lighting", "direct")),
        ("--pass lighting --pass direct stderr", "passes", ("lighting", "direct", "stderr")),
        ("--format exr --format png", "formats", ("exr", "png")),
        ("--pass direct direct --pass lighting --pass direct", "passes", ("direct", "lighting")),
        ("--format rgbm logluv", "formats", ("rgbm", "logluv")),
        ("--png-view scene", "view_transform", "scene"),
        ("--name-pattern {pass}_{page}", "name_pattern", "{pass}_{page}"),
        ("--pack", "pack", True),
        ("--flat", "hierarchical", False),
        ("--no-contact", "contact", False),
        ("--error 0.1", "error", 0.1),
        ("--max-photons 5000", "max_photons", 5000),
        ("--time-limit 2.5", "time_limit", 2.5),
        ("--workers 2", "workers", 2),
    ],
)
def test_flag_sets_its_knob_and_no_other(words, knob, value):
    assert parse(*words.split()).settings == dataclasses.replace(Settings(), **{knob: value})


def test_scene_and_output_options():
    words = "--objects Floor --objects Wall --uv-layer Light --output a/b --report r.json --save s.blend --no-assign --quiet"
    expected = BakeRequest(
        Settings(),
        scene=Path("room.blend"),
        objects=("Floor", "Wall"),
        uv_layer="Light",
        output=Path("a/b"),
        report=Path("r.json"),
        save=Path("s.blend"),
        assign=False,
        quiet=True,
    )
    assert parse(*words.split()) == expected


def test_paths_beside_the_blend_are_told_from_those_of_other_machines(monkeypatch):
    """Also on Windows, where a path cannot tell them apart."""
    found = parse("--output", "//maps", "--save", "//out/room.blend", "--report", "/tmp/r.json")
    assert (found.output, found.save, found.report) == (Path("maps"), Path("out/room.blend"), Path("/tmp/r.json"))
    assert found.beside == {"output", "save"}
    monkeypatch.setattr(arguments, "Path", PureWindowsPath)
    found = parse("--output", "//maps", "--keep", r"\\farm\share\kept", "--gltf", r"C:\out\room.glb")
    assert found.beside == {"output"}
    assert [str(path) for path in (found.output, found.keep, found.gltf)] == ["maps", r"\\farm\share\kept", r"C:\out\room.glb"]


@pytest.mark.parametrize(
    "words", ["--sighs 5", "--size big", "--size 1.5", "--size", "--pass shine", "--format gif", "--siz 64", "b.blend"]
)
def test_words_that_cannot_be_read_end_with_2_and_usage(words, capsys):
    with pytest.raises(SystemExit) as end:
        parse(*words.split())
    assert end.value.code == 2
    assert "usage: leaflight" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("--size 0", r"^--size: expected 4 to 16384 texels, got 0; choose a value in this range\.$"),
        ("--size 100000", r"^--size: .* got 100000;"),
        ("--size -5", r"^--size: .* got -5;"),
        ("--max-photons 5", r"^--max-photons: .* got 5;"),
        ("--error nan", r"^--error: expected 0\.0001 to 1, got nan;"),
        ("--time-limit inf", r"^--time-limit: .* got inf;"),
        ("--name-pattern {size}", r"^--name-pattern: expected no other fields than .* got '{size}'; choose another\.$"),
        ("--save room", r"^--save room: .* end in \.blend;"),
        *((f"{flag} maps/nul\0.glb", f"^{flag}: .* no file name may hold;") for flag in ("--gltf", "--report", "--output", "--keep")),
    ],
)
def test_values_out_of_range_are_told_by_their_flag(words, sentence):
    with pytest.raises(ValueError, match=sentence):
        parse(*words.split())


def test_help_tells_every_knob_and_no_empty_default(capsys):
    with pytest.raises(SystemExit) as end:
        parse("--help")
    text = capsys.readouterr().out
    assert end.value.code == 0
    for knob in dataclasses.fields(Settings):
        flag = knob.metadata["flag"] or "--" + knob.name.replace("_", "-")
        assert f" {flag} " in text, flag
    assert "(default: 512)" in " ".join(text.split())
    for odd in ("default: True", "default: None", "default: []", "default: )"):
        assert odd not in text


def test_names_that_begin_with_a_dash_can_be_listed():
    assert parse("--objects", "-Lamp", "Chair", "-2", "--size", "64").objects == ("-Lamp", "Chair", "-2")
    assert parse("--objects", "Chair", "--objects", "-Lamp").objects == ("Chair", "-Lamp")
    with pytest.raises(SystemExit):
        parse("--size", "64", "-Lamp")


def test_scene_view_layer_and_frame():
    request = parse("--scene", "Night", "--view-layer", "Walls", "--frame", "-5")
    assert (request.scene, request.scene_name, request.view_layer, request.frame) == (Path("room.blend"), "Night", "Walls", -5)
    assert parse("--dry-run", "--enable-scripts").dry_run
    with pytest.raises(SystemExit):
        parse("--enable-scripts", with_scene=False)  # there Blender has opened the file already
