"""Clips negative light of leaves to zero and preserves their flux.

A plane that is fitted to a small spot of light dips below zero beside it. Clipping alone would add energy, a sixth or more of a caustic on
a large leaf. So the rest of the leaf is scaled down to the flux that it had. If the flux of a leaf is negative, which blending with a
neighbour's plane may cause, the smallest ancestor with enough flux is scaled instead, or the whole chart.

The limiter of Zhang & Shu 2010, "On maximum-principle-satisfying high order schemes for scalar conservation laws", keeps a leaf's flux too,
by reducing its slope; at the edge of a shadow its squared error is a third larger.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..radiosity.quadtree import Quadtree
from ..util.ablation import uses
from ..util.arrays import Float64, IntArray


def clip_light(light: NDArray[Any], area: NDArray[Any], leaf: IntArray, tree: Quadtree) -> None:
    """Clip negative light to zero, in place, and scale the rest of each leaf down to the flux it had.

    light   (n,) float, W/m^2, at texels in any order
    area    (n,) float, m^2, of the texels
    leaf    (n,) int: the node of each texel; the nodes do not overlap
    """
    if not len(light) or light.min() >= 0.0:
        return
    if not uses("flux_clipping"):
        np.maximum(light, 0.0, out=light)
        return
    before: Float64 = np.bincount(leaf, light * area, len(tree)).astype(np.float64, copy=False)
    np.maximum(light, 0.0, out=light)
    after: Float64 = np.bincount(leaf, light * area, len(tree)).astype(np.float64, copy=False)
    leaves = np.flatnonzero(np.bincount(leaf, minlength=len(tree)))
    factor = np.ones(len(tree), light.dtype)
    factor[leaves] = _find_factors(before[leaves], after[leaves], leaves, tree)
    light *= factor[leaf]


def _find_factors(before: Float64, after: Float64, leaves: IntArray, tree: Quadtree) -> Float64:
    """(m,): factors on the clipped light of leaves (m,), from their flux (m,), W, before and after clipping."""
    order = np.argsort(tree.start[leaves])
    start = tree.start[leaves[order]]
    before, after = before[order], after[order]
    sums = np.array([np.concatenate([[0.0], np.cumsum(flux)]) for flux in (before, after)])
    factor = np.divide(before, after, out=np.ones(len(leaves)), where=after > 0.0)
    factor[after <= 0.0] = 0.0
    chart = tree.chart[leaves[order]]
    paying: list[tuple[int, int, float]] = []
    node = leaves[order][before < 0.0]
    while len(node):
        node, orphan = np.unique(tree.parent[node]), np.unique(tree.chart[node[tree.parent[node] < 0]])
        node = node[node >= 0]
        first = np.concatenate([np.searchsorted(start, tree.start[node]), np.searchsorted(chart, orphan)])
        last = np.concatenate([np.searchsorted(start, tree.end[node]), np.searchsorted(chart, orphan, side="right")])
        own_before, own_after = sums[:, last] - sums[:, first]
        pays = own_before >= 0.0
        share = np.divide(own_before, own_after, out=np.zeros(len(first)), where=own_after > 0.0)
        pays[len(node) :] = True  # charts, which have nothing above them
        paying += zip(first[pays], last[pays], share[pays], strict=True)
        node = node[~pays[: len(node)]]
    for begin, end, own in sorted(paying, key=lambda one: one[1] - one[0]):  # ancestors override their descendants
        factor[begin:end] = own
    out = np.empty(len(leaves))
    out[order] = np.maximum(factor, 0.0)
    return out
