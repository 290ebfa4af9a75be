"""What a process keeps open, and shards of texels: pure functions, whoever runs them."""

from dataclasses import replace

import numpy as np
from boxes import lamp_scene, prepare_folder, to_bytes
from leaflight.core.integrate import texel_shards
from leaflight.core.util.settings import Settings

SETTINGS = Settings(size=32, padding=1)


def test_a_direct_shard_is_a_pure_function_and_takes_its_texels_only(tmp_path):
    _, texel_map = prepare_folder(tmp_path, lamp_scene(), SETTINGS)
    shard = texel_shards.DirectShard(str(tmp_path), seed=1, turn=0, start=0, texels=np.arange(10, 60), tolerance=0.01)
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
