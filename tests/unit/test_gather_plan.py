"""When it pays to gather, and that it is tried once; what is known of the light of leaves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from leaflight.core.bake.gather_plan import GatherPlan
from leaflight.core.filter import error_estimate
from leaflight.core.transport.energy_audit import Ledger
from leaflight.core.util.settings import Settings

ASKED = Settings(error=0.02)
LEDGER = Ledger(photons=10**6, total_weight=1e6, rays=500_000)
NOISY = error_estimate.StatedError(0.049, 0.05, 0.0, 0.04, 1.0, lambda: np.zeros(0, np.float32), indirect=1.0)


def pays(settings=ASKED, stated=NOISY, ledger=LEDGER, round_=3, n_texel=40_000, tiled=1.0, weight=1.0):
    return GatherPlan(n_texel, tiled).pays(settings, stated, ledger, round_, lambda: weight)


def test_gathering_pays_where_photons_are_far_from_the_error_asked_for():
    assert pays()
    assert not pays(n_texel=4_000_000)  # a page so large takes more rays than photons do
    assert not pays(stated=replace(NOISY, photons=0.014))  # what errs is direct light, or what leaves cannot hold yet


def test_it_pays_where_a_bake_may_not_have_the_photons_that_it_needs():
    """Of a million, which need seven million more at best, if all that errs is noise; on a page that is large enough for photons else."""
    large = {"n_texel": 4_000_000}
    assert not pays(replace(ASKED, max_photons=8_001_000), **large)
    assert pays(replace(ASKED, max_photons=7_999_000), **large)
    assert pays(replace(ASKED, max_photons=8_001_000), ledger=replace(LEDGER, total_weight=2e6), **large)
    assert not pays(replace(ASKED, max_photons=7_999_000, error=0.0195), **large)  # too little is known of what would be gathered


@pytest.mark.parametrize("knobs", [{"gather": False}, {"direct": "photons"}, {"hierarchical": False}, {"max_depth": 3}])
def test_settings_that_leave_all_to_photons(knobs):
    assert not pays(replace(ASKED, **knobs))


def test_a_bake_whose_gathering_took_more_rays_than_photons_were_to_need_goes_back_to_leaves_for_good():
    """Of 21.63 times 500,000 rays, see above."""
    plan = GatherPlan(40_000, 1.0)
    assert plan.pays(ASKED, NOISY, LEDGER, 3, lambda: 1.0)
    assert plan.budget_rays == pytest.approx(21.63 * LEDGER.rays, rel=1e-3)
    assert plan.pays(ASKED, NOISY, replace(LEDGER, gathered=int(0.99 * plan.budget_rays)), 4, lambda: 1.0)
    assert not plan.pays(ASKED, NOISY, replace(LEDGER, gathered=int(1.01 * plan.budget_rays)), 4, lambda: 1.0)
