"""Which pieces a floor of single texels falls into, by where one can go on it."""

from collections import Counter

import numpy as np
import pytest
from leaflight.core.scene.topology import join_sets
from leaflight.core.texels.contact_parts import part_in_squares
from leaflight.core.texels.texel_grid import interleave_bits

SIDE = 32
LARGE = 64  # a side too


def part_floor(is_wall, below=None):
    """(SIDE, SIDE) int twice: what hangs together, and the pieces; is_wall (SIDE, SIDE - 1) bool, between columns x and x + 1."""
    row, column = np.mgrid[0:SIDE, 0:SIDE]
    key = interleave_bits(column.ravel(), row.ravel()).astype(np.int64)
    order = np.argsort(key)
    place = np.empty(SIDE * SIDE, np.int64)
    place[order] = np.arange(len(order))
    place = place.reshape(SIDE, SIDE)
    beside, above = np.stack([place[:, :-1], place[:, 1:]]), np.stack([place[:-1].ravel(), place[1:].ravel()])
    ways = np.concatenate([beside[:, ~is_wall], above], axis=1)
    found = part_in_squares(key[order], np.ones(SIDE * SIDE, np.int64), ways, beside[:, is_wall], 5)
    return [labels[place] for labels in found]


def wall(column, rows):
    """A sheet right of a column."""
    out = np.zeros((SIDE, SIDE - 1), bool)
    out[rows, column] = True
    return out


def test_what_nothing_stands_on_stays_whole():
    whole, piece = part_floor(wall(0, slice(0, 0)))
    assert (whole == 0).all()
    assert (piece == 0).all()


def test_a_wall_all_across_makes_two_pieces_and_no_more():
    for labels in part_floor(wall(14, slice(None))):
        assert len(np.unique(labels)) == 2
        assert (labels[:, :15] == 0).all()


@pytest.mark.parametrize("end", [16, 20, 23, 25])
@pytest.mark.parametrize("column", [13, 14, 16, 18])
def test_on_each_side_of_a_wall_with_a_door_is_another_piece(column, end):
    """Near its end too: the square there holds both sides, and hangs together."""
    whole, piece = part_floor(wall(column, slice(0, end)))
    assert (whole == 0).all()
    assert not np.intersect1d(piece[:end, column], piece[:end, column + 1]).size


@pytest.mark.parametrize("column", [13, 14, 16, 18])
def test_no_square_holds_both_sides_in_one_piece(column):
    piece = part_floor(wall(column, slice(0, 24)))[1]
    for side in (8, 16):
        for low in range(0, 17 - side + 8 if side == 8 else 1, side):
            for left in range(0, SIDE, side):
                square = piece[low : low + side, left : left + side]
                split = np.clip(column + 1 - left, 0, side)
                assert not np.intersect1d(square[:, :split], square[:, split:]).size


def test_a_post_founds_no_piece():
    assert len(np.unique(part_floor(wall(12, slice(10, 13)))[1])) == 1


def test_pieces_are_named_by_their_first_patch():
    piece = part_floor(wall(14, slice(0, 20)))[1]
    row, column = np.mgrid[0:SIDE, 0:SIDE]
    key = interleave_bits(column.ravel(), row.ravel())
    flat = piece.ravel()[np.argsort(key)]
    for name in np.unique(flat):
        assert np.flatnonzero(flat == name)[0] == name
    whole = part_floor(wall(14, slice(None)))[0].ravel()[np.argsort(key)]
    assert set(whole.tolist()) == {0, np.flatnonzero(whole)[0]}


def draw_walls(rng):
    """Keys of a floor with holes, pairs of its texels where one can go, and pairs with a sheet between, of many lengths."""
    place = np.full((LARGE + 1, LARGE + 1), -1)
    covered = np.ones((LARGE, LARGE), bool)
    for _ in range(rng.integers(1, 8)):
        (x, y), (width, height) = rng.integers(0, LARGE, 2), rng.integers(1, 24, 2)
        covered[y : y + height, x : x + width] = False
    row, column = np.nonzero(covered)
    key = interleave_bits(column, row).astype(np.int64)
    order = np.argsort(key)
    place[row[order], column[order]] = np.arange(len(order))
    is_wall = np.zeros((2, LARGE, LARGE), bool)
    for _ in range(rng.integers(2, 16)):
        axis, at, low, length = *rng.integers(0, (2, LARGE, LARGE)), rng.integers(2, 50)
        is_wall[axis].T[at, low : low + length] = True
    pairs = np.stack([place[:-1, :-1], place[:-1, 1:]]), np.stack([place[:-1, :-1].T, place[1:, :-1].T])
    ways, closed = (
        np.concatenate([pair[:, wall == shut] for pair, wall in zip(pairs, is_wall, strict=True)], axis=1) for shut in (False, True)
    )
    return key[order], ways[:, (ways >= 0).all(axis=0)], closed[:, (closed >= 0).all(axis=0)]


def part_one_by_one(key, ways, closed):
    """What part_in_squares does, of single texels, one part after the other."""
    whole = label = join_sets(len(key), *ways)
    column, row = (sum((key >> 2 * bit + axis & 1) << bit for bit in range(6)) for axis in (0, 1))

    def lines_of(pair):
        one, other = pair
        return [
            (key[a] >> 6, ("row", max(row[a], row[b])) if column[a] == column[b] else ("column", max(column[a], column[b])))
            for a, b in zip(one, other, strict=True)
        ]

    stood_on = {line for line, inside in zip(lines_of(closed), np.ptp(key[closed] >> 6, axis=0) == 0, strict=True) if inside}
    for level in (5, 4, 3):
        square = key >> 2 * level
        inner = ways[:, square[ways[0]] == square[ways[1]]]
        if level == 3:
            inner = inner[:, [line not in stood_on for line in lines_of(inner)]]
        part = join_sets(len(key), *inner)
        size, first = np.bincount(part), np.unique(part)
        outward = [(a, b) for a, b in np.concatenate([ways, ways[::-1]], axis=1).T.tolist() if square[a] != square[b]]
        for _ in range(8):
            kinds = {}
            for one in sorted(first, key=lambda one: (-size[one], one)):
                if np.isin(square[one], square[closed]):
                    kinds.setdefault((square[one], label[one]), []).append(one)
            less = {one for kind in kinds.values() for one in kind[1:]}
            beside = {}
            for a, b in outward:
                if part[a] in less:
                    beside.setdefault(part[a], Counter())[part[b]] += 1
            into = {}
            for small, width in sorted(beside.items()):
                best = min(width, key=lambda one: (label[one] == label[small], -width[one], one))
                if label[best] != label[small]:
                    into[small] = label[best]
                elif level > 3 and size[small] >= 8 and best not in less:
                    into[small] = into[best] = len(key) * (1 + level) + label.max() + best
            if all(label[one] == name for one, name in into.items()):
                break
            label = np.array([into.get(one, name) for one, name in zip(part, label, strict=True)])
    return whole, np.unique(label, return_index=True)[1][np.unique(label, return_inverse=True)[1]]


def join_tiles(key, ways, closed):
    """The same with one patch for each whole square of 8 x 8 texels that nothing stands on, and the first texels of all patches."""
    number = np.unique(key >> 6, return_inverse=True)[1]
    is_tile = np.bincount(number) == 64
    is_tile[number[closed]] = False
    start = np.flatnonzero(~is_tile[number] | (np.diff(number, prepend=-1) > 0))
    patch = np.searchsorted(start, np.arange(len(key)), side="right") - 1
    ways = np.unique(patch[ways], axis=1)
    return start, np.diff(start, append=len(key)), ways[:, ways[0] != ways[1]], patch[closed], patch


# Of the first ones some tell widths of ways apart.
@pytest.mark.parametrize("seed", [*range(27, 39), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(39, 51))])
def test_pieces_are_those_of_parting_one_by_one(seed):
    """Whether or not texels that nothing stands on are taken together."""
    key, ways, closed = draw_walls(np.random.default_rng(seed))
    expected = part_one_by_one(key, ways, closed)
    found = part_in_squares(key, np.ones(len(key), np.int64), ways, closed, 6)
    start, size, *of_patches, patch = join_tiles(key, ways, closed)
    by_tiles = part_in_squares(key[start], size, *of_patches, 6)
    for one, other, tiled in zip(expected, found, by_tiles, strict=True):
        np.testing.assert_array_equal(one, other)
        np.testing.assert_array_equal(one, start[tiled][patch])
