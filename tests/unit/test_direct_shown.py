"""What is said of smoothed direct light is what it is off."""

import numpy as np
import pytest
from leaflight.core.direct_field import DirectField
from leaflight.core.direct_shown import ShownDirect
from trees import entries_of_page, make_square_map

SIDE = 64


@pytest.fixture(scope="module")
def texels():
    return make_square_map(SIDE, 1)


def show(texels, truth, sigma, seed=1):
    """Noisy light, its variance, and what is shown of it."""
    noisy = (truth + sigma * np.random.default_rng(seed).standard_normal(truth.shape)).astype(np.float32)
    variance = np.broadcast_to(np.float32(sigma**2), truth.shape).copy()
    return noisy, variance, ShownDirect.smoothed(noisy, variance, texels, entries_of_page(texels))


def real_and_told(shown, truth):
    """How far the light is off, root mean square, and what is said of it."""
    return np.sqrt(((shown.irradiance - truth) ** 2).mean()), np.sqrt(shown.variance.mean() + max(shown.blur2.mean(), 0))


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


def test_blur_is_seen_as_such(texels):
    """Ripples half as high as the noise are smoothed away with it, on average over pages."""
    truth = ripple(texels.texel_xy[:, :1]) * np.ones(3)
    pages = [show(texels, truth, 0.2, seed)[2] for seed in range(4)]
    assert sum(shown.blur2.mean() for shown in pages) > sum(shown.variance.mean() for shown in pages) > 0


def test_smoothing_even_light_is_no_blur(texels):
    """What texels keep of their own noise is told apart from what was light, on average over pages."""
    sigma, told = 0.1, []
    for seed in range(20):
        noisy, _, shown = show(texels, np.ones((SIDE * SIDE, 3)), sigma, seed)
        by_chance = ((noisy - 1) ** 2).mean() - sigma**2  # how much more noise there is than is said
        told.append((shown.blur2.mean() - by_chance) / sigma**2)
    assert abs(np.mean(told)) < 0.003  # 0.001 by chance; a smoothed texel keeps 0.03 of its noise


def test_light_is_smoothed_where_it_has_grain_and_told_as_it_is_elsewhere(texels):
    truth = np.ones((SIDE * SIDE, 3))
    x = texels.texel_xy[:, 0]
    noisy = (truth + np.where(x < 20, 0.1, 0.001)[:, None] * np.random.default_rng(1).standard_normal(truth.shape)).astype(np.float32)
    variance = np.where(x < 20, np.float32(0.01), np.float32(1e-6))[:, None].repeat(3, axis=1)
    shown = ShownDirect.smoothed(noisy, variance, texels, entries_of_page(texels))
    far = x > 22
    for found, given in ((shown.irradiance, noisy), (shown.variance, variance), (shown.blur2, np.zeros_like(noisy))):
        np.testing.assert_array_equal(found[far], given[far])
        assert (found[x < 20] != given[x < 20]).mean() > 0.99


def test_light_with_little_noise_is_shown_as_it_is(texels):
    noisy, variance, shown = show(texels, np.ones((SIDE * SIDE, 3)), 0.001)
    assert shown.irradiance is noisy
    assert shown.variance is variance
    assert not shown.blur2.any()


def test_a_field_smooths_once_for_each_shot(texels):
    noisy, variance, shown = show(texels, np.ones((SIDE * SIDE, 3)), 0.1)
    field = DirectField(noisy, variance, np.ones(len(noisy), np.int16))
    entry_at = entries_of_page(texels)
    first = field.show(texels, entry_at, smooth=True)
    assert field.show(texels, entry_at, smooth=True) is first
    np.testing.assert_array_equal(first.irradiance, shown.irradiance)
    assert field.show(texels, entry_at, smooth=False).irradiance is noisy
