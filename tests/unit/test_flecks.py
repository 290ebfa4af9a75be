"""What few photons leave at rims and in small leaves is taken out, and nothing else."""

import numpy as np
import pytest
from leaflight.core.flecks import clip_flecks, fill_rims
from trees import make_map, make_square_map

RNG = np.random.default_rng(3)
HEIGHT = 6


def strips(*ends):
    """A map of rectangles side by side on one page, a chart each, from x to x; 6 texels high."""
    corners = [[[a, 0], [b, 0], [b, HEIGHT], [a, HEIGHT]] for a, b in ends]
    tri = np.array([[quad[i] for i in face] for quad in corners for face in ((0, 1, 2), (0, 2, 3))], float)
    return make_map(tri, np.repeat(np.arange(len(ends)), 2))


def fill(texels, side, parts=2):
    n = len(texels.texel_area)
    light, variance = RNG.random((parts, n, 3)).astype(np.float32), RNG.random((n, 3)).astype(np.float32)
    filled, doubt = light.copy(), variance.copy()
    fill_rims(filled, doubt, np.full(n, side, np.int32), texels, texels.entry_at)
    return light, variance, filled, doubt


@pytest.mark.parametrize("side", [16, 32])
def test_a_sliver_of_a_small_leaf_shows_what_is_beside_it(side):
    """Of two charts whose slivers are side by side, each looks at its own texels; those of large leaves are left."""
    texels = strips((0, 3.3), (3.8, 7))  # both have slivers in column 3
    light, variance, filled, doubt = fill(texels, side)
    x, y = texels.texel_xy.T
    sliver = ~texels.is_central
    assert x[sliver].tolist() == [3] * 2 * HEIGHT
    expected, expected_doubt = light.copy(), variance.copy()
    for entry in np.flatnonzero(sliver) if side == 16 else ():
        near = (np.abs(x - x[entry]) <= 1) & (np.abs(y - y[entry]) <= 1) & ~sliver & (texels.texel_chart == texels.texel_chart[entry])
        assert near.sum() in (2, 3)
        expected[:, entry], expected_doubt[entry] = light[:, near].mean(axis=1), variance[near].mean(axis=0)
    np.testing.assert_allclose(filled, expected, rtol=1e-6)
    np.testing.assert_allclose(doubt, expected_doubt, rtol=1e-6)


def test_a_chart_of_slivers_alone_stays():
    light, variance, filled, doubt = fill(strips((0, 3), (3.6, 3.9)), 2)
    np.testing.assert_array_equal(filled, light)
    np.testing.assert_array_equal(doubt, variance)


def clip(value, around=1.0, noise=0.2, side=2, width=12):
    """Light of a leaf of that value, and of what is around it, before and after; noise is relative to the leaf's."""
    texels = make_square_map(width, 0)
    x, y = texels.texel_xy.T
    leaf = np.where((x // side == 1) & (y // side == 1), 1, 0)
    colour = np.array([1.0, 0.5, 0.1], np.float32)
    light = np.where(leaf == 1, value, around * (0.5 + 0.5 * RNG.random(len(leaf))))[:, None] * colour
    light[(x == side - 1) & (y == side - 1)] = around * colour  # as near to all of the leaf as is looked
    light = light.astype(np.float32)
    variance = np.full_like(light, (noise * value * colour.mean()) ** 2)
    clipped = light.copy()
    clip_flecks(clipped, variance, leaf, np.full(len(leaf), side, np.int32), texels, texels.entry_at)
    np.testing.assert_array_equal(clipped[leaf == 0], light[leaf == 0])
    return clipped[leaf == 1], light[leaf == 1], colour


@pytest.mark.parametrize("side", [1, 2, 4])
def test_a_leaf_of_few_photons_is_no_brighter_than_all_around(side):
    clipped, _, colour = clip(4.0, side=side)
    np.testing.assert_allclose(clipped, np.tile(colour, (side * side, 1)), rtol=1e-6)


@pytest.mark.parametrize(
    "case",
    [
        {"value": 4.0, "noise": 0.1},  # many photons
        {"value": 1.4},  # little brighter
        {"value": 0.1},  # a dark one
        {"value": 4.0, "side": 8, "width": 24},  # a large leaf
        {"value": 4.0, "width": 4},  # twelve texels around
        {"value": 4.0, "around": 0.0},  # the only light
    ],
)
def test_other_leaves_are_left(case):
    clipped, before, _ = clip(**case)
    np.testing.assert_array_equal(clipped, before)


def test_a_dark_page_stays_dark():
    clipped, _, _ = clip(0.0, 0.0)
    assert not clipped.any()
