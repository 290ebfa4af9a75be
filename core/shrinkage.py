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


def shrink_leaves(tree: Quadtree, totals: Totals, leaves: NDArray[np.int64]) -> Quadtree:
    """The tree with projectors that shrink what the functions of `leaves` (m,) have beyond their mean, each degree for itself.

    The mean stays, and so does all flux. It is for tally.solve_tallies alone. The stated error asks for the noise of functions that are not
    shrunk: the share of it that is shown is read off one noisy slope, and stated too little where that came out small by chance.
    """
    raw = totals.raw[..., leaves].sum((0, 1))
    noise = totals.weight2[:, leaves].sum(0) / np.maximum(tree.area[leaves], _TINY)  # of one function
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
        told = 1.0 - np.divide((rank - rank_below) * noise, energy, out=np.ones(len(leaves)), where=energy > 0.0)
        share = np.clip(told, 0.0, 1.0) if degree else np.ones(len(leaves))
        shrunk = shrunk + share[:, None, None] * step
    project = tree.project.copy()
    project[leaves] = shrunk
    return replace(tree, project=project)
