"""Weights of leaves in the blend: their shares of the area of a window around each point.

Source: a partition of unity (Babuska & Melenk 1997) by the overlap of boxes.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..radiosity.quadtree import Quadtree
from .neighbours import Neighbours

Float64: TypeAlias = NDArray[np.float64]

_LEAST_SHARE = 0.125  # of the point's own leaf, which has 1/4 where four corners meet; binds on slivers, and where squares overlap


def find_shares(
    tree: Quadtree, neighbours: Neighbours, leaf: NDArray[np.int32], x: Float64, y: Float64
) -> tuple[Float64, NDArray[np.int64], NDArray[np.int32], Float64]:
    """Shares of leaves in the windows around points x, y (m,), page texels, on leaves (m,).

    A window is as wide as its leaf; or, near a smaller leaf, as wide as that one plus its distance. So windows and shares are continuous
    where leaves meet, except for small steps near leaves of a third size. The width of a partly covered leaf is that of a square of as many
    texels, since its function is invalid far outside of them.

    out   (m,) share of each point's own leaf; then for k pairs: int64 row of the point, ascending, int32 other leaf, and its share. The
          part of a window outside of the chart belongs to no leaf, so shares need not add up to 1
    """
    row, pair = neighbours.list_pairs(leaf)
    other = neighbours.other[pair]
    low, own_low = (
        [tree.origin[node, axis] - at for axis, at in enumerate(place)] for node, place in ((other, (x[row], y[row])), (leaf, (x, y)))
    )
    side = tree.side[other]
    away = np.maximum.reduce([np.zeros(len(row)), *low, *(-(along + side) for along in low)])
    window = np.sqrt(tree.end[leaf] - tree.start[leaf])
    np.minimum.at(window, row, np.sqrt(tree.end[other] - tree.start[other]) + away)
    own, share = _overlap(own_low, tree.side[leaf], window), _overlap(low, side, window[row])
    within = np.flatnonzero(neighbours.within[pair])
    own -= np.bincount(row[within], share[within], len(leaf))
    around = np.flatnonzero(neighbours.around[pair])
    if len(around):  # a leaf whose square contains this one has the part of the window where no other leaf lies
        share[around] = 0.0
        left = 1.0 - np.bincount(row, share, len(leaf)) - own
        share[around] = np.maximum(left, 0.0)[row[around]] / np.bincount(row[around], minlength=len(leaf))[row[around]]
    kept = np.flatnonzero(share)
    return np.maximum(own, _LEAST_SHARE), row[kept], other[kept], share[kept]


def _overlap(low: list[Float64], side: NDArray[Any], window: Float64) -> Float64:
    """(m,): share of windows, of width (m,) about a point, in squares of sides (m,) whose low corners are at low[axis] (m,) from it."""
    share = np.ones(len(window))
    for along in low:
        share *= np.clip(np.minimum(along + side, window / 2.0) - np.maximum(along, -window / 2.0), 0.0, None) / window
    return share
