"""Shards in which direct light is asked for, and the first of them, which are sent ahead."""

from dataclasses import replace

import numpy as np
import pytest
from boxes import lamp_scene, prepare_folder
from leaflight.core.integrate import direct_shards, texel_shards
from leaflight.core.integrate.direct_field import DirectField
from leaflight.core.integrate.direct_shards import NOTHING_AHEAD, ShotAhead
from leaflight.core.parallel import executors, folders
from leaflight.core.texels.error_metric import DARK_FLOOR
from leaflight.core.util.settings import Settings

SETTINGS = Settings(size=64, padding=1, workers=1, error=0.2)


@pytest.mark.parametrize("count", [0, 1, 2, 100, 6_000, 9_300, 37_339, 200_000, 541_000, 711_122, 11_702_608])
def test_two_workers_have_shards_alike(count):
    ends = direct_shards.cut_into_shards(count)
    sizes = np.diff(ends)
    assert ends[0] == 0
    assert ends[-1] == count
    assert (sizes > 0).all()
    assert np.ptp(sizes) <= 1 if count else not len(sizes)
    if count > 1.5 * direct_shards.SHARD_TEXELS:
        assert len(sizes) % 2 == 0 or len(sizes) > 32
        assert sizes.min() > 4_000
        assert sizes.max() <= 1 << 15  # one chunk
        assert len(sizes) >= min(count // 9_300, 31)


class Noting(executors.InlineExecutor):
    """Knows what it was asked for."""

    def __init__(self):
        super().__init__()
        self.shards = []

    def submit(self, fn, /, *args, **kwargs):
        self.shards += args
        return super().submit(fn, *args, **kwargs)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """With a scene of which direct light takes a dozen shards; its number of texels."""
    n_texel = len(prepare_folder(tmp_path, lamp_scene(), SETTINGS)[1])
    monkeypatch.setattr(direct_shards, "SHARD_TEXELS", n_texel // 12)
    yield tmp_path, n_texel
    folders.forget_folders()


def shoot(folder, n_texel, ahead, executor):
    field = DirectField.none(n_texel)
    assert field.shoot(folder, SETTINGS, executor, range(n_texel), ahead=ahead)
    return field


def test_shards_sent_ahead_are_not_sent_again_and_have_the_same_light_where_nothing_else_is_seen(folder):
    folder, n_texel = folder
    executor = Noting()
    whole = shoot(folder, n_texel, NOTHING_AHEAD, executor)
    every, executor.shards = executor.shards, []
    ahead = ShotAhead.send(folder, SETTINGS, executor, n_texel)
    assert ahead.count == 1
    assert not executor.shards  # nobody has asked for them yet
    parted = shoot(folder, n_texel, ahead, executor)
    assert executor.shards == every[ahead.count :]
    np.testing.assert_array_equal(parted.irradiance, whole.irradiance)
    np.testing.assert_array_equal(parted.variance, whole.variance)
    assert parted.counters == whole.counters
    assert (parted.passes == 1).all()


@pytest.mark.parametrize(("error_of", "share"), [("bake", DARK_FLOOR), ("objects", DARK_FLOOR**2)])
def test_below_a_sky_shards_sent_ahead_know_how_bright_all_is(tmp_path, monkeypatch, error_of, share):
    settings, seen, light_texels = replace(SETTINGS, error_of=error_of), [], texel_shards.light_texels
    n_texel = len(prepare_folder(tmp_path, replace(lamp_scene(), world_rgb=(1.0, 1.0, 1.0)), settings)[1])
    monkeypatch.setattr(direct_shards, "SHARD_TEXELS", n_texel // 12)
    monkeypatch.setattr(texel_shards, "light_texels", lambda shard: seen.append(shard) or light_texels(shard))
    every = range(n_texel)
    glance = direct_shards.glance(direct_shards.ask_for_direct(tmp_path, settings, 0, every))
    seen.clear()
    ShotAhead.send(tmp_path, settings, executors.InlineExecutor(), n_texel).wait()
    assert [shard.dark for shard in seen] == [0.0] + [share * glance] * (len(seen) - 1)  # the first is the glance
    field = DirectField.none(n_texel)
    field.shoot(tmp_path, settings, executors.InlineExecutor(), every)
    assert 0.8 < glance / field.irradiance.mean() < 1.25
    folders.forget_folders()
