"""What is shown of a leaf is never below zero, and has the leaf's flux."""

import numpy as np
import pytest
from leaflight.core.filter.clip_light import clip_light
from leaflight.core.radiosity import quadtree
from trees import SquareBake

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


def test_the_node_above_pays_for_a_leaf_that_is_below_zero_in_all(quarters):
    bake, leaf, x, y = quarters
    light = np.where((x < 8) & (y < 8), -1.0, 2.0)
    flux = (light * bake.texels.texel_area).sum()
    clip_light(light, bake.texels.texel_area, leaf, bake.tree)
    assert light.min() == 0.0
    assert (light * bake.texels.texel_area).sum() == pytest.approx(flux)


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
