"""The parts of the zoo's benchmark that bake nothing: seeds, windows, batches, pages put together, ratios, tables."""

import datetime
from pathlib import Path

import bench_zoo
import numpy as np
import pytest
from speed_curves import Point
from zoo_reference import PageReference, Subject, find_reference, next_samples, reference_path, spread_windows
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


def test_each_day_has_seeds_of_its_own():
    days = [datetime.date(2026, 11, 28) + datetime.timedelta(day) for day in range(3)]
    drawn = [seed for day in days for seed in bench_zoo.draw_seeds(16, day)]
    assert len(set(drawn)) == 48
    assert bench_zoo.draw_seeds(16, days[0]) == drawn[:16]


@pytest.mark.parametrize(
    ("size", "side", "triangles", "count"),
    [(64, 10, 500, 1), (256, 32, 500, 1), (256, 10, 500, 64), (256, 10, 20_000, 16), (384, 32, 500, 64), (1024, 32, 200_000, 4)],
)
def test_windows_lie_on_the_page_and_not_on_each_other(size, side, triangles, count):
    window, corners = spread_windows(size, side, triangles)
    assert len(corners) == count
    seen = np.zeros((size, size), int)
    for left, low in corners:
        seen[low : low + window, left : left + window] += 1
    assert seen.max() == 1
    assert seen.sum() == (64 * side * side if count > 1 else size * size)


def test_batches_double_and_end_with_the_time():
    assert next_samples(8, 1.0, 0.5, 60.0) == 16
    assert next_samples(512, 40.0, 20.0, 60.0) == 512
    assert next_samples(512, 50.0, 20.0, 60.0) == 256
    assert next_samples(512, 58.0, 20.0, 60.0) == 0
    assert next_samples(512, 61.0, 20.0, 60.0) == 0


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


def test_a_good_reference_of_the_cache_is_taken_as_it_is(tmp_path):
    subject = Subject(tmp_path, "seed 1", ("a",), "", 64, 500, "seed 1: a room")
    subject.save()
    assert Subject.load(tmp_path) == subject
    light = np.random.default_rng(1).random((4096, 3)).astype(np.float32) + 1.0
    path = reference_path(subject, "layout", 32)
    np.savez(path, covered=np.ones((64, 64), bool), first=light, second=light, owner=np.zeros(4096), samples=8, seconds=1.0)
    assert find_reference(subject, "layout", 32, 60.0, 0.01).noise == 0.0


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


def test_a_scene_that_fails_is_told_and_the_others_are_run(monkeypatch, capsys):
    def run(subject, effort, options):
        if subject.name == "bad":
            raise RuntimeError("bad: the bake failed: no light")
        return GOOD

    subjects = [Subject(Path("nowhere"), name, (), "", 64, 500, f"{name}: a room") for name in ("bad", "good")]
    monkeypatch.setattr(bench_zoo, "list_subjects", lambda arguments, effort: [(one.name, lambda one=one: one) for one in subjects])
    monkeypatch.setattr(bench_zoo, "run_scene", run)
    assert bench_zoo.main(["--quick"]) == 1
    told = capsys.readouterr().out
    assert "bad FAILED: bad: the bake failed: no light" in told
    assert "| good |" in told
