"""Light that leaves cannot hold, squared and relative to local brightness: told by their children, foretold by the nodes above them.

The children's word is right in sum, but few leaves tell it roughly, and the photons that tell it are those that chose the leaves: nodes
whose children differed little by chance stayed whole. What nodes one and two levels up could not hold stands far out of noise, and how it
falls from level to level foretells the leaves' own. Both words are sums over all leaves; each counts by how sure it is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..radiosity import refine
from ..radiosity.quadtree import Quadtree
from ..radiosity.shrinkage import beyond_noise
from ..radiosity.tally import Solution
from ..util.ablation import uses
from ..util.arrays import IntArray
from .reconstruct import PointLight, evaluate_leaf

# Squared light that a node cannot hold, over what its parent could not: 1/2 along edges, 1/16 where light is smooth.
BIAS_DECAY = 0.25
# A leaf misses so much of what its parent does, in times what the parent missed of its own parent's: in the closed forms, where light is
# smooth and falls the faster the finer leaves are. And how far off, relative, is what that foretells in sum.
FALL_GOES_ON, FALL_DOUBT = 0.5, 0.5
# What children tell is taken for as much less sure where it is less than foretold, for the choice of leaves hides some of it.
HIDDEN_DOUBT = 2.0
# Standard deviations of noise by which a grandparent's children must differ to tell how it falls: of even light that was split by chance
# they differ by three to five.
FAR_OUT = 10.0
_TINY = float(np.finfo(float).tiny)


@dataclass(frozen=True)
class AskedLight:
    """Light of leaves at some texels, blended, as it is asked for its error.

    leaf     (m,) int32
    x, y     (m,) float64, page texels
    light    with its halves
    weight   (m, 3) float32: what makes squared light relative
    """

    leaf: NDArray[np.int32]
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    light: PointLight
    weight: NDArray[np.float32]


@dataclass(frozen=True)
class Bias:
    """What is missing at some texels: float64, squared and relative.

    judge         (m,) int32, of find_judges
    told          (m,): a product of what each half of the bake says alone, whose noise is independent, and so right in sum
    gap           (m,): how far that is from zero, noise and all: who leaves out the worst by it leaves out as much noise below zero as
                  above
    noise         (m,): a standard error of `told`, by which all texels of a judge are off together
    parent        (m,): what the parent of the texel's leaf could not hold; nan where there is none, and of leaves of one texel
    grandparent   (m,): the same, one level up; nan also where it hardly stands out of noise
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

    def take(self, rows: NDArray[np.int64], factor: NDArray[np.float64]) -> Bias:
        """That at some of the texels, (k,), relative to what gives these squared errors a factor, (k,)."""
        values = (factor * part[rows] for part in (self.told, self.gap, self.noise, self.parent, self.grandparent))
        return Bias(self.judge[rows], *values)

    def sum_up(self, best: NDArray[np.intp]) -> tuple[float, float]:
        """The mean over the texels `best` (k,), and its standard error."""
        likely = self._foretell(best)
        foretold = ~np.isnan(likely)
        if not likely[foretold].sum() > 0.0 or not uses("bias_forecast"):
            foretold[:] = False
        told, seen2, doubt2 = self._tell(best[~foretold])
        value, square = beyond_noise(told, seen2), doubt2
        if foretold.any():
            told, _, doubt2 = self._tell(best[foretold])
            found, found2 = _weigh(float(likely[foretold].sum()), told, doubt2)
            value, square = value + found, square + found2
        return value / len(best), math.sqrt(square) / len(best)

    def _tell(self, rows: NDArray[np.intp]) -> tuple[float, float, float]:
        """What the children say of the texels `rows`: its sum, the squared sums of each judge's word, and what noise makes of these."""
        # It is told only in sum, by judges that err apart. How far apart was seen says how much of it is sure; what may be missing
        # is told by what could be expected, for few may agree by chance.
        seen2, doubt2 = ((np.bincount(self.judge[rows], part[rows]) ** 2).sum() for part in (self.told, self.noise))
        return float(self.told[rows].sum()), float(seen2), float(doubt2)

    def _foretell(self, best: NDArray[np.intp]) -> NDArray[np.float64]:
        """(k,): what is likely to be missing at the texels `best` (k,), right in sum; nan where nothing is foretold."""
        parent, grandparent = self.parent[best], self.grandparent[best]
        deep = ~np.isnan(parent + grandparent)
        above, below = float(grandparent[deep].sum()), float(parent[deep].sum())
        # Of leaves that are not so deep it is foretold too, by how it falls elsewhere.
        fall = below / above if above > 0.0 and below > 0.0 else math.nan
        likely: NDArray[np.float64] = FALL_GOES_ON * fall * parent
        return likely


def _weigh(likely: float, told: float, doubt2: float) -> tuple[float, float]:
    """What is foretold and told of the same, together, and the square of how far that may be off.

    doubt2   squared standard error of `told`
    """
    is_less = told < likely
    told2, foretold2 = doubt2 * (HIDDEN_DOUBT**2 if is_less else 1.0), (FALL_DOUBT * likely) ** 2
    share = told2 / (told2 + foretold2) if told2 else 0.0  # of what is foretold; both could be too small to be squared
    return max(told + share * (likely - told), 0.0), share * foretold2


def find_bias(
    tree: Quadtree,
    solution: Solution,
    comparison: refine.Comparison,
    nodes: IntArray,
    sample: NDArray[np.int64],
    asked: AskedLight,
    correction: NDArray[np.float64],
) -> Bias:
    """What the blend of `nodes`, which tile the charts, misses at the texel entries `sample` (m,).

    asked        what they show there
    correction   (3,), of photon_noise.noise_correction
    """
    judge = find_judges(tree, nodes, sample)
    blind2 = (asked.weight * guess_blind(tree, solution, comparison, nodes)[asked.leaf]).mean(1)
    told = compare_with_judges(tree, solution, judge, asked, correction, blind2)
    parent = np.where(tree.side[asked.leaf] > 1, tree.parent[asked.leaf], -1)  # a texel is all that a leaf could be asked to hold
    grandparent = np.where(parent >= 0, tree.parent[parent], -1)
    missing = _find_missing_of(comparison, parent), _find_missing_of(comparison, grandparent, FAR_OUT)  # how noise falls foretells nothing
    return Bias(judge, *told, *((asked.weight * of_nodes).mean(1) for of_nodes in missing))


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
    judge: NDArray[np.int32],
    asked: AskedLight,
    correction: NDArray[np.float64],
    blind2: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Squared relative difference between the blend and the nodes that judge it: `told`, `gap` and `noise` of a Bias.

    judge    (m,) int32, of find_judges
    blind2   (m,): what is told where there are no nodes below
    """
    unbiased = blind2.copy()
    seen = np.maximum(unbiased, 0.0)
    noise = np.abs(blind2)
    told = np.flatnonzero(judge != asked.leaf)
    weight, halves = asked.weight[told].T, asked.light.irradiance[..., told]
    below = evaluate_leaf(tree, solution, judge[told], asked.x[told], asked.y[told], halves=True)
    gap = np.where(halves.sum(0) > 0.0, halves, 0.0) - below.irradiance  # what dips below zero is shown as dark
    unbiased[told] = (weight * gap[0] * gap[1]).mean(0)
    group = judge[told]
    seen[told] = np.abs(np.bincount(group, unbiased[told]))[group] / np.bincount(group)[group]
    # Either half has twice the variance of both; over a node a product has as many independent parts as the node has functions.
    # A mean that weighs its parts well shares as much of each one's noise as it has itself, so that this is not seen between them.
    noise2 = np.maximum(below.variance - asked.light.variance[:, told], 0.0) * correction[:, None]
    of_half = 2.0 * (weight * noise2).mean(0)
    noise[told] = of_half / np.sqrt(np.maximum(tree.rank[judge[told]], 1))
    return unbiased, seen, noise


def guess_blind(tree: Quadtree, solution: Solution, comparison: refine.Comparison, nodes: IntArray) -> NDArray[np.float64]:
    """(n, 3) float64, (W/m^2)^2: mean square that those of the `nodes` (m,) cannot hold which have no previews yet; 0 of all others."""
    missing = np.zeros((len(tree), 3))
    blind = nodes[~tree.has_children[nodes] & (tree.side[nodes] > 1) & (tree.parent[nodes] >= 0)]
    # What their parents could not hold tells, and dark ones have less of it.
    parent = tree.parent[blind]
    light2, parent2 = (((solution.flux[:, ids] / np.maximum(tree.area[ids], _TINY)) ** 2).sum(0) for ids in (blind, parent))
    share = np.divide(light2, parent2, out=np.zeros(len(blind)), where=parent2 > 0.0)
    missing[blind] = BIAS_DECAY * np.minimum(share, 1.0)[:, None] * np.nan_to_num(np.maximum(_find_missing_of(comparison, parent), 0.0))
    return missing


def _find_missing_of(comparison: refine.Comparison, nodes: IntArray, least_sigmas: float = -math.inf) -> NDArray[np.float64]:
    """(m, 3) float64, (W/m^2)^2: what `nodes` (m,) cannot hold, as both halves see it.

    least_sigmas   nan of those that stand out of noise by less, of those that were not compared with their children, and of -1
    """
    row, difference = comparison.rows[0][nodes], comparison.differences[0]
    known = np.flatnonzero((nodes >= 0) & (row >= 0))
    known = known[difference.sigmas[row[known]] >= least_sigmas]
    missing = np.full((len(nodes), 3), np.nan)
    # Not the excess: photons spread more evenly than chance would spread them, and the noise that their number tells would hide a bias.
    missing[known] = difference.common[row[known]]
    return missing
