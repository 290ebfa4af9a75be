"""Tiles: squares of texels among those of charts, and light over them told by nine of their texels."""

from __future__ import annotations

import numpy as np
from floors import morton_square
from leaflight.core.texels.tiles import TILE_TEXELS, find_calm


def test_gentle_light_is_calm_and_an_edge_is_not():
    """A bent ramp, a ramp with noise, and a hard edge of the same height as the noise."""
    x, y = morton_square(8)
    ramp = 1.0 + 0.1 * x + 0.05 * y - 0.01 * x * y
    noisy = ramp + np.random.default_rng(1).normal(scale=0.1, size=TILE_TEXELS)
    edge = ramp + 1.0 * (x > 3)
    value = np.stack([ramp, noisy, edge])
    assert find_calm(value, np.full(3, 1e-5)).tolist() == [True, False, False]
    assert find_calm(value, np.full(3, 0.03)).tolist() == [True, True, False]


def test_tiles_that_are_off_by_more_than_they_show_are_not_calm():
    value, allowed = np.ones((3, TILE_TEXELS)), np.full(3, 0.1)
    assert find_calm(value, allowed, least=np.array([0.0, 0.39, 0.41]) ** 2).tolist() == [True, True, False]


def test_even_light_without_noise_is_calm():
    assert find_calm(np.zeros((1, TILE_TEXELS)), np.zeros(1), True).all()
