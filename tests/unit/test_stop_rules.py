"""What ends a bake, and how far it has come."""

import math
import time
from types import SimpleNamespace

import pytest
from leaflight.core.bake.stop_rules import StopRules
from leaflight.core.util.settings import Settings


def rules(wished=False, age_s=0.0, **knobs):
    return StopRules(Settings(**{"error": 0.05, "max_photons": 10_000, **knobs}), lambda: wished, time.monotonic() - age_s)


@pytest.mark.parametrize(
    ("error", "photons", "options", "reason"),
    [
        (0.06, 5000, {}, ""),
        (0.05, 5000, {}, "error"),
        (math.nan, 5000, {}, ""),
        (0.06, 9998, {}, ""),
        (0.06, 9999, {}, "max_photons"),  # two halves of a bake want a photon each
        (0.06, 5000, {"time_limit": 20.0, "age_s": 30.0}, "time_limit"),
        (0.06, 5000, {"time_limit": 40.0, "age_s": 30.0}, ""),
        (0.05, 5000, {"time_limit": 20.0, "age_s": 30.0}, "error"),
        (0.05, 9999, {"time_limit": 20.0, "age_s": 30.0, "wished": True}, "interrupted"),
    ],
)
def test_a_bake_ends_for_the_first_reason_that_holds(error, photons, options, reason):
    assert rules(**options).find_reason(error, photons) == reason


def progress(before=0, photons=5000, error=0.1, stopped_by="", **options):
    light = SimpleNamespace(photons=photons, error=error, stopped_by=stopped_by, leaves=[1, 2, 3])
    return rules(**options).measure_progress(light, before)


def test_progress_is_that_of_the_rule_that_is_nearest():
    assert progress(age_s=10.0).fraction == pytest.approx(0.5)
    assert progress(age_s=10.0, error=0.06).fraction == pytest.approx((0.05 / 0.06) ** 2)
    assert progress(age_s=18.0, time_limit=20.0).fraction == pytest.approx(0.9, rel=1e-3)
    assert progress(age_s=10.0, stopped_by="interrupted").fraction == 1.0
    assert progress(error=math.nan, age_s=10.0).fraction == pytest.approx(0.5)
    assert progress(age_s=30.0, time_limit=20.0).fraction == 1.0


def test_time_left_is_by_what_this_bake_has_done_of_it():
    alone, resumed = progress(age_s=10.0), progress(before=4000, age_s=10.0)
    assert (alone.photons_per_s, alone.seconds_left) == (pytest.approx(500.0, rel=1e-3), pytest.approx(10.0, rel=1e-3))
    assert (resumed.photons_per_s, resumed.seconds_left) == (pytest.approx(100.0, rel=1e-3), pytest.approx(50.0, rel=1e-3))
    assert math.isnan(progress(before=5000).seconds_left)
