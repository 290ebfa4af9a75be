"""Grain is averaged over like neighbours, and nothing else is."""

import numpy as np
import pytest
from leaflight.core.filter import denoise
from leaflight.core.parallel.executors import make_executor
from trees import make_square_map

SIDE = 48
SIGMA = 0.1


@pytest.fixture(scope="module")
def texels():
    return make_square_map(SIDE, 1)


def denoise_all(light, variance, grainy, texels):
    """Light (k, n, 3) with what denoise smooths in place."""
    found, out = denoise.denoise(light, variance, grainy, texels), light.copy()
    assert not found.variance.any()  # nobody asked for it
    out[:, found.entry] = found.light
    return out


def smooth(texels, truth, sigma=SIGMA, grainy=True, seed=1, scale=1.0):
    """Images (h, w) of noisy light and of what denoise makes of it; truth is a function of the texel's x and y."""
    x, y = texels.texel_xy.T
    noisy = truth(x, y)[:, None] + sigma * np.random.default_rng(seed).standard_normal((3, len(x))).T
    light = np.float32([0.75 * noisy, 0.25 * noisy]) * np.float32(scale)
    variance = np.full((len(x), 3), (sigma * scale) ** 2, np.float32)
    out = denoise_all(light, variance, np.full(len(x), grainy), texels)
    np.testing.assert_allclose(out[0], 3 * out[1], rtol=1e-4, atol=1e-12)  # parts are averaged alike
    return tuple(image_of(texels, one.sum(0)[:, 0] / scale) for one in (light, out))


def image_of(texels, values):
    image = np.empty((SIDE, SIDE))
    image[texels.texel_xy[:, 1], texels.texel_xy[:, 0]] = values
    return image


def even(x, y):
    return np.ones(len(x))


def edge(x, y):
    return np.where(x < SIDE // 2, 1.0, 3.0)


def ramp(x, y):
    return 1.0 + x / SIDE


@pytest.mark.parametrize(("truth", "gain"), [(even, 4.0), (edge, 3.5), (ramp, 3.0)])
def test_noise_falls(texels, truth, gain):
    noisy, found = smooth(texels, truth)
    expected = image_of(texels, truth(*texels.texel_xy.T))
    assert np.sqrt(((found - expected) ** 2).mean()) < np.sqrt(((noisy - expected) ** 2).mean()) / gain


def test_a_step_of_four_errors_is_seen(texels):
    def step(x, y):
        return np.where(x < SIDE // 2, 1.0, 1.0 + 4 * SIGMA)

    columns = smooth(texels, step)[1].mean(axis=0)
    assert columns[SIDE // 2] - columns[SIDE // 2 - 1] > 0.75 * 4 * SIGMA


def test_nothing_is_touched_where_there_is_no_grain(texels):
    noisy, found = smooth(texels, even, grainy=False)
    assert (found == noisy).all()


def test_dark_light_of_bright_noise_stays_dark(texels):
    """Of two kinds of light, of which one is smoothed, the noise may be all of the other's."""
    n = len(texels.texel_xy)
    found = denoise_all(np.zeros((1, n, 3), np.float32), np.ones((n, 3), np.float32), np.ones(n, bool), texels)
    assert not found.any()


@pytest.mark.parametrize("scale", [1e-12, 1e12])
def test_tiny_and_huge_light_is_smoothed_alike(texels, scale):
    np.testing.assert_allclose(smooth(texels, edge, scale=scale)[1], smooth(texels, edge)[1], rtol=1e-3, atol=1e-12)


@pytest.mark.parametrize("brightness", [0.1, 30.0])
def test_noise_that_is_left_is_told_in_the_units_of_the_light(texels, brightness):
    """With how much of it a texel keeps of its own, whatever the light's scale."""
    count, told = len(texels.texel_xy), []
    noise = np.random.default_rng(1).standard_normal((count, 3))
    for scale in (1.0, brightness):
        light, variance = np.float32([scale * (1.0 + SIGMA * noise)]), np.full((count, 3), (scale * SIGMA) ** 2, np.float32)
        smoothed = denoise.denoise(light, variance, np.ones(count, bool), texels, with_variance=True)
        told.append(smoothed)
        real = ((smoothed.light[0] / scale - 1.0) ** 2).mean()
        assert smoothed.variance.mean() / scale**2 == pytest.approx(real, rel=0.2)
    np.testing.assert_allclose(told[1].variance / brightness**2, told[0].variance, rtol=1e-3)
    np.testing.assert_allclose(told[1].own_share, told[0].own_share, rtol=1e-3)


def test_a_flash_beyond_all_others_stays_finite(texels):
    def flash(x, y):
        return np.where((x == 7) & (y == 9), 1e25, 1.0)

    found = smooth(texels, flash)[1]
    assert np.isfinite(found).all()
    assert np.delete(found.ravel(), 9 * SIDE + 7).max() < 2.0


@pytest.mark.parametrize("piece", [0, 1])
def test_charts_do_not_mix_unless_they_were_one(texels, monkeypatch, piece):
    """Two halves of the page that are charts of their own, and differ by less than their noise."""
    x = texels.texel_xy[:, 0]
    monkeypatch.setitem(texels.__dict__, "texel_chart", (x >= SIDE // 2).astype(np.int32))
    monkeypatch.setitem(texels.__dict__, "chart_page", np.zeros(2, np.int32))
    monkeypatch.setitem(texels.__dict__, "chart_piece", np.array([0, piece], np.int32))
    light = np.zeros((1, len(x), 3), np.float32) + np.where(x < SIDE // 2, 1.0, 1.1).astype(np.float32)[:, None]
    found = denoise_all(light, np.ones((len(x), 3), np.float32), np.ones(len(x), bool), texels)
    assert np.allclose(found, light, rtol=1e-5) == (piece == 1)


def test_processes_change_no_byte():
    texels = make_square_map(96, 1)  # four tiles
    rng = np.random.default_rng(5)
    light = 1 + SIGMA * rng.standard_normal((2, len(texels.texel_area), 3), np.float32)
    variance, grainy = np.full(light.shape[1:], SIGMA**2, np.float32), np.ones(light.shape[1], bool)
    found = []
    for workers in (1, 2):
        with make_executor(workers) as executor:
            found.append(denoise.denoise(light, variance, grainy, texels, executor.spread, with_variance=True))
    assert len(found[0].entry) == len(grainy)
    for name in ("entry", "light", "variance", "own_share"):
        np.testing.assert_array_equal(*(getattr(one, name) for one in found))
