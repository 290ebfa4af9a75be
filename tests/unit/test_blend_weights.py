"""What leaves have of windows: the definition leaf by leaf, and that nothing changes with a step where leaves meet."""

import dataclasses
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


def distance(tree, node, x, y):
    """Of a place from a node's square, along the axis where that is greater."""
    (left, low), side = tree.origin[node], tree.side[node]
    return max(left - x, x - left - side, low - y, y - low - side, 0.0)


def overlap(tree, node, x, y, window):
    (left, low), side = tree.origin[node], tree.side[node]
    across, up = (min(a + side, at + window / 2) - max(a, at - window / 2) for a, at in ((left, x), (low, y)))
    return max(across, 0.0) * max(up, 0.0) / window**2


@pytest.mark.parametrize("width", [1.0, 0.7])
def test_shares_are_those_of_the_definition(width):
    _, tree, neighbours, leaf = split_leaves(width=width)
    widths = np.sqrt(np.bincount(leaf, minlength=len(tree)))
    rng = np.random.default_rng(1)
    entry = rng.integers(0, len(leaf), 200)
    node = leaf[entry]
    x, y = (tree.origin[node, axis] + rng.random(200) * tree.side[node] for axis in (0, 1))
    own, row, other, share = find_shares(tree, neighbours, node, x, y)
    leaves, narrowed = np.unique(leaf), 0
    for k in range(200):
        low, high = tree.origin[leaves], tree.origin[leaves] + tree.side[leaves, None]
        touches = ((low <= tree.origin[node[k]] + tree.side[node[k]]) & (high >= tree.origin[node[k]])).all(axis=1)
        beside = leaves[touches & (leaves != node[k])]
        window = min([widths[node[k]], *(widths[one] + distance(tree, one, x[k], y[k]) for one in beside)])
        narrowed += window < widths[node[k]]
        assert own[k] == pytest.approx(max(overlap(tree, node[k], x[k], y[k], window), 0.125))
        expected = {int(one): overlap(tree, one, x[k], y[k], window) for one in beside}
        expected = {one: pytest.approx(value) for one, value in expected.items() if value > 0.0}
        assert dict(zip(other[row == k].tolist(), share[row == k].tolist(), strict=True)) == expected
    assert narrowed > 20


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


def test_a_leaf_within_the_square_of_another_takes_its_place_from_it():
    """As where a piece of a chart was cut: the quarter at the upper right is another's; its neighbour has what is left of the square."""
    bake = SquareBake(side=16, degree=0, preview_depth=1)
    root = int(np.flatnonzero(bake.tree.current)[0])
    quarter = int(bake.tree.children[root, 3])
    leaf = np.full(bake.n_texel, root, np.int32)
    leaf[bake.texels.texel_xy.min(axis=1) >= 8] = quarter
    parts = dataclasses.replace(bake.tree, chart=np.where(np.arange(len(bake.tree)) == quarter, 1, 0).astype(np.int32))
    texels = dataclasses.replace(bake.texels, chart_piece=np.zeros(2, np.int32))
    neighbours = Neighbours.of(parts, leaf, texels)
    for (x, y), node, say in (
        ((8.0, 8.0), root, (0.75, 0.25)),
        ((8.0, 8.0), quarter, (0.75, 0.25)),
        ((8.0, 12.0), root, (0.5, 0.5)),
        ((8.0, 12.0), quarter, (0.5, 0.5)),
        ((12.0, 12.0), quarter, (0.0, 1.0)),
    ):
        own, _, other, share = find_shares(parts, neighbours, np.array([node], np.int32), np.array([x]), np.array([y]))
        found = {node: own[0], **dict(zip(other.tolist(), share.tolist(), strict=True))}
        assert (found.get(root, 0.0), found.get(quarter, 0.0)) == pytest.approx(say), (x, y, node)


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
