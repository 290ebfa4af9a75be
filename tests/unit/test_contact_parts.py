"""Which pieces a floor of single texels falls into, by where one can go on it."""

import numpy as np
import pytest
from leaflight.core.texels.contact_parts import part_in_squares
from leaflight.core.texels.texel_grid import interleave_bits

SIDE = 32


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
