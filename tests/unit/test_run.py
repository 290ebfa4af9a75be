"""What every stage of a bake is given: who hears of it, and how long it takes."""

import math
from pathlib import Path

import pytest
from leaflight.core.bake.run import Run
from leaflight.core.util.job import Job
from leaflight.core.util.messages import Status, Warning_
from leaflight.core.util.progress import Interrupted
from leaflight.core.util.settings import Settings

FIRST, SECOND = Status("texels", "Measuring texels"), Status("write", "Writing images")


def open_run(told, should_stop=lambda: False):
    return Run(Path(), Job(Settings(), "images", "room"), told.append, should_stop)


def test_a_stage_is_told_as_it_begins_and_its_parts_are_added_up(monkeypatch):
    clock = iter([1.0, 1.5, 2.0, 4.0, 10.0, 10.25])
    monkeypatch.setattr("leaflight.core.bake.run.time.perf_counter", lambda: next(clock))
    told = []
    run = open_run(told)
    for said in (FIRST, SECOND, FIRST):
        with run.stage(said):
            assert told[-1] == said
    assert told == [FIRST, SECOND, FIRST]
    assert run.seconds == {"texels": 0.75, "write": 2.0}


def test_a_stage_that_fails_has_no_seconds():
    run = open_run([])
    with pytest.raises(ValueError, match="full"), run.stage(SECOND):
        raise ValueError("full")
    assert run.seconds == {}


def test_what_is_warned_of_is_told_at_once_and_kept_in_order():
    told = []
    run = open_run(told)
    run.warn([("Snow", "is clamped"), ("Lamp", "is left out")])
    run.warn(iter([("", "is dark")]))
    assert run.warnings == [("Snow", "is clamped"), ("Lamp", "is left out"), ("", "is dark")]
    assert told == [Warning_(*one) for one in run.warnings]


def test_each_stage_has_a_watch_of_its_own_that_asks_whether_to_go_on(monkeypatch):
    told, asked = [], []
    run = open_run(told, lambda: bool(asked))
    monkeypatch.setattr("leaflight.core.util.progress.SECONDS_BETWEEN_WORDS", math.inf)
    early = run.watch()
    monkeypatch.setattr("leaflight.core.util.progress.SECONDS_BETWEEN_WORDS", -1.0)
    early(FIRST, 0.25, "")
    assert [message.share for message in told] == [0.25]
    run.watch()(FIRST, 0.25, "")  # a watch of another stage has said nothing yet
    assert [message.share for message in told] == [0.25, 0.25]
    asked.append(True)
    with pytest.raises(Interrupted):
        run.watch()(FIRST, 0.5, "")
