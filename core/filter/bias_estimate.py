"""Discretisation bias of the leaves' light, squared and relative to local brightness, from two estimators.

The first, the difference between a leaf and its children, is unbiased in the sum over leaves, apart from selection: the same photons chose
the leaves, and nodes whose children differed little by chance were not split. Its variance is high where leaves are few. The second
extrapolates the bias of nodes one and two levels up, which is far above noise, by its decay from level to level. Both are sums over all
leaves and are combined with weights of inverse variance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..radiosity import refine
from ..radiosity.coefficient_shrinkage import beyond_noise
from ..radiosity.quadtree import Quadtree
from ..radiosity.tally import Solution
from ..util.ablation import uses
from ..util.arrays import IntArray
from .reconstruct import PointLight, evaluate_leaf

# Squared bias of a node over that of its parent: 1/2 along edges, 1/16 where light is smooth.
BIAS_DECAY = 0.25
# bias2(leaf) = FALL_GOES_ON * fall * bias2(parent) with fall = sum bias2(parent) / sum bias2(grandparent). The factor is below 1 since, in
# the closed forms, the decay becomes faster as leaves become finer. FALL_DOUBT is the relative standard error of the extrapolated sum.
FALL_GOES_ON, FALL_DOUBT = 0.5, 0.5
# Factor on the standard error of the first estimator where it is below the extrapolation, for its selection bias.
HIDDEN_DOUBT = 2.0
# Standard deviations of noise by which a grandparent's children must differ for its bias to enter the decay. Children of evenly lit nodes
# that were split by chance differ by three to five.
FAR_OUT = 10.0
_TINY = float(np.finfo(float).tiny)


@dataclass(frozen=True)
class AskedLight:
    """Blended light of leaves at the sampled texels, for which the error is estimated.

    leaf     (m,) int32
    x, y     (m,) float64, page texels
    light    the light, by dual buffers
    weight   (m, 3) float32: factor that makes squared errors relative
    """

    leaf: NDArray[np.int32]
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    light: PointLight
    weight: NDArray[np.float32]


@dataclass(frozen=True)
class Bias:
    """Bias at some texels: float64, squared and relative.

    node          (m,) int32, from find_comparison_nodes
    unbiased      (m,): product of the differences in the two dual buffers, whose noise is independent: an unbiased estimator
    gap           (m,): its absolute value, averaged over the comparison node. It ranks the worst texels, so that leaving them out removes
                  as much noise below zero as above
    noise         (m,): standard error of `unbiased`, fully correlated among the texels of one comparison node
    parent        (m,): bias of the parent of the texel's leaf; nan without a parent, and for leaves of one texel
    grandparent   (m,): bias one level further up; nan also where it is not significant (FAR_OUT)
    """

    node: NDArray[np.int32]
    unbiased: NDArray[np.float64]
    gap: NDArray[np.float64]
    noise: NDArray[np.float64]
    parent: NDArray[np.float64]
    grandparent: NDArray[np.float64]

    def without(self, texels: NDArray[np.bool_]) -> Bias:
        """The bias with 0 at the texels (m,) bool that show other light than the leaves'."""
        unbiased, gap, noise = (np.where(texels, 0.0, part) for part in (self.unbiased, self.gap, self.noise))
        parent, grandparent = (np.where(texels, np.nan, part) for part in (self.parent, self.grandparent))
        return replace(self, unbiased=unbiased, gap=gap, noise=noise, parent=parent, grandparent=grandparent)

    def take(self, rows: NDArray[np.int64], factor: NDArray[np.float64]) -> Bias:
        """The bias at the texels `rows` (k,), its squares scaled by `factor` (k,)."""
        values = (factor * part[rows] for part in (self.unbiased, self.gap, self.noise, self.parent, self.grandparent))
        return Bias(self.node[rows], *values)

    def sum_up(self, best: NDArray[np.intp]) -> tuple[float, float]:
        """The mean over the texels `best` (k,), and its standard error."""
        extrapolated = self._extrapolate(best)
        is_extrapolated = ~np.isnan(extrapolated)
        if not extrapolated[is_extrapolated].sum() > 0.0 or not uses("bias_forecast"):
            is_extrapolated[:] = False
        unbiased, seen2, doubt2 = self._sum_unbiased(best[~is_extrapolated])
        value, square = beyond_noise(unbiased, seen2), doubt2
        if is_extrapolated.any():
            unbiased, _, doubt2 = self._sum_unbiased(best[is_extrapolated])
            found, found2 = _weigh(float(extrapolated[is_extrapolated].sum()), unbiased, doubt2)
            value, square = value + found, square + found2
        return value / len(best), math.sqrt(square) / len(best)

    def _sum_unbiased(self, rows: NDArray[np.intp]) -> tuple[float, float, float]:
        """Over texels `rows`: the sum of the estimates, its squared scatter between comparison nodes, and its squared standard error."""
        # Only the sum is unbiased, and errors of comparison nodes are independent. Shrinkage uses the observed scatter of the nodes' sums,
        # the standard error the expected one, since a few sums may agree by chance.
        seen2, doubt2 = ((np.bincount(self.node[rows], part[rows]) ** 2).sum() for part in (self.unbiased, self.noise))
        return float(self.unbiased[rows].sum()), float(seen2), float(doubt2)

    def _extrapolate(self, best: NDArray[np.intp]) -> NDArray[np.float64]:
        """(k,): extrapolated bias at the texels `best` (k,), of which only the sum is meaningful; nan where there is none."""
        parent, grandparent = self.parent[best], self.grandparent[best]
        deep = ~np.isnan(parent + grandparent)
        above, below = float(grandparent[deep].sum()), float(parent[deep].sum())
        # Leaves without a grandparent's bias use the decay of the others.
        fall = below / above if above > 0.0 and below > 0.0 else math.nan
        extrapolated: NDArray[np.float64] = FALL_GOES_ON * fall * parent
        return extrapolated


def _weigh(extrapolated: float, unbiased: float, doubt2: float) -> tuple[float, float]:
    """Mean of both estimates, weighted by inverse variance, and its squared standard error.

    doubt2   squared standard error of `unbiased`
    """
    is_less = unbiased < extrapolated
    unbiased2, extrapolated2 = doubt2 * (HIDDEN_DOUBT**2 if is_less else 1.0), (FALL_DOUBT * extrapolated) ** 2
    share = unbiased2 / (unbiased2 + extrapolated2) if unbiased2 else 0.0  # weight of the extrapolation; both squares may underflow
    return max(unbiased + share * (extrapolated - unbiased), 0.0), share * extrapolated2


def find_bias(
    tree: Quadtree,
    solution: Solution,
    comparison: refine.Comparison,
    nodes: IntArray,
    sample: NDArray[np.int64],
    asked: AskedLight,
    correction: NDArray[np.float64],
) -> Bias:
    """The bias of the blend of `nodes`, which tile the charts, at the texel entries `sample` (m,).

    asked        the light shown there
    correction   (3,), from variance_estimate.noise_correction
    """
    node = find_comparison_nodes(tree, nodes, sample)
    blind2 = (asked.weight * guess_blind(tree, solution, comparison, nodes)[asked.leaf]).mean(1)
    unbiased = compare_with_nodes(tree, solution, node, asked, correction, blind2)
    parent = np.where(tree.side[asked.leaf] > 1, tree.parent[asked.leaf], -1)  # a leaf of one texel has no bias
    grandparent = np.where(parent >= 0, tree.parent[parent], -1)
    missing = _find_missing_of(comparison, parent), _find_missing_of(comparison, grandparent, FAR_OUT)  # noise would decay differently
    return Bias(node, *unbiased, *((asked.weight * of_nodes).mean(1) for of_nodes in missing))


def find_comparison_nodes(tree: Quadtree, nodes: IntArray, sample: NDArray[np.int64]) -> NDArray[np.int32]:
    """(m,) int32: the comparison node of each texel entry of `sample` (m,): a child of its leaf among `nodes`, or the leaf if it has none.

    Nodes further down have fewer photons, and tens of times the variance of a leaf.
    """
    opened = np.zeros(len(tree), bool)
    opened[nodes] = tree.has_children[nodes]
    found = refine.open_nodes(tree, nodes, opened)
    found = found[np.argsort(tree.start[found])]  # they tile the charts
    place = np.searchsorted(tree.start[found], sample, side="right") - 1
    node: NDArray[np.int32] = found[place].astype(np.int32)
    return node


def compare_with_nodes(
    tree: Quadtree,
    solution: Solution,
    node: NDArray[np.int32],
    asked: AskedLight,
    correction: NDArray[np.float64],
    blind2: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Squared relative difference between the blend and the comparison nodes: `unbiased`, `gap` and `noise` of a Bias.

    node     (m,) int32, from find_comparison_nodes
    blind2   (m,): the estimate for leaves without children
    """
    unbiased = blind2.copy()
    seen = np.maximum(unbiased, 0.0)
    noise = np.abs(blind2)
    rows = np.flatnonzero(node != asked.leaf)
    weight, halves = asked.weight[rows].T, asked.light.irradiance[..., rows]
    below = evaluate_leaf(tree, solution, node[rows], asked.x[rows], asked.y[rows], halves=True)
    gap = np.where(halves.sum(0) > 0.0, halves, 0.0) - below.irradiance  # light below zero is shown as 0
    unbiased[rows] = (weight * gap[0] * gap[1]).mean(0)
    group = node[rows]
    seen[rows] = np.abs(np.bincount(group, unbiased[rows]))[group] / np.bincount(group)[group]
    # Each half has twice the variance of the whole, and over a node the product has as many degrees of freedom as the node has functions.
    # The blend and the comparison node share part of their noise. The blend's weights are near those of least variance, so the covariance
    # is the blend's own variance, and the difference has the variance var(below) - var(blend).
    noise2 = np.maximum(below.variance - asked.light.variance[:, rows], 0.0) * correction[:, None]
    of_half = 2.0 * (weight * noise2).mean(0)
    noise[rows] = of_half / np.sqrt(np.maximum(tree.rank[node[rows]], 1))
    return unbiased, seen, noise


def guess_blind(tree: Quadtree, solution: Solution, comparison: refine.Comparison, nodes: IntArray) -> NDArray[np.float64]:
    """(n, 3) float64, (W/m^2)^2: guess of the mean squared bias of `nodes` (m,) without children, from their parents'; else 0."""
    missing = np.zeros((len(tree), 3))
    blind = nodes[~tree.has_children[nodes] & (tree.side[nodes] > 1) & (tree.parent[nodes] >= 0)]
    # The parent's bias decays by one level, and is scaled down where the node is darker than its parent.
    parent = tree.parent[blind]
    light2, parent2 = (((solution.flux[:, ids] / np.maximum(tree.area[ids], _TINY)) ** 2).sum(0) for ids in (blind, parent))
    share = np.divide(light2, parent2, out=np.zeros(len(blind)), where=parent2 > 0.0)
    missing[blind] = BIAS_DECAY * np.minimum(share, 1.0)[:, None] * np.nan_to_num(np.maximum(_find_missing_of(comparison, parent), 0.0))
    return missing


def _find_missing_of(comparison: refine.Comparison, nodes: IntArray, least_sigmas: float = -math.inf) -> NDArray[np.float64]:
    """(m, 3) float64, (W/m^2)^2: squared bias of `nodes` (m,) from the product of both halves; nan for -1, for nodes that were not compared
    with their children, and where the difference is less significant than least_sigmas.
    """
    row, difference = comparison.rows[0][nodes], comparison.differences[0]
    known = np.flatnonzero((nodes >= 0) & (row >= 0))
    known = known[difference.sigmas[row[known]] >= least_sigmas]
    missing = np.full((len(nodes), 3), np.nan)
    # No expected noise is subtracted: photons are stratified, so they have less, and the subtraction would hide a bias.
    missing[known] = difference.common[row[known]]
    return missing
