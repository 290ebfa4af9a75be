"""Means of images and of their squares."""

from __future__ import annotations

import numpy as np
import pytest
from leaflight.core.scene.mipmap import Mipmap, halve
from leaflight.core.scene.scene import TextureImage

WHITE = (1.0, 1.0, 1.0)


def centres(height: int, width: int) -> np.ndarray:
    """(height * width, 2): UV of texels, row by row."""
    column, row = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    return np.stack([column.ravel(), row.ravel()], axis=1)


@pytest.mark.parametrize("rows", [4, 700])  # the large image is halved in parts
def test_texels_are_means_of_four(rows):
    pixels = np.random.default_rng(1).random((2 * rows, 12, 3)).astype(np.float32)
    expected = pixels.reshape(rows, 2, 6, 2, 3).mean(axis=(1, 3))
    assert halve(pixels) == pytest.approx(expected, rel=1e-6)
    mean, square = Mipmap(TextureImage("Picture", pixels, closest=True), WHITE).at(1, centres(rows, 6))
    assert mean == pytest.approx(expected.reshape(-1, 3), rel=1e-3)
    assert square == pytest.approx((pixels**2).reshape(rows, 2, 6, 2, 3).mean(axis=(1, 3)).reshape(-1, 3), rel=1e-3)


def test_colours_are_linear_between_texels_of_a_level():
    """Those of `closest` images too: a level's texels lie a little apart from their own."""
    pixels = np.repeat(np.float32([0, 0, 1, 1])[None, :, None], 3, axis=2)
    mean = Mipmap(TextureImage("Picture", pixels, extension="EXTEND", closest=True), WHITE).at(1, np.array([[0.5, 0.5], [0.25, 0.5]]))[0]
    assert mean[:, 0] == pytest.approx([0.5, 0])


def test_levels_go_on_to_the_mean_of_all():
    """And from an image of another size: the rows of an odd one do not count alike, but nearly."""
    pixels = np.random.default_rng(2).random((64, 32, 3)).astype(np.float32)
    mean, square = Mipmap(TextureImage("Picture", pixels), (2.0, 1.0, 0.0)).at(6, np.array([[0.3, 0.7]]))
    assert mean[0] == pytest.approx(pixels.mean(axis=(0, 1)) * (2, 1, 0), rel=1e-4)
    assert square[0] == pytest.approx((pixels**2).mean(axis=(0, 1)) * (4, 1, 0), rel=1e-4)
    odd = Mipmap(TextureImage("Picture", pixels[:45, :23]), WHITE).at(6, np.array([[0.3, 0.7]]))[0]
    assert odd[0] == pytest.approx(pixels[:45, :23].mean(axis=(0, 1)), rel=0.05)


@pytest.mark.parametrize("size", [45, 360, 1025, 2161])
def test_a_bright_spot_stays_where_it_is(size):
    """Sizes that are odd sooner or later: less than a texel of the level beside its own place."""
    for at in (0, size // 3, size - size // 40, size - 1):
        pixels = np.zeros((1, size, 3), np.float32)
        pixels[0, at] = 1
        for level in (1, 3, 5, 9):
            count = size
            for _ in range(level):
                count = (count + 1) // 2
            shown = Mipmap(TextureImage("Spot", pixels, extension="EXTEND"), WHITE).at(level, centres(1, count))[0][:, 0]
            assert shown.sum() > 0
            assert abs((shown.argmax() + 0.5) / count - (at + 0.5) / size) < 1 / count


def test_what_is_no_colour_is_black():
    pixels = np.full((4, 4, 3), 2.0, np.float32)
    pixels[0, 0], pixels[0, 1], pixels[1, 0] = np.nan, np.inf, -5
    mean, square = Mipmap(TextureImage("Picture", pixels), WHITE).at(1, centres(2, 2))
    assert mean[0] == pytest.approx([0.5] * 3)
    assert square[0] == pytest.approx([1.0] * 3)
    assert mean[1:] == pytest.approx(2)
    huge = Mipmap(TextureImage("Picture", np.full((4, 4, 3), 1e30, np.float32)), WHITE).at(2, np.array([[0.5, 0.5]]))
    assert np.isfinite(huge[1]).all()
