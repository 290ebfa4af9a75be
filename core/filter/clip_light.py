"""Leaves' light without its negative part, and with no more flux than before.

A plane that is fitted to a small spot of light dips below zero beside it. To set that to zero alone would make energy, a sixth and more
of a caustic on a large leaf. So what is left of a leaf is scaled down to the flux that it had. Where blending with a neighbour's plane
leaves a leaf below zero in all, the smallest node above it that has the flux, or the chart, pays for it.

The limiter of Zhang & Shu 2010, "On maximum-principle-satisfying high order schemes for scalar conservation laws", keeps a leaf's flux too,
by less slope; at the edge of a shadow its squared error is a third larger.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..radiosity.quadtree import Quadtree
from ..util.ablation import uses
from ..util.arrays import Float64, IntArray


def clip_light(light: NDArray[Any], area: NDArray[Any], leaf: IntArray, tree: Quadtree) -> None:
    """Sets what is below zero to zero, in place, and scales the rest of each leaf down to the flux it had.

    light   (n,) float, W/m^2, at texels in any order
    area    (n,) float, m^2, of the texels
    leaf    (n,) int: the node that each is on; the nodes do not overlap
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
    """(m,): what the light on leaves (m,) is to be times, by their flux (m,), W, before and after what is below zero was set to zero."""
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
        pays[len(node) :] = True  # nothing is above a chart
        paying += zip(first[pays], last[pays], share[pays], strict=True)
        node = node[~pays[: len(node)]]
    for begin, end, own in sorted(paying, key=lambda one: one[1] - one[0]):  # the larger of two counts
        factor[begin:end] = own
    out = np.empty(len(leaves))
    out[order] = np.maximum(factor, 0.0)
    return out
