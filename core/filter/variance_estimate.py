"""Variance of the photons on leaves, estimated from the bake itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..radiosity import coefficient_shrinkage
from ..radiosity.quadtree import Quadtree
from ..radiosity.tally import Solution
from ..texels.error_metric import ErrorMetric
from ..util.ablation import uses
from ..util.arrays import IntArray
from .bias_estimate import AskedLight

# Weight, in values, of the prior: a ratio of 1, that of independent photons. The ratios of few leaves have a high variance.
_PRIOR_VALUES = 64.0
_TINY = float(np.finfo(float).tiny)


def noise_correction(tree: Quadtree, solution: Solution, nodes: IntArray) -> NDArray[np.float64]:
    """(3,) float64: ratio of the variance between the dual buffers to that of independent photons, for each channel.

    It exceeds 1 in light of many bounces, where one photon's path deposits on a leaf more than once.

    nodes   (m,) int, nodes that tile the charts
    """
    if not uses("noise_correction"):
        return np.ones(3)
    area = np.maximum(tree.area[nodes], _TINY)
    seen = ((solution.flux_half[0] - solution.flux_half[1])[:, nodes] / (2.0 * area)) ** 2
    predicted = solution.variance[:, nodes]
    ratio = np.divide(seen, predicted, out=np.zeros_like(seen), where=predicted > 0.0)
    # Leaves have few photons of unequal power, so their ratios have long tails; leaves are weighted by the root of their light.
    weight = np.sqrt(np.maximum(solution.flux[:, nodes], 0.0)) * (predicted > 0.0)
    weight /= np.maximum(weight.max(axis=1, keepdims=True, initial=0.0), _TINY)
    total, squares = weight.sum(axis=1), (weight**2).sum(axis=1)
    effective = np.divide(total**2, squares, out=np.zeros(len(total)), where=squares > 0.0)
    measured = np.divide((ratio * weight).sum(axis=1), total, out=np.ones(len(total)), where=total > 0.0)
    prior = _PRIOR_VALUES / len(measured)
    out: NDArray[np.float64] = (measured * effective + prior) / (effective + prior)
    return out


def find_unseen(metric: ErrorMetric, weight: NDArray[np.float32], photon_w: NDArray[np.float64]) -> NDArray[np.float64]:
    """(m,) float64, relative and squared: bound of the light that could have missed an object altogether, one photon for each object.

    Without photons the sample variance is zero. The bound is negligible beside the noise of many photons, but keeps the bake of a small
    house on a wide plain from stopping too soon.

    weight     (m, 3), from ReferenceLight.weigh
    photon_w   (3,), W: power of one photon
    """
    unseen2 = np.zeros(len(weight))
    for rows in metric.objects.values() if metric.entry_group is None else metric.groups:
        of_one = photon_w / max(float(metric.area_m2[rows].sum()), _TINY)
        unseen2[rows] = (weight[rows] * of_one**2).mean(1)
    return unseen2


@dataclass
class PhotonNoise:
    """Relative variance of photons at texels (m,); later corrections change it in place.

    photons2              (m,) float64
    shrunk2               (m,) float64: part of it that coefficient shrinkage reduces
    taken, taken_surely   share of shrunk2 that shrinkage removes: its estimate and its lower bound
    """

    photons2: NDArray[np.float64]
    shrunk2: NDArray[np.float64]
    taken: float
    taken_surely: float

    @classmethod
    def of(
        cls,
        solution: Solution,
        asked: AskedLight,
        variance_alone: NDArray[np.float64],
        correction: NDArray[np.float64],
        nodes: IntArray,
        risk: NDArray[np.float64] | None,
    ) -> PhotonNoise:
        """Variance of blended leaves.

        variance_alone   (3, m) float64, (W/m^2)^2: of the leaves without blending
        correction       (3,), of noise_correction
        nodes            (k,) int, leaves that tile the charts
        risk             (k,) float64 of each leaf, of coefficient_shrinkage.shrink_leaves; None where they are not shrunk
        """
        photons2 = (asked.weight.T * asked.light.variance * correction[:, None]).mean(0)
        if risk is None:
            return cls(photons2, np.zeros(len(photons2)), 0.0, 0.0)
        shrunk2 = coefficient_shrinkage.find_shrunk_noise(solution, asked.leaf, variance_alone, photons2)
        taken, taken_surely = coefficient_shrinkage.find_share_taken(asked.leaf, shrunk2, nodes, risk)
        return cls(photons2 - taken * shrunk2, shrunk2, taken, taken_surely)

    def keep(self, share2: float | NDArray[np.float64], rows: IntArray) -> None:
        """Scale the noise at the texels `rows` by `share2`."""
        self.photons2[rows] *= share2
        self.shrunk2[rows] *= share2

    def replace(self, photons2: NDArray[np.floating[Any]], rows: NDArray[np.bool_]) -> None:
        """Set the noise at the texels `rows` (m,) bool, where other light is shown."""
        self.photons2[rows], self.shrunk2[rows] = photons2, 0.0

    def take(self, rows: NDArray[np.int64], factor: NDArray[np.float64]) -> PhotonNoise:
        """The noise at the texels `rows` (k,), its squares scaled by `factor` (k,)."""
        return PhotonNoise(self.photons2[rows] * factor, self.shrunk2[rows] * factor, self.taken, self.taken_surely)

    def find_doubt2(self, best: NDArray[np.int64]) -> float:
        """Mean over the texels `best` of the noise between the estimate and the lower bound of what shrinkage removes."""
        return (self.taken - self.taken_surely) * float(self.shrunk2[best].mean())
