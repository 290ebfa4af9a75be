"""Digests: alike for what bakes alike, and different for each thing that decides the images."""

import dataclasses
from dataclasses import replace

import numpy as np
import pytest
from boxes import lamp_scene
from leaflight.core.scene import snapshot
from leaflight.core.scene.scene import Material, TextureImage
from leaflight.core.scene.snapshot import hash_bake, load_snapshot, save_snapshot
from leaflight.core.util import digest
from leaflight.core.util.job import Job
from leaflight.core.util.settings import Settings

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
