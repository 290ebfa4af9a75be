"""The order in which light is sought, and what is left when that is stopped or has nothing to seek."""

from dataclasses import replace

import numpy as np
import pytest
from boxes import lamp_scene
from leaflight.core.atlas.chart_cache import ChartCache
from leaflight.core.bake import checkpoint
from leaflight.core.bake.first_photons import FirstPhotons
from leaflight.core.bake.light_search import PREVIEW_FOLDER, LightSearch
from leaflight.core.bake.receiving_texels import find_receivers, lay_out
from leaflight.core.bake.run import Run
from leaflight.core.bake.solve import Solver
from leaflight.core.bake.work_plan import WorkPlan
from leaflight.core.integrate import direct_shards
from leaflight.core.integrate.direct_field import DirectField
from leaflight.core.integrate.direct_shards import ShotAhead
from leaflight.core.parallel import executors, folders
from leaflight.core.scene.materials import SurfaceMaterials
from leaflight.core.scene.snapshot import save_snapshot
from leaflight.core.util.job import SNAPSHOT_FILE, Job
from leaflight.core.util.messages import Preview, Status
from leaflight.core.util.settings import Settings

QUICK = Settings(size=32, padding=1, workers=1, error=0.3, max_photons=20_000)


@pytest.fixture
def seek(tmp_path):
    """Finds the light of a lamp over a block: run, light and solver."""

    def find(settings=QUICK, should_stop=lambda: False, first=None, **job):
        scene, told = lamp_scene(), []
        folder = tmp_path / f"job_{len(list(tmp_path.glob('job_*')))}"
        folder.mkdir()
        save_snapshot(folder / SNAPSHOT_FILE, scene)
        run = Run(folder, Job(settings, str(tmp_path / "images"), "room", **job), told.append, should_stop)
        run.told = told
        surfaces = SurfaceMaterials(scene)
        needs = WorkPlan.of(settings, surfaces)
        settings = needs.trim(settings)
        atlas, executor = lay_out(run, scene, settings, ChartCache()), executors.InlineExecutor()
        receivers = find_receivers(run, scene, settings, atlas, executor, needs.direct, needs.photons)
        told.clear()
        first = first(run) if first else FirstPhotons()
        search = LightSearch(run, settings, needs, receivers, executor, first, surfaces, scene.tri_object)
        return run, *search.find()

    yield find
    folders.forget_folders()


def list_stages(run):
    return [message.stage for message in run.told if isinstance(message, Status)]


def test_photons_tell_shadow_rays_how_sure_they_must_be(seek):
    run, light, solver = seek()
    assert list_stages(run) == ["photons", "direct", "photons"]
    assert (light.direct.passes > 0).all()
    assert light.photons == solver.ledger.photons > 0
    assert light.stopped_by == "error"


def test_the_first_rays_are_on_their_way_before_trees_are_grown(seek, monkeypatch):
    done = []
    send, post_init = ShotAhead.send, Solver.__post_init__
    monkeypatch.setattr(ShotAhead, "send", lambda *asked: done.append("rays") or send(*asked))
    monkeypatch.setattr(Solver, "__post_init__", lambda solver: done.append("trees") or post_init(solver))
    seek()
    assert done[:2] == ["rays", "trees"]
    done.clear()
    seek(replace(QUICK, direct="photons"))
    assert "rays" not in done


def test_photons_alone_bring_all_light(seek):
    run, light, solver = seek(replace(QUICK, direct="photons"))
    assert not light.direct.passes.any()
    assert light.solution.coefficient[0].any()
    assert solver is not None
    assert list_stages(run) == ["direct", "photons"]


def test_light_straight_from_lamps_takes_no_solver(seek):
    _, light, solver = seek(replace(QUICK, passes=("direct",)))
    assert solver is None
    assert light.photons == 0
    assert light.direct.irradiance.any()


def test_surfaces_alone_take_no_light(seek):
    run, light, solver = seek(replace(QUICK, passes=("albedo",)))
    assert list_stages(run) == []
    assert solver is None
    assert not light.direct.irradiance.any()


def test_who_stops_before_the_rays_are_done_sees_all_light_by_a_few_photons_and_keeps_no_state(seek, monkeypatch):
    """And nothing of what was begun: some texels would have light of rays, and others the same of photons."""
    monkeypatch.setattr(direct_shards, "SHARD_TEXELS", 100)
    monkeypatch.setattr(DirectField, "begin_show", lambda *_: pytest.fail("smoothed for nobody"))
    asked = []
    run, light, solver = seek(should_stop=lambda: asked.append(1) or len(asked) > 2)
    assert solver is None
    assert light.stopped_by == "interrupted"
    assert not light.direct.passes.any()
    assert not light.direct.irradiance.any()
    assert light.solution.coefficient[0].any()  # light straight from lamps too
    assert list_stages(run)[-1] == "photons"


def test_photons_that_were_traced_ahead_for_rays_are_not_taken_for_photons_alone(seek):
    """Which bring light straight from lamps too."""
    taken = []

    class Told(FirstPhotons):
        def take(self, shard):
            taken.append(len(list_stages(self.sent)))
            return shard

    seek(should_stop=lambda: True, first=Told)
    assert set(taken) == {1}  # before there was direct light


def test_a_viewport_sees_light_before_all_else(seek):
    run, light, _ = seek(preview=True)
    first = next(i for i, message in enumerate(run.told) if isinstance(message, Preview))
    assert [message.stage for message in run.told[:first]] == ["preview"]
    assert (run.folder / PREVIEW_FOLDER).is_dir()
    _, alone, _ = seek()
    assert np.array_equal(light.solution.coefficient, alone.solution.coefficient)  # and is the same as if nobody had


def test_a_bake_goes_on_from_a_kept_state(seek, tmp_path, monkeypatch):
    _, light, solver = seek()
    checkpoint.save_checkpoint(tmp_path / "state", solver, light.error)
    monkeypatch.setattr("leaflight.core.bake.preview.find_first_light", lambda *_: pytest.fail("there is light already"))
    more = replace(QUICK, max_photons=40_000, error=1e-3)
    again, better, _ = seek(more, resume=str(tmp_path / "state"), preview=True)
    assert list_stages(again) == ["preview", "photons"]  # what shadow rays found is there
    assert better.photons == 40_000
    assert better.rounds > light.rounds


def test_light_that_was_lost_is_warned_of(seek, monkeypatch):
    monkeypatch.setattr("leaflight.core.bake.light_search.state_lost", lambda light, settings: (light, [("Room", "is dark")]))
    run, *_ = seek()
    assert run.warnings == [("Room", "is dark")]
