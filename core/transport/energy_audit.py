"""Energy audit and cost of a bake."""

from dataclasses import dataclass, field

import numpy as np

from ..util.arrays import Float64
from .photon_log import ENERGY_NAMES, Counters, EnergyAudit


@dataclass
class Ledger:
    """Sums over all shards. Each photon carries the power of the whole scene, so totals are divided by the number of photons.

    energy_w   for each of ENERGY_NAMES, (3,) float64
    rays       number of photons' rays
    gathered   number of gather rays, also of those whose light is not shown
    """

    energy_w: dict[str, Float64] = field(default_factory=lambda: {name: np.zeros(3) for name in ENERGY_NAMES})
    photons: int = 0
    rays: int = 0
    deposits: int = 0
    gathered: int = 0

    def add(self, photons: int, audit: EnergyAudit, counters: Counters) -> None:
        """Add a shard of `photons` photons."""
        for name in ENERGY_NAMES:
            self.energy_w[name] += getattr(audit, name)
        self.photons += photons
        self.rays += counters.rays
        self.deposits += counters.deposits

    def find_lost(self) -> float:
        """Share of the light that the limit of bounces cuts off, in the channel where it is largest."""
        emitted, left = self.energy_w["emitted"], self.energy_w["remainder"]
        return float(np.divide(left, emitted, out=np.zeros(len(left)), where=emitted > 0.0).max())

    def audit_w(self) -> dict[str, list[float]]:
        """The energy audit, W, by ENERGY_NAMES: emitted = absorbed + escaped + remainder."""
        return {name: (total / max(self.photons, 1)).tolist() for name, total in self.energy_w.items()}
