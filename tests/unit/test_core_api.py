"""The core as programmers meet it: what importing costs, the example in its docstring, and its memory."""

import json
import subprocess
import sys
import tempfile
import textwrap
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from leaflight import core
from leaflight.core.bake.bake import run_bake
from leaflight.core.output import report
from leaflight.core.output.image_file import read_image
from leaflight.core.scene.snapshot import save_snapshot
from leaflight.core.util import job

# The core as programmers meet it: what importing costs, and the example in its docstring.
NATIVE = ("embreex", "xatlas", "OpenImageIO", "bpy")


def test_importing_the_core_loads_no_native_library():
    modules = ("bake.bake", "scene.scene", "scene.snapshot", "util.job", "util.messages", "util.settings")
    code = "import sys; " + "".join(f"import leaflight.core.{name}; " for name in modules) + "print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert "leaflight.core.bake.bake" in loaded
    assert set(NATIVE) & set(loaded) == set()


@pytest.fixture(scope="module")
def names():
    """Those that the docstring's example leaves behind."""
    example = textwrap.dedent(core.__doc__.partition("::\n")[2].partition("\nWhat programs")[0])
    found = {}
    exec(compile(example, "core docstring", "exec"), found)
    return found


def test_the_example_in_the_docstring_runs(names):
    light = names["light"]
    (page,) = light.pages["lighting"]
    lit = page[page[..., 3] == 1, 0]
    # Below a lamp of P watts at d metres Blender shows P / (4 pi^2 d^2), and the lamp is above the middle.
    assert lit.max() == pytest.approx(100 / (4 * np.pi**2 * 1.5**2), rel=0.02)
    assert light.stopped_by == "error"
    assert light.error < names["Settings"]().error
    assert [row["name"] for row in light.report["objects"]] == ["Floor"]
    assert light.object_page.tolist() == [0]
    x, y = (light.tri_uv.mean(axis=(0, 1)) * len(page)).astype(int)
    assert page[y, x, 0] == pytest.approx(lit.max(), rel=0.05)


def test_memory_and_files_have_the_same_light(names, tmp_path, open_image_io):
    settings = replace(names["Settings"](size=64, workers=1), passes=("combined", "lighting", "stderr", "level"))
    save_snapshot(tmp_path / job.SNAPSHOT_FILE, names["room"])
    job.Job(settings, output=str(tmp_path), atlas_name="room").save(tmp_path)
    run_bake(tmp_path, tell=lambda message: None, should_stop=lambda: False)
    light = core.solve(names["room"], settings)
    for name in ("combined", "lighting", "stderr"):
        pixels, _ = read_image(tmp_path / f"room_0.{name}.exr")
        np.testing.assert_allclose(light.pages[name][0], pixels, rtol=1e-3, atol=1e-6)  # half floats in the file
    assert json.loads((tmp_path / "result.json").read_text())["photons"] == light.report["photons"]


def test_a_scene_that_cannot_be_baked_raises_its_sentence_and_leaves_no_file(names, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    nothing = replace(names["room"], objects=(replace(names["floor"], receives=False),))
    with pytest.raises(ValueError, match="nothing to bake"):
        core.solve(nothing, names["Settings"](size=64))
    assert not list(tmp_path.iterdir())


def test_solving_hears_of_progress_and_can_be_stopped(names):
    heard = []
    light = core.solve(names["room"], names["Settings"](size=64, error=1e-4), tell=heard.append, should_stop=lambda: True)
    assert light.stopped_by == "interrupted"
    assert light.pages["combined"].any()  # the best so far
    assert heard


# What a bake tells of its objects, and of its memory.
def test_peak_memory_is_in_megabytes():
    found = report.measure_memory_mb()
    assert not found if sys.platform == "win32" else 20 < found["core"] < 100_000


@pytest.mark.parametrize(("platform", "unit_mb"), [("linux", 1e-3), ("darwin", 1e-6)])
def test_peak_memory_is_told_in_the_units_of_the_system(monkeypatch, platform, unit_mb):
    usage = SimpleNamespace(RUSAGE_SELF=0, RUSAGE_CHILDREN=-1, getrusage=lambda who: SimpleNamespace(ru_maxrss=(5 - who) / unit_mb))
    monkeypatch.setitem(sys.modules, "resource", usage)
    monkeypatch.setattr(report.sys, "platform", platform)
    assert report.measure_memory_mb() == {"core": 5.0, "worker": 6.0}
