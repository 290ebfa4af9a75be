"""Functions of leaves, shrunk to what their photons bear out.

A leaf's mean is sure before its slope is. Where the slope that was measured is no steeper than noise alone would make it, it says nothing,
and the leaf errs less without it; where it is steeper, it errs least with the share that is not noise.

Source: James & Stein 1961, positive part, one block of functions for each degree as in Cai 1999 (block thresholding).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from . import basis
from .quadtree import Quadtree
from .tally import Totals

_TINY = np.finfo(float).tiny


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
