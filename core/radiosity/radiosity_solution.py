"""The solution after a round: the light on the leaves, and the statistics for refining the tree."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..util.arrays import Float64, Int64
from . import basis, refine, tally
from .coefficient_shrinkage import shrink_leaves
from .quadtree import Quadtree
from .scarce_charts import ChartOrder, share_light
from .tally import Solution, Tally, Totals

_TINY = float(np.finfo(float).tiny)


# Weight, in values, of a prior ratio of 1 between the variances of dependent and of independent photons.
_PRIOR_VALUES = 64.0
_DECAY = 0.25  # squared error of a node's functions over that of its parent: 1/2 along edges, 1/16 where light is smooth


@dataclass(frozen=True, eq=False)  # compared by identity
class RadiositySolution:
    """Solution on the nodes of a tree, which may have grown since.

    solution     irradiance of leaves, of nodes compared with their children, and of all ancestors of these
    comparison   comparison of nodes with their children
    leaves       (m,) int64: the nodes to show, which tile the charts
    freedom      (m,) float64: effective number of functions on each leaf
    """

    tree: Quadtree
    totals: Totals
    solution: Solution
    comparison: refine.Comparison
    leaves: Int64
    freedom: Float64

    @classmethod
    def of(cls, tree: Quadtree, counted: Tally, rule: refine.Rule, shrink: bool, charts: ChartOrder | None = None) -> RadiositySolution:
        """The solution from the tally of a tree's nodes.

        rule     selects the nodes to compare
        shrink   whether slopes of leaves are shrunk by their noise
        charts   those that few photons meet share light in this order; None for not at all
        """
        totals = tally.accumulate(tree, counted)
        compared = np.flatnonzero(refine.find_comparable(tree, totals, rule.stability))
        comparison = refine.Comparison.of(tree, totals, tally.solve_tallies(tree, totals, compared), rule)
        leaves = refine.choose_leaves(tree, comparison)
        shown = shrink_leaves(tree, totals, leaves) if shrink else tree
        solution = tally.solve_tallies(shown, totals, np.concatenate([compared, leaves]))
        variance = solution.variance * _compare_halves(tree, solution, leaves)
        gram = basis.gram_matrix(tree.moment[leaves], tree.degree)
        freedom = (shown.project[leaves] * gram).sum(axis=(1, 2))
        solution = replace(solution, variance=variance)
        if charts is not None:
            solution, scarce = share_light(tree, totals.received, leaves, solution, charts)
            freedom[np.isin(leaves, scarce)] = 1.0
        return cls(tree, totals, solution, comparison, leaves, freedom)

    @cached_property
    def mean(self) -> Float64:
        """(n_node, 3) W/m^2: mean irradiance of leaves and of the nodes above them."""
        return np.ascontiguousarray((self.solution.flux / np.maximum(self.tree.area, _TINY)).T)

    @cached_property
    def direct_share(self) -> Float64:
        """(n_node, 3) in [0, 1]: share of a node's light that photons brought straight from lamps, or from lamps by mirrors and glass.

        It is that of the flux: at the node's middle, which a chart may not even cover, the functions hold noise of their slopes.
        """
        moment = self.tree.moment[:, : self.solution.coefficient.shape[2]]
        direct, indirect = np.maximum(np.einsum("ckmn,nm->ckn", self.solution.coefficient, moment), 0.0)
        return np.divide(direct, direct + indirect, out=np.zeros_like(direct), where=direct > 0.0).T

    @cached_property
    def error2(self) -> Float64:
        """(n_node, 3) (W/m^2)^2: mean squared error of each leaf, its variance and what its functions cannot hold; 0 for other nodes.

        The latter is the difference of a leaf's children from its function, by dual buffers, so that it has no bias from noise; without
        children it is _DECAY times that of the leaf's parent. Only sums over leaves are meaningful.
        """
        tree, leaves, rows = self.tree, self.leaves, self.comparison.rows[0]
        parent = tree.parent[leaves]
        is_blind = (rows[leaves] < 0) & (tree.side[leaves] > 1) & (parent >= 0)
        row = np.where(is_blind, rows[parent], rows[leaves])
        known, share = np.flatnonzero(row >= 0), np.where(is_blind, _DECAY, 1.0)[:, None]
        out = np.zeros((len(tree), 3))
        out[leaves] = (self.solution.variance[:, leaves] * self.freedom).T
        out[leaves[known]] += share[known] * self.comparison.differences[0].common[row[known]]
        return out


def _compare_halves(tree: Quadtree, solution: Solution, leaves: Int64) -> float:
    """Ratio of the variance between the dual buffers to that of independent photons.

    It exceeds 1 in light of many bounces, where the path of one photon meets a leaf more than once.
    Source: Rousselle et al. 2012, "Adaptive rendering with non-local means filtering", for dual buffers.
    """
    gap = (solution.flux_half[0] - solution.flux_half[1])[:, leaves] / (2.0 * np.maximum(tree.area[leaves], _TINY))
    predicted = solution.variance[:, leaves]
    ratio = np.divide(gap**2, predicted, out=np.zeros_like(gap), where=predicted > 0.0)
    # Leaves have few photons of unequal power, so their ratios have long tails; leaves are weighted by the root of their light.
    weight = np.sqrt(np.maximum(solution.flux[:, leaves], 0.0)) * (predicted > 0.0)
    weight /= max(float(weight.max(initial=0.0)), _TINY)
    return float((ratio * weight).sum() + _PRIOR_VALUES) / float(weight.sum() + _PRIOR_VALUES)
