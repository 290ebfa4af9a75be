"""Grain is averaged over like neighbours, nothing else is, and what is said of the noise that is left is true."""

import numpy as np
import pytest
from leaflight.core.filter import denoise
from leaflight.core.filter.filtered_field import GRAIN, FilteredField, find_grain
from leaflight.core.filter.nonlocal_means import HALO, RADIUS, smooth_alike
from leaflight.core.integrate.direct_field import DirectField
from leaflight.core.parallel.executors import make_executor
from trees import make_square_map

# Grain is averaged over like neighbours, and nothing else is.
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


# Planes through like neighbours: of gradients nothing is lost, at borders neither, and what noise is left is what is told.
CHART_SIDE = 24


def make_chart(left=0):
    """A page without its halo, of which a chart covers the columns from `left` on."""
    whole = CHART_SIDE + 2 * HALO
    chart = np.full((whole, whole), -1, np.int32)
    chart[HALO:-HALO, HALO + left : -HALO] = 0
    return chart


def smooth_chart(truth, sigma=SIGMA, left=0, seed=1, noise=None):
    """What is made of truth (SIDE, SIDE) and its noise; noise is what is said of it, if not that."""
    chart = make_chart(left)
    image = np.zeros(chart.shape, np.float32)
    image[HALO:-HALO, HALO:-HALO] = truth + sigma * np.random.default_rng(seed).standard_normal(truth.shape)
    variance = np.where(chart >= 0, np.float32((sigma if noise is None else noise) ** 2), np.float32(0))
    light = np.maximum(np.where(chart >= 0, image, np.float32(0)), 0)
    light, variance = (np.repeat(values[None], 3, axis=0) for values in (light, variance))
    return tuple(values[..., left:] for values in smooth_alike(light[None], variance, chart, with_variance=True))


def ramp_chart(along_x, along_y):
    y, x = np.mgrid[:CHART_SIDE, :CHART_SIDE]
    return 1 + along_x * x + along_y * y


@pytest.mark.parametrize(("slope", "left"), [((0.004, 0.0), 0), ((0.0, -0.004), 5), ((0.003, 0.002), 7)])
def test_a_gradient_stays_as_it_is_at_borders_too(slope, left):
    """A mean over what there is on one side would be 2 or 4 texels' change off."""
    truth = ramp_chart(*slope)
    fitted, _, _ = smooth_chart(truth, sigma=0.0, left=left, noise=SIGMA)
    off = np.abs(fitted[0, 0] - truth[:, left:])
    assert off.max() < 0.6 * np.abs(slope).sum()
    assert off[RADIUS:-RADIUS, RADIUS:-RADIUS].max() < 1e-5


def test_noise_that_is_left_is_told_in_the_middle_and_at_borders():
    """Where texels are chosen by their noise too, it is the larger for that."""
    truth, found = (
        np.ones((CHART_SIDE, CHART_SIDE)),
        [smooth_chart(np.ones((CHART_SIDE, CHART_SIDE)), sigma=0.01, seed=seed, noise=0.05) for seed in range(60)],
    )
    told = np.mean([left[0] for _, left, _ in found], axis=0) / 25
    real = np.mean([(fitted[0, 0] - truth) ** 2 for fitted, _, _ in found], axis=0)
    inner, border = slice(RADIUS, -RADIUS), np.ones((CHART_SIDE, CHART_SIDE), bool)
    border[1:-1, 1:-1] = False
    assert told[inner, inner].mean() == pytest.approx(real[inner, inner].mean(), rel=0.1)
    assert told[border].mean() == pytest.approx(real[border].mean(), rel=0.15)
    assert told[border].mean() > 2 * told[inner, inner].mean()


def test_a_texel_s_own_share_is_what_it_adds():
    truth = np.ones((CHART_SIDE, CHART_SIDE))
    for y, x in ((12, 12), (0, 0), (0, 12)):
        brighter = truth.copy()
        brighter[y, x] += 1e-3
        (plain, _, own_share), (fitted, _, _) = (smooth_chart(image, sigma=0.0, noise=1.0) for image in (truth, brighter))
        assert (fitted - plain)[0, 0, y, x] == pytest.approx(1e-3 * own_share[y, x], rel=0.02)


def test_light_is_never_below_nothing():
    """As a plane through what rises ever faster would be where it begins."""
    y, x = np.mgrid[:CHART_SIDE, :CHART_SIDE]
    fitted, _, _ = smooth_chart((x / CHART_SIDE) ** 3 + 0 * y, sigma=0.0, noise=1.0)
    assert fitted.min() == 0
    assert fitted[0, 0, :, 0].max() == 0
    assert fitted[0, 0, :, RADIUS:].min() > 0


# What is said of smoothed direct light is what it is off.
PAGE_SIDE = 64


@pytest.fixture(scope="module")
def page_texels():
    return make_square_map(PAGE_SIDE, 1)


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


def even_light(x):
    return np.ones_like(x)


def ripple(x):
    return 1 + 0.1 * np.sin(1.5 * x)


def wave(x):
    return 1 + 0.1 * np.sin(0.5 * x)


def ramp_light(x):
    return 1 + np.clip((x - 20) / 20, 0, 1)


def edge_light(x):
    return np.where(x < 30, 1.0, 3.0)


@pytest.mark.parametrize("sigma", [0.02, 0.1, 0.3])
@pytest.mark.parametrize("light", [even_light, ripple, wave, ramp_light, edge_light])
def test_what_is_told_is_what_the_light_is_off(page_texels, light, sigma):
    truth = light(page_texels.texel_xy[:, :1]) * np.ones(3)
    noisy, _, shown = show(page_texels, truth, sigma)
    real, told = real_and_told(shown, truth)
    assert 0.7 * real < told < 1.4 * real
    smoothed = (shown.irradiance != noisy).any(axis=1)
    dim = truth[:, 0] < 1.3  # where light is bright, noise of 2 % is too little to care for
    assert smoothed[dim if sigma == 0.02 else slice(None)].all()
    assert np.sqrt(((shown.irradiance - truth)[smoothed] ** 2).mean()) < 0.4 * sigma


def test_smoothing_even_light_is_no_blur(page_texels):
    """What texels keep of their own noise is told apart from what was light, on average over pages."""
    sigma, told = 0.1, []
    for seed in range(20):
        noisy, _, shown = show(page_texels, np.ones((PAGE_SIDE * PAGE_SIDE, 3)), sigma, seed)
        by_chance = ((noisy - 1) ** 2).mean() - sigma**2  # how much more noise there is than is said
        told.append((shown.blur2_at(np.arange(PAGE_SIDE * PAGE_SIDE)).mean() - by_chance) / sigma**2)
    assert abs(np.mean(told)) < 0.003  # 0.001 by chance; a smoothed texel keeps 0.03 of its noise


def test_few_dark_texels_among_lit_ones_are_told_roughly(page_texels):
    """Where one ray in a hundred of a texel's four met something, nearly all texels say that they have no noise at all."""
    real2, told2, every = [], [], np.arange(PAGE_SIDE * PAGE_SIDE)
    for seed in range(8):
        lit = (np.random.default_rng(seed).random((4, len(every), 1)) < 0.99).mean(axis=0).astype(np.float32).repeat(3, axis=1)
        shown = FilteredField.begin_smoothing(lit, lit * (1 - lit) / 3, page_texels)()
        real2.append(((shown.irradiance - 0.99) ** 2).mean())
        told2.append((shown.variance_at(every) + shown.blur2_at(every)).mean())
    assert 0.7**2 < np.mean(told2) / np.mean(real2) < 1.5**2


def test_light_is_smoothed_where_it_has_grain_and_told_as_it_is_elsewhere(page_texels):
    truth = np.ones((PAGE_SIDE * PAGE_SIDE, 3))
    x = page_texels.texel_xy[:, 0]
    noisy = (truth + np.where(x < 20, 0.1, 0.001)[:, None] * np.random.default_rng(1).standard_normal(truth.shape)).astype(np.float32)
    variance = np.where(x < 20, np.float32(0.01), np.float32(1e-6))[:, None].repeat(3, axis=1)
    shown = FilteredField.begin_smoothing(noisy, variance, page_texels)()
    far, every = x > 24, np.arange(PAGE_SIDE * PAGE_SIDE)
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


def test_the_less_error_is_asked_for_the_less_noise_is_left_as_it_is(page_texels):
    noisy, variance, _ = show(page_texels, np.ones((PAGE_SIDE * PAGE_SIDE, 3)), 0.01)
    smoothed = []
    for error in (0.05, 0.02, 0.01, 0.004):
        field = DirectField(noisy, variance, np.ones(len(noisy), np.int16))
        field.ask_for(error)
        smoothed.append(len(field.show(page_texels, smooth=True).entry))
    assert smoothed == [0, 0, PAGE_SIDE * PAGE_SIDE, PAGE_SIDE * PAGE_SIDE]
    assert find_grain(1.0) == find_grain(0.02) == 4 * find_grain(0.005) == GRAIN
