"""The light that a bake has found, from solve or direct_only, for pages and previews."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..radiosity.quadtree import Quadtree
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
    direct         direct light by shadow rays
    error          estimated relative error
    gathered       indirect light by gather rays at all texels; None where leaves show it
    object_error   relative error of each object, by its index; objects with too few sampled texels are left out
    stopped_by     "error", "max_photons", "max_rays", "time_limit" or "interrupted"
    """

    tree: Quadtree
    solution: Solution
    leaves: NDArray[np.int64]
    received: NDArray[np.int64]
    direct: DirectField
    error: float
    photons: int
    rounds: int
    stopped_by: str
    ledger: Ledger
    gathered: GatheredField | None = None
    object_error: dict[int, float] = field(default_factory=dict)

    @property
    def has_direct_photons(self) -> bool:
        """Whether photons carried direct light, from lamps or by mirrors and glass."""
        return bool(self.solution.coefficient[0].any())
