"""What is shown of a leaf is never below zero, and has the leaf's flux."""

import numpy as np
import pytest
from leaflight.core.filter.clip_light import clip_light
from leaflight.core.radiosity import quadtree
from trees import SquareBake, current

SIDE = 16


@pytest.fixture
def quarters():
    """Texels of a square whose four quarters are leaves, and the leaf, column and row of each texel."""
    bake = SquareBake(side=SIDE, level=1, preview_depth=1)
    leaves = np.flatnonzero(bake.tree.current)
    assert len(leaves) == 4
    leaf = quadtree.node_of_texel(bake.tree, leaves, bake.n_texel)
    return bake, leaf, *bake.texels.texel_xy.T


def find_flux(light, texels, leaf):
    return np.bincount(leaf, light * texels.texel_area)


def test_a_plane_that_dips_below_zero_keeps_its_flux(quarters):
    bake, leaf, x, y = quarters
    light = np.where(y < 8, (x % 8) - 2.0, 3.0 + y)
    before, untouched = light.copy(), y >= 8
    clip_light(light, bake.texels.texel_area, leaf, bake.tree)
    assert light.min() == 0.0
    assert find_flux(light, bake.texels, leaf) == pytest.approx(find_flux(before, bake.texels, leaf))
    assert light[untouched] == pytest.approx(before[untouched])
    # It stays a ramp where it shows.
    shown = ~untouched & (before > 0)
    assert np.ptp(light[shown] / before[shown]) < 1e-9


@pytest.mark.parametrize(("dark", "other", "side"), [(-1.0, 2.0, 8), (-10.0, 2.0, 16), (-1.0, -10.0, 16)])
def test_the_smallest_node_above_pays_for_a_leaf_that_is_below_zero_in_all(dark, other, side):
    """A quarter for one of its leaves; the whole where a quarter is below zero too, and then all parts of it alike."""
    bake = SquareBake(side=SIDE, preview_depth=1)
    for _ in range(2):
        bake.tree = quadtree.split(bake.tree, current(bake))
        bake.grow()
    leaf = quadtree.node_of_texel(bake.tree, current(bake), bake.n_texel)
    x, y = bake.texels.texel_xy.T
    before = np.select([(x < 4) & (y < 4), (x >= 12) & (y >= 12)], [dark, other], 2.0)
    light = before.copy()
    clip_light(light, bake.texels.texel_area, leaf, bake.tree)
    pays = (x < side) & (y < side)
    assert light.min() == 0.0
    assert find_flux(light, bake.texels, pays) == pytest.approx(find_flux(before, bake.texels, pays))
    assert (light[~pays] == 2.0).all()
    assert np.ptp(light[pays & (before > 0)]) < 1e-9


def test_light_that_is_nowhere_above_zero_is_black(quarters):
    bake, leaf, *_ = quarters
    light = np.full(len(leaf), -1.0)
    clip_light(light, bake.texels.texel_area, leaf, bake.tree)
    assert not light.any()


def test_light_above_zero_stays_as_it_is(quarters):
    bake, leaf, x, _ = quarters
    light = x.astype(np.float32)
    clip_light(light, bake.texels.texel_area, leaf, bake.tree)
    assert (light == x).all()
