"""Parts of texel entries for threads: all of them once, in order, and the same whoever works."""

import os
import subprocess
import sys
import threading
from itertools import pairwise

import pytest
from leaflight.core.util.progress import Interrupted
from leaflight.core.util.threads import count_usable, run_on_threads, split_entries


@pytest.mark.parametrize("count", [0, 1, (1 << 16) + 1, 11_700_000])
def test_parts_follow_each_other_to_the_end(count):
    parts = split_entries(count)
    assert [part.start for part in parts] == [0, *(part.stop for part in parts[:-1])]
    assert parts[-1].stop == count
    assert all(part.stop - part.start <= 1 << 18 for part in parts)
    assert all(part.stop - part.start >= 1 << 16 for part in parts[:-1])


@pytest.mark.parametrize("within", [(0, 10), (87_500, 175_000), (5, 699_999)])
def test_parts_of_some_entries_end_where_those_of_all_do(within):
    """And where these begin and end."""
    low, high = within
    ends = sorted({low, high, *(part.start for part in split_entries(700_000) if low < part.start < high)})
    assert [(low + part.start, low + part.stop) for part in split_entries(700_000, slice(low, high))] == list(pairwise(ends))


def test_what_is_found_comes_in_order_from_threads_side_by_side():
    """Each waits for the other, which one thread alone would do for ever."""
    both = threading.Barrier(2)

    def work(part):
        both.wait(timeout=30)
        return part.start

    assert run_on_threads(work, 2 << 16, 2) == [0, 1 << 16]


def test_an_error_in_a_thread_is_raised():
    def work(part):
        raise ValueError(f"part {part.start}")

    with pytest.raises(ValueError, match="part 0"):
        run_on_threads(work, 10, 2)


def test_share_of_the_parts_that_are_done_is_told():
    told = []
    run_on_threads(lambda part: part, 4 << 16, 2, told.append)
    assert told == [0.25, 0.5, 0.75, 1.0]
    assert run_on_threads(lambda part: part.stop, 4 << 16, 2, within=slice(10, 1 << 17)) == [(1 << 16) - 10, (1 << 17) - 10]


def test_whoever_wants_no_more_has_no_further_part_begun():
    """The one thread has a part in hand when it is told, and six are left."""
    begun, go_on = [], threading.Event()

    def work(part):
        begun.append(part.start)
        if len(begun) > 1:
            go_on.wait(30)

    def stop(share):
        threading.Timer(0.2, go_on.set).start()
        raise Interrupted

    with pytest.raises(Interrupted):
        run_on_threads(work, 8 << 16, 1, stop)
    assert len(begun) <= 2


@pytest.mark.parametrize("usable", [{0}, {2, 3, 5}])
def test_processors_that_a_batch_system_gives_to_others_are_not_counted(monkeypatch, usable):
    monkeypatch.setattr(os, "cpu_count", lambda: 64)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: usable, raising=False)
    assert count_usable() == len(usable)


def test_all_processors_are_usable_where_the_system_does_not_tell(monkeypatch):
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    for told, count in ((64, 64), (None, 1)):
        monkeypatch.setattr(os, "cpu_count", lambda told=told: told)
        assert count_usable() == count


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells")
def test_a_process_is_alone_until_it_has_a_thread_that_works():
    lines = (
        "from leaflight.core.util.threads import is_alone; import threading; e = threading.Event(); t = threading.Thread(target=e.wait); "
        "found = [is_alone()]; t.start(); found.append(is_alone()); e.set(); t.join(); print(found)"
    )
    said = subprocess.run([sys.executable, "-c", lines], capture_output=True, text=True, check=True)
    assert said.stdout.split() == ["[True,", "False]"]
