"""The light of a bake, as solve or direct_only leave it for pages and previews."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..filter.neighbours import Neighbours
from ..filter.subtexel_tally import SubtexelLight
from ..radiosity.quadtree import Quadtree
from ..radiosity.spatial_shrinkage import SpatialShrinkage
from ..radiosity.tally import Solution
from ..transport.energy_audit import Ledger
from .direct_field import DirectField
from .gathered import GatheredField


@dataclass(frozen=True)
class LightField:
    """The light of a bake, before it becomes pages.

    solution       of the leaves and what is above them
    leaves         (m,) int64: the nodes to show
    correction     (3,) float64, of the leaves' variance, see estimate
    squares        tallies on texels at contacts; None without photons
    neighbours     of the leaves, once computed
    few            leaves shrunk towards their surroundings; None where none are
    gathered       indirect light by rays from texels, where they met all that sends it; None where leaves hold all of it
    object_error   of each object by its index, relative to its own brightness; without objects of too few sampled texels
    stopped_by     "error", "max_photons", "max_rays", "time_limit" or "interrupted"
    """

    tree: Quadtree
    solution: Solution
    leaves: NDArray[np.int64]
    received: NDArray[np.int64]
    correction: NDArray[np.float64]
    direct: DirectField
    error: float
    photons: int
    rounds: int
    stopped_by: str
    ledger: Ledger
    squares: SubtexelLight | None = None
    gathered: GatheredField | None = None
    neighbours: Neighbours | None = None
    few: SpatialShrinkage | None = None
    object_error: dict[int, float] = field(default_factory=dict)
