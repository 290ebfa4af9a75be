"""The committed references of Cycles are on the layout that Leaflight makes of the samples today."""

from __future__ import annotations

import pytest

bpy = pytest.importorskip("bpy")

from cycles_reference import COMMITTED, OBJECTS, SAMPLES, Reference
from leaflight.addon.read.export_scene import export_scene
from leaflight.core.atlas.charts import make_charts
from leaflight.core.util.settings import Settings

PAGES = [(name, size) for size, names in COMMITTED.items() for name in sorted(names)]


@pytest.mark.parametrize(("name", "size"), PAGES)
def test_layout_is_that_of_the_reference(name, size):
    bpy.ops.wm.open_mainfile(filepath=str(SAMPLES / f"{name}.blend"), load_ui=False)
    atlas = make_charts(export_scene(bpy.context, OBJECTS.get(name)).snapshot, Settings(size=size, share_meshes=False, even_out=False))
    Reference.load(name, size).check_layout(atlas.tri_uv / atlas.page_size)
