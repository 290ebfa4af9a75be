"""The pure parts of the speed benchmark: times to an error, ratios, tables, history."""

import dataclasses
import math

import bench_speed
import pytest
from speed_curves import Point, Reach, geometric_mean, ratio_text, reach_error

# Two seconds of start, then 0.1 s a sample; error 1 / sqrt(samples).
SAMPLED = [Point(2.0 + 0.1 * n, n**-0.5, 2.0 * n**-0.5, n) for n in (4, 16, 64)]


def test_between_bakes_error_is_a_power_of_time():
    points = [Point(1.0, 0.4, 0.4, 1), Point(4.0, 0.2, 0.2, 4), Point(16.0, 0.1, 0.1, 16)]
    assert reach_error(points, 0.2) == Reach(pytest.approx(4.0))
    assert reach_error(points[::-1], 0.2 / 2.0**0.25) == Reach(pytest.approx(4.0 * 2.0**0.5))


def test_beyond_the_longest_bake_samples_are_extrapolated_not_the_start():
    assert reach_error(SAMPLED, 0.05) is None
    assert reach_error(SAMPLED, 0.05, extrapolate=True) == Reach(pytest.approx(2.0 + 0.1 * 400), "~")
    assert reach_error(SAMPLED, 0.05, "nrmse", extrapolate=True) == Reach(pytest.approx(2.0 + 0.1 * 1600), "~")
    assert reach_error([], 0.05, extrapolate=True) is None


def test_mean_and_ratios():
    assert geometric_mean([2.0, 8.0]) == pytest.approx(4.0)
    assert geometric_mean([2.0, 0.0]) == 0.0
    assert math.isnan(geometric_mean([]))
    assert ratio_text(Reach(30.0, "~"), Reach(10.0)) == "~3"
    assert ratio_text(Reach(30.0), Reach(10.0, "<=")) == "≥3"
    assert ratio_text(None, Reach(1.0)) == "never"
    assert ratio_text(Reach(1.0), None) == "-"


def curves(ours_s):
    """Cycles, its filtered pages that stop at 8 %, and Leaflight at a fixed time for each error."""
    ours = [Point(ours_s * k, error, error, error) for k, error in ((1, 0.1), (2, 0.05), (5, 0.02))]
    filtered = [dataclasses.replace(point, rel=0.08, nrmse=0.08) for point in SAMPLED]
    return {bench_speed.CYCLES: SAMPLED, bench_speed.OIDN: filtered, bench_speed.OURS: ours, bench_speed.PHOTONS: ours[:1]}


def test_targets_are_judged_from_the_curves():
    judged = {target.text: target for target in bench_speed.judge_curves({("cornell_box", 256): curves(0.1)})}
    mean = judged["time to 5% rel, Cycles / Leaflight, geometric mean"]
    assert mean.figure == pytest.approx(42.0 / 0.2)
    assert mean.holds
    assert judged["time to 2% rel, Cycles / Leaflight, least"].figure == pytest.approx((2.0 + 0.1 * 2500) / 0.5)
    assert judged["cornell_box 256² to 2 % nrmse / Cycles' 16 samples"].figure == pytest.approx(0.5 / 3.6)
    slow = bench_speed.judge_curves({("cornell_box", 256): curves(100.0)})
    assert not any(target.holds for target in slow)


def test_history_grows_and_is_shown_beside_the_next_run(tmp_path):
    path = tmp_path / "history.jsonl"
    assert bench_speed.read_history(path) == []
    first = [bench_speed.Target.at_least("a", 2.0, 1.0), bench_speed.Target.at_most("b", math.nan, 1.0)]
    bench_speed.append_history(path, first)
    bench_speed.append_history(path, first)
    kept = bench_speed.read_history(path)
    assert [line["figures"] for line in kept] == [{"a": 2.0, "b": None}] * 2
    assert {"date", "version", "sources"} < set(kept[0])
    table = bench_speed.table_targets([bench_speed.Target.at_least("a", 0.5, 1.0)], {"a": 2.0})
    assert table.rows == [["a", "0.5", "2", ">= 1", "FAILS"]]
