"""Pieces of charts, cut further where squares of a quadtree hold parts of them that do not hang together.

A wall with a door in it parts no floor: one can go round. But it parts squares of texels, and a leaf over both of its sides would
show at the wall's foot the light of the room behind it. So in each square, from large ones to small ones, all parts but the largest leave
their piece: for the piece that lies beside them, or for one of their own with what lies beside them, so that photons enough fall on it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .texel_grid import part_bits
from .texel_map import CHART_SHIFT
from .tiles import TILE_SIDE
from .topology import join_sets

_LEAST_LOG2 = TILE_SIDE.bit_length() - 1  # of the side of a square that is looked at: what nothing touches is known by tiles
_MOST_PASSES = 8  # over squares of one size
_LEAST_PART = 8  # texels, of what is worth a piece of its own

_Int64 = NDArray[np.int64]
_Bool = NDArray[np.bool_]


@dataclass(frozen=True)
class _Net:
    """Patches, or units of them that hang together within squares, and the ways between them.

    key      (k,) int64, ascending: of each one's first texel
    size     (k,) int64, texels
    pair     (2, m) int64: where one can go
    length   (m,) int64, texels: how wide each way is
    """

    key: _Int64
    size: _Int64
    pair: _Int64
    length: _Int64

    def join(self, level: int) -> tuple[_Int64, _Net]:
        """The net of units within squares of side 2**level, and in which of them each is (k,). No larger square can part them."""
        square = self.key >> 2 * level
        inside = square[self.pair[0]] == square[self.pair[1]]
        part = join_sets(len(square), *self.pair[:, inside])
        is_first = part == np.arange(len(part))
        unit = (np.cumsum(is_first) - 1)[part]
        number, length = _sum_alike(unit[self.pair[:, ~inside]], self.length[~inside], len(unit))
        return unit, _Net(self.key[is_first], _sum_at(unit, self.size), number, length)

    def take(self, rows: _Int64) -> _Net:
        """Those at rows (j,), ascending, and the ways between them."""
        place = np.full(len(self.key), -1)
        place[rows] = np.arange(len(rows))
        pair = place[self.pair]
        both = (pair >= 0).all(axis=0)
        return _Net(self.key[rows], self.size[rows], pair[:, both], self.length[both])


def part_in_squares(key: _Int64, size: _Int64, ways: _Int64, closed: _Int64, log2: int) -> tuple[_Int64, _Int64]:
    """The first patch of what each patch hangs together with somehow (k,), and of its piece of that (k,).

    key      (k,) int64, ascending: chart and Morton code of each patch's first texel
    size     (k,) int64, texels: 1, or all of a tile
    ways     (2, m) int64: patches side by side where one can go
    closed   (2, j) int64: those of single texels where something stands between them
    log2     of the side of the largest root
    """
    if not closed.size:
        whole = join_sets(len(key), *ways)
        return whole, whole
    nets, units = [_Net(key, size, ways, np.where((size[ways] > 1).all(axis=0), TILE_SIDE, 1))], []
    for level in range(_LEAST_LOG2, log2 - 1):
        unit, net = nets[-1].join(level)
        nets.append(net)
        units.append(unit)
    top = nets[-1]
    whole = label = np.searchsorted(key, top.key)[join_sets(len(top.key), *top.pair)]
    for k in range(len(nets) - 1, -1, -1):
        label = _part_squares(nets[k], label, _LEAST_LOG2 + k, key[closed])
        if k:
            whole, label = whole[units[k - 1]], label[units[k - 1]]
    first = np.empty(label.max() + 1, np.int64)
    first[label[::-1]] = np.arange(len(label))[::-1]  # of several assignments to one place the last stays
    return whole, first[label]


def _part_squares(net: _Net, label: _Int64, level: int, closed_key: _Int64) -> _Int64:
    """(k,) int64: labels of pieces, where parts have left squares of side 2**level.

    label        (k,) int64: the piece that each is of
    closed_key   (2, j) int64: keys of texels side by side that something stands between
    """
    square, founds = net.key >> 2 * level, level > _LEAST_LOG2
    looked = _are_among(square, closed_key >> 2 * level)  # elsewhere only the shape of the chart parts anything
    around = square[net.pair[:, looked[net.pair].any(axis=0)]]
    kept = np.flatnonzero(looked | _are_among(square, around))
    near, square, looked = net.take(kept), square[kept], looked[kept]
    inner = square[near.pair[0]] == square[near.pair[1]]
    if not founds:
        inner[inner] = ~_cross_lines(near.key[near.pair[:, inner]], closed_key)
    part = join_sets(len(kept), *near.pair[:, inner])  # they move as wholes
    label = label.copy()
    for _ in range(_MOST_PASSES):  # as a piece takes what lies beside it, it comes to lie beside more
        before = label[kept]
        label[kept] = _move_parts(near, before, square, part, looked, int(label.max()) + 1 if founds else 0)
        if (before == label[kept]).all():
            break
    return label


def _move_parts(net: _Net, label: _Int64, square: _Int64, part: _Int64, looked: _Bool, fresh: int) -> _Int64:
    """(k,) int64: labels of pieces, where parts have left for others.

    label    (k,) int64: the piece that each is of
    square   (k,) int64: the square that it is in
    part     (k,) int64: the first one of its part, all of which is of one piece in one square
    looked   (k,) bool: those in squares whose parts may leave
    fresh    label of the first piece that parts found which lie beside no other one; 0 if they stay
    """
    count = len(label)
    texels = _sum_at(part, net.size)
    first = np.flatnonzero(looked & (part == np.arange(count)))
    order = first[np.lexsort((-texels[first], label[first], square[first]))]
    is_less = np.zeros(count, bool)
    is_less[order[1:][(np.diff(square[order]) == 0) & (np.diff(label[order]) == 0)]] = True
    pair, length = np.concatenate([net.pair, net.pair[::-1]], axis=1), np.tile(net.length, 2)
    outward = is_less[part[pair[0]]] & (square[pair[0]] != square[pair[1]])
    (small, beside), length = _sum_alike(part[pair[:, outward]], length[outward], count)
    is_own = label[beside] == label[small]
    best = np.lexsort((-length, is_own, small))
    best = best[np.append(True, np.diff(small[best]) != 0)[: len(best)]]
    small, beside, is_own = small[best], beside[best], is_own[best]
    into = np.full(count, -1)
    into[small[~is_own]] = label[beside[~is_own]]
    if fresh:
        alone = is_own & (texels[small] >= _LEAST_PART) & ~is_less[beside]
        into[beside[alone]] = into[small[alone]] = fresh + np.unique(beside[alone], return_inverse=True)[1]
    out: _Int64 = np.where(into[part] >= 0, into[part], label)
    return out


def _cross_lines(key: _Int64, closed_key: _Int64) -> _Bool:
    """(m,) bool: ways across a line, within one of the smallest squares, that something stands on: a wall's line goes on past its end.

    key, closed_key   (2, m) and (2, j) int64: keys of texels side by side; those of a way lie in one square
    """
    return _are_among(_number_lines(key), _number_lines(closed_key))


def _number_lines(key: _Int64) -> _Int64:
    """(m,) int64: which line between columns or rows of which square is between texels of keys (2, m); the first is a square's edge."""
    x, y = part_bits(key & ((1 << CHART_SHIFT) - 1))
    is_row = x[0] == x[1]
    step = np.where(is_row, y.max(axis=0), x.max(axis=0)) % TILE_SIDE
    number: _Int64 = 2 * ((key[0] >> 2 * _LEAST_LOG2) * TILE_SIDE + step) + is_row
    return number


def _sum_alike(pair: _Int64, length: _Int64, count: int) -> tuple[_Int64, _Int64]:
    """Pairs (2, m) of numbers below count, each once and in order, and the sums of their lengths (m,)."""
    found, place = np.unique(pair[0] * count + pair[1], return_inverse=True)
    return np.stack(np.divmod(found, count)), _sum_at(place, length)


def _sum_at(place: _Int64, value: _Int64) -> _Int64:
    """(max + 1,) int64: sums of values (m,) at places (m,)."""
    return np.bincount(place, value).astype(np.int64)


def _are_among(value: _Int64, wanted: _Int64) -> _Bool:
    """(m,) bool: which of the values (m,) are wanted."""
    every = np.unique(wanted)
    found: _Bool = every[np.searchsorted(every[:-1], value)] == value if len(every) else np.zeros(len(value), bool)
    return found
