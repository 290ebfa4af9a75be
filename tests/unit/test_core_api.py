"""The core as programmers meet it: what importing costs, and the example in its docstring."""

import json
import subprocess
import sys
import textwrap

import numpy as np
import pytest
from leaflight import core
from leaflight.core.output.image_file import read_image

NATIVE = ("embreex", "xatlas", "OpenImageIO", "bpy")


def test_importing_the_core_loads_no_native_library():
    modules = ("bake.bake", "scene.scene", "scene.snapshot", "util.job", "util.messages", "util.settings")
    code = "import sys; " + "".join(f"import leaflight.core.{name}; " for name in modules) + "print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert "leaflight.core.bake.bake" in loaded
    assert set(NATIVE) & set(loaded) == set()


@pytest.mark.usefixtures("open_image_io")
def test_the_example_in_the_docstring_runs(tmp_path):
    example = textwrap.dedent(core.__doc__.partition("::\n")[2].partition("\nWith more")[0])
    exec(compile(example, "core docstring", "exec"), {"folder": tmp_path, "print": lambda message: None})
    result = json.loads((tmp_path / "result.json").read_text())
    assert [row["name"] for row in result["objects"]] == ["Floor"]
    pixels, _ = read_image(tmp_path / "room_0.combined.exr")
    lit = pixels[pixels[..., 3] == 1, 0]
    # Below a lamp of P watts at d metres Blender shows P / (4 pi^2 d^2) times the albedo.
    assert lit.max() == pytest.approx(100 / (4 * np.pi**2 * 1.5**2) * 0.5, rel=0.02)
