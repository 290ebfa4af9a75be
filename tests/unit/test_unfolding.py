import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from leaflight.core.atlas import unfolding
from leaflight.core.atlas.layer_check import signed_areas
from leaflight.core.atlas.unfolding import Unfolder, UnfolderDied, own_unfolder
from processes import wait_for_end

SQUARE = (np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32), np.array([[0, 1, 2], [0, 2, 3]], np.uint32))


@pytest.fixture
def unfolder():
    own = Unfolder()
    yield own
    own._kill()


def test_meshes_of_one_question_lie_side_by_side():
    (chart, uv), (other_chart, other_uv) = own_unfolder().unfold([SQUARE, SQUARE], 2.0, False)
    assert chart.tolist() == [0, 0]
    assert set(other_chart.tolist()) == {1}
    np.testing.assert_allclose(np.abs(signed_areas(uv)), np.abs(signed_areas(other_uv)), rtol=1e-5)
    assert (uv.max(axis=(0, 1)) < other_uv.min(axis=(0, 1))).any() or (other_uv.max(axis=(0, 1)) < uv.min(axis=(0, 1))).any()


def test_child_that_was_killed_between_two_questions_is_replaced(unfolder):
    first = unfolder.unfold([SQUARE], 1.0, False)
    unfolder._child.kill()
    unfolder._child.wait()
    np.testing.assert_array_equal(unfolder.unfold([SQUARE], 1.0, False)[0][1], first[0][1])


def plant_xatlas(monkeypatch, folder, deaths):
    """An xatlas whose process dies when it is loaded, so many times; `deaths` files are left of them."""
    (folder / "xatlas.py").write_text(
        f"""
import importlib, os, pathlib, sys
fallen = len(list(pathlib.Path({str(folder)!r}).glob("*.died")))
if fallen < {deaths}:
    pathlib.Path({str(folder)!r}, f"{{fallen}}.died").touch()
    os._exit(7)
sys.path.remove({str(folder)!r})
del sys.modules["xatlas"]
sys.modules["xatlas"] = importlib.import_module("xatlas")
"""
    )
    monkeypatch.syspath_prepend(str(folder))


def test_a_question_that_a_child_died_of_is_put_again(unfolder, tmp_path, monkeypatch):
    expected = own_unfolder().unfold([SQUARE], 1.0, False)
    plant_xatlas(monkeypatch, tmp_path, deaths=2)
    np.testing.assert_array_equal(unfolder.unfold([SQUARE], 1.0, False)[0][1], expected[0][1])
    assert len(list(tmp_path.glob("*.died"))) == 2


def test_crash_is_told_and_the_next_question_answered(unfolder, tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        plant_xatlas(patch, tmp_path, deaths=100)
        with pytest.raises(UnfolderDied, match=r"^7$"):
            unfolder.unfold([SQUARE], 1.0, False)
        assert len(list(tmp_path.glob("*.died"))) == 3
    assert len(unfolder.unfold([SQUARE], 1.0, False)) == 1


def test_questions_are_answered_in_their_order_and_cancelled_ones_never(unfolder, monkeypatch):
    asked, may_answer = [], threading.Event()
    monkeypatch.setattr(unfolder, "unfold", lambda meshes, area, dense: (may_answer.wait(60) and asked.append(area)) or [area])
    answers = [unfolder.ask([SQUARE], area, False) for area in (1.0, 2.0, 3.0)]
    assert answers[1].cancel()
    may_answer.set()
    assert answers[2].result(60) == [3.0]
    assert (answers[0].result(60), asked) == ([1.0], [1.0, 3.0])


def test_whoever_waits_is_called_until_the_answer_is_there(unfolder, monkeypatch):
    may_answer, calls = threading.Event(), []
    monkeypatch.setattr(unfolder, "unfold", lambda meshes, area, dense: may_answer.wait(60) and [area])

    def watch():
        calls.append(1)
        if len(calls) == 3:
            may_answer.set()

    assert unfolding.wait_for(unfolder.ask([SQUARE], 1.0, False), watch) == [1.0]
    assert len(calls) >= 3


def test_missing_xatlas_says_what_to_do(tmp_path, monkeypatch, unfolder):
    (tmp_path / "xatlas.py").write_text("raise ImportError('planted')\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(ValueError, match=r"xatlas cannot be loaded \(planted\).*choose an existing UV layer"):
        unfolder.ask([SQUARE], 1.0, False).result()


@pytest.mark.skipif(os.name != "posix", reason="asks for a process by its number")
def test_child_ends_with_its_parent():
    script = """
import os
from leaflight.core.atlas import unfolding
from leaflight.core.atlas.layer_check import signed_areas
from test_unfolding import SQUARE
unfolder = unfolding.Unfolder()
unfolder.unfold([SQUARE], 1.0, False)
print(unfolder._child.pid, flush=True)
os.kill(os.getpid(), 9)
"""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
    ended = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == -signal.SIGKILL, ended.stderr
    assert not ended.stderr
    assert wait_for_end([int(ended.stdout)]) == []
