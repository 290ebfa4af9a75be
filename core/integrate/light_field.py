"""The light that a bake has found, from solve or direct_only, for pages and previews."""

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

    solution       light of the leaves and of the nodes above them
    leaves         (m,) int64: the nodes to show
    received       (n_node,) int64: number of photons received by each node
    correction     (3,) float64: factors of the leaves' variance, from variance_estimate.noise_correction
    direct         direct light by shadow rays
    error          estimated relative error
    squares        tallies on texels at contacts; None without photons
    gathered       indirect light by gather rays, at texels whose rays met all that sends it; None where leaves hold all indirect light
    neighbours     neighbours of the leaves, once computed
    few            leaves shrunk towards their surroundings; None if there are none
    object_error   relative error of each object, by its index; objects with too few sampled texels are left out
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
