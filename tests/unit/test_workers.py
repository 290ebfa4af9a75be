"""What a process keeps open, and shards of texels: pure functions, whoever runs them."""

from dataclasses import replace

import numpy as np
import pytest
from boxes import lamp_scene, prepare_folder, to_bytes
from leaflight.core.integrate import texel_shards
from leaflight.core.lights import emitters
from leaflight.core.parallel import folders, shared_arrays
from leaflight.core.scene.scene import SceneObject
from leaflight.core.transport import traced_scene
from leaflight.core.util.settings import Settings

SETTINGS = Settings(size=32, padding=1)


def test_what_is_dark_goes_with_a_direct_shard(tmp_path, monkeypatch):
    prepare_folder(tmp_path, lamp_scene(), SETTINGS)
    asked = []
    monkeypatch.setattr(texel_shards.direct, "direct_irradiance", lambda *_, dark, **__: asked.append(dark))
    monkeypatch.setattr(texel_shards.direct_quads, "light_by_quads", lambda find_light, *_: find_light())
    texel_shards.light_texels(texel_shards.DirectShard(str(tmp_path), 1, 0, 0, np.arange(5), tolerance=0.01, smoothed=False, dark=3.0))
    assert asked == [3.0]


def test_a_direct_shard_is_a_pure_function_and_takes_its_texels_only(tmp_path):
    _, texel_map = prepare_folder(tmp_path, lamp_scene(), SETTINGS)
    shard = texel_shards.DirectShard(str(tmp_path), seed=1, turn=0, start=0, texels=np.arange(10, 60), tolerance=0.01, smoothed=False)
    light = texel_shards.light_texels(shard)
    assert light.irradiance_rgb.shape == (50, 3)
    assert light.irradiance_rgb.dtype == light.variance_rgb.dtype == np.float32
    assert np.median(light.variance_rgb) < (0.1 * np.median(light.irradiance_rgb)) ** 2  # most texels see all of the lamp
    for same in (shard, replace(shard, texels=range(10, 60))):
        assert to_bytes(texel_shards.light_texels(same)) == to_bytes(light)
    everywhere = replace(shard, texels=np.arange(len(texel_map.texel_area)))
    whole = texel_shards.light_texels(everywhere).irradiance_rgb
    assert (
        texel_shards.light_texels(replace(everywhere, turn=1)).irradiance_rgb != whole
    ).any()  # in half shadow other rays see other light
    assert np.median(np.abs(light.irradiance_rgb - whole[10:60]) / np.maximum(whole[10:60], 1e-3)) < 0.02


def test_a_folder_is_opened_once_until_it_is_forgotten(tmp_path):
    scene = lamp_scene()
    prepare_folder(tmp_path, scene, SETTINGS)
    opened = traced_scene.open_tracing(str(tmp_path))
    assert traced_scene.open_tracing(str(tmp_path)) is opened
    shared_arrays.remove_struct(tmp_path / folders.TEXELS_FOLDER)
    prepare_folder(tmp_path, replace(scene, objects=(SceneObject("Other"), SceneObject("Block"))), SETTINGS)
    folders.forget_folders()
    assert traced_scene.open_tracing(str(tmp_path)).snapshot.objects[0].name == "Other"


def test_a_scene_without_light_is_a_sentence(tmp_path):
    prepare_folder(tmp_path, replace(lamp_scene(), lights=()), SETTINGS)
    with pytest.raises(ValueError, match="the scene has no light: add"):
        traced_scene.open_tracing(str(tmp_path))


def test_a_folder_that_cannot_be_opened_ahead_is_told_when_there_is_work(tmp_path):
    traced_scene.open_ahead(str(tmp_path))
    with pytest.raises(FileNotFoundError):
        traced_scene.open_tracing(str(tmp_path))


def test_solids_that_shine_are_looked_for_once(tmp_path, monkeypatch):
    """For photons and for shadow rays: of a ball of many triangles that takes seconds."""
    scene = lamp_scene()
    shining = tuple(replace(material, emission_rgb=(1.0, 1.0, 1.0)) for material in scene.materials)
    prepare_folder(tmp_path, replace(scene, materials=shining), SETTINGS)
    times = []
    monkeypatch.setattr(emitters, "find_sealed", lambda snapshot, shines, *_: times.append(shines.any()) or np.zeros(snapshot.n_tri, bool))
    folders.forget_folders()
    texel_shards.light_texels(
        texel_shards.DirectShard(str(tmp_path), seed=1, turn=0, start=0, texels=np.arange(5), tolerance=0.01, smoothed=False)
    )
    assert times == [True]
