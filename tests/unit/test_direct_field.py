"""Shots add up to means, with the variance of means."""

import copy

import numpy as np
import pytest
from boxes import lamp_scene, prepare_folder
from leaflight.core.integrate import direct_shards
from leaflight.core.integrate.direct import DirectLight
from leaflight.core.integrate.direct_field import DirectField
from leaflight.core.parallel import executors
from leaflight.core.util.settings import Settings

SETTINGS = Settings(size=24, padding=1, error=0.25)


@pytest.fixture
def shot(tmp_path):
    n_texel = len(prepare_folder(tmp_path, lamp_scene(), SETTINGS)[1].texel_area)
    field = DirectField.none(n_texel)
    field.shoot(tmp_path, SETTINGS, executors.InlineExecutor(), np.arange(n_texel))
    return tmp_path, field


def test_a_second_shot_is_averaged_in_and_told_so(shot):
    folder, field = shot
    noisy = np.argsort(field.variance[:, 0])[-20:]
    noisy.sort()
    rest = np.setdiff1d(np.arange(len(field.passes)), noisy)
    irradiance, variance = field.irradiance.copy(), field.variance.copy()
    field.shoot(folder, SETTINGS, executors.InlineExecutor(), noisy)
    assert field.passes[noisy].tolist() == [2] * 20
    assert (field.passes[rest] == 1).all()
    np.testing.assert_array_equal(field.irradiance[rest], irradiance[rest])
    assert (field.irradiance[noisy] != irradiance[noisy]).any()
    assert field.variance[noisy].mean() < 0.8 * variance[noisy].mean()


def test_many_shots_come_to_the_light(shot):
    folder, field = shot
    once = field.irradiance.copy()
    for _ in range(20):
        field.shoot(folder, SETTINGS, executors.InlineExecutor(), np.arange(len(field.passes)))
    stated = np.sqrt(field.variance.mean())
    assert stated < 0.35 * np.sqrt(np.mean((once - field.irradiance) ** 2))
    assert field.counters["rays"] > 0


def test_a_shot_that_is_stopped_leaves_what_there_was(shot, monkeypatch):
    """And the next one is as if it had never been, as of a bake that goes on later."""
    folder, field = shot
    noisy = np.sort(np.argsort(field.variance[:, 0])[-200:])
    field.shoot(folder, SETTINGS, executors.InlineExecutor(), noisy[::2])
    other, asked = copy.deepcopy(field), []
    monkeypatch.setattr(direct_shards, "SHARD_TEXELS", 50)
    assert not field.shoot(folder, SETTINGS, executors.InlineExecutor(), noisy, should_stop=lambda: asked.append(True) or len(asked) > 2)
    assert len(asked) == 3
    for _ in range(2):
        for name in ("irradiance", "variance", "passes"):
            np.testing.assert_array_equal(getattr(field, name), getattr(other, name))
        assert (field.counters, field.turns) == (other.counters, other.turns)
        assert all(one.shoot(folder, SETTINGS, executors.InlineExecutor(), noisy) for one in (field, other))


def test_rare_light_is_right_on_average_however_often_texels_are_shot_again():
    """Each estimate counts rays that found it, three in the mean, and a texel is shot again while it errs too much."""

    def settle(choose):
        rng, field = np.random.default_rng(2), DirectField.none(1 << 14)
        field.by_openings[:] = True
        texels = np.arange(len(field.passes))
        while len(texels):
            found = rng.poisson(3.0, len(texels))[:, None] / np.full(3, 3.0)
            variance = np.maximum(found / 3, 1 / 24)
            field._add(
                texels, DirectLight(found.astype(np.float32), variance.astype(np.float32), {}, by_openings=np.ones(len(texels), bool))
            )
            error2 = (field.variance / (field.irradiance**2 + 0.01)).mean(axis=1)
            texels = np.flatnonzero((choose(field, error2) > 0.2**2) & (field.passes < 64))
        return field.irradiance[:, 0].mean(), np.sqrt(1 / 3 / len(field.passes) / field.passes.mean()), field.passes.mean()

    mean, noise, passes = settle(DirectField.share_error)
    assert passes > 4
    assert mean == pytest.approx(1.0, abs=4 * noise)
    assert abs(settle(lambda field, error2: error2)[0] - 1.0) > 10 * noise  # were each chosen by its own
