"""A time limit as wall time: what is held back for the end, and what is left out for its sake."""

import math

import pytest
from leaflight.core.bake.deadline import Deadline, OutOfTime
from leaflight.core.util.messages import Status


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
