"""What is said of smoothed direct light is what it is off."""

import numpy as np
import pytest
from leaflight.core.filter.filtered_field import GRAIN, FilteredField, find_grain
from leaflight.core.integrate.direct_field import DirectField
from trees import make_square_map

SIDE = 64


@pytest.fixture(scope="module")
def texels():
    return make_square_map(SIDE, 1)


def show(texels, truth, sigma, seed=1):
    """Noisy light, its variance, and what is shown of it."""
    noisy = (truth + sigma * np.random.default_rng(seed).standard_normal(truth.shape)).astype(np.float32)
    variance = np.broadcast_to(np.float32(sigma**2), truth.shape).copy()
    return noisy, variance, FilteredField.begin_smoothing(noisy, variance, texels)()


def real_and_told(shown, truth):
    """How far the light is off, root mean square, and what is said of it."""
    every = np.arange(len(shown))
    told = np.sqrt(shown.variance_at(every).mean() + max(shown.blur2_at(every).mean(), 0))
    return np.sqrt(((shown.irradiance - truth) ** 2).mean()), told


def even(x):
    return np.ones_like(x)


def ripple(x):
    return 1 + 0.1 * np.sin(1.5 * x)


def wave(x):
    return 1 + 0.1 * np.sin(0.5 * x)


def ramp(x):
    return 1 + np.clip((x - 20) / 20, 0, 1)


def edge(x):
    return np.where(x < 30, 1.0, 3.0)


@pytest.mark.parametrize("sigma", [0.02, 0.1, 0.3])
@pytest.mark.parametrize("light", [even, ripple, wave, ramp, edge])
def test_what_is_told_is_what_the_light_is_off(texels, light, sigma):
    truth = light(texels.texel_xy[:, :1]) * np.ones(3)
    noisy, _, shown = show(texels, truth, sigma)
    real, told = real_and_told(shown, truth)
    assert 0.7 * real < told < 1.4 * real
    smoothed = (shown.irradiance != noisy).any(axis=1)
    dim = truth[:, 0] < 1.3  # where light is bright, noise of 2 % is too little to care for
    assert smoothed[dim if sigma == 0.02 else slice(None)].all()
    assert np.sqrt(((shown.irradiance - truth)[smoothed] ** 2).mean()) < 0.4 * sigma


def test_smoothing_even_light_is_no_blur(texels):
    """What texels keep of their own noise is told apart from what was light, on average over pages."""
    sigma, told = 0.1, []
    for seed in range(20):
        noisy, _, shown = show(texels, np.ones((SIDE * SIDE, 3)), sigma, seed)
        by_chance = ((noisy - 1) ** 2).mean() - sigma**2  # how much more noise there is than is said
        told.append((shown.blur2_at(np.arange(SIDE * SIDE)).mean() - by_chance) / sigma**2)
    assert abs(np.mean(told)) < 0.003  # 0.001 by chance; a smoothed texel keeps 0.03 of its noise


def test_few_dark_texels_among_lit_ones_are_told_roughly(texels):
    """Where one ray in a hundred of a texel's four met something, nearly all texels say that they have no noise at all."""
    real2, told2, every = [], [], np.arange(SIDE * SIDE)
    for seed in range(8):
        lit = (np.random.default_rng(seed).random((4, len(every), 1)) < 0.99).mean(axis=0).astype(np.float32).repeat(3, axis=1)
        shown = FilteredField.begin_smoothing(lit, lit * (1 - lit) / 3, texels)()
        real2.append(((shown.irradiance - 0.99) ** 2).mean())
        told2.append((shown.variance_at(every) + shown.blur2_at(every)).mean())
    assert 0.7**2 < np.mean(told2) / np.mean(real2) < 1.5**2


def test_light_is_smoothed_where_it_has_grain_and_told_as_it_is_elsewhere(texels):
    truth = np.ones((SIDE * SIDE, 3))
    x = texels.texel_xy[:, 0]
    noisy = (truth + np.where(x < 20, 0.1, 0.001)[:, None] * np.random.default_rng(1).standard_normal(truth.shape)).astype(np.float32)
    variance = np.where(x < 20, np.float32(0.01), np.float32(1e-6))[:, None].repeat(3, axis=1)
    shown = FilteredField.begin_smoothing(noisy, variance, texels)()
    far, every = x > 24, np.arange(SIDE * SIDE)
    assert not np.isin(shown.entry, np.flatnonzero(far)).any()
    for found, given in (
        (shown.irradiance, noisy),
        (shown.variance_at(every), variance),
        (shown.blur2_at(every), np.zeros_like(noisy)),
    ):
        np.testing.assert_array_equal(found[far], given[far])
        assert (found[x < 20] != given[x < 20]).mean() > 0.99
    assert shown.total_light == pytest.approx(shown.irradiance.sum(dtype=float), rel=1e-6)
    assert shown.total_light != pytest.approx(noisy.sum(dtype=float), rel=1e-6)


def test_the_less_error_is_asked_for_the_less_noise_is_left_as_it_is(texels):
    noisy, variance, _ = show(texels, np.ones((SIDE * SIDE, 3)), 0.01)
    smoothed = []
    for error in (0.05, 0.02, 0.01, 0.004):
        field = DirectField(noisy, variance, np.ones(len(noisy), np.int16))
        field.ask_for(error)
        smoothed.append(len(field.show(texels, smooth=True).entry))
    assert smoothed == [0, 0, SIDE * SIDE, SIDE * SIDE]
    assert find_grain(1.0) == find_grain(0.02) == 4 * find_grain(0.005) == GRAIN
