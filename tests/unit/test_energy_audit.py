"""Sums of shards."""

import numpy as np
from leaflight.core.transport.energy_audit import ENERGY_NAMES, Ledger
from leaflight.core.transport.photon_log import Counters, EnergyAudit


def make_shard(photons):
    """A shard whose photons bring 2 W each of red light to where nothing reflects, and what came of it."""
    watts = np.array([2.0, 0.0, 0.0]) * photons
    return photons, EnergyAudit(watts, watts, *np.zeros((5, 3))), Counters(photons, 3 * photons, photons)


def test_watts_do_not_depend_on_how_many_photons_there_were():
    ledger = Ledger()
    assert ledger.audit_w() == {name: [0.0] * 3 for name in ENERGY_NAMES}
    for photons in (100, 50):
        ledger.add(*make_shard(photons))
    assert ledger.audit_w() == {
        "emitted": [2.0, 0.0, 0.0],
        "absorbed": [2.0, 0.0, 0.0],
        "escaped": [0.0] * 3,
        "remainder": [0.0] * 3,
        "passed": [0.0] * 3,
        "mirrored": [0.0] * 3,
        "refracted": [0.0] * 3,
    }
    assert (ledger.photons, ledger.rays, ledger.deposits) == (150, 450, 150)
