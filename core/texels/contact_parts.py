"""Cuts pieces of charts further where a square of the quadtree holds disconnected parts of a piece.

A wall with a door does not disconnect the floor as a whole, but it disconnects squares of texels, and a leaf over both of its sides would
leak the light of the other room to the wall's foot. So in each square, from large to small, all parts but the largest leave their piece:
they join the adjacent piece, or found a new one with their adjacent parts, so that it receives enough photons.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..scene.topology import join_sets
from ..util.arrays import BoolArray, Int64
from ..util.geometry import gather
from .texel_grid import part_bits
from .tiles import TILE_SIDE, TILE_TEXELS

_LEAST_LOG2 = TILE_SIDE.bit_length() - 1  # of the least side of a square: regions without contacts are handled as tiles
_MOST_PASSES = 8  # over squares of one size
_COLUMN, _ROW = part_bits(np.arange(TILE_TEXELS))  # of texels in a square of the smallest size, in Morton order
_LEAST_PART = 8  # texels, the least size of a new piece


@dataclass(frozen=True)
class _Net:
    """A graph whose nodes are patches, or units of patches connected within squares; edges join adjacent nodes.

    key      (k,) int64, ascending: key of each node's first texel
    size     (k,) int64, texels
    pair     (2, m) int64: nodes of each edge
    length   (m,) int64, texels: length of the border that both share
    """

    key: Int64
    size: Int64
    pair: Int64
    length: Int64

    def join(self, level: int) -> tuple[Int64, _Net]:
        """The unit of each node (k,), and the graph of units: nodes that are connected within a square of side 2**level, which larger
        squares cannot disconnect.
        """
        square = self.key >> 2 * level
        inside = square[self.pair[0]] == square[self.pair[1]]
        part = join_sets(len(square), *self.pair.compress(inside, axis=1))
        is_first = part == np.arange(len(part))
        unit = (np.cumsum(is_first) - 1)[part]
        outside = np.flatnonzero(~inside)
        number, length = _sum_alike(unit[gather(self.pair, outside)], self.length[outside], len(unit))
        return unit, _Net(self.key[is_first], _sum_at(unit, self.size), number, length)

    def take(self, rows: Int64) -> _Net:
        """The subgraph of nodes (j,), ascending."""
        place = np.full(len(self.key), -1)
        place[rows] = np.arange(len(rows))
        pair = place[self.pair]
        both = np.flatnonzero((pair[0] >= 0) & (pair[1] >= 0))
        return _Net(self.key[rows], self.size[rows], gather(pair, both), self.length[both])


def part_in_squares(key: Int64, size: Int64, ways: Int64, closed: Int64, log2: int) -> tuple[Int64, Int64]:
    """The first patch of each patch's connected component (k,), and the first patch of its piece within the component (k,).

    key      (k,) int64, ascending: chart and Morton code of each patch's first texel
    size     (k,) int64, texels: 1, or all of a tile
    ways     (2, m) int64: adjacent patches with nothing between them
    closed   (2, j) int64: adjacent patches of single texels with a surface between them
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


def _part_squares(net: _Net, label: Int64, level: int, closed_key: Int64) -> Int64:
    """(k,) int64: labels of the nodes' pieces, after parts have left their pieces in squares of side 2**level.

    label        (k,) int64: labels before
    closed_key   (2, j) int64: keys of adjacent texels with a surface between them
    """
    key, founds = net.key >> 2 * level, level > _LEAST_LOG2
    square = np.cumsum(np.diff(key, prepend=-1) != 0) - 1
    closed_square = square[np.searchsorted(key, closed_key >> 2 * level)]
    is_near = np.zeros(len(square), bool)  # by square
    is_near[closed_square] = True
    looked = is_near[square]  # elsewhere only the chart's shape disconnects parts
    is_near[square[net.pair.compress(looked[net.pair[0]] | looked[net.pair[1]], axis=1)]] = True
    kept = np.flatnonzero(is_near[square])
    near, square, looked = net.take(kept), square[kept], looked[kept]
    inner = square[near.pair[0]] == square[near.pair[1]]
    within, outer = near.pair.compress(inner, axis=1), near.pair.compress(~inner, axis=1)
    if not founds:
        open_ways = ~_cross_lines(near.key[within], square[within[0]], closed_key, closed_square)
        within = within.compress(open_ways, axis=1)
    part = join_sets(len(kept), *within)  # parts change pieces as a whole
    across = _Net(near.key, near.size, np.concatenate([outer, outer[::-1]], axis=1), np.tile(near.length.compress(~inner), 2))
    label = label.copy()
    for _ in range(_MOST_PASSES):  # a piece that took a part may be adjacent to further ones
        before = label[kept]
        label[kept] = _move_parts(across, before, square, part, looked, int(label.max()) + 1 if founds else 0)
        if (before == label[kept]).all():
            break
    return label


def _move_parts(net: _Net, label: Int64, square: Int64, part: Int64, looked: BoolArray, fresh: int) -> Int64:
    """(k,) int64: labels of the nodes' pieces, after parts have moved to other pieces.

    net      its edges connect squares and are listed in both directions
    label    (k,) int64: piece of each node
    square   (k,) int64: square of each node
    part     (k,) int64: first node of each node's part; a part lies in one square and in one piece
    looked   (k,) bool: nodes in squares whose parts may leave
    fresh    first label for new pieces of parts that are adjacent to no other piece; 0 if such parts stay
    """
    count = len(label)
    texels = _sum_at(part, net.size)
    first = np.flatnonzero(looked & (part == np.arange(count)))
    order = first[np.lexsort((-texels[first], label[first], square[first]))]
    is_less = np.zeros(count, bool)
    is_less[order[1:][(np.diff(square[order]) == 0) & (np.diff(label[order]) == 0)]] = True
    outward = np.flatnonzero(is_less[part[net.pair[0]]])
    (small, beside), length = _sum_alike(part[gather(net.pair, outward)], net.length[outward], count)
    is_own = label[beside] == label[small]
    best = np.lexsort((-length, is_own, small))
    best = best[np.append(True, np.diff(small[best]) != 0)[: len(best)]]
    small, beside, is_own = small[best], beside[best], is_own[best]
    into = np.full(count, -1)
    into[small[~is_own]] = label[beside[~is_own]]
    if fresh:
        alone = is_own & (texels[small] >= _LEAST_PART) & ~is_less[beside]
        into[beside[alone]] = into[small[alone]] = fresh + np.unique(beside[alone], return_inverse=True)[1]
    return np.where(into[part] >= 0, into[part], label)


def _cross_lines(key: Int64, square: Int64, closed_key: Int64, closed_square: Int64) -> BoolArray:
    """(m,) bool: pairs of texels across a line on which a surface stands somewhere in their square: a wall's line is extended past its end.

    Lines lie between columns or rows of the smallest squares.

    key, closed_key         (2, m) and (2, j) int64: keys of adjacent texels
    square, closed_square   (m,) and (2, j) int64: numbers of their squares; both texels of a pair (m,) lie in one
    """
    inside = closed_square[0] == closed_square[1]
    closed = _number_lines(closed_key[:, inside], closed_square[0, inside])
    line = _number_lines(key, square)
    crossed = np.zeros(max(closed.max(initial=-1), line.max(initial=-1)) + 1, bool)
    crossed[closed] = True
    return crossed[line]


def _number_lines(key: Int64, square: Int64) -> Int64:
    """(m,) int64: numbers of the lines between texels of keys (2, m), both of which lie in squares (m,)."""
    x, y = (place[key & (TILE_TEXELS - 1)] for place in (_COLUMN, _ROW))
    is_row = x[0] == x[1]
    return 2 * (square * TILE_SIDE + np.where(is_row, np.maximum(*y), np.maximum(*x))) + is_row


def _sum_alike(pair: Int64, length: Int64, count: int) -> tuple[Int64, Int64]:
    """Distinct pairs of numbers below count, ascending, from pairs (2, m); and the sums of their lengths."""
    found, place = np.unique(pair[0] * count + pair[1], return_inverse=True)
    return np.stack(np.divmod(found, count)), _sum_at(place, length)


def _sum_at(place: Int64, value: Int64) -> Int64:
    """(max + 1,) int64: sums of values (m,) at places (m,)."""
    return np.bincount(place, value).astype(np.int64)
