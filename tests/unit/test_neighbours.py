import dataclasses

import numpy as np
import pytest
from leaflight.core.filter.neighbours import Neighbours
from leaflight.core.radiosity import quadtree
from leaflight.core.texels.split_texels import TexelBorders
from trees import SquareBake


def leaves_of(bake, tree):
    return quadtree.node_of_texel(tree, np.flatnonzero(tree.current), bake.n_texel)


def pairs_of(texels, tree, leaf):
    found = Neighbours.of(tree, leaf, texels)
    row, pair = found.list_pairs(np.arange(len(tree)))
    return set(zip(row.tolist(), found.other[pair].tolist(), strict=True))


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
        tree = quadtree.grow_previews(quadtree.split(tree, split), bake.texels, 1, 1)
    leaf = leaves_of(bake, tree)
    assert {16, 8, 4, 2, 16 >> splits} == set(tree.side[leaf].tolist())
    entry_at = bake.texels.entry_at[0]
    at = np.where(entry_at >= 0, leaf[entry_at], -1)
    expected = set()
    for column, row in ((1, 0), (0, 1), (1, 1)):
        for one, other in ((at[: 32 - row, : 32 - column], at[row:, column:]), (at[: 32 - row, column:], at[row:, : 32 - column])):
            touch = (one != other) & (one >= 0) & (other >= 0)
            expected |= set(zip(one[touch].tolist(), other[touch].tolist(), strict=True))
    assert pairs_of(bake.texels, tree, leaf) == expected | {(b, a) for a, b in expected}


def test_other_charts_and_other_pages_are_no_neighbours():
    bake = SquareBake(side=16, degree=0, preview_depth=1, level=1)
    leaf = leaves_of(bake, bake.tree)
    assert len(pairs_of(bake.texels, bake.tree, leaf)) == 12  # four leaves that meet in one point
    apart = dataclasses.replace(bake.tree, chart=np.arange(len(bake.tree), dtype=np.int32))
    texels = dataclasses.replace(bake.texels, chart_piece=np.arange(len(bake.tree), dtype=np.int32))
    assert not pairs_of(texels, apart, leaf)
    second = dataclasses.replace(bake.texels, page_count=2, chart_page=np.ones(1, np.int32))
    assert len(pairs_of(second, bake.tree, leaf)) == 12
    is_right = (bake.texels.texel_xy[:, 0] >= 8).astype(np.int32)
    both = dataclasses.replace(second, chart_page=np.arange(2, dtype=np.int32), texel_chart=is_right)
    x = bake.tree.origin[:, 0]
    found = pairs_of(both, bake.tree, leaf)
    assert len(found) == 4
    assert all(x[one] == x[other] for one, other in found)


def test_charts_that_were_one_are_neighbours_where_nothing_stands_between():
    """Four leaves of four charts; then with a wall between the left and the right ones."""
    bake = SquareBake(side=16, degree=0, preview_depth=1, level=1)
    leaf = leaves_of(bake, bake.tree)
    parts = dataclasses.replace(bake.tree, chart=np.arange(len(bake.tree), dtype=np.int32))
    texels = dataclasses.replace(bake.texels, chart_piece=np.zeros(len(bake.tree), np.int32))
    assert len(pairs_of(texels, parts, leaf)) == 12
    entry_at = bake.texels.entry_at
    pairs = [(entry_at[0, row, column], entry_at[0, row, column + 1]) for row in range(16) for column in [7]]
    one, other = np.array(pairs, np.int64).T
    way = np.repeat([0, 2], len(one))
    reach = np.full(2 * len(one), 0.5)
    borders = TexelBorders.of(len(leaf), way, np.concatenate([one, other]), np.concatenate([other, one]), reach)
    walled = dataclasses.replace(texels, borders=borders)
    x = bake.tree.origin[:, 0]
    assert {(x[a], x[b]) for a, b in pairs_of(walled, parts, leaf)} == {(0, 0), (8, 8)}


def walled_quarters(bake, *walls):
    """A map of four charts of one piece, and sheets that cross texels towards the next: page texels (m, 2), and one way in 0, 1."""
    ways, ones, others, entry_at = [], [], [], bake.texels.entry_at
    for texels, way in walls:
        one = entry_at[0, [y for _, y in texels], [x for x, _ in texels]].astype(np.int64)
        other = entry_at[0, [y + way for _, y in texels], [x + 1 - way for x, _ in texels]].astype(np.int64)
        ways += [way] * len(one) + [way + 2] * len(one)
        ones += [one, other]
        others += [other, one]
    one, other = np.concatenate(ones), np.concatenate(others)
    borders = TexelBorders.of(len(bake.texels.texel_area), np.array(ways), one, other, np.full(len(ways), 0.5))
    return dataclasses.replace(bake.texels, chart_piece=np.zeros(len(bake.tree), np.int32), borders=borders)


@pytest.mark.parametrize("corner", [0, 1, 2, 3])
def test_no_light_goes_through_the_corner_of_a_room(corner):
    """Sheets stand between one quarter and both of its neighbours: no texel of the opposite one is crossed."""
    bake = SquareBake(side=16, degree=0, preview_depth=1, level=1)
    leaf = leaves_of(bake, bake.tree)
    parts = dataclasses.replace(bake.tree, chart=np.arange(len(bake.tree), dtype=np.int32))
    right, up = corner % 2, corner // 2
    upright = [(7, y) for y in range(8 * up, 8 * up + 8)]
    level = [(x, 7) for x in range(8 * right, 8 * right + 8)]
    found = pairs_of(walled_quarters(bake, (upright, 0), (level, 1)), parts, leaf)
    inside = leaf[bake.texels.entry_at[0, 15 * up, 15 * right]]
    assert len(found) == 4
    assert not any(inside in pair for pair in found)


@pytest.mark.parametrize("corner", [0, 1, 2, 3])
def test_a_leaf_knows_whose_square_holds_its_own(corner):
    """A quarter belongs to a chart of its own, within the square of the leaf beside it."""
    bake = SquareBake(side=16, degree=0, preview_depth=1)
    root = int(np.flatnonzero(bake.tree.current)[0])
    quarter = int(bake.tree.children[root, corner])
    inside = (bake.texels.texel_xy // 8 == bake.tree.origin[quarter] // 8).all(axis=1)
    leaf = np.where(inside, np.int32(quarter), leaves_of(bake, bake.tree))
    parts = dataclasses.replace(bake.tree, chart=np.where(np.arange(len(bake.tree)) == quarter, 1, 0).astype(np.int32))
    texels = dataclasses.replace(bake.texels, chart_piece=np.zeros(2, np.int32))
    found = Neighbours.of(parts, leaf, texels)
    row, pair = found.list_pairs(np.array([root, quarter]))
    known = [found.other[pair], found.around[pair], found.within[pair]]
    assert list(zip(row, *known, strict=True)) == [(0, quarter, False, True), (1, root, True, False)]


def test_leaves_beside_each_other_hold_none():
    bake = SquareBake(side=16, degree=0, preview_depth=1, level=1)
    tree = quadtree.grow_previews(quadtree.split(bake.tree, np.flatnonzero(bake.tree.current)[:1]), bake.texels, 1, 1)
    found = Neighbours.of(tree, leaves_of(bake, tree), bake.texels)
    assert len(found.other) > 12
    assert not (found.around | found.within).any()
