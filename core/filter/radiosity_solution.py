"""The solution after a round: the light on the leaves, and the statistics for refining the tree and estimating the error."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..radiosity import coefficient_shrinkage, refine, tally
from ..radiosity.quadtree import Quadtree
from ..radiosity.tally import Solution, Tally, Totals
from ..texels.error_metric import ErrorMetric
from ..util.arrays import IntArray
from . import bias_estimate, variance_estimate
from .subtexel_tally import SubtexelLight


@dataclass(frozen=True, eq=False)  # compared by identity
class RadiositySolution:
    """Solution on the nodes of a tree, which may have grown since.

    solution     irradiance of leaves, of the comparison nodes of their error estimate, of nodes compared with their children, and of all
                 ancestors of these
    comparison   comparison of nodes with their children
    leaves       (m,) int64: the nodes to show, which tile the charts
    risk         (m,) float64 of each leaf, from coefficient_shrinkage.shrink_leaves; None without shrinkage
    squares      tallies that the leaves' light is mixed with; None for none
    """

    tree: Quadtree
    totals: Totals
    solution: Solution
    comparison: refine.Comparison
    leaves: NDArray[np.int64]
    risk: NDArray[np.float64] | None = None
    squares: SubtexelLight | None = None

    @classmethod
    def of(
        cls, tree: Quadtree, counted: Tally, rule: refine.Rule, metric: ErrorMetric, shrink: bool, squares: SubtexelLight
    ) -> RadiositySolution:
        """The solution from the tally of a tree's nodes.

        rule     selects the nodes to compare
        metric   texels whose error will be estimated
        shrink   whether leaves' coefficients are shrunk towards those of the nodes above
        """
        totals = tally.accumulate(tree, counted)
        compared = np.flatnonzero(refine.find_comparable(tree, totals, rule.stability))
        solution = tally.solve_tallies(tree, totals, compared)
        comparison = refine.Comparison.of(tree, totals, solution, rule)
        leaves = refine.choose_leaves(tree, comparison)
        shown, risk = coefficient_shrinkage.shrink_leaves(tree, totals, leaves) if shrink else (tree, None)
        needed = np.concatenate([compared, list_needed(tree, leaves, metric)])
        return cls(tree, totals, tally.solve_tallies(shown, totals, needed), comparison, leaves, risk, squares)

    @cached_property
    def correction(self) -> NDArray[np.float64]:
        """(3,): variance_estimate.noise_correction of the leaves."""
        return variance_estimate.noise_correction(self.tree, self.solution, self.leaves)


def list_needed(tree: Quadtree, nodes: IntArray, metric: ErrorMetric) -> NDArray[np.int64]:
    """(m,) int64: the nodes whose functions error_estimate.state_error evaluates: the leaves `nodes` and their comparison nodes."""
    return np.concatenate([nodes, bias_estimate.find_comparison_nodes(tree, nodes, metric.entry)])
