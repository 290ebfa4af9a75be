"""Charts and texels of what takes light, before there is any."""

from dataclasses import replace

import pytest
from boxes import lamp_scene
from leaflight.core.atlas.chart_cache import ChartCache
from leaflight.core.bake.receiving_texels import find_receivers, lay_out
from leaflight.core.bake.run import Run
from leaflight.core.parallel import executors
from leaflight.core.scene.snapshot import save_snapshot
from leaflight.core.texels import creases
from leaflight.core.util.job import LAYOUT_FILE, SNAPSHOT_FILE, Job
from leaflight.core.util.messages import Status
from leaflight.core.util.settings import Settings
from scenes import make_scene, quad_mesh

SMALL = Settings(size=64, padding=1, workers=1)


@pytest.fixture
def run(tmp_path):
    """A bake that tells all into `run.told`."""
    told = []
    (tmp_path / "images").mkdir()
    found = Run(tmp_path, Job(SMALL, str(tmp_path / "images"), "room"), told.append, lambda: False)
    found.told = told
    return found


@pytest.fixture
def scene(tmp_path):
    """A block on a floor, in the folder of `run`."""
    found = lamp_scene()
    save_snapshot(tmp_path / SNAPSHOT_FILE, found)
    return found


def find(run, scene, settings=SMALL, lit=True, by_photons=True, executor=None):
    atlas = lay_out(run, scene, settings, ChartCache())
    return atlas, find_receivers(run, scene, settings, atlas, executor or executors.InlineExecutor(), lit, by_photons)


def list_stages(run):
    return list(dict.fromkeys(message.stage for message in run.told if isinstance(message, Status)))


def test_nothing_to_unwrap_is_a_sentence_with_the_reason(run):
    hidden = make_scene([quad_mesh("Floor")])
    hidden = replace(hidden, objects=tuple(replace(one, receives=False) for one in hidden.objects))
    with pytest.raises(ValueError, match=r"^nothing to bake: no object has a face that takes light \(.*\)\.$"):
        lay_out(run, hidden, SMALL, ChartCache())
    assert not (run.folder / LAYOUT_FILE).exists()


def test_leaves_are_cut_where_the_block_stands_on_the_floor(run, scene):
    atlas, found = find(run, scene)
    assert list_stages(run) == list(run.seconds) == ["charts", "texels", "scene", "contacts"]
    at_foot = scene.tri_object[found.texels.texel_tri[found.touched]]
    assert set(at_foot) == {0, 1}
    assert len(found.facets.chart_page) > len(creases.cut_at_creases(scene, atlas).chart_page)  # what lies below the block
