"""Which leaves touch each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .quadtree import Quadtree
from .scene import IntArray

_ALONG = 4  # places looked at beside each side of a leaf


@dataclass(frozen=True)
class Neighbours:
    """Of each node that is a leaf, the leaves of its chart that it shares a side or a corner with.

    start   (n_node + 1,) int64: other[start[k] : start[k + 1]] are those of node k
    other   (p,) int32
    """

    start: NDArray[np.int64]
    other: NDArray[np.int32]

    @classmethod
    def of(cls, tree: Quadtree, leaf: NDArray[np.int32], page: NDArray[np.int32], entry_at: NDArray[np.int32]) -> Neighbours:
        """Looked for right beside each leaf, which finds what is as large or larger; what is smaller finds it.

        leaf, page   (n,) int32, of each texel entry
        entry_at     (n_page, size, size) int32, -1 where there is none
        """
        is_leaf = np.zeros(len(tree), bool)
        is_leaf[leaf] = True
        own = np.flatnonzero(is_leaf)
        side, (x, y), chart = tree.side[own], tree.origin[own].T, tree.chart[own]
        first_row = page[tree.start[own]].astype(np.int64) * entry_at.shape[1]
        size, flat = entry_at.shape[1], entry_at.ravel()
        before, along = np.full_like(side, -1), [((2 * k + 1) * side) // (2 * _ALONG) for k in range(_ALONG)]
        ends = (before, side)
        beside = [(a, b) for a in ends for b in (*along, *ends)] + [(b, a) for a in ends for b in along]
        pairs = []
        for right, up in beside:
            column, row = x + right, y + up
            inside = (column >= 0) & (column < size) & (row >= 0) & (row < size)
            entry = np.where(inside, flat.take((first_row + row) * size + column, mode="clip"), -1)
            other = leaf.take(np.maximum(entry, 0))
            touches = (entry >= 0) & (tree.chart.take(other) == chart)
            pairs += [own[touches] * len(tree) + other[touches], other[touches].astype(np.int64) * len(tree) + own[touches]]
        nodes, others = np.divmod(np.unique(np.concatenate(pairs)), max(len(tree), 1))
        return cls(np.searchsorted(nodes, np.arange(len(tree) + 1)), others.astype(np.int32))

    def list_pairs(self, node: IntArray) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
        """Rows (k,) of node (m,), ascending, and the neighbours (k,) of each."""
        first = self.start[node]
        count = self.start[node + 1] - first
        row = np.repeat(np.arange(len(node)), count)
        return row, self.other[np.arange(len(row)) + (first - np.cumsum(count) + count)[row]]
