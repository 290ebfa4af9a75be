"""The parts of the zoo's benchmark that bake nothing: seeds, windows, batches, pages put together, ratios, tables."""

import numpy as np
import pytest
from speed_curves import Point
from zoo_reference import PageReference
from zoo_results import CYCLES, OIDN, OURS, Outcome, SceneResult, share_of_tracing, summarize

# Two seconds of start, then 0.1 s a sample; error 1 / sqrt(samples).
SAMPLED = tuple(Point(2.0 + 0.1 * n, n**-0.5, 2.0 * n**-0.5, n) for n in (4, 16, 64))
FILTERED = tuple(Point(point.seconds, point.rel / 3.0, point.nrmse / 3.0, point.asked) for point in SAMPLED)


def outcome(asked, rel, seconds, stated=None, traced=None):
    return Outcome(asked, stated or asked, rel, rel, -0.002, seconds, 2.0 * seconds, 4_000_000, "error", {"photons": seconds}, traced)


def scene(name, ours, rivals=True):
    series = {CYCLES: SAMPLED, OIDN: FILTERED} if rivals else {}
    return SceneResult(name, f"{name}: a room", 0.01, tuple(ours), series)


GOOD = scene("good", [outcome(0.05, 0.05, 2.0), outcome(0.02, 0.02, 6.0, traced=0.5)])
SLOW = scene("slow", [outcome(0.05, 0.05, 8.0), outcome(0.02, 0.03, 30.0, traced=0.3)])


def row(table, what):
    (found,) = [list(one) for one in table.rows if one[0] == what]
    return found


def test_each_object_is_held_against_its_own_page():
    light = np.array([[1.0, 2.0, 3.0], [2.0, 2.0, 2.0], [4.0, 3.0, 2.0]], np.float32)
    covered = np.array([[True, False], [True, True]])
    reference = PageReference(covered, light, light, np.array([0, 1, 0]), 8, 1.0)
    pages = {name: np.full((2, 2, 4), 9.0) for name in ("a", "b")}
    pages["a"][0, 0, :3], pages["b"][1, 0, :3], pages["a"][1, 1, :3] = light
    assert reference.measure(pages, ("a", "b")).nrmse == 0.0
    assert reference.measure({"": np.where(covered[..., None], pages["a"], 0.0)}, ("a", "b")).nrmse > 0.5
    pages["b"][1, 0, :3] += 1.0
    assert reference.measure(pages, ("a", "b")).bias == pytest.approx(3.0 / light.sum())


def test_the_summary_has_means_and_the_worst():
    table = summarize([GOOD, SLOW])
    assert row(table, "seconds to 5%")[1:3] == ["4", "8"]
    assert row(table, "seconds to 2%")[2:] == ["never", "1 of 2 come to it"]
    assert row(table, "seconds to 2 % / seconds to 5 %")[1] == "3"
    assert row(table, f"time to 5%, {CYCLES} / {OURS}")[1:3] == ["10.5", "5.25"]
    assert row(table, f"time to 2%, {CYCLES} / {OURS}")[2:] == ["0", "1 only by the rival"]
    assert row(table, f"time to 2%, {OIDN} / {OURS}")[3] == "1 only by us, 1 by neither"
    assert row(table, "stated / real")[2:] == ["0.67", "3 of 4 in 0.75 - 1.33"]
    assert row(table, "bias, of the finest bake")[2] == "-0.20%"
    assert row(table, "share of tracing, bakes over 3 s")[1:] == ["40% (median)", "30%", "2 bakes"]


def test_the_share_of_tracing_counts_all_processes():
    assert share_of_tracing({"trace_photons": 6.0, "light_texels": 2.0, "find_in_charts": 1.0}, 2 * 10.0) == pytest.approx(0.4)
    assert share_of_tracing({}, 20.0) is None
    with pytest.raises(ValueError, match="trace_more"):
        share_of_tracing({"trace_more": 1.0}, 20.0)
