"""The arithmetic of the ablation: ratios, noise, verdicts and tables, from bakes that are made up; and its page in docs/."""

import math
import random
from pathlib import Path

import bench_ablation
import pytest
from ablation_results import SceneTrials, Trial, tabulate_worth, weigh_mechanism
from leaflight.core.util.ablation import MECHANISMS

NOISE = 0.05  # standard deviation of the logarithm of a bake's error
PAGE = Path(__file__).resolve().parents[2] / "docs" / "ablation.md"


def make_scenes(count=12, seed=3, **factors):
    """Scenes with two bakes of everything, and bakes whose error and cost are those times two factors."""
    rng = random.Random(seed)

    def trial(error=1.0, cpu=1.0, changed=True, level=0.03):
        rel = level * error * math.exp(rng.gauss(0.0, NOISE))
        return Trial(rel, 0.9 * rel, 10.0 * cpu * math.exp(rng.gauss(0.0, 0.02)), changed)

    scenes = []
    for index in range(count):
        base = trial(level=0.02 + 0.002 * index), trial(level=0.02 + 0.002 * index)
        level = base[0].rel
        without = {name: trial(*of, level=level) for name, of in factors.items()}
        scenes.append(SceneTrials(f"seed {index}", f"seed {index}: a room", base, without))
    return scenes


def rows(table):
    return {row[0]: dict(zip(table.head, row, strict=True)) for row in table.rows}


def test_ratios_are_geometric_means_of_without_over_with():
    base = Trial(0.02, 0.02, 10.0), Trial(0.021, 0.02, 10.1)
    scenes = [
        SceneTrials("a", "a: room", base, {"tiles": Trial(0.04, 0.02, 20.0)}),
        SceneTrials("b", "b: room", base, {"tiles": Trial(0.02, 0.02, 5.0, changed=False)}),
        SceneTrials("c", "c: room", base),
    ]
    worth = weigh_mechanism(scenes, "tiles")
    assert worth.error == pytest.approx(math.sqrt(2.0))
    assert worth.cpu == pytest.approx(1.0)
    assert worth.effort == pytest.approx(2.0)
    assert worth.honesty == pytest.approx(math.sqrt(0.5))
    assert (worth.honest, worth.changed, worth.scenes) == (0.5, 1, 2)
    assert rows(tabulate_worth(scenes, ["tiles"]))["tiles"]["verdict"].endswith("failed in 1")


def test_what_is_worth_something_is_told_from_noise():
    scenes = make_scenes(good=(1.3, 1.0), bad=(0.8, 1.0), dear=(1.0, 1.5), useless=(1.0, 1.0), idle=(1.0, 1.0, False))
    for scene in scenes:  # whose pixels do not change
        scene.without["idle"] = Trial(scene.base[0].rel, scene.base[0].stated, scene.without["idle"].cpu_s, False)
    found = {name: weigh_mechanism(scenes, name).verdict for name in ("good", "bad", "dear", "useless", "idle")}
    assert found == {"good": "worth it", "bad": "does harm", "dear": "worth it", "useless": "within noise", "idle": "no effect"}


def test_scenes_fail_alone_and_the_page_gets_its_tables(tmp_path, monkeypatch, capsys):
    (done,) = make_scenes(count=1, tiles=(1.3, 1.0))

    def run(subject, asked, mechanisms):
        if subject.name == "bad":
            raise RuntimeError("bad: the bake failed: no light")
        assert asked.seeds == (1, 2, 3)
        assert mechanisms == ["tiles", "seams+contacts"]
        return done

    class Subject:
        def __init__(self, name):
            self.name = self.about = name

    monkeypatch.setattr(bench_ablation, "list_subjects", lambda *_: [(name, lambda name=name: Subject(name)) for name in ("bad", "good")])
    monkeypatch.setattr(bench_ablation, "run_scene", run)
    monkeypatch.setattr(bench_ablation, "ROOT", tmp_path)
    page = tmp_path / "docs" / "ablation.md"
    page.parent.mkdir()
    page.write_text(PAGE.read_text(encoding="utf-8"), encoding="utf-8")
    assert bench_ablation.main(["--mechanisms", "tiles", "seams+contacts", "--turns", "3", "--docs"]) == 1
    assert "bad FAILED: bad: the bake failed: no light" in capsys.readouterr().out
    assert "| tiles | " in page.read_text(encoding="utf-8").partition("<!-- table: worth -->")[2].partition("<!-- end -->")[0]
    for wrong in (["--turns", "1"], ["--mechanisms", "seams+tile"]):
        with pytest.raises(SystemExit):
            bench_ablation.main(wrong)
    assert "no mechanism: tile;" in capsys.readouterr().err


def test_the_page_lists_every_mechanism():
    text = PAGE.read_text(encoding="utf-8")
    assert [name for name in MECHANISMS if f"| {name} |" not in text] == []
