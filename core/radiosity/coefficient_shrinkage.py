"""Shrinkage of the leaves' coefficients beyond the mean.

The coefficients of each degree above 0 are multiplied by max(0, 1 - E/S), with S their squared norm and E its expectation under noise
alone. This biased estimator has a lower mean squared error than the least-squares fit; the mean is not changed.

Source: James & Stein 1961, positive part, one block of functions for each degree as in Cai 1999 (block thresholding).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..util.arrays import Float64, Int32, Int64, IntArray
from . import basis
from .quadtree import Quadtree
from .tally import Solution, Totals

_TINY = np.finfo(float).tiny
# Number of standard errors by which the lower bound of the noise reduction is below its estimate, for the stopping rule.
_SHRUNK_DOUBT = 2.0


def shrink_leaves(tree: Quadtree, totals: Totals, leaves: Int64) -> tuple[Quadtree, Float64]:
    """The tree with projectors that shrink the functions of `leaves` (m,) beyond their mean, degree by degree; and risks.

    Means and flux are preserved. The result is for tally.solve_tallies only; variances come from the tree without shrinkage.
    risk   (m,) float64: Stein's unbiased estimate of the squared error after shrinkage, relative to the noise beyond the mean before it.
           Only sums over leaves are accurate; a single value is often outside of [0, 1]. Source: Stein 1981, theorem 1
    """
    raw = totals.raw[..., leaves].sum((0, 1))
    noise = totals.weight2[:, leaves].sum(0) / np.maximum(tree.area[leaves], _TINY)  # per function
    shrunk = lower = np.zeros((len(leaves), *tree.project.shape[1:]))
    rank = np.zeros(len(leaves), np.int64)
    risk, beyond = np.zeros((2, len(leaves)))
    for degree in range(tree.degree + 1):
        functions = basis.orthonormal_functions(basis.gram_matrix(tree.moment[leaves], degree))
        size = functions.shape[1]
        up_to = np.zeros_like(lower)
        up_to[:, :size, :size] = basis.projector(functions)
        step, lower = up_to - lower, up_to
        rank_below, rank = rank, functions.any(2).sum(1)
        energy = (raw * basis.apply_matrices(step, raw)).sum((0, 1))
        expected = (rank - rank_below) * noise
        noisy = np.divide(expected, energy, out=np.ones(len(leaves)), where=energy > 0.0)
        signal = 1.0 - noisy
        share = np.clip(signal, 0.0, 1.0) if degree else np.ones(len(leaves))
        shrunk = shrunk + share[:, None, None] * step
        if degree:
            risk += np.where(signal > 0.0, (1.0 + (4.0 / np.maximum(rank - rank_below, 1) - 1.0) * noisy) * expected, energy - expected)
            beyond += expected
    project = tree.project.copy()
    project[leaves] = shrunk
    return replace(tree, project=project), np.divide(risk, beyond, out=np.ones(len(leaves)), where=beyond > 0.0)


def beyond_noise(value: float, variance: float) -> float:
    """Positive-part shrinkage of a noisy value that is known to be non-negative: max(value - variance / value, 0).

    Source: James & Stein 1961
    """
    return max(value - variance / value, 0.0) if value > 0.0 else 0.0


def find_shrunk_noise(solution: Solution, leaf: Int32, leaf_variance: Float64, noise2: Float64) -> Float64:
    """(m,) float64: the part of the texels' variance `noise2` (m,) that comes from coefficients beyond their leaves' means.

    leaf            (m,) int32
    leaf_variance   (3, m) float64, (W/m^2)^2: variance of the leaf alone at the texel, see reconstruct.PointLight
    """
    variance = leaf_variance.sum(0)
    of_mean = np.divide(solution.variance[:, leaf].sum(0), variance, out=np.ones(len(leaf)), where=variance > 0.0)
    return np.maximum(1.0 - of_mean, 0.0) * noise2


def find_share_taken(leaf: Int32, shrunk2: Float64, nodes: IntArray, risk: Float64) -> tuple[float, float]:
    """Share of the variance `shrunk2` (m,) of texels on leaves `leaf` (m,) that shrinkage removes: an estimate and a lower bound.

    Risks of single leaves are noisy, so they are averaged over all leaves; their scatter gives the standard error for the bound.
    """
    by_leaf = np.bincount(leaf, shrunk2, int(nodes.max()) + 1)[nodes]
    total: float = max(float(by_leaf.sum()), float(_TINY))
    left = float((by_leaf * risk).sum()) / total
    doubt = float(np.sqrt((by_leaf**2 * (risk - left) ** 2).sum())) / total
    return min(max(1.0 - left, 0.0), 1.0), min(max(1.0 - left - _SHRUNK_DOUBT * doubt, 0.0), 1.0)
