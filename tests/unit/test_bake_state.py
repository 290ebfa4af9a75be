"""What the panel knows: the state of a bake, driven by a process that only talks, its bar, and what is told before a bake."""

import dataclasses
import json
import math
import threading

import pytest
from leaflight.addon.app.bake_bar import Bar
from leaflight.addon.app.bake_state import BakeState
from leaflight.addon.app.estimate import Measured, estimate_bake
from leaflight.addon.show.bake_pace import Pace
from leaflight.addon.show.bake_text import Worn, describe_count, describe_seconds
from leaflight.core.util.messages import Done, Error, Preview, Progress, Status, Warning_
from leaflight.core.util.settings import Settings

# The state behind the panel, driven by a process that only talks.
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


# The bar of a bake, from the messages of its stages.
def tell_progress(fraction, left=12.0, error=0.1):
    return Progress(fraction, 1_500_000, 1e6, error, left, 100)


def hear(bar, *messages):
    """The bar after each message."""
    found = []
    for message in messages:
        (bar.hear_status if isinstance(message, Status) else bar.hear_progress)(message)
        found.append(bar.fraction)
    return found


def test_every_stage_moves_the_bar_forward():
    stages = [
        *(Status(stage, stage, share) for stage in ("read", "load", "charts", "texels", "scene", "contacts") for share in (0.0, 0.5, 1.0)),
        Status("photons", "Tracing photons"),  # the first round, before direct light
        Status("direct", "Direct light"),
        Status("direct", "Direct light, 50%", 0.5),
        Status("photons", "Tracing photons"),
        tell_progress(0.006, error=math.nan),
        tell_progress(0.5),
        tell_progress(0.3),  # a later round knows better
        tell_progress(1.0),
        Status("write", "Writing images"),
        Status("keep", "Keeping the state"),
    ]
    bars = hear(Bar(), *stages)
    assert bars == sorted(bars)
    assert bars[-1] < 1.0
    assert bars[len(bars) // 2] < 0.25, "else the bar would wait for the light nearly full"


def test_a_time_is_told_once_two_rounds_agree():
    bar = Bar()
    hear(bar, tell_progress(0.01, left=61.0, error=math.nan))
    assert bar.predict_seconds() == 0.0
    hear(bar, tell_progress(0.1, left=60.0))
    assert bar.predict_seconds() == 0.0, "one prediction is not to be trusted"
    hear(bar, tell_progress(0.4, left=10.0))
    assert bar.predict_seconds() == 0.0, "they contradict each other"
    hear(bar, tell_progress(0.6, left=8.0))
    assert bar.predict_seconds() == pytest.approx(8.0, abs=1.0)
    hear(bar, Status("photons", "Indirect light", 0.5))
    assert bar.predict_seconds() == 0.0, "rays are no photons"


# What the panel tells before a bake, from areas.
LAST_BAKE = {
    "estimated_error": 0.1,
    "error_of": "bake",
    "photons": 1,
    "objects": [{"texels": 9}],
    "seconds": {},
    "resumed": False,
    "skipped": {"bake": 0},
}
ROOM = [Measured("Floor", 20.0, 1.0), Measured("Walls", 60.0, 1.0), Measured("Lamp", 1.0, 1.0)]


def estimate(objects=ROOM, own_layers=0, pace=None, **chosen):
    return estimate_bake(objects, Settings(**chosen), own_layers, 2, pace)


def test_a_page_holds_what_it_can():
    found = estimate()
    assert (found.objects, found.pages, found.page_size) == (3, 1, 512)
    assert found.area_m2 == 81.0
    assert 0.4 * 512**2 < found.texels < 0.9 * 512**2
    assert found.density == pytest.approx((found.texels / 81.0) ** 0.5, rel=1e-4)
    assert estimate(size=1024).density > 2.0 * found.density
    assert estimate(padding=16).texels < found.texels


def test_density_decides_texels_and_pages():
    found = estimate(density=50.0)
    assert found.texels == pytest.approx(81.0 * 50.0**2, rel=1e-6)
    assert found.density == 50.0
    assert found.pages == 2
    assert found.too_large == ()
    assert estimate(density=100.0).too_large == ("Walls",)


def test_what_is_longer_than_a_page_does_not_fit_it():
    rail = Measured("Rail", 1.0, 2.0, 20.0)
    found = [estimate([*ROOM, rail], density=density) for density in (17.5, 20.0)]
    assert [one.too_large for one in found] == [(), ("Rail",)]
    assert found[1].fitting == pytest.approx((2**0.5 * 504 / (20.0 * 2.0 * 20.0),))


@pytest.mark.parametrize(("density", "padding"), [(400.0, 4), (100.0, 16)])
def test_what_does_not_fit_is_as_coarse_as_it_fills_a_page_alone(density, padding):
    found, alone = estimate(density=density, padding=padding), estimate(ROOM[1:2], padding=padding)
    assert density * dict(zip(found.too_large, found.fitting, strict=True))["Walls"] == pytest.approx(alone.density)


def test_each_object_may_be_finer_or_have_its_own_page():
    finer = [Measured("Floor", 20.0, 2.0), *ROOM[1:]]
    assert estimate(finer, density=40.0).texels == pytest.approx((81.0 + 3 * 20.0) * 40.0**2, rel=1e-6)
    assert estimate(finer).density < estimate().density
    assert estimate(atlas=False).pages == 3
    assert estimate(own_layers=1).pages == 2
    assert estimate(own_layers=3).pages == 3


def test_who_takes_the_page_is_named():
    level = [Measured("Ground", 900.0, 1.0, n_chart=1), *(Measured(f"Prop {k}", 2.0, 1.0, n_chart=6) for k in range(50))]
    assert estimate(level, density=3.0).takers == (("Ground", pytest.approx(0.9)),)
    assert estimate(level[1:]).takers == ()
    assert estimate(level[:1]).takers == (), "all of it is its own"
    assert estimate(level, atlas=False).takers == ()


def test_small_things_are_finer_and_named():
    level = [Measured("Ground", 40_000.0, 1.0, n_chart=1), *(Measured(f"Prop {k}", 24.0, 1.0, n_chart=6) for k in range(60))]
    even, plain = estimate(level), estimate(level, even_out=False)
    assert [name for name, _ in even.evened] == [one.name for one in level[1:]]
    assert even.evened[0][1] == pytest.approx(4.0, rel=0.1)
    assert [found.takers[0][1] for found in (plain, even)] == pytest.approx([0.965, 0.64], abs=0.01)
    assert plain.evened == estimate(level, density=1.0).evened == ()
    assert even.density < plain.density


def test_pages_are_told_as_they_are_made():
    """In the figures of bakes: 2,000 boxes have five pages of 512 and one of 1024."""
    boxes = [Measured(f"Box {k}", 6.0, 1.0, n_chart=6) for k in range(2000)]
    found = estimate(boxes)
    assert (found.pages, found.page_size) == (5, 512)
    assert found.density == pytest.approx(5.0, rel=0.1)
    assert estimate(boxes, size=1024).pages == 1
    assert estimate(boxes, max_pages=4).pages == 4
    assert estimate(boxes, density=10.0).pages == pytest.approx(2000 * 6 * 14.5**2 / 512**2 / 0.9, rel=0.25)
    assert estimate(boxes[:200]).pages == 1


def test_finer_bakes_take_more():
    coarse, fine = estimate(error=0.2), estimate(error=0.05)
    assert coarse.seconds[1] < fine.seconds[1]
    assert fine.seconds[0] < fine.seconds[1]
    assert estimate(size=2048).memory_mb > 2.0 * estimate().memory_mb
    assert estimate(time_limit=1.0).seconds == (1.0, 1.0)


def test_the_last_bake_tells_the_pace_of_the_next():
    texels = estimate().texels
    result = LAST_BAKE | {
        "estimated_error": 0.1,
        "photons": 10**6,
        "objects": [{"texels": texels}],
        "seconds": {"direct": 6.0, "write": 1.0, "photons": 3.0},
    }
    pace = Pace.of_result(result)
    assert estimate(error=0.1, pace=pace).seconds == (pytest.approx(10.0, rel=1e-4),) * 2
    assert estimate(error=0.05, pace=pace).seconds[0] == pytest.approx(7.0 + 2 * 3.0, rel=1e-4)
    assert estimate(error=0.05, direct="photons", pace=pace).seconds[0] == pytest.approx(7.0 + 4 * 3.0, rel=1e-4)
    waited = Pace.of_result(result, 14.0)
    assert estimate(error=0.1, pace=waited).seconds[0] == pytest.approx(14.0, rel=1e-4), "as long as the user waited"


def test_where_each_object_is_to_be_right_it_takes_more_and_no_other_bake_tells_how_much():
    assert estimate(error_of="objects").seconds[1] > 2 * estimate().seconds[1]
    pace = Pace.of_result(LAST_BAKE | {"objects": [{"texels": estimate().texels}], "seconds": {"photons": 3.0}})
    assert estimate(pace=pace).seconds != estimate().seconds
    assert estimate(pace=pace, error_of="objects").seconds == estimate(error_of="objects").seconds


@pytest.mark.parametrize(
    "changes", [{"estimated_error": float("nan")}, {"estimated_error": 0.0}, {"objects": []}, {"resumed": True}, {"skipped": {"bake": 1}}]
)
def test_a_bake_that_tells_too_little_has_no_pace(changes):
    assert Pace.of_result(LAST_BAKE) is not None
    assert Pace.of_result(LAST_BAKE | changes) is None


@pytest.mark.parametrize("area", [0.0, float("inf"), float("nan")])
def test_nothing_to_bake_has_no_estimate(area):
    assert estimate([]) is None
    assert estimate([Measured("Point", area, 1.0)]) is None
