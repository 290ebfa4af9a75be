"""Rough estimate of indirect light at texels: a reference level for the tolerance of shadow rays.

The error is relative to the sum of direct and indirect light. In a shadow with much indirect light few rays are enough; relative to the
little direct light there, the same tolerance would take more rays than anywhere else.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..radiosity.quadtree import Quadtree, spread_over_texels
from ..radiosity.tally import Solution
from ..util.arrays import IntArray
from ..util.brightness import weigh_channels
from ..util.coverage import as_slice

_TINY = 1e-30  # m^2
# Share of a leaf's light that is taken for granted: a leaf of the first round may be as wide as its chart, and be darker in a corner.
# Measured on the samples at 1024^2 and 5 %: rays from texels fall by 8 % (instances) to 30 % (cornell_box), and errors stay.
_SURE_SHARE = 0.5


@dataclass(frozen=True)
class ReferenceLevel:
    """level   (n,) float32, W/m^2, at the texel entries: a cautious estimate of the light there, weighted over the channels"""

    level: NDArray[np.float32]

    @classmethod
    def of_leaves(cls, tree: Quadtree, solution: Solution, leaves: IntArray) -> ReferenceLevel:
        """Estimate it from photons, without direct light; `leaves` tile the charts."""
        irradiance = solution.flux[:, leaves] / np.maximum(tree.area[leaves], _TINY)
        level = (_SURE_SHARE * weigh_channels(np.maximum(irradiance.T, 0.0))).astype(np.float32)
        return cls(spread_over_texels(tree, leaves, level, "level"))

    def at(self, entry: IntArray) -> NDArray[np.float32]:
        """(m,) float32, W/m^2: level at the texel entries (m,), ascending."""
        return self.level[as_slice(entry)]
