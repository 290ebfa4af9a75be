"""Photons are counted in the deepest node where they fall."""

import numpy as np
import pytest
from leaflight.core.radiosity import quadtree
from leaflight.core.radiosity.tree_view import TreeView
from trees import make_square_map


def test_a_hit_may_lie_half_a_texel_beyond_its_node():
    """As where a wall's foot runs through the next texel; what lies farther off is brought that near."""
    texels = make_square_map(8, 1)
    tree = quadtree.plant_trees(texels, 1, 2, 1, False)
    view = TreeView.of_tree(tree, len(texels.texel_chart), np.zeros(0, np.int32))
    entry = np.flatnonzero((texels.texel_xy == [1, 0]).all(1)).repeat(3)
    node, s, t = view.locate(entry, np.array([1.5, 2.4, 9.0]), np.array([0.5, -0.4, -9.0]))
    assert tree.side[node].tolist() == [2, 2, 2]
    assert s == pytest.approx([0.5, 1.4, 1.5])
    assert t == pytest.approx([-0.5, -1.4, -1.5])
