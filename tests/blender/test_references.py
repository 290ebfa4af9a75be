"""The committed references of Cycles are on the layout that Leaflight makes of the samples today."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

sys.path.append(str(Path(__file__).resolve().parents[1] / "bench"))

from cycles_reference import OBJECTS, REFERENCES, SAMPLE_COUNTS, SAMPLES, Reference
from leaflight.addon.export_scene import export_scene
from leaflight.core.charts import make_charts
from leaflight.core.settings import Settings


@pytest.mark.parametrize("name", sorted(SAMPLE_COUNTS))
def test_layout_is_that_of_the_reference(name):
    bpy.ops.wm.open_mainfile(filepath=str(SAMPLES / f"{name}.blend"), load_ui=False)
    atlas = make_charts(export_scene(bpy.context, OBJECTS.get(name)).snapshot, Settings(size=256, share_meshes=False))
    Reference.load(name).check_layout(atlas.tri_uv / atlas.page_size)


@pytest.mark.parametrize("name", sorted(SAMPLE_COUNTS))
def test_is_of_the_kind_it_should_be(name):
    with np.load(REFERENCES / f"{name}_256.npz") as file:
        assert int(file["samples"]) == SAMPLE_COUNTS[name]
        assert str(file["blender"]).startswith("5.0.")  # later ones take another mean over a texel
        assert file["first"].dtype == file["second"].dtype == np.float16
