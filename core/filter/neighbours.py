"""Adjacency of leaves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..radiosity.quadtree import Quadtree
from ..texels.texel_map import TexelMap
from ..util.arrays import IntArray

_ALONG = 4  # texels tested along each side of a leaf


@dataclass(frozen=True)
class Neighbours:
    """For each leaf, the leaves that share a side or a corner with it, on its chart or on another chart of the same piece.

    start   (n_node + 1,) int64: other[start[k] : start[k + 1]] are the neighbours of node k
    other   (p,) int32
    around  (p,) bool: the neighbour's square contains that of the node, which may occur where a chart was cut
    within  (p,) bool: the neighbour's square lies within that of the node
    """

    start: NDArray[np.int64]
    other: NDArray[np.int32]
    around: NDArray[np.bool_]
    within: NDArray[np.bool_]

    @classmethod
    def of(cls, tree: Quadtree, leaf: NDArray[np.int32], texels: TexelMap) -> Neighbours:
        """Find neighbours at texels right beside each leaf. That finds leaves as large or larger; smaller ones find this leaf.

        leaf   (n,) int32: leaf of each texel entry
        """
        is_leaf = np.zeros(len(tree), bool)
        is_leaf[leaf] = True
        own = np.flatnonzero(is_leaf)
        side, (x, y), chart = tree.side[own], tree.origin[own].T, tree.chart[own]
        piece = texels.chart_piece[tree.chart]
        size, flat = texels.page_size, texels.entry_at.ravel()
        first_row = texels.page_of(tree.start[own]).astype(np.int64) * size
        before, along = np.full_like(side, -1), [((2 * k + 1) * side) // (2 * _ALONG) for k in range(_ALONG)]
        ends = (before, side)
        beside = [(a, b) for a in ends for b in (*along, *ends)] + [(b, a) for a in ends for b in along]
        pairs = []
        for right, up in beside:
            column, row = x + right, y + up
            inside = (column >= 0) & (column < size) & (row >= 0) & (row < size)
            entry = np.where(inside, flat.take((first_row + row) * size + column, mode="clip"), -1)
            other = leaf.take(np.maximum(entry, 0))
            touches = (entry >= 0) & (piece.take(other) == piece[own])
            cut = np.flatnonzero(touches & (tree.chart.take(other) != chart))
            if len(cut):  # across a cut: only from a texel of the leaf itself, and if no surface stands between
                nearest = np.stack([np.clip(step[cut], 0, side[cut] - 1) for step in (right, up)])
                at = (first_row[cut] + y[cut] + nearest[1]) * size + x[cut] + nearest[0]
                touches[cut] = _is_open(own[cut], flat.take(at, mode="clip"), entry[cut], leaf, texels)
            pairs += [own[touches] * len(tree) + other[touches], other[touches].astype(np.int64) * len(tree) + own[touches]]
        nodes, others = np.divmod(np.unique(np.concatenate(pairs)), max(len(tree), 1))
        around, within = (_holds(tree, *pair) for pair in ((others, nodes), (nodes, others)))  # a pair of equal squares would be both
        return cls(np.searchsorted(nodes, np.arange(len(tree) + 1)), others.astype(np.int32), around, within)

    def list_pairs(self, node: IntArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Pairs of nodes (m,) with their neighbours: (k,) rows of `node`, ascending, and (k,) indices into `other`."""
        first = self.start[node]
        count = self.start[node + 1] - first
        row = np.repeat(np.arange(len(node)), count)
        return row, np.arange(len(row)) + (first - np.cumsum(count) + count)[row]


def _holds(tree: Quadtree, outer: IntArray, inner: IntArray) -> NDArray[np.bool_]:
    """(m,) bool: whether the squares of nodes outer (m,) contain those of nodes inner (m,)."""
    from_corner = tree.origin[inner] - tree.origin[outer]
    held: NDArray[np.bool_] = ((from_corner >= 0) & (from_corner + tree.side[inner, None] <= tree.side[outer, None])).all(axis=1)
    return held


def _is_open(own: IntArray, near: IntArray, far: IntArray, leaf: NDArray[np.int32], texels: TexelMap) -> NDArray[np.bool_]:
    """(m,) bool: whether texel entries `near` (m,), -1 for none, lie on leaves `own` (m,), and no surface stands between them and `far`."""
    is_open: NDArray[np.bool_] = (near >= 0) & (leaf.take(np.maximum(near, 0)) == own)
    borders = texels.borders
    if not len(borders.entry):
        return is_open
    rows = np.flatnonzero(is_open)
    rows = rows[borders.crossed[near[rows]] | borders.crossed[far[rows]]]
    aslant = (texels.texel_xy[far[rows]] != texels.texel_xy[near[rows]]).all(axis=1)
    is_open[rows[aslant]] = False  # at the corner of a room only one of the two is crossed
    rows = rows[~aslant]
    rows = rows[borders.crossed[near[rows]]]
    is_open[rows] = ~(borders.other[:, np.searchsorted(borders.entry, near[rows])] == far[rows]).any(axis=0)
    return is_open
