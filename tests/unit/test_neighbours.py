import dataclasses

import numpy as np
import pytest
from leaflight.core import quadtree
from leaflight.core.neighbours import Neighbours
from trees import SquareBake


def leaves_of(bake, tree):
    leaf = quadtree.node_of_texel(tree, np.flatnonzero(tree.current), len(bake.keys))
    entry_at = np.full((1, bake.side, bake.side), -1, np.int32)
    entry_at[0, bake.texels.texel_xy[:, 1], bake.texels.texel_xy[:, 0]] = np.arange(len(leaf))
    return leaf, np.zeros(len(leaf), np.int32), entry_at


def pairs_of(tree, leaf, page, entry_at):
    row, other = Neighbours.of(tree, leaf, page, entry_at).list_pairs(np.arange(len(tree)))
    return set(zip(row.tolist(), other.tolist(), strict=True))


@pytest.mark.parametrize("width", [1.0, 0.7])
@pytest.mark.parametrize("splits", [3, 4])
def test_leaves_of_all_sizes_find_each_other(width, splits):
    """Against all pairs of texels that touch."""
    bake = SquareBake(side=32, degree=0, preview_depth=1, level=1, width=width)
    tree = bake.tree
    for _ in range(splits):  # down to leaves of two texels in a corner, or of one there and all along one side of a leaf of sixteen
        split = np.flatnonzero(tree.current)[-2:]
        if splits > 3:
            beside = tree.current & (tree.side > 1) & (tree.origin[:, 0] == 16) & (tree.origin[:, 1] < 16)
            split = np.union1d(split, np.flatnonzero(beside))
        tree = quadtree.grow_previews(quadtree.split(tree, split), bake.texels, bake.keys, 1, 1)
    leaf, page, entry_at = leaves_of(bake, tree)
    assert {16, 8, 4, 2, 16 >> splits} == set(tree.side[leaf].tolist())
    at = np.where(entry_at[0] >= 0, leaf[entry_at[0]], -1)
    expected = set()
    for column, row in ((1, 0), (0, 1), (1, 1)):
        for one, other in ((at[: 32 - row, : 32 - column], at[row:, column:]), (at[: 32 - row, column:], at[row:, : 32 - column])):
            touch = (one != other) & (one >= 0) & (other >= 0)
            expected |= set(zip(one[touch].tolist(), other[touch].tolist(), strict=True))
    assert pairs_of(tree, leaf, page, entry_at) == expected | {(b, a) for a, b in expected}


def test_other_charts_and_other_pages_are_no_neighbours():
    bake = SquareBake(side=16, degree=0, preview_depth=1, level=1)
    leaf, page, entry_at = leaves_of(bake, bake.tree)
    assert len(pairs_of(bake.tree, leaf, page, entry_at)) == 12  # four leaves that meet in one point
    apart = dataclasses.replace(bake.tree, chart=np.arange(len(bake.tree), dtype=np.int32))
    assert not pairs_of(apart, leaf, page, entry_at)
    two_pages = np.concatenate([np.full_like(entry_at, -1), entry_at])
    assert len(pairs_of(bake.tree, leaf, page + 1, two_pages)) == 12
    assert not pairs_of(bake.tree, leaf, page, two_pages)


def test_one_leaf_has_no_neighbour():
    bake = SquareBake(side=8, degree=0)
    assert not pairs_of(bake.tree, *leaves_of(bake, bake.tree))
