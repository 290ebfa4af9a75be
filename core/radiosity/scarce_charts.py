"""Light on charts that few photons meet, which share it with charts beside them.

The variance of a photon's flux over an area goes as one over the area. A chart of a single small texel has no larger node to fall back on:
one photon that a mirror throws there makes it far too bright, and may be most of the error that a bake states. So such
charts are joined in order of place until some photons are among them, as if they were one leaf of a constant function.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..util.arrays import Float64, Int64
from .quadtree import Quadtree
from .tally import Solution

# Photons on which a mean has a standard error of a quarter, if all have the same power.
_FEW = 16


@dataclass(frozen=True)
class ChartOrder:
    """Charts in an order in which neighbours follow each other.

    rank    (n_chart,) int64
    owner   (n_chart,) int64: the object; others do not share its light
    """

    rank: Int64
    owner: Int64


def share_light(tree: Quadtree, received: Int64, leaves: Int64, solution: Solution, order: ChartOrder) -> tuple[Solution, Int64]:
    """The solution with the light of scarce charts spread evenly over some of them; their flux stays the same. And their leaves (m,).

    received   (n_node,) int64: number of photons
    """
    is_root = tree.parent < 0
    is_whole = is_root & (np.bincount(tree.chart[is_root], minlength=len(order.rank))[tree.chart] == 1)
    scarce = leaves[is_whole[leaves] & (received[leaves] < _FEW) & (tree.area[leaves] > 0)]
    chart = tree.chart[scarce]
    scarce = scarce[np.lexsort((order.rank[chart], order.owner[chart]))]
    if not len(scarce):
        return solution, scarce
    before = np.cumsum(received[scarce]) - received[scarce]
    owner, filled = order.owner[tree.chart[scarce]], before // _FEW
    first = np.flatnonzero(np.diff(owner, prepend=-1) | np.diff(filled, prepend=-1))
    count = np.diff(first, append=len(scarce))
    area = np.add.reduceat(tree.area[scarce], first)

    def spread(flux: Float64) -> Float64:
        """(..., m): mean irradiance of each leaf's group, from the leaves' flux (..., m)."""
        return np.repeat(np.add.reduceat(flux, first, axis=-1) / area, count, axis=-1)

    def flatten(functions: Float64) -> Float64:
        """Functions (..., K, n) with constants on the scarce leaves."""
        own = functions[..., scarce]
        out = functions.copy()
        out[..., scarce] = 0.0
        out[..., 0, scarce] = spread((own * tree.moment[scarce, : own.shape[-2]].T).sum(axis=-2))
        return out

    flux, flux_half, variance = solution.flux.copy(), solution.flux_half.copy(), solution.variance.copy()
    flux[:, scarce] = spread(flux[:, scarce]) * tree.area[scarce]
    flux_half[..., scarce] = spread(flux_half[..., scarce]) * tree.area[scarce]
    squares = np.add.reduceat(variance[:, scarce] * tree.area[scarce] ** 2, first, axis=1)
    variance[:, scarce] = np.repeat(squares / area**2, count, axis=1)
    shared = replace(
        solution,
        coefficient=flatten(solution.coefficient),
        half=flatten(solution.half),
        flux=flux,
        flux_half=flux_half,
        variance=variance,
    )
    return shared, scarce
