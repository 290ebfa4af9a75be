"""What leaves have of windows: the definition leaf by leaf, and that nothing changes with a step where leaves meet."""

from types import SimpleNamespace

import numpy as np
import pytest
from leaflight.core.filter.blend_weights import find_shares
from leaflight.core.filter.neighbours import Neighbours
from leaflight.core.radiosity import quadtree
from trees import SquareBake


def split_leaves(side=32, width=1.0, splits=2, seed=3):
    """A square, a fourth of whose leaves was split again and again: its tree, who touches whom, and the leaf of each texel."""
    bake = SquareBake(side=side, degree=0, preview_depth=1, level=1, width=width)
    tree, rng = bake.tree, np.random.default_rng(seed)
    for _ in range(splits):
        current = np.flatnonzero(tree.current & (tree.side > 1))
        tree = quadtree.grow_previews(quadtree.split(tree, rng.choice(current, -(-len(current) // 4), replace=False)), bake.texels, 1, 1)
    leaf = quadtree.node_of_texel(tree, np.flatnonzero(tree.current), bake.n_texel)
    return bake, tree, Neighbours.of(tree, leaf, bake.texels), leaf


def say_of_all(tree, neighbours, node, x, y):
    """(m, n_node): what every leaf has to say at places x, y (m,) on leaves (m,), in all 1."""
    own, row, other, share = find_shares(tree, neighbours, node, x, y)
    say = np.zeros((len(node), len(tree)))
    say[np.arange(len(node)), node] = own
    say[row, other] = share
    return say / say.sum(axis=1, keepdims=True)


@pytest.mark.parametrize(("splits", "most"), [(0, 1e-9), (2, 0.15)])
@pytest.mark.parametrize("width", [1.0, 0.7])
def test_it_comes_to_the_same_from_either_side_of_a_border(splits, most, width):
    """Also at the rim of the chart, where windows lie outside in part. What touches the leaf on one side alone is unknown on the other."""
    bake, tree, neighbours, leaf = split_leaves(width=width, splits=splits)
    at = np.full((bake.side, bake.side), -1)
    at[bake.texels.texel_xy[:, 1], bake.texels.texel_xy[:, 0]] = leaf
    for turned in (at, at.T):
        row, column = ((turned[:, 1:] != turned[:, :-1]) & (turned[:, 1:] >= 0) & (turned[:, :-1] >= 0)).nonzero()
        across, along = column + 1.0, row + 0.3
        x, y = (across, along) if turned is at else (along, across)
        one, other = (say_of_all(tree, neighbours, turned[row, column + k].astype(np.int32), x, y) for k in (0, 1))
        off = np.abs(one - other).sum(axis=1) / 2
        assert off.max() < most
        assert off.mean() < most / 10
        own = one[np.arange(len(row)), turned[row, column]]
        assert own.max() < 0.6  # and nobody speaks alone


def test_a_sliver_does_not_speak_far_beyond_its_texels():
    """Of a square of 32 texels the right half is covered in its first column alone: 16 texels of a leaf of 256 are four wide."""
    bake, tree, neighbours, leaf = split_leaves(width=17 / 32, splits=0)
    entry = np.flatnonzero((bake.texels.texel_xy == (16, 4)).all(axis=1))
    sliver, beside = leaf[entry], leaf[np.flatnonzero((bake.texels.texel_xy == (15, 4)).all(axis=1))]
    assert (tree.side[sliver], (leaf == sliver).sum()) == (16, 16)
    for x, node in ((14.5, beside), (13.0, beside), (12.0, beside), (16.5, sliver)):
        say = say_of_all(tree, neighbours, node, np.array([x]), np.array([4.5]))[0]
        window = 4.0 + max(16.0 - x, 0.0)
        assert say[sliver[0]] == pytest.approx(np.clip((x + window / 2 - 16.0) / window, 0.0, 1.0))


def test_leaves_around_another_have_what_is_left_in_equal_parts():
    tree = SimpleNamespace(
        origin=np.zeros((3, 2), np.int32), side=np.int32([8, 16, 16]), start=np.array([0, 64, 100]), end=np.array([64, 100, 136])
    )
    is_around = np.array([True, True, False, False])
    neighbours = Neighbours(np.array([0, 2, 3, 4]), np.int32([1, 2, 0, 0]), is_around, ~is_around)
    own, _, other, share = find_shares(tree, neighbours, np.zeros(1, np.int32), np.zeros(1), np.zeros(1))
    assert own == pytest.approx([0.25])
    assert dict(zip(other.tolist(), share.tolist(), strict=True)) == pytest.approx({1: 0.375, 2: 0.375})
    own, _, _, share = find_shares(tree, neighbours, np.ones(1, np.int32), np.full(1, 4.0), np.full(1, 4.0))
    assert own == pytest.approx([0.125])  # what lies within it has all of the window, and it still has a say
    assert share == pytest.approx([1.0])
