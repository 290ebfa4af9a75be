"""The state behind the panel, driven by a process that only talks."""

import dataclasses
import json
import math
import threading

from leaflight.addon.app.bake_state import BakeState
from leaflight.addon.show.bake_text import Worn, describe_count, describe_seconds
from leaflight.core.util.messages import Done, Error, Preview, Progress, Status, Warning_

RESULT = {
    "stopped_by": "error",
    "estimated_error": 0.048,
    "error_of": "bake",
    "objects": [{"name": "Floor", "estimated_error": 0.04, "texels": 900, "lighting": 1.0}],
    "seconds": {"photons": 3.0},
    "resumed": False,
    "leaves": 1234,
    "photons": 2_500_000,
    "pages": 2,
    "page_size": 512,
    "skipped": {"bake": 0},
}


class Talker:
    """Says what it is given, then waits to be killed where `lasting`."""

    def __init__(self, messages, lasting=False):
        self.said = messages
        self.killed = threading.Event()
        self.lasting = lasting
        self.cancelled = 0

    def messages(self):
        for message in self.said:
            if isinstance(message, Exception):
                raise message
            yield message
        if self.lasting:
            self.killed.wait(10)
            yield Error("killed")

    def cancel(self):
        self.cancelled += 1

    def kill(self):
        self.killed.set()


def begin(*messages, lasting=False, warnings=()):
    state, process = BakeState(), Talker(messages, lasting)
    state.begin(process, 0.0, list(warnings))
    return state, process


def progress(fraction, error=0.1, left=12.0):
    return Progress(fraction, 1_500_000, 1e6, error, left, 100)


def test_messages_reach_the_panel():
    state, _ = begin(Status("photons", "Tracing photons"), progress(0.4), progress(0.3), Done("result.json", False))
    assert state.running
    assert state.wait() == Done("result.json", False)
    bar, line = state.describe()
    assert bar.endswith(" %, 12 s left")
    assert line == "Tracing photons: 1.50 M, error 10 %"
    state.end(result=RESULT)
    assert not state.running
    assert state.summarize()[1:] == ["Error 4.8 %", "2 pages of 512 x 512 texels"]
    assert state.worn[0].details == ("1,234 leaves", "2.50 M photons")
    state.end(result=RESULT | {"leaves": 1, "pages": 1})
    assert state.summarize()[2:] == ["1 page of 512 x 512 texels"]
    assert state.worn[0].details == ("1 leaf", "2.50 M photons")


def test_unknown_error_and_time_are_not_shown():
    state, _ = begin(Status("photons", "Tracing photons"), progress(0.4, math.nan, math.nan), Done("", False))
    state.wait()
    assert "left" not in state.describe()[0]
    assert state.describe()[1] == "Tracing photons: 1.50 M"


def test_drain_gives_nothing_while_the_bake_runs():
    state, process = begin(Status("charts", "Unwrapping"), lasting=True)
    while state.stage != "Unwrapping":
        assert state.drain() is None
    assert state.describe()[1] == "Unwrapping"
    state.discard()
    assert process.killed.is_set()
    assert state.wait() == Error("killed")
    assert state.discarded


def test_cancel_asks_once():
    state, process = begin(lasting=True)
    state.cancel()
    state.cancel()
    assert process.cancelled == 1
    state.progress = progress(0.5)
    assert state.describe()[1] == "Finishing with the best so far"
    assert state.describe_goal() == ""
    state.clear()
    assert process.killed.is_set()
    assert not state.running


def test_old_messages_do_not_reach_the_next_bake():
    state, _ = begin(lasting=True)
    state.clear()
    state.begin(Talker([Done("second", False)]), 0.0, [])
    assert state.wait() == Done("second", False)


def test_a_process_that_cannot_be_understood_is_ended():
    reason = ValueError("not a Leaflight message: 'x'")
    state, process = begin(reason)
    ended = state.wait()
    assert isinstance(ended, Error)
    assert str(reason) in ended.text
    assert process.killed.is_set()


def test_warnings_are_kept_in_their_order():
    state, _ = begin(Warning_("A", "A: is too small."), Done("", False), warnings=[("A", "has no faces")])
    state.wait()
    assert state.warnings == [("A", "has no faces"), ("A", "A: is too small.")]


def finish(state, scene, pages, warnings=()):
    """A bake of that scene that comes to its end; the lines that it is told with."""
    state.begin(Talker([Done("", False)]), 0.0, list(warnings), scene=scene)
    state.wait()
    state.end(result=RESULT | {"pages": pages})
    return tuple(state.summarize())


def test_each_scene_is_told_of_its_own_bake():
    state = BakeState()
    first, second = finish(state, 1, 2, [("A", "is too small")]), finish(state, 2, 3)
    assert first != second
    assert (state.describe_worn(1), state.describe_worn(2), state.describe_worn(3)) == (first, second, ())
    assert state.list_warnings(1, has_bake=True) == [("A", "is too small")]
    assert state.list_warnings(1, has_bake=False) == []  # it was undone
    assert state.list_warnings(2, has_bake=True) == []
    state.clear()
    assert state.describe_worn(1) == ()


def test_a_bake_that_is_thrown_away_leaves_what_was_told_before():
    state = BakeState()
    before = finish(state, 1, 2, [("A", "is too small")])
    process = Talker([], lasting=True)
    state.begin(process, 0.0, [("B", "has no faces")], scene=1)
    assert state.list_warnings(1, has_bake=True) == [("B", "has no faces")]  # while it runs
    assert state.list_warnings(2, has_bake=True) == []
    state.discard()
    state.wait()
    state.end()
    assert state.describe_worn(1) == before
    assert state.list_warnings(1, has_bake=True) == [("A", "is too small")]


def test_a_bake_that_fails_tells_its_own_warnings_beside_its_error():
    state = BakeState()
    before = finish(state, 1, 2, [("A", "is too small")])
    state.begin(Talker([Error("All is dark.")]), 0.0, [("B", "has no faces")], scene=1)
    state.end(state.wait().text)
    assert state.describe_worn(1) == before
    assert state.list_warnings(1, has_bake=False) == [("B", "has no faces")]
    state.fail("no mesh is selected", scene=1)
    assert state.list_warnings(1, has_bake=True) == [("A", "is too small")]


def test_result_tells_why_it_stopped():
    state = BakeState()
    state.end(result=RESULT | {"stopped_by": "max_photons"})
    assert state.summarize()[1] == "Error 4.8 %, stopped at Max Photons"
    state.end(result=RESULT | {"stopped_by": "interrupted"})
    assert state.summarize()[0].startswith("Stopped after")


def test_what_is_said_of_a_bake_comes_back_from_the_file():
    floor, chair = (
        {"name": name, "estimated_error": error, "texels": 900, "lighting": 1.0} for name, error in (("Floor", 0.04), ("Chair 2", 0.383))
    )
    worn = Worn.of_result(RESULT | {"objects": [floor, chair]}, 9.0, "", [("A", "is too small")])
    assert worn.lines == ("Baked in 9 s", "Error 4.8 %", "Worst object: Chair 2, 38 %", "2 pages of 512 x 512 texels")
    assert worn.worst == "Chair 2"
    assert Worn.decode(worn.encode()) == worn
    for text in ("", "[]", '{"lines": 3}', '{"lines": [], "details": [], "worst": "", "warnings": [1]}'):
        assert Worn.decode(text) == Worn()


def test_the_pace_of_a_bake_comes_back_from_the_file_if_it_is_one():
    worn = Worn.of_result(RESULT, 9.0, "", [])
    assert worn.pace is not None
    assert Worn.decode(worn.encode()).pace == worn.pace
    fields = json.loads(worn.encode())
    for damage in ({"texels": 0}, {"error": math.nan}, {"photon_s": -1.0}, {"other_s": "9"}, {"error_of": None}, {"more": 1}):
        damaged = Worn.decode(json.dumps(fields | {"pace": fields["pace"] | damage}))
        assert (damaged.lines, damaged.pace) == (worn.lines, None)
    del fields["pace"]
    assert Worn.decode(json.dumps(fields)).lines == worn.lines, "what an earlier version saved"
    kept = Worn.of_result(RESULT | {"skipped": {"bake": 1}}, 0.1, "kept", [], worn.pace)
    assert kept.pace == worn.pace, "a bake that was not done again says nothing new"


def test_numbers_for_a_narrow_panel():
    assert [describe_count(count) for count in (65_536, 1_234_567)] == ["65,536", "1.23 M"]
    assert [describe_seconds(seconds) for seconds in (12.4, 125, 7300)] == ["12 s", "2 min 05 s", "2 h 01 min"]


def test_the_goal_is_told():
    state, process = BakeState(), Talker([progress(0.4), Done("", False)])
    assert state.describe_goal() == ""
    state.begin(process, 0.0, [], target=0.05)
    state.wait()
    assert state.describe_goal() == "to an error of 5.0 %"
    state.progress = dataclasses.replace(state.progress, photons_per_s=0.0)
    assert state.describe_goal() == ""


def test_the_newest_page_is_shown_and_once():
    state, _ = begin(Preview(0, "a"), Preview(1, "b"), Preview(0, "c"), Done("", False))
    state.wait()
    assert state.take_previews() == {0: "c", 1: "b"}
    assert state.take_previews() == {}
