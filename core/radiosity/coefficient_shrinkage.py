"""Shrinkage of the leaves' coefficients beyond the mean.

The coefficients of each degree above 0 are multiplied by max(0, 1 - E/S), with S their squared norm and E its expectation under noise
alone. This biased estimator has a lower mean squared error than the least-squares fit; the mean is not changed.

Source: James & Stein 1961, positive part, one block of functions for each degree as in Cai 1999 (block thresholding).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..util.arrays import Int64
from . import basis
from .quadtree import Quadtree
from .tally import Totals

_TINY = np.finfo(float).tiny


def shrink_leaves(tree: Quadtree, totals: Totals, leaves: Int64) -> Quadtree:
    """The tree with projectors that shrink the functions of `leaves` (m,) beyond their mean, degree by degree.

    Means and flux are preserved. The result is for tally.solve_tallies only; variances come from the tree without shrinkage.
    """
    raw = totals.raw[..., leaves].sum((0, 1))
    noise = totals.weight2[:, leaves].sum(0) / np.maximum(tree.area[leaves], _TINY)  # per function
    shrunk = lower = np.zeros((len(leaves), *tree.project.shape[1:]))
    rank = np.zeros(len(leaves), np.int64)
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
        share = np.clip(1.0 - noisy, 0.0, 1.0) if degree else np.ones(len(leaves))
        shrunk = shrunk + share[:, None, None] * step
    project = tree.project.copy()
    project[leaves] = shrunk
    return replace(tree, project=project)
