"""Shards in which direct light is asked for, and the first of them, which are sent ahead."""

import numpy as np
import pytest
from boxes import lamp_scene, prepare_folder
from leaflight.core.integrate import direct_shards
from leaflight.core.integrate.direct_field import DirectField
from leaflight.core.integrate.direct_shards import NOTHING_AHEAD, ShotAhead
from leaflight.core.parallel import executors, folders
from leaflight.core.util.settings import Settings

SETTINGS = Settings(size=64, padding=1, workers=1, error=0.2)


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
