"""Light that leaves cannot hold, squared and relative to local brightness: told by their children, foretold by the nodes above them.

The children's word is right in sum, but few leaves tell it roughly, and the photons that tell it are those that chose the leaves: nodes
whose children differed little by chance stayed whole. What nodes one and two levels up could not hold is sure, for they were opened
because it stood out of noise; how it falls from level to level foretells the leaves' own. Each counts by how sure it is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from . import refine
from .quadtree import Quadtree
from .reconstruct import LeafBlender, PointLight, evaluate_leaf
from .scene import IntArray
from .tally import Solution, Totals

# Squared light that a node cannot hold, over what its parent could not: 1/2 along edges, 1/16 where light is smooth.
BIAS_DECAY = 0.25
# From the level above the leaves it falls by more than up to there: by so many times as much in the closed forms, within a half either way.
FALL_GOES_ON, FALL_DOUBT = 0.5, 0.5
# What children tell is taken for as much less sure where it is less than foretold, for the choice of leaves hides some of it.
HIDDEN_DOUBT = 2.0
_TINY = float(np.finfo(float).tiny)


@dataclass(frozen=True)
class Bias:
    """What is missing at some texels: float64, squared and relative.

    judge         (m,) int32, of find_judges
    told          (m,): a product of what each half of the bake says alone, whose noise is independent, and so right in sum
    gap           (m,): how far that is from zero, noise and all: who leaves out the worst by it leaves out as much noise below zero as
                  above
    noise         (m,): a standard error of `told`, by which all texels of a judge are off together
    parent        (m,): what the parent of the texel's leaf could not hold; nan where there is none
    grandparent   (m,): the same, one level up
    """

    judge: NDArray[np.int32]
    told: NDArray[np.float64]
    gap: NDArray[np.float64]
    noise: NDArray[np.float64]
    parent: NDArray[np.float64]
    grandparent: NDArray[np.float64]

    def without(self, texels: NDArray[np.bool_]) -> Bias:
        """As it is where some texels (m,) show light that is not the leaves'."""
        told, gap, noise = (np.where(texels, 0.0, part) for part in (self.told, self.gap, self.noise))
        parent, grandparent = (np.where(texels, np.nan, part) for part in (self.parent, self.grandparent))
        return replace(self, told=told, gap=gap, noise=noise, parent=parent, grandparent=grandparent)

    def sum_up(self, best: NDArray[np.intp]) -> tuple[float, float]:
        """The mean over the texels `best` (k,), and its standard error."""
        likely = self._foretell(best)
        foretold = ~np.isnan(self.parent[best]) & (likely > 0.0)
        by_word, seen, doubt = self._tell(best, ~foretold)
        value, variance = _beyond_noise(by_word, seen), doubt
        if likely:
            told, _, noise = self._tell(best, foretold)
            noise *= HIDDEN_DOUBT**2 if told < likely else 1.0
            sure = noise / (noise + (FALL_DOUBT * likely) ** 2)
            value += max(told + sure * (likely - told), 0.0)
            variance += sure * (FALL_DOUBT * likely) ** 2
        return value, float(np.sqrt(variance))

    def _tell(self, best: NDArray[np.intp], which: NDArray[np.bool_]) -> tuple[float, float, float]:
        """What the children say of `which` (k,) of the texels, the sum of what each judge says squared, and what noise makes of that."""
        rows = best[which]
        # It is told only in sum, by judges that err apart. How far apart was seen says how much of it is sure; what may be missing
        # is told by what could be expected, for few may agree by chance.
        seen, expected = ((np.bincount(self.judge[rows], part[rows]) ** 2).sum() / len(best) ** 2 for part in (self.told, self.noise))
        return float(self.told[rows].sum()) / len(best), float(seen), float(expected)

    def _foretell(self, best: NDArray[np.intp]) -> float:
        """Mean over `best` of what leaves with a parent are likely to miss; 0 where no leaf is deep enough to tell how it falls."""
        parent, grandparent = self.parent[best], self.grandparent[best]
        deep = ~np.isnan(grandparent)
        above, below = float(grandparent[deep].sum()), float(parent[deep].sum())
        likely = FALL_GOES_ON * float(np.nansum(parent)) / len(best)
        return likely * below / above if min(likely, below, above) > 0.0 else 0.0


def _beyond_noise(value: float, variance: float) -> float:
    """What is sure of a number that cannot be negative: below zero it is noise, which must not hide other noise, and the more so above.

    Source: James & Stein 1961, the positive part
    """
    return max(value - variance / value, 0.0) if value > 0.0 else 0.0


def find_bias(
    tree: Quadtree,
    totals: Totals,
    solution: Solution,
    comparison: refine.Comparison,
    nodes: IntArray,
    leaf: NDArray[np.int32],
    sample: NDArray[np.int64],
    blender: LeafBlender,
    shown: PointLight,
    correction: NDArray[np.float64],
    weight: NDArray[np.float32],
) -> Bias:
    """What the blend of `nodes`, which tile the charts, misses at the texels `sample` (m,).

    leaf         (m,) int32, of `nodes`, at the sample
    shown        light there, with its halves
    correction   (3,), of estimate.noise_correction
    weight       (m, 3): what makes squared light relative
    """
    judge, every = find_judges(tree, nodes, sample), weight.mean(1)
    blind2 = every * find_missing(tree, totals, solution, comparison, nodes)[leaf]
    told = compare_with_judges(tree, solution, leaf, judge, sample, blender, shown, correction, weight, blind2)
    parent = tree.parent[leaf]
    grandparent = np.where(parent >= 0, tree.parent[parent], -1)
    above = (every * _find_missing_of(comparison, up) for up in (parent, grandparent))
    return Bias(judge, *told, *above)


def find_judges(tree: Quadtree, nodes: IntArray, sample: NDArray[np.int64]) -> NDArray[np.int32]:
    """(m,) int32: the node that judges the light at each texel of `sample` (m,): a child of its leaf of `nodes`, where that has any.

    What the fewer photons of nodes deeper down tell drowns in noise, tens of times the variance of a leaf's own.
    """
    opened = np.zeros(len(tree), bool)
    opened[nodes] = tree.has_children[nodes]
    judges = refine.open_nodes(tree, nodes, opened)
    judges = judges[np.argsort(tree.start[judges])]  # they tile the charts
    place = np.searchsorted(tree.start[judges], sample, side="right") - 1
    judge: NDArray[np.int32] = judges[place].astype(np.int32)
    return judge


def compare_with_judges(
    tree: Quadtree,
    solution: Solution,
    leaf: NDArray[np.int32],
    judge: NDArray[np.int32],
    sample: NDArray[np.int64],
    blender: LeafBlender,
    shown: PointLight,
    correction: NDArray[np.float64],
    weight: NDArray[np.float32],
    blind2: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Squared relative difference between the blend and the nodes that judge it: `told`, `gap` and `noise` of a Bias.

    judge    (m,) int32, of find_judges
    blind2   (m,): what is told where there are no nodes below
    """
    unbiased = blind2.copy()
    seen = np.maximum(unbiased, 0.0)
    noise = np.abs(blind2)
    told = np.flatnonzero(judge != leaf)
    entry = sample[told]
    x, y = blender.texels.own_points_at(entry)
    below = evaluate_leaf(tree, solution, judge[told], x, y, halves=True)
    halves = shown.irradiance[..., told]
    gap = np.where(halves.sum(0) > 0.0, halves, 0.0) - below.irradiance  # what dips below zero is shown as dark
    unbiased[told] = (weight[told].T * gap[0] * gap[1]).mean(0)
    group, count = np.unique(judge[told], return_inverse=True, return_counts=True)[1:]
    seen[told] = np.abs(np.bincount(group, unbiased[told]) / count)[group]
    # Either half has twice the variance of both; over a node a product has as many independent parts as the node has functions.
    # A mean that weighs its parts well shares as much of each one's noise as it has itself, so that this is not seen between them.
    noise2 = np.maximum(below.variance - shown.variance[:, told], 0.0) * correction[:, None]
    of_half = 2.0 * (weight[told].T * noise2).mean(0)
    noise[told] = of_half / np.sqrt(np.maximum(tree.rank[judge[told]], 1))
    return unbiased, seen, noise


def find_missing(tree: Quadtree, totals: Totals, solution: Solution, comparison: refine.Comparison, nodes: IntArray) -> NDArray[np.float64]:
    """(n,) float64, (W/m^2)^2: mean square a channel of light that `nodes` cannot hold, 0 elsewhere; noise can make it negative."""
    missing = np.zeros(len(tree))
    parents = nodes[tree.has_children[nodes] & (totals.shot[nodes] > 0)]
    missing[parents] = _find_missing_of(comparison, parents)
    blind = nodes[~tree.has_children[nodes] & (tree.side[nodes] > 1) & (tree.parent[nodes] >= 0)]
    # No previews yet: what their parents could not hold tells, and dark ones have less of it.
    parent = tree.parent[blind]
    light2, parent2 = (((solution.flux[:, ids] / np.maximum(tree.area[ids], _TINY)) ** 2).sum(0) for ids in (blind, parent))
    share = np.divide(light2, parent2, out=np.zeros(len(blind)), where=parent2 > 0.0)
    missing[blind] = BIAS_DECAY * np.minimum(share, 1.0) * np.nan_to_num(np.maximum(_find_missing_of(comparison, parent), 0.0))
    return missing


def _find_missing_of(comparison: refine.Comparison, nodes: IntArray) -> NDArray[np.float64]:
    """(m,) float64, (W/m^2)^2 a channel: what `nodes` (m,) cannot hold, by their children; nan where these tell nothing, and of node -1."""
    row = np.where(nodes >= 0, comparison.rows[0][nodes], -1)
    # Photons spread more evenly than chance would spread them: less noise than their number tells, which would hide a bias.
    common = np.append(comparison.differences[0].common / 3.0, np.nan)
    found: NDArray[np.float64] = common[row]
    return found
