"""What is told of light beside direct light: no more than there is, from the leaves of a first round."""

import numpy as np
from leaflight.core.integrate.reference_level import ReferenceLevel
from leaflight.core.util.brightness import weigh_channels
from trees import SquareBake, hill, hill_truth


def test_half_of_what_the_leaves_hold_is_told_at_their_texels():
    bake = SquareBake(side=32, degree=1, level=2)
    rng = np.random.default_rng(1)
    flux = np.outer([3.0, 2.0, 0.5], np.ones(200_000))
    bake.throw(*hill(rng, 200_000), flux=flux, is_first=False)
    leaves = np.random.default_rng(2).permutation(np.flatnonzero(bake.tree.current))
    told = ReferenceLevel.of_leaves(bake.tree, bake.solution(), leaves)
    x, y = (bake.texels.texel_xy.T + 0.5) / 32
    leaf = (x * 4).astype(int) + 4 * (y * 4).astype(int)  # of 8 texels
    of_leaf = (np.bincount(leaf, hill_truth(x, y)) / 64)[leaf]
    expected = 0.5 * weigh_channels(np.array([[3.0, 2.0, 0.5]]))[0] * of_leaf
    np.testing.assert_allclose(told.level, expected, rtol=0.05)
    assert told.level.dtype == np.float32
    entry = np.array([3, 50, 51, 1000])
    np.testing.assert_array_equal(told.at(entry), told.level[entry])
    np.testing.assert_array_equal(told.at(np.arange(100, 140)), told.level[100:140])


def test_nothing_is_told_where_no_photon_fell():
    bake = SquareBake(side=8, degree=1)
    told = ReferenceLevel.of_leaves(bake.tree, bake.solution(), np.flatnonzero(bake.tree.current))
    assert told.level.tolist() == [0.0] * 64
