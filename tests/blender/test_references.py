"""The committed references of Cycles are on the layout that Leaflight makes of the samples today."""

from __future__ import annotations

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from cycles_reference import COMMITTED, OBJECTS, REFERENCES, SAMPLES, Reference, count_samples
from leaflight.addon.read.export_scene import export_scene
from leaflight.core.atlas.charts import make_charts
from leaflight.core.util.settings import Settings

PAGES = [(name, size) for size, names in COMMITTED.items() for name in sorted(names)]


@pytest.mark.parametrize(("name", "size"), PAGES)
def test_layout_is_that_of_the_reference(name, size):
    bpy.ops.wm.open_mainfile(filepath=str(SAMPLES / f"{name}.blend"), load_ui=False)
    atlas = make_charts(export_scene(bpy.context, OBJECTS.get(name)).snapshot, Settings(size=size, share_meshes=False, even_out=False))
    Reference.load(name, size).check_layout(atlas.tri_uv / atlas.page_size)


@pytest.mark.parametrize(("name", "size"), PAGES)
def test_is_of_the_kind_it_should_be(name, size):
    with np.load(REFERENCES / f"{name}_{size}.npz") as file:
        assert int(file["samples"]) == count_samples(name, size)
        assert str(file["blender"]).startswith("5.0.")  # later ones take another mean over a texel
        assert file["first"].dtype == file["second"].dtype == np.float16
