"""What photons' deposits are worth: most where a leaf is dark and small."""

import numpy as np
import pytest
from leaflight.core.radiosity.deposit_worth import weigh_deposits
from trees import SquareBake


def dark_of(light, leaves):
    return 0.1 * np.maximum(light[:, leaves], 0.0).mean()


def test_light_is_worth_most_on_dark_small_leaves():
    bake = SquareBake(side=64, preview_depth=1)
    tree = bake.tree
    leaves, light = tree.levels[1], np.ones((3, len(tree)))
    light[:, leaves[0]] = 0.1
    worth = weigh_deposits(tree, leaves, light, 10**9)
    share = (tree.end - tree.start)[leaves[1]]
    dark = dark_of(light, leaves)
    assert worth[0, leaves[1]] == pytest.approx(share / (1 + dark**2) / tree.area[leaves[1]] ** 2, rel=1e-6)
    assert worth[0, leaves[0]] / worth[0, leaves[1]] == pytest.approx((1 + dark**2) / (0.01 + dark**2), rel=1e-6)
    few = weigh_deposits(tree, leaves, light, 1)[:, leaves]
    assert (few < 0.1 * worth[:, leaves]).all()  # one photon for all of them: its leaf stays as uncertain as it was
    light[1, leaves[0]] = -5.0  # a fitted plane may dip below zero
    dipped = weigh_deposits(tree, leaves, light, 10**9)[1, leaves]
    assert dipped[0] / dipped[1] == pytest.approx((1 + dark_of(light, leaves) ** 2) / dark_of(light, leaves) ** 2, rel=1e-6)
