"""Pieces of charts, cut further where squares of a quadtree hold parts of them that do not hang together.

A wall with a door in it parts no floor: one can go round. But it parts squares of texels, and a leaf over both of its sides would
show at the wall's foot the light of the room behind it. So in each square, from large ones to small ones, all parts but the largest leave
their piece: for the piece that lies beside them, or for one of their own with what lies beside them, so that photons enough fall on it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .layer_check import join_sets
from .texel_grid import part_bits
from .texel_map import CHART_SHIFT
from .tiles import TILE_SIDE

_LEAST_LOG2 = TILE_SIDE.bit_length() - 1  # of the side of a square that is looked at: what nothing touches is known by tiles
_MOST_PASSES = 8  # over squares of one size
_LEAST_PART = 8  # texels, of what is worth a piece of its own

_Int64 = NDArray[np.int64]


@dataclass(frozen=True)
class Ways:
    """Pairs of patches that lie side by side.

    pair   (2, m) int64
    axis   (m,) int64: 0 for columns beside each other, 1 for rows
    """

    pair: _Int64
    axis: _Int64

    @classmethod
    def of(cls, parts: list[_Int64]) -> Ways:
        """parts   (3, m) int64 each: pairs, and their axis"""
        pairs = np.concatenate([np.zeros((3, 0), np.int64), *parts], axis=1)
        return cls(pairs[:2], pairs[2])

    def take(self, rows: NDArray[np.bool_]) -> Ways:
        return Ways(self.pair[:, rows], self.axis[rows])

    def within(self, label: _Int64) -> NDArray[np.bool_]:
        """(m,) bool: both have one label, of labels (k,)."""
        one, other = label[self.pair]
        inside: NDArray[np.bool_] = one == other
        return inside

    def renumber(self, kept: _Int64, count: int) -> Ways:
        """Those between patches `kept` (k,), ascending, of `count`, by their places in that list."""
        place = np.full(count, -1)
        place[kept] = np.arange(len(kept))
        rows = (place[self.pair] >= 0).all(axis=0)
        return Ways(place[self.pair[:, rows]], self.axis[rows])

    def list_lines(self, key: _Int64) -> _Int64:
        """(m,) int64: which line between columns or rows of which of the smallest squares each crosses; key (k,) of the patches."""
        x, y = part_bits(key[self.pair].max(axis=0) & ((1 << CHART_SHIFT) - 1))  # along an axis the farther one's key is the larger
        square, step = key[self.pair[0]] >> 2 * _LEAST_LOG2, np.where(self.axis == 0, x, y) % TILE_SIDE
        number: _Int64 = 2 * (square * TILE_SIDE + step) + self.axis
        return number


def part_in_squares(key: _Int64, size: _Int64, ways: Ways, closed: Ways, log2: int) -> tuple[_Int64, _Int64]:
    """The first patch of what each patch hangs together with somehow (k,), and of its piece of that (k,).

    key      (k,) int64, ascending: chart and Morton code of each patch's first texel
    size     (k,) int64, texels: 1, or all of a tile
    ways     where one can go
    closed   where something stands between two texels
    log2     of the side of the largest root
    """
    whole = join_sets(len(key), *ways.pair)
    label = whole.copy()
    if len(closed.axis):
        for level in range(log2 - 1, _LEAST_LOG2 - 1, -1):
            founds = level > _LEAST_LOG2
            inner = ways if founds else _end_at_lines(key, ways, closed)
            square = key >> 2 * level
            looked = np.isin(square, square[closed.pair])  # elsewhere only the shape of the chart parts anything
            beside = ways.pair[:, looked[ways.pair].any(axis=0)]
            kept = np.flatnonzero(np.isin(square, square[beside]) | looked)
            near, near_inner = (some.renumber(kept, len(key)) for some in (ways, inner))
            for _ in range(_MOST_PASSES):  # as a piece takes what lies beside it, it comes to lie beside more
                before, fresh = label[kept], int(label.max()) + 1
                label[kept] = _part_squares(square[kept], size[kept], before, near, near_inner, looked[kept], fresh if founds else 0)
                if (before == label[kept]).all():
                    break
    _, first, number = np.unique(label, return_index=True, return_inverse=True)
    return whole, first[number].astype(np.int64)


def _end_at_lines(key: _Int64, ways: Ways, closed: Ways) -> Ways:
    """The ways within the smallest squares, but for those across a line on which something stands: a wall's line goes on past its end."""
    square = key >> 2 * _LEAST_LOG2
    inner, lines = ways.take(ways.within(square)), closed.take(closed.within(square)).list_lines(key)
    return inner.take(~np.isin(inner.list_lines(key), lines))


def _part_squares(square: _Int64, size: _Int64, label: _Int64, ways: Ways, inner: Ways, looked: NDArray[np.bool_], fresh: int) -> _Int64:
    """(k,) int64: labels of pieces, where parts have left for others.

    square   (k,) int64: the square that each patch is in
    label    (k,) int64: the piece that it is of
    inner    those of the ways by which parts hang together, where both ends lie in one square
    looked   (k,) bool: those in squares whose parts may leave
    fresh    label of the first piece that parts found which lie beside no other one; 0 if they stay
    """
    count = len(label)
    part = join_sets(count, *inner.take(inner.within(square) & inner.within(label)).pair)
    texels = np.bincount(part, size, count).astype(np.int64)
    first = np.flatnonzero(part == np.arange(count))
    order = first[np.lexsort((-texels[first], label[first], square[first]))]
    is_less = np.zeros(count, bool)
    is_less[order[1:][(np.diff(square[order]) == 0) & (np.diff(label[order]) == 0)]] = True
    is_less &= looked
    pair = np.concatenate([ways.pair, ways.pair[::-1]], axis=1)
    pair = pair[:, is_less[part[pair[0]]] & (square[pair[0]] != square[pair[1]])]
    length = np.where((size[pair] > 1).all(axis=0), TILE_SIDE, 1)
    found, number = np.unique(part[pair[0]] * count + part[pair[1]], return_inverse=True)
    small, beside = np.divmod(found, count)
    is_own = label[beside] == label[small]
    best = np.lexsort((-np.bincount(number, length, len(found)), is_own, small))
    best = best[np.append(True, np.diff(small[best]) != 0)[: len(best)]]
    small, beside, is_own = small[best], beside[best], is_own[best]
    into = np.full(count, -1)
    into[small[~is_own]] = label[beside[~is_own]]
    if fresh:
        alone = is_own & (texels[small] >= _LEAST_PART) & ~is_less[beside]
        number = np.unique(beside[alone], return_inverse=True)[1]
        into[beside[alone]] = into[small[alone]] = fresh + number
    out: _Int64 = np.where(into[part] >= 0, into[part], label)
    return out
