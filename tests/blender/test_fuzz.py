"""A few cases of `make fuzz`: odd scenes, damaged files and odd words end in a bake or in a sentence, and harm nothing."""

import os

import pytest

pytest.importorskip("bpy")

from fuzz_judge import judge, list_content
from run_fuzz import run_cases

pytestmark = pytest.mark.skipif(os.name != "posix", reason="cases are run with what POSIX has")

SEEDS = (5, 6, 9, 20)  # one of each kind of case, and with each exit code


def test_cases_from_seeds_end_as_they_should(tmp_path):
    outcomes = run_cases(SEEDS, tmp_path)
    assert {one.seed: (one.about, one.wrong) for one in outcomes if one.wrong} == {}
    assert len(outcomes) == len(SEEDS)
    assert {one.code for one in outcomes} == {0, 1, 2}
    assert len({one.kind for one in outcomes}) >= 4


@pytest.fixture
def run(tmp_path):
    """Judges a run of which this was printed, after `change` has been at its folder."""
    work, temporary = tmp_path / "work", tmp_path / "tmp"
    (work / "maps").mkdir(parents=True)
    temporary.mkdir()
    (work / "room.blend").write_bytes(b"scene")
    before = list_content(work)

    def judge_run(code, told, change=lambda work, temporary: None):
        change(work, temporary)
        return judge(code, told, work, before, ("maps", "report.json"), temporary)

    return judge_run


def test_runs_as_they_should_be(run):
    assert run(0, "leaflight: Unwrapping") == []
    assert run(1, "leaflight: error: nothing to bake: add a mesh.") == []
    assert run(2, "usage: leaflight bake\nleaflight bake: error: argument --size: invalid int value: 'a'") == []


@pytest.mark.parametrize(
    ("code", "told", "change"),
    [
        (-11, "", None),
        (1, "", None),
        (1, "leaflight: error: 5", None),
        (2, "", None),
        (0, "leaflight: error: it failed after all, you see.", None),
        (1, "leaflight: error: it was so, you see.\nTraceback (most recent call last):", None),
        (1, "leaflight: error: code 3: this is a fault of Leaflight's", None),
        (0, "", lambda work, temporary: (work / "room.blend").write_bytes(b"other")),
        (0, "", lambda work, temporary: (work / "room.blend").unlink()),
        (0, "", lambda work, temporary: (work / "new.txt").touch()),
        (0, "", lambda work, temporary: (work / "maps" / ".page.exr.7.part").touch()),
        (0, "", lambda work, temporary: (temporary / "leaflight_job").mkdir()),
        (0, "", lambda work, temporary: (work / "report.json").write_text('{"error": NaN}')),
        (0, "", lambda work, temporary: (work / "maps" / "page.exr").write_bytes(b"cut off")),
    ],
)
def test_each_fault_is_seen(run, code, told, change):
    assert len(run(code, told, change or (lambda work, temporary: None))) == 1
