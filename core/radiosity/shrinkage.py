"""Functions of leaves, shrunk to what their photons bear out.

A leaf's mean is sure before its slope is. Where the slope that was measured is no steeper than noise alone would make it, it says nothing,
and the leaf errs less without it; where it is steeper, it errs least with the share that is not noise.

Source: James & Stein 1961, positive part, one block of functions for each degree as in Cai 1999 (block thresholding).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..util.arrays import IntArray
from . import basis
from .quadtree import Quadtree
from .tally import Solution, Totals

_TINY = np.finfo(float).tiny
# Of how the leaves differ in what shrinking them takes, so many standard errors are held against who stops because the error is small.
_SHRUNK_DOUBT = 2.0


def shrink_leaves(tree: Quadtree, totals: Totals, leaves: NDArray[np.int64]) -> tuple[Quadtree, NDArray[np.float64]]:
    """The tree with projectors that shrink what the functions of `leaves` (m,) have beyond their mean, each degree for itself; and risks.

    The mean stays, and so does all flux. It is for tally.solve_tallies alone. Noise is told by the tree that is not shrunk.
    risk   (m,) float64: squared error that shrinking leaves of the noise beyond the mean; right in sum, for a single leaf
           often beyond [0, 1], since it is read off one noisy slope. Source: Stein 1981, theorem 1
    """
    raw = totals.raw[..., leaves].sum((0, 1))
    noise = totals.weight2[:, leaves].sum(0) / np.maximum(tree.area[leaves], _TINY)  # of one function
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
        told = 1.0 - noisy
        share = np.clip(told, 0.0, 1.0) if degree else np.ones(len(leaves))
        shrunk = shrunk + share[:, None, None] * step
        if degree:
            risk += np.where(told > 0.0, (1.0 + (4.0 / np.maximum(rank - rank_below, 1) - 1.0) * noisy) * expected, energy - expected)
            beyond += expected
    project = tree.project.copy()
    project[leaves] = shrunk
    return replace(tree, project=project), np.divide(risk, beyond, out=np.ones(len(leaves)), where=beyond > 0.0)


def beyond_noise(value: float, variance: float) -> float:
    """What is sure of a number that cannot be negative: below zero it is noise, which must not hide other noise, and the more so above.

    Source: James & Stein 1961, the positive part
    """
    return max(value - variance / value, 0.0) if value > 0.0 else 0.0


def find_shrunk_noise(
    solution: Solution, leaf: NDArray[np.int32], leaf_variance: NDArray[np.float64], noise2: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(m,) float64: the part of texels' squared noise `noise2` (m,) that is not that of their leaves' means.

    leaf            (m,) int32
    leaf_variance   (3, m) float64, (W/m^2)^2: of each alone at the texel, see reconstruct.PointLight
    """
    variance = leaf_variance.sum(0)
    of_mean = np.divide(solution.variance[:, leaf].sum(0), variance, out=np.ones(len(leaf)), where=variance > 0.0)
    beyond: NDArray[np.float64] = np.maximum(1.0 - of_mean, 0.0) * noise2
    return beyond


def find_share_taken(
    leaf: NDArray[np.int32], shrunk2: NDArray[np.float64], nodes: IntArray, risk: NDArray[np.float64]
) -> tuple[float, float]:
    """The share that shrinking leaves takes of the noise `shrunk2` (m,) beyond their means, likely and surely; leaf (m,).

    Single leaves know it too roughly. All together tell it, and by how they differ what of it is sure.
    """
    by_leaf = np.bincount(leaf, shrunk2, int(nodes.max()) + 1)[nodes]
    total: float = max(float(by_leaf.sum()), float(_TINY))
    left = float((by_leaf * risk).sum()) / total
    doubt = float(np.sqrt((by_leaf**2 * (risk - left) ** 2).sum())) / total
    return min(max(1.0 - left, 0.0), 1.0), min(max(1.0 - left - _SHRUNK_DOUBT * doubt, 0.0), 1.0)
