"""From a job and its scene to the light on texels; the images are written later."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..atlas.chart_cache import ChartCache, find_charts_file
from ..atlas.charts import ChartAtlas
from ..filter import seams
from ..filter.denoise import Spread
from ..integrate import texel_light
from ..integrate.light_field import LightField
from ..output import image_room, pages, resolve
from ..parallel import executors
from ..scene.dark_places import describe_dark
from ..scene.light_probe import LightProbe
from ..scene.materials import SurfaceMaterials, clamp_warnings
from ..scene.pruning import prune_scene
from ..scene.scene import SceneSnapshot
from ..scene.sides import settle_sides
from ..scene.snapshot import load_snapshot, save_snapshot
from ..texels import seam_points
from ..texels.texel_map import TexelMap
from ..transport import traced_scene
from ..util.job import SNAPSHOT_FILE
from ..util.messages import Warning_
from ..util.settings import Settings
from . import solve
from .first_photons import FirstPhotons
from .light_search import LightSearch
from .receiving_texels import Receivers, find_receivers, lay_out
from .run import Run
from .work_plan import WorkPlan


@dataclass(frozen=True)
class Loaded:
    """A scene, loaded and prepared.

    given        the snapshot as it was exported
    snapshot     the same after sides.settle_sides, which turns faces whose back is the side to bake
    tri_turned   (n_tri,) bool: the faces that it turned
    surfaces     materials of the pruned scene
    left_out     counts from pruning.prune_scene
    needs        the light that the images need
    charts       charts of the last bake in this folder
    settings     those of the job, without what no image shows
    """

    given: SceneSnapshot
    snapshot: SceneSnapshot
    tri_turned: NDArray[np.bool_]
    surfaces: SurfaceMaterials
    left_out: Mapping[str, int]
    needs: WorkPlan
    charts: ChartCache
    settings: Settings

    @classmethod
    def of(cls, run: Run) -> Loaded:
        given = load_snapshot(run.folder / SNAPSHOT_FILE)
        run.warn(clamp_warnings(given))
        settled = settle_sides(given, run.job.settings.sides)
        run.warn(settled.warnings)
        snapshot = settled.snapshot
        if snapshot is not given:  # the tracing processes read it from the file
            save_snapshot(run.folder / SNAPSHOT_FILE, snapshot)
        pruned, left_out = prune_scene(snapshot)
        surfaces = SurfaceMaterials(pruned)
        needs = WorkPlan.of(run.job.settings, surfaces)
        charts = ChartCache() if run.job.settings.force else ChartCache.load(find_charts_file(run.job))
        return cls(given, snapshot, settled.tri_turned, surfaces, left_out, needs, charts, needs.trim(run.job.settings))


@dataclass(frozen=True)
class FoundLight:
    """The light of a bake before it becomes pages.

    solver       has the state to keep; None if there is none
    settings     the settings with which the light was found
    is_hurried   whether a time limit left time for one round of photons only, which is shown without filter
    """

    light: LightField
    solver: solve.Solver | None
    atlas: ChartAtlas
    receivers: Receivers
    settings: Settings
    is_hurried: bool


def find_light(run: Run, loaded: Loaded, executor: executors.ShardExecutor) -> FoundLight:
    """Lay out charts and texels, and find the light on them.

    Raises ValueError with a sentence if nothing can be baked, Interrupted if the bake was stopped before there was any light.
    """
    job, folder, snapshot, needs, settings = run.job, run.folder, loaded.snapshot, loaded.needs, loaded.settings
    first = FirstPhotons.send(folder, settings, executor) if needs.photons and not job.resume else FirstPhotons()
    atlas = lay_out(run, snapshot, settings, loaded.charts, loaded.tri_turned)
    lack = image_room.find_lack(job, atlas, pages.list_names(job, snapshot, atlas))
    if lack:
        run.tell(Warning_("", lack))
    executor.wake()  # not before: xatlas works beside this process
    if needs.direct:
        executor.on_each(traced_scene.open_ahead, str(folder))
    # A state has the texels of charts that are cut along contacts.
    receivers = find_receivers(run, snapshot, settings, atlas, executor, needs.direct, by_photons=needs.photons or bool(job.resume))
    hurried = run.deadline.is_over() and needs.photons and not job.resume
    if hurried:  # there is time for one round of photons only
        settings, first = dataclasses.replace(settings, direct="photons"), FirstPhotons()
    light, solver = LightSearch(run, settings, needs, receivers, executor, first, loaded.surfaces, snapshot.tri_object).find()
    return FoundLight(light, solver, atlas, receivers, settings, hurried)


def name_dark(snapshot: SceneSnapshot, texels: TexelMap, light: LightField) -> list[tuple[str, str]]:
    """(name, sentence) of each object that has texels but no light on any of them, with the reason; none if the bake was interrupted."""
    if light.stopped_by == "interrupted":
        return []
    texel_object = snapshot.tri_object[texels.texel_tri]
    is_dark = np.zeros(len(snapshot.objects), bool)
    is_dark[texel_object] = True
    is_dark[texel_object[light.direct.irradiance.any(axis=1)]] = False
    lit = light.leaves[light.solution.flux[:, light.leaves].any(axis=0)]
    is_dark[texel_object[light.tree.start[lit]]] = False
    dark = np.flatnonzero(is_dark)
    return describe_dark(LightProbe(snapshot), dark.tolist()) if len(dark) else []


def resolve_light(
    found: FoundLight, snapshot: SceneSnapshot, surfaces: SurfaceMaterials, settings: Settings, spread: Spread, spend: bool = False
) -> tuple[resolve.Resolver, seams.SeamReport]:
    """The resolver, which makes pages of the light, and a report on seams.

    settings   those of the job
    spread     distributes work among the processes
    spend      as for texel_light.light_at_texels
    """
    texels, margin, points = found.receivers.texels, settings.margin, None
    if settings.seams and margin and not found.is_hurried:  # without a margin, filtering reads the empty page, whatever the texels are
        points = seam_points.find_seams(snapshot, found.atlas.tri_chart, found.atlas.tri_uv, found.atlas.object_page[snapshot.tri_object])
    doubt = "stderr" in settings.passes or (points is not None and points.place.size > 0)
    smooth, threads = settings.denoise and not found.is_hurried, executors.count_processors(settings.workers)
    light = texel_light.light_at_texels(found.light, texels, smooth, threads, spread, doubt, spend=spend)
    report = seams.SeamReport(0, 0, 0.0, 0.0)
    if points is not None:
        light, report = resolve.close_seams(light, points, texels)
    return resolve.Resolver(light, texels, surfaces, margin, threads), report
