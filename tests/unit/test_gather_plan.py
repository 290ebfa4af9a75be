"""When it pays to gather, and that it is tried once; what is known of the light of leaves."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from boxes import lamp_scene, make_solver
from leaflight.core.bake.gather_plan import GatherPlan
from leaflight.core.filter import error_estimate
from leaflight.core.integrate.gathered import GatheredField
from leaflight.core.texels.tiles import Tiles
from leaflight.core.transport.energy_audit import Ledger
from leaflight.core.util.settings import Settings

ASKED = Settings(error=0.02)
LEDGER = Ledger(photons=10**6, told=1e6, rays=500_000)
NOISY = error_estimate.StatedError(0.049, 0.05, 0.0, 0.04, 1.0, lambda: np.zeros(0, np.float32), indirect=1.0)


def pays(settings=ASKED, stated=NOISY, ledger=LEDGER, round_=3, n_texel=40_000, tiled=1.0, weight=1.0):
    return GatherPlan(n_texel, tiled).pays(settings, stated, ledger, round_, lambda: weight)


def test_gathering_pays_where_photons_are_far_from_the_error_asked_for():
    assert pays()
    assert not pays(n_texel=4_000_000)  # a page so large takes more rays than photons do
    assert not pays(stated=replace(NOISY, photons=0.014))  # what errs is direct light, or what leaves cannot hold yet


def test_photons_are_held_to_need_what_their_share_of_the_error_says():
    """Noise with half of it that leaves miss is to fall, squared, from 1.5 * 0.04^2 to 3 / 4 of 0.02^2, by refining trees of linear
    functions: 22.63 times as many rays, 21.63 more, for 12 + 0.45 / 0.02 a texel."""
    assert pays(n_texel=313_400)
    assert not pays(n_texel=313_600)
    assert pays(replace(ASKED, basis="constant"), n_texel=1_600_000)


def test_photons_that_are_guided_tell_more_each():
    """A fifth of them is enough then; of those so far, which told as much as twice as many would, half were guided already."""
    assert pays(weight=5.0, n_texel=313_400 // 5)
    assert not pays(weight=5.0, n_texel=313_600 // 5 + 1)
    told_more = replace(LEDGER, told=2e6)
    assert pays(ledger=told_more, n_texel=2 * 313_400)
    assert not pays(ledger=told_more, n_texel=2 * 313_600)


def test_less_indirect_light_is_gathered_by_fewer_rays():
    some = replace(NOISY, indirect=0.25)
    assert pays(stated=some, n_texel=4 * 313_400)
    assert not pays(stated=some, n_texel=4 * 313_600)


def test_light_that_is_gathered_is_known_well_enough():
    assert pays(replace(ASKED, error=0.0197))
    assert not pays(replace(ASKED, error=0.0195))  # a 2.5th of what all light errs by so far


def test_it_pays_where_a_bake_may_not_have_the_photons_that_it_needs():
    """Of a million, which need seven million more at best, if all that errs is noise; on a page that is large enough for photons else."""
    large = {"n_texel": 4_000_000}
    assert not pays(replace(ASKED, max_photons=8_001_000), **large)
    assert pays(replace(ASKED, max_photons=7_999_000), **large)
    assert pays(replace(ASKED, max_photons=8_001_000), ledger=replace(LEDGER, told=2e6), **large)
    assert not pays(replace(ASKED, max_photons=7_999_000, error=0.0195), **large)  # too little is known of what would be gathered


@pytest.mark.parametrize("knobs", [{"gather": False}, {"direct": "photons"}, {"hierarchical": False}, {"max_depth": 3}])
def test_settings_that_leave_all_to_photons(knobs):
    assert not pays(replace(ASKED, **knobs))


def test_it_wants_trees_that_have_been_refined_and_charts_with_room_for_tiles():
    assert not pays(round_=1)
    assert pays(round_=2)
    assert not pays(tiled=0.5)


def test_what_was_not_enough_is_not_tried_again_until_photons_are_twice_as_many(tmp_path):
    solver = make_solver(tmp_path, lamp_scene(), Settings(size=32, padding=1, max_photons=20_000))
    solver._trace_round(None)
    assert solver.gather_plan.given_up == math.inf
    solver.gathered = GatheredField.none(len(solver.tracing.texels))
    solver._trace_round(None)
    assert solver.gather_plan.given_up == solver.settings.error
    assert solver.gather_plan.given_up_told == 20_000
    assert solver.gathered is None
    tried = GatherPlan(40_000, 1.0)
    tried.give_up(0.02, LEDGER.told)
    assert not tried.pays(ASKED, NOISY, LEDGER, 3, lambda: 1.0)
    assert not tried.pays(ASKED, NOISY, replace(LEDGER, told=1.9 * LEDGER.told), 3, lambda: 1.0)
    assert tried.pays(ASKED, NOISY, replace(LEDGER, told=2.1 * LEDGER.told), 3, lambda: 1.0)
    assert tried.pays(replace(ASKED, error=0.0199), NOISY, LEDGER, 3, lambda: 1.0)  # of a bake that goes on to a smaller one


def test_a_bake_whose_gathering_took_more_rays_than_photons_were_to_need_goes_back_to_leaves_for_good():
    """Of 21.63 times 500,000 rays, see above."""
    plan = GatherPlan(40_000, 1.0)
    assert plan.pays(ASKED, NOISY, LEDGER, 3, lambda: 1.0)
    assert plan.budget_rays == pytest.approx(21.63 * LEDGER.rays, rel=1e-3)
    assert plan.pays(ASKED, NOISY, replace(LEDGER, gathered=int(0.99 * plan.budget_rays)), 4, lambda: 1.0)
    assert not plan.pays(ASKED, NOISY, replace(LEDGER, gathered=int(1.01 * plan.budget_rays)), 4, lambda: 1.0)


def test_tiles_are_counted(tmp_path):
    solver = make_solver(tmp_path, lamp_scene(), Settings(size=128, padding=1))
    assert solver.gather_plan.n_texel == len(solver.tracing.texels)
    texels = solver.tracing.texels
    inside = np.unique(Tiles.of(texels.texel_chart, texels.texel_code).texels())
    assert solver.gather_plan.tiled == pytest.approx(len(inside) / len(solver.tracing.texels))
    assert 0.3 < solver.gather_plan.tiled < 1.0
