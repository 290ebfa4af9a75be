"""Noise of photons: what leaves err by because so few have fallen on them, told from the bake itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..radiosity import shrinkage
from ..radiosity.quadtree import Quadtree
from ..radiosity.tally import Solution
from ..texels.judged import Judged
from ..util.ablation import uses
from ..util.arrays import IntArray
from .missing_light import AskedLight

# The halves of few leaves say little about noise; the prior says "as independent photons" with this many values' weight.
_PRIOR_VALUES = 64.0
_TINY = float(np.finfo(float).tiny)


def noise_correction(tree: Quadtree, solution: Solution, nodes: IntArray) -> NDArray[np.float64]:
    """Variance seen between the halves of the bake over the variance that independent photons would have, (3,) float64: of each channel.

    Light that is reflected more often comes by photons that fall on a leaf more than once.

    nodes   (m,) int, nodes that tile the charts
    """
    if not uses("noise_correction"):
        return np.ones(3)
    area = np.maximum(tree.area[nodes], _TINY)
    seen = ((solution.flux_half[0] - solution.flux_half[1])[:, nodes] / (2.0 * area)) ** 2
    predicted = solution.variance[:, nodes]
    ratio = np.divide(seen, predicted, out=np.zeros_like(seen), where=predicted > 0.0)
    # Photons of a leaf are few and their powers differ, so single ratios have long tails: weigh leaves by their light.
    weight = np.sqrt(np.maximum(solution.flux[:, nodes], 0.0)) * (predicted > 0.0)
    weight /= np.maximum(weight.max(axis=1, keepdims=True, initial=0.0), _TINY)
    total, squares = weight.sum(axis=1), (weight**2).sum(axis=1)
    effective = np.divide(total**2, squares, out=np.zeros(len(total)), where=squares > 0.0)
    told = np.divide((ratio * weight).sum(axis=1), total, out=np.ones(len(total)), where=total > 0.0)
    prior = _PRIOR_VALUES / len(told)
    out: NDArray[np.float64] = (told * effective + prior) / (effective + prior)
    return out


def find_unseen(judged: Judged, weight: NDArray[np.float32], photon_w: NDArray[np.float64]) -> NDArray[np.float64]:
    """(m,) float64, relative and squared: noise of what came to none of the texels of an object that are asked, but could have.

    Where no photon fell there is no variance to be seen. One more could have come to each object, as likely as not: where many did it is
    next to nothing beside their noise, and in a small house on a wide plain it is what keeps a bake going.

    weight     (m, 3) of AllLight.weigh
    photon_w   (3,), W: that one carries
    """
    unseen2 = np.zeros(len(weight))
    for rows in judged.objects.values() if judged.entry_group is None else judged.groups:
        of_one = photon_w / max(float(judged.area_m2[rows].sum()), _TINY)
        unseen2[rows] = (weight[rows] * of_one**2).mean(1)
    return unseen2


@dataclass
class PhotonNoise:
    """Of photons at some texels, (m,), relative and squared; changed in place as it is found what becomes of it.

    photons2              (m,) float64
    shrunk2               (m,) float64: of it, what was asked to be less as leaves' light is shrunk
    taken, taken_surely   share of that which shrinking takes, and what it takes at least
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
        """Of blended leaves.

        variance_alone   (3, m) float64, (W/m^2)^2: of the leaves themselves
        correction       (3,), of noise_correction
        nodes            (k,) int, that tile the charts
        risk             (k,) float64 of each, of shrinkage.shrink_leaves; None where they are not shrunk
        """
        photons2 = (asked.weight.T * asked.light.variance * correction[:, None]).mean(0)
        if risk is None:
            return cls(photons2, np.zeros(len(photons2)), 0.0, 0.0)
        shrunk2 = shrinkage.find_shrunk_noise(solution, asked.leaf, variance_alone, photons2)
        taken, taken_surely = shrinkage.find_share_taken(asked.leaf, shrunk2, nodes, risk)
        return cls(photons2 - taken * shrunk2, shrunk2, taken, taken_surely)

    def keep(self, share2: float | NDArray[np.float64], rows: IntArray) -> None:
        """So much of it is left at some of the texels."""
        self.photons2[rows] *= share2
        self.shrunk2[rows] *= share2

    def replace(self, photons2: NDArray[np.floating[Any]], told: NDArray[np.bool_]) -> None:
        """There is something else in its place at some of the texels, told (m,)."""
        self.photons2[told], self.shrunk2[told] = photons2, 0.0

    def take(self, rows: NDArray[np.int64], factor: NDArray[np.float64]) -> PhotonNoise:
        """That at some of the texels, (k,), relative to what gives these squared errors a factor, (k,)."""
        return PhotonNoise(self.photons2[rows] * factor, self.shrunk2[rows] * factor, self.taken, self.taken_surely)

    def find_doubt2(self, best: NDArray[np.int64]) -> float:
        """Mean, over the texels `best`, of what shrinking may not have taken."""
        return (self.taken - self.taken_surely) * float(self.shrunk2[best].mean())
