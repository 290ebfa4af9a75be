"""Nodes tile their chart, areas add up, and children lie where their parents say."""

import numpy as np
import pytest
from leaflight.core.radiosity import quadtree
from trees import SquareBake, make_map, make_square_map


@pytest.mark.parametrize("level", [0, 1])
def test_a_chart_may_leave_the_corners_of_its_square_empty(level):
    """Every node holds the texels that lie on its square, and no others."""
    texels = make_map([[[8, 1], [15, 8], [8, 15]], [[8, 15], [1, 8], [8, 1]]], size=16)
    tree = quadtree.grow_previews(quadtree.plant_trees(texels, 1, level, 1, False), texels, 4, 1)
    assert tree.side.min() == 1
    for start, end, origin, side in zip(tree.start, tree.end, tree.origin, tree.side, strict=True):
        inside = ((texels.texel_xy >= origin) & (texels.texel_xy < origin + side)).all(axis=1)
        assert np.flatnonzero(inside).tolist() == list(range(start, end))


@pytest.mark.parametrize("side", [16, 400])
def test_nodes_tell_of_the_texels_in_them(side):
    """Their means, and whether any has a flag."""
    bake, rng = SquareBake(side=side, width=0.7, preview_depth=3), np.random.default_rng(2)
    flag, values = rng.random(bake.n_texel) < 13.0 / side**2, rng.random((bake.n_texel, 3)).astype(np.float32)
    texels = [slice(start, end) for start, end in zip(bake.tree.start, bake.tree.end, strict=True)]
    found = quadtree.any_in_nodes(bake.tree, flag)
    assert found.tolist() == [bool(flag[inside].any()) for inside in texels]
    assert found.any() != found.all()
    means = np.transpose([values[inside].mean(axis=0, dtype=np.float64) for inside in texels])
    np.testing.assert_allclose(quadtree.mean_in_nodes(bake.tree, values), means, rtol=1e-9)
    assert not quadtree.mean_in_nodes(bake.tree, np.zeros_like(values)).any()


@pytest.mark.parametrize("level", [0, 1, 2, 9])
def test_a_minimum_level_starts_there_or_at_texels(level):
    texels = make_square_map(8, 0)
    tree = quadtree.plant_trees(texels, 0, level, finest_texels=2, flat=False)
    assert len(tree) == 4 ** min(level, 2)
    assert tree.current.all()
    place = texels.texel_xy - tree.origin[quadtree.node_of_texel(tree, np.arange(len(tree)), 64)]
    assert ((place >= 0) & (place < tree.side[0])).all()


def test_nodes_that_do_not_tile_are_refused():
    bake = SquareBake(side=8, preview_depth=1)
    with pytest.raises(ValueError, match="expected to tile 64 texels"):
        quadtree.node_of_texel(bake.tree, bake.tree.children[0][:2], 64)
    with pytest.raises(ValueError, match="expected to tile 64 texels, got 80"):
        quadtree.node_of_texel(bake.tree, np.append(bake.tree.children[0], bake.tree.children[0][0]), 64)
