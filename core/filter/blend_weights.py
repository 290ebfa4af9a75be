"""Shares of leaves in a window around a place: their weights in the blend.

Source: a partition of unity (Babuska & Melenk 1997) by the overlap of boxes.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..radiosity.quadtree import Quadtree
from .neighbours import Neighbours

Float64: TypeAlias = NDArray[np.float64]

_LEAST_SHARE = 0.125  # of a leaf itself: less than at its corners, where four meet; binds where squares of leaves overlap, and on slivers


def find_shares(
    tree: Quadtree, neighbours: Neighbours, leaf: NDArray[np.int32], x: Float64, y: Float64
) -> tuple[Float64, NDArray[np.int64], NDArray[np.int32], Float64]:
    """Shares of the windows around places x, y (m,), page texels, on leaves (m,).

    A window is as wide as its leaf, or as a smaller one beside it and wider by what that is away. So neither a window nor a share changes
    with a step where leaves meet, but for a little near leaves of a third size. A leaf of which little is covered is as wide as a square
    of as many texels: far outside of them its function is invalid.

    out   (m,) what each leaf has of its own window; (k,) int64 rows of places, ascending, (k,) int32 other leaves, and (k,) what they have
          of the windows there. The part outside of the chart belongs to no leaf, so that they need not add up to 1
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
    if len(around):  # it lies where neither the leaf nor another does
        share[around] = 0.0
        left = 1.0 - np.bincount(row, share, len(leaf)) - own
        share[around] = np.maximum(left, 0.0)[row[around]] / np.bincount(row[around], minlength=len(leaf))[row[around]]
    kept = np.flatnonzero(share)
    return np.maximum(own, _LEAST_SHARE), row[kept], other[kept], share[kept]


def _overlap(low: list[Float64], side: NDArray[Any], window: Float64) -> Float64:
    """(m,): share of windows (m,), each around a place, in squares of sides (m,) with corners low[axis] (m,) from there."""
    share = np.ones(len(window))
    for along in low:
        share *= np.clip(np.minimum(along + side, window / 2.0) - np.maximum(along, -window / 2.0), 0.0, None) / window
    return share
