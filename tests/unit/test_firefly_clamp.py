"""What few photons leave in small leaves is taken out, and nothing else."""

import numpy as np
import pytest
from leaflight.core.filter.firefly_clamp import clip_flecks
from trees import make_map, make_square_map

RNG = np.random.default_rng(3)


def clip(value, around=1.0, noise=0.2, side=2, width=12, neighbour=None, corner=(-1, -1)):
    """Light of a leaf of that value before and after, and its colour; noise is relative to the leaf's.

    neighbour   value of the leaf to the right of it, as noisy
    corner      which of the texels beyond the leaf's corners is the brightest around
    """
    texels = make_square_map(width, 0)
    x, y = texels.texel_xy.T
    leaf = x // side + 100 * (y // side)
    own, right = leaf == 101, leaf == 102
    colour = np.array([1.0, 0.5, 0.1], np.float32)
    light = around * (0.5 + 0.5 * RNG.random(len(leaf)))
    column, row = (side - 1 if way < 0 else 2 * side for way in corner)
    light[(x == column) & (y == row)] = around  # as near to all of the leaf as is looked
    light[own] = value
    size = np.full(len(leaf), max(side, 8), np.int32)
    size[own] = side
    if neighbour is not None:
        light[right], size[right] = neighbour, side
    light = (light[:, None] * colour).astype(np.float32)
    clipped = light.copy()
    clip_flecks(clipped, (noise * light.mean(axis=1, keepdims=True) * np.ones(3)) ** 2, leaf, size, texels)
    np.testing.assert_array_equal(clipped[~own & ~right], light[~own & ~right])
    return clipped[own], light[own], colour


@pytest.mark.parametrize("corner", [(-1, -1), (1, -1), (-1, 1), (1, 1)])
@pytest.mark.parametrize("side", [1, 2, 4])
def test_a_leaf_of_few_photons_is_no_brighter_than_all_around(side, corner):
    clipped, _, colour = clip(4.0, side=side, corner=corner)
    np.testing.assert_allclose(clipped, np.tile(colour, (side * side, 1)), rtol=1e-6)


@pytest.mark.parametrize(
    "case",
    [
        {"value": 4.0, "noise": 0.1},  # many photons
        {"value": 2.0, "noise": 0.13},  # not so many, and not so bright
        {"value": 9.0, "noise": 0.05},  # very many
        {"value": 1.4},  # little brighter
        {"value": 0.1},  # a dark one
        {"value": 4.0, "side": 8, "width": 24},  # a large leaf
        {"value": 4.0, "width": 4, "side": 2},  # twelve texels around
        {"value": 4.0, "around": 0.0},  # the only light
    ],
)
def test_other_leaves_are_left(case):
    clipped, before, _ = clip(**case)
    np.testing.assert_array_equal(clipped, before)


@pytest.mark.parametrize(("value", "noise"), [(3.0, 0.13), (9.0, 0.1)])
def test_more_photons_that_may_have_parted_together_are_not_believed_where_they_are_far_brighter(value, noise):
    clipped, _, colour = clip(value, noise=noise)
    np.testing.assert_allclose(clipped, np.tile(colour, (4, 1)), rtol=1e-6)


@pytest.mark.parametrize("side", [2, 4])
def test_what_is_better_known_counts_around(side):
    """A noisy leaf beside is no measure, unless there is nothing else."""
    clipped, _, colour = clip(4.0, side=side, neighbour=3.9)
    np.testing.assert_allclose(clipped, np.tile(colour, (side * side, 1)), rtol=1e-6)


def test_other_charts_do_not_count():
    """Two strips side by side, the right one bright: it is no measure of the left one's leaf."""
    corners = [[[a, 0], [b, 0], [b, 8], [a, 8]] for a, b in ((0, 4), (4, 8))]
    texels = make_map([[quad[i] for i in face] for quad in corners for face in ((0, 1, 2), (0, 2, 3))], np.repeat([0, 1], 2))
    x, y = texels.texel_xy.T
    own = (x // 2 == 1) & (y // 2 == 1)
    light = np.where(own | (x >= 4), 4.0, 1.0).astype(np.float32)[:, None].repeat(3, axis=1)
    clip_flecks(light, (0.2 * light) ** 2, own.astype(int), np.where(own, 2, 8).astype(np.int32), texels)
    assert (light[own] == 1.0).all()
