"""What ends a bake, how long its rounds are, what is left out for the sake of time, and how far it has come."""

import math
import time
from types import SimpleNamespace

import numpy as np
import pytest
from leaflight.core.bake.deadline import Deadline, OutOfTime
from leaflight.core.bake.stop_rules import StopRules
from leaflight.core.transport.rounds import (
    FIRST_ROUND_PHOTONS,
    ROUND_PHOTONS,
    SHARD_PHOTONS,
    SPARE,
    grow_photons,
    next_photons,
    share_photons,
)
from leaflight.core.util.messages import Status
from leaflight.core.util.progress import Interrupted, ProgressReporter, stretch, unwatched
from leaflight.core.util.settings import Settings


# A time limit as wall time: what is held back for the end, and what is left out for its sake.
def test_without_a_limit_nothing_is_ever_late(clock):
    free = Deadline()
    free.note_texels(100.0)
    clock[0] += 1e9
    assert free.left() == math.inf
    assert not free.is_over()
    assert not free.is_lost()
    assert free.cap_photons(10**9) == 10**9
    assert not free.foresee(10)()


def test_it_counts_from_when_the_bake_was_asked_for(clock):
    limited = Deadline(40.0, began=clock[0] - 30.0)
    assert limited.left() == pytest.approx(10.0)
    clock[0] += 10.0
    assert limited.is_over()


def test_the_end_is_held_back(clock):
    """Writing takes about as long as looking at the light does, and looking at it some times as long as measuring texels."""
    limited = Deadline(40.0, after_s=1.0)
    assert limited.reserve_s == 1.0
    limited.note_texels(2.0)
    assert 1.0 + 2.0 * (1.5 + 0.8) < limited.reserve_s < 20.0
    limited.note_light(4.0)
    assert limited.reserve_s > 1.0 + 4.0 + 4.0
    before = limited.reserve_s
    limited.note_light(0.1)  # nothing had to be smoothed
    assert 1.0 + 0.1 + 4.0 < limited.reserve_s < before
    clock[0] += 40.0 - limited.reserve_s
    assert limited.is_over()


def test_a_page_takes_time_to_write_whatever_is_on_it(clock):
    idle, busy = Deadline(40.0), Deadline(40.0)
    idle.note_texels(0.1, 2048**2)
    busy.note_texels(0.1, 2048**2, slowness=5.0)
    assert idle.reserve_s > 3.0
    assert busy.reserve_s > 4 * idle.reserve_s


@pytest.mark.parametrize(("limit", "grace"), [(40.0, 4.0), (5.0, 2.0)])
def test_a_bake_without_light_may_be_a_little_late(clock, limit, grace):
    limited = Deadline(limit)
    clock[0] += limit + 0.99 * grace
    assert not limited.is_lost()
    clock[0] += 0.02 * grace
    assert limited.is_lost()


def test_a_round_has_no_more_photons_than_there_is_time_for(clock):
    limited = Deadline(10.0)
    assert 10**5 < limited.cap_photons(10**8) < 10**6  # nothing is known of how fast they are
    limited.note_round(1_000_000, 0.5)
    assert limited.cap_photons(1_000_000) == 1_000_000
    assert 15_000_000 < limited.cap_photons(10**8) < 20_000_000
    clock[0] += 12.0
    assert limited.cap_photons(10**8) == 0


def test_a_stage_that_would_take_too_long_is_foreseen(clock):
    limited = Deadline(100.0)
    quick, slow = limited.foresee(10), limited.foresee(10)
    for _ in range(10):
        clock[0] += 5.0
        assert not quick()
    limited = Deadline(100.0)
    slow = limited.foresee(100)
    told = []
    for _ in range(20):
        clock[0] += 2.0
        told.append(slow())
    assert not any(told[:4])  # too early to tell
    assert all(told[5:])


def test_a_stage_that_is_slow_to_begin_is_not_taken_for_a_slow_one(clock):
    """Its first steps may open the scene in all processes, and come together: so did those of a bake of a level with 15.3 s left."""
    late = Deadline(15.3).foresee(28)
    for seconds in (2.5, 1.3, *[0.0] * 6, *[0.25] * 20):
        clock[0] += seconds
        assert not late()


def test_a_stage_whose_first_step_takes_all_the_time_is_late(clock):
    late = Deadline(20.0).foresee(28)
    clock[0] += 18.0
    assert late()


def test_contacts_have_their_share_of_the_time(clock):
    said = []
    watch = Deadline(40.0).watch_contacts(lambda *words: said.append(words))
    watch(Status("contacts", "Looking"), 0.1, "")
    clock[0] += 9.0
    watch(Status("contacts", "Looking"), 0.2, "")
    assert len(said) == 2
    clock[0] += 2.0
    with pytest.raises(OutOfTime):
        watch(Status("contacts", "Looking"), 0.3, "")


def test_work_that_is_spread_ends_when_it_is_late(clock):
    limited = Deadline(10.0)
    done = []
    spread = limited.limit_spread(lambda fn, calls: (fn(*call) for call in calls), limited.is_over)

    def work(number):
        done.append(number)
        clock[0] += 3.0
        return number

    assert list(spread(work, ((number,) for number in range(100)))) == [0, 1, 2, 3]
    assert done == [0, 1, 2, 3]
    assert list(Deadline().limit_spread(lambda fn, calls: (fn(*call) for call in calls), lambda: True)(int, (("1",), ("2",)))) == [1, 2]


# What ends a bake, and how far it has come.
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


# How long rounds are and how they are shared out.
PLENTY = 10**9


def next_plain(so_far, most, n_node, wanted_error, error, fixed_error, degree=None):
    """Where all photons told as much as those of a first round."""
    return next_photons(so_far, most, n_node, wanted_error, error, fixed_error, degree)[0]


@pytest.mark.parametrize(("degree", "power"), [(None, 1.0), (0, 1 / 2), (1, 2 / 3), (2, 3 / 4)])
@pytest.mark.parametrize("fixed", [0.0, 0.02, 0.04])
def test_a_round_aims_at_the_error_asked_for(fixed, degree, power):
    """With the photons that it asks for, noise that falls as it does on such trees would come out a little below."""
    noise2 = 1.15 * (0.05**2 - fixed**2)
    photons = next_plain(3_000_000, PLENTY, 10, 0.05, math.sqrt(noise2 + fixed**2), fixed, degree)
    then2 = noise2 * (3_000_000 / (3_000_000 + photons)) ** power + fixed**2
    assert (then2 - fixed**2) * SPARE == pytest.approx(0.05**2 - fixed**2, rel=1e-5)


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_refined_leaves_balance_noise_and_what_they_cannot_hold(degree):
    """Of leaves of side h squared noise is 1 / (N h^2), and what functions of that degree miss h^(2 degree + 2): the least sum of both."""
    side = np.geomspace(1e-4, 1.0, 100_000)

    def least(photons):
        return (1.0 / (photons * side**2) + side ** (2 * degree + 2)).min()

    assert grow_photons(least(1e4), least(1e6), degree) == pytest.approx(100.0, rel=1e-3)
    assert grow_photons(4.0, 1.0, None) == 4.0
    assert grow_photons(0.0, 1.0, degree) == 0.0


@pytest.mark.parametrize("photons", [2, 3, 1001, FIRST_ROUND_PHOTONS, 3 * SHARD_PHOTONS, 1_234_567, ROUND_PHOTONS])
def test_shards_are_of_all_photons_and_both_halves_alike(photons):
    shares = share_photons(photons)
    assert sum(shares) == photons
    assert len(shares) % 2 == 0
    assert sum(shares[::2]) - sum(shares[1::2]) == photons % 2
    assert max(shares) <= SHARD_PHOTONS
    many = photons > 4 * SHARD_PHOTONS
    whole, last = (shares[:-4], shares[-4:]) if many else (shares, [])
    assert len(whole) >= 2
    assert all(abs(2 * small - large) <= 3 for small in last for large in whole)
    assert max(whole) - min(whole) <= 1


SAID = Status("charts", "Unwrapping")


def test_a_word_a_second_says_the_share_that_is_done_and_at_what(clock):
    told = []
    speaker = ProgressReporter(told.append)
    for second, share, about in ((0.9, 0.1, ""), (1.1, 0.25, ""), (2.0, 0.3, ""), (2.2, 0.5, "Floor"), (9.0, 0.996, "")):
        clock[0] = 1000.0 + second
        speaker.say(SAID, share, about)
    assert told == [
        Status("charts", "Unwrapping, 25%", 0.25),
        Status("charts", "Unwrapping, 50%: Floor", 0.5),
        Status("charts", "Unwrapping, 100%", 0.996),
    ]


def test_after_half_a_second_the_impatient_are_heard_whenever_anything_is_said(clock):
    told, stop = [], []
    speaker = ProgressReporter(told.append, lambda: bool(stop))
    clock[0] += 1.1
    speaker.say(SAID, 0.5)
    stop.append(True)
    clock[0] += 0.01
    with pytest.raises(Interrupted):
        speaker.say(SAID, 0.6)
    assert len(told) == 1
    speaker = ProgressReporter(pytest.fail, lambda: True)
    clock[0] += 0.45
    speaker.say(SAID, 0.5)
    clock[0] += 0.1
    with pytest.raises(Interrupted):
        speaker.say(SAID, 0.5)


def test_shares_of_a_part_of_a_stage_are_told_as_shares_of_the_stage():
    told = []
    say = stretch(lambda *word: told.append(word), SAID, 0.25, 0.75)
    for share in (0.0, 0.5, 1.0):
        say(share)
    assert told == [(SAID, 0.25, ""), (SAID, 0.5, ""), (SAID, 0.75, "")]
    stretch(unwatched, SAID)(0.5)
