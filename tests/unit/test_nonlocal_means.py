"""Planes through like neighbours: of gradients nothing is lost, at borders neither, and what noise is left is what is told."""

import numpy as np
import pytest
from leaflight.core.filter.nonlocal_means import HALO, RADIUS, smooth_alike

SIDE = 24
SIGMA = 0.1


def make_chart(left=0):
    """A page without its halo, of which a chart covers the columns from `left` on."""
    whole = SIDE + 2 * HALO
    chart = np.full((whole, whole), -1, np.int32)
    chart[HALO:-HALO, HALO + left : -HALO] = 0
    return chart


def smooth(truth, sigma=SIGMA, left=0, seed=1, noise=None):
    """What is made of truth (SIDE, SIDE) and its noise; noise is what is said of it, if not that."""
    chart = make_chart(left)
    image = np.zeros(chart.shape, np.float32)
    image[HALO:-HALO, HALO:-HALO] = truth + sigma * np.random.default_rng(seed).standard_normal(truth.shape)
    variance = np.where(chart >= 0, np.float32((sigma if noise is None else noise) ** 2), np.float32(0))
    light = np.maximum(np.where(chart >= 0, image, np.float32(0)), 0)
    light, variance = (np.repeat(values[None], 3, axis=0) for values in (light, variance))
    return tuple(values[..., left:] for values in smooth_alike(light[None], variance, chart, with_variance=True))


def ramp(along_x, along_y):
    y, x = np.mgrid[:SIDE, :SIDE]
    return 1 + along_x * x + along_y * y


@pytest.mark.parametrize(("slope", "left"), [((0.004, 0.0), 0), ((0.0, -0.004), 5), ((0.003, 0.002), 7)])
def test_a_gradient_stays_as_it_is_at_borders_too(slope, left):
    """A mean over what there is on one side would be 2 or 4 texels' change off."""
    truth = ramp(*slope)
    fitted, _, _ = smooth(truth, sigma=0.0, left=left, noise=SIGMA)
    off = np.abs(fitted[0, 0] - truth[:, left:])
    assert off.max() < 0.6 * np.abs(slope).sum()
    assert off[RADIUS:-RADIUS, RADIUS:-RADIUS].max() < 1e-5


def test_noise_that_is_left_is_told_in_the_middle_and_at_borders():
    """Where texels are chosen by their noise too, it is the larger for that."""
    truth, found = np.ones((SIDE, SIDE)), [smooth(np.ones((SIDE, SIDE)), sigma=0.01, seed=seed, noise=0.05) for seed in range(60)]
    told = np.mean([left[0] for _, left, _ in found], axis=0) / 25
    real = np.mean([(fitted[0, 0] - truth) ** 2 for fitted, _, _ in found], axis=0)
    inner, border = slice(RADIUS, -RADIUS), np.ones((SIDE, SIDE), bool)
    border[1:-1, 1:-1] = False
    assert told[inner, inner].mean() == pytest.approx(real[inner, inner].mean(), rel=0.1)
    assert told[border].mean() == pytest.approx(real[border].mean(), rel=0.15)
    assert told[border].mean() > 2 * told[inner, inner].mean()


def test_a_texel_s_own_share_is_what_it_adds():
    truth = np.ones((SIDE, SIDE))
    for y, x in ((12, 12), (0, 0), (0, 12)):
        brighter = truth.copy()
        brighter[y, x] += 1e-3
        (plain, _, own_share), (fitted, _, _) = (smooth(image, sigma=0.0, noise=1.0) for image in (truth, brighter))
        assert (fitted - plain)[0, 0, y, x] == pytest.approx(1e-3 * own_share[y, x], rel=0.02)


def test_light_is_never_below_nothing():
    """As a plane through what rises ever faster would be where it begins."""
    y, x = np.mgrid[:SIDE, :SIDE]
    fitted, _, _ = smooth((x / SIDE) ** 3 + 0 * y, sigma=0.0, noise=1.0)
    assert fitted.min() == 0
    assert fitted[0, 0, :, 0].max() == 0
    assert fitted[0, 0, :, RADIUS:].min() > 0
