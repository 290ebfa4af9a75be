"""Knobs and jobs: their ranges, the way to disk, and the digest of all that decides the images."""

import dataclasses
import math
from dataclasses import replace

import numpy as np
import pytest
from boxes import lamp_scene
from leaflight.core.scene import snapshot
from leaflight.core.scene.scene import Material, TextureImage
from leaflight.core.scene.snapshot import hash_bake, load_snapshot, save_snapshot
from leaflight.core.util import digest
from leaflight.core.util.job import JOB_FILE, Job
from leaflight.core.util.settings import Settings

# Every knob has help and a range, and keeps it.
KNOBS = dataclasses.fields(Settings)
RANGED = [knob for knob in KNOBS if knob.metadata["low"] is not None]
CHOSEN = [knob for knob in KNOBS if knob.metadata["choices"]]


def by_name(knobs):
    return pytest.mark.parametrize("knob", knobs, ids=[knob.name for knob in knobs])


@by_name(KNOBS)
def test_knob_has_help_and_a_rule(knob):
    assert knob.metadata["help"]
    about = knob.metadata
    assert isinstance(knob.default, bool) or knob in RANGED or knob in CHOSEN or about["find_error"] or about["metavar"] == "ADDRESS"


@by_name(RANGED)
def test_ends_of_a_range_are_allowed(knob):
    for end in ("low", "high"):
        value = type(knob.default)(knob.metadata[end])
        assert getattr(Settings(**{knob.name: value}), knob.name) == value


@by_name(RANGED)
def test_beyond_the_range_is_a_sentence(knob):
    low, high, unit = (knob.metadata[name] for name in ("low", "high", "unit"))
    for value in (low - 1, high + 1, high * 2 + 1):
        with pytest.raises(ValueError, match=knob.name) as caught:
            Settings(**{knob.name: type(knob.default)(value)})
        assert str(caught.value) == f"{knob.name}: expected {low:g} to {high:g}{' ' * bool(unit)}{unit}, got {value:g}"


@by_name([knob for knob in RANGED if isinstance(knob.default, float)])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_what_is_no_number_is_refused(knob, value):
    with pytest.raises(ValueError, match=f"^{knob.name}: "):
        Settings(**{knob.name: value})


@by_name(CHOSEN)
def test_choices_are_kept(knob):
    choices = knob.metadata["choices"]
    many = isinstance(knob.default, tuple)
    for choice in choices:
        Settings(**{knob.name: (choice,) if many else choice})
    with pytest.raises(ValueError, match=f"^{knob.name}: expected one of ") as caught:
        Settings(**{knob.name: (choices[0], "odd") if many else "odd"})
    assert str(caught.value) == f"{knob.name}: expected one of {', '.join(choices)}, got 'odd'"


@pytest.mark.parametrize("value", ["combined", (), ["combined"]])
def test_a_list_of_passes_is_a_tuple_with_something_in_it(value):
    with pytest.raises(ValueError, match="passes: expected at least one of combined"):
        Settings(passes=value)


def test_a_pattern_of_names_is_checked():
    assert Settings(name_pattern="{page}").name_pattern == "{page}"
    with pytest.raises(ValueError, match=r"^name_pattern: expected no other fields than .*, got '{size}'$"):
        Settings(name_pattern="{size}")
    with pytest.raises(ValueError, match=r"^name_pattern: expected {pass} in it, for there are 2 passes, got '{name}'$"):
        Settings(name_pattern="{name}", passes=("combined", "albedo"))


# A job on disk is the job that was saved.
def another_value(knob):
    """A value of the knob that is allowed and not its default."""
    if knob.metadata["choices"]:
        last = knob.metadata["choices"][-2:]
        return last if isinstance(knob.default, tuple) else next(one for one in last if one != knob.default)
    if isinstance(knob.default, bool):
        return not knob.default
    if isinstance(knob.default, str):
        return knob.default + "_"
    return next(type(knob.default)(knob.metadata[end]) for end in ("high", "low") if knob.metadata[end] != knob.default)


def test_all_knobs_come_back_from_disk(tmp_path):
    changed = Settings(**{knob.name: another_value(knob) for knob in dataclasses.fields(Settings)})
    assert all(getattr(changed, knob.name) != knob.default for knob in dataclasses.fields(Settings))
    job = Job(changed, output="/some where/\u00e4", atlas_name="caf\u00e9", preview=True, resume="a", keep="b", keep_mb=3)
    job.save(tmp_path)
    assert Job.load(tmp_path) == job


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"settings": {"sise": 4}, "output": "", "atlas_name": ""}', '{"settings": {}}', "\xff"])
def test_a_damaged_job_is_a_sentence(tmp_path, text):
    (tmp_path / JOB_FILE).write_text(text)
    with pytest.raises(ValueError, match=r"job\.json: is no Leaflight job or is damaged \(.+\); start the bake again"):
        Job.load(tmp_path)


def test_a_knob_out_of_range_is_named(tmp_path):
    (tmp_path / JOB_FILE).write_text('{"settings": {"size": 1}, "output": "", "atlas_name": ""}')
    with pytest.raises(ValueError, match=r"job\.json: .+size: expected 4 to 16384 texels, got 1"):
        Job.load(tmp_path)


# Digests: alike for what bakes alike, and different for each thing that decides the images.
JOB = Job(Settings(), "images", "room")
WOOD = TextureImage("Wood", np.full((2, 3, 3), 0.5, np.float32), "REPEAT", False)
SCENE = replace(
    lamp_scene(),
    images=(WOOD,),
    materials=(*lamp_scene().materials, Material("Unused")),
    tri_tangents=np.tile(np.eye(3, dtype=np.float32), (len(lamp_scene().tri_vertex), 3, 1, 1)),
)


def other_value(knob):
    """A value of the knob besides its default."""
    if knob.metadata["choices"]:
        choice = knob.metadata["choices"][-1]
        return (choice,) if isinstance(knob.default, tuple) else next(c for c in knob.metadata["choices"] if c != knob.default)
    if isinstance(knob.default, bool):
        return not knob.default
    if isinstance(knob.default, str):
        return "{name}" if knob.metadata["find_error"] else "farm:8786"
    return knob.default + 1 if isinstance(knob.default, int) else knob.default / 2 or 1.0


def test_a_saved_snapshot_has_the_digest_of_the_one_in_memory(tmp_path):
    save_snapshot(tmp_path / "scene", SCENE)
    assert hash_bake(load_snapshot(tmp_path / "scene"), JOB) == hash_bake(SCENE, JOB)


@pytest.mark.parametrize("knob", dataclasses.fields(Settings), ids=lambda knob: knob.name)
def test_a_knob_counts_when_it_decides_the_images(knob):
    changed = replace(JOB, settings=replace(JOB.settings, **{knob.name: other_value(knob)}))
    same = hash_bake(SCENE, changed) == hash_bake(SCENE, JOB)
    assert same == (knob.name in ("workers", "cluster", "force", "pack"))


ARRAYS = [field.name for field in dataclasses.fields(SCENE) if isinstance(getattr(SCENE, field.name), np.ndarray)]


@pytest.mark.parametrize("name", ARRAYS)
def test_each_array_counts(name):
    changed = getattr(SCENE, name).copy()
    changed.flat[0] = 1 - changed.flat[0]
    assert hash_bake(replace(SCENE, **{name: changed}), JOB) != hash_bake(SCENE, JOB)


@pytest.mark.parametrize(
    "change",
    [
        {"lights": (replace(SCENE.lights[0], power_rgb=(10.0, 5.0, 2.6)),)},
        {"materials": (replace(SCENE.materials[0], albedo_rgb=(0.5, 0.5, 0.6)), SCENE.materials[1])},
        {"objects": (SCENE.objects[0], replace(SCENE.objects[1], receives=False))},
        {"images": (replace(SCENE.images[0], pixels=np.full((2, 3, 3), 0.6, np.float32)),)},
        {"images": (replace(SCENE.images[0], pixels=np.full((3, 2, 3), 0.5, np.float32)),)},
        {"images": (replace(SCENE.images[0], closest=True),)},
        {"world_rgb": (0.0, 0.0, 0.1)},
    ],
)
def test_the_rest_of_the_scene_counts(change):
    assert hash_bake(replace(SCENE, **change), JOB) != hash_bake(SCENE, JOB)


def test_the_name_counts_and_the_folder_does_not():
    assert hash_bake(SCENE, replace(JOB, atlas_name="hall")) != hash_bake(SCENE, JOB)
    assert hash_bake(SCENE, replace(JOB, output="elsewhere")) == hash_bake(SCENE, JOB)


def test_the_code_counts(monkeypatch):
    before = hash_bake(SCENE, JOB)
    monkeypatch.setattr(snapshot, "hash_code", lambda: "another version")
    assert hash_bake(SCENE, JOB) != before


def test_digest_of_the_code_is_of_every_core_module(tmp_path, monkeypatch):
    (tmp_path / "util").mkdir()
    for name in ("a.py", "util/b.py"):
        (tmp_path / name).write_text("first")
    monkeypatch.setattr(digest, "__file__", str(tmp_path / "util" / "digest.py"))
    digest.hash_code.cache_clear()
    digests = [digest.hash_code()]
    for name in ("a.py", "util/b.py"):
        (tmp_path / name).write_text("second")
        digest.hash_code.cache_clear()
        digests.append(digest.hash_code())
    digest.hash_code.cache_clear()
    assert len(set(digests)) == 3
