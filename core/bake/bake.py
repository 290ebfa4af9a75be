"""A whole bake without Blender: a folder with a snapshot and a job goes in, image files and a result come out (see job)."""

from __future__ import annotations

import dataclasses
import json
import tempfile
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..atlas.charts import ChartAtlas
from ..atlas.kept_charts import KeptCharts, find_charts_file
from ..filter import seams
from ..integrate import texel_light
from ..integrate.light_field import LightField
from ..output import debug_passes, image_room, pages, report, resolve
from ..parallel import executors, folders
from ..scene.materials import SurfaceMaterials, clamp_warnings
from ..scene.pruning import prune_scene
from ..scene.scene import SceneSnapshot
from ..scene.sides import settle_sides
from ..scene.snapshot import load_snapshot, save_snapshot
from ..texels import seam_points
from ..texels.texel_map import TexelMap
from ..transport import traced_scene
from ..util import ablation
from ..util.job import RESULT_FILE, SNAPSHOT_FILE, Job
from ..util.messages import Done, Message, Status, Warning_
from ..util.settings import DEBUG_PASSES, Settings
from ..util.words import Interrupted
from . import checkpoint, earlier_bakes, kept_bake, solve, tasks
from .dark_objects import name_dark
from .deadline import Deadline
from .first_photons import FirstPhotons
from .light_search import LightSearch
from .needs import Needs, count_skipped
from .receivers import find_receivers, lay_out
from .stages import Run

_LOADING, _WRITING, _KEEPING = Status("load", "Reading the scene"), Status("write", "Writing images"), Status("keep", "Keeping the state")


def run_bake(
    folder: Path,
    tell: Callable[[Message], None],
    should_stop: Callable[[], bool],
    open_executor: Callable[[Settings], Executor] = tasks.open_executor,
) -> None:
    """Bake the job in `folder`; the last message is Done.

    tell            hears every message
    should_stop     asked after every round, and while rays are sent from texels: the best so far is then written; and while an unwrapping,
                    the measuring of texels or the search for contacts takes long, which is before there is any light: then nothing is
    open_executor   where the shards run; it is shut down at the end
    Raises ValueError or OSError with a sentence for the user; no image is then left half-written.
    """
    job = Job.load(folder)
    job = dataclasses.replace(job, settings=ablation.trim_settings(job.settings))
    now = time.monotonic()
    deadline = Deadline(job.settings.time_limit, job.began if 0.0 < job.began <= now else now, job.after_s)
    run = Run(folder, job, tell, should_stop, deadline=deadline)
    _open_output(Path(run.job.output))
    switched_off = ablation.describe_without()
    run.warn([("", switched_off)] if switched_off else [])
    with run.stage(_LOADING):
        loaded = _Loaded.of(run)
        executor = open_executor(loaded.settings) if loaded.needs.direct else executors.InlineExecutor()
    try:
        light = _bake(run, loaded, executor)
    except Interrupted:
        if not should_stop() and deadline.is_lost():
            raise ValueError(_describe_late(run)) from None
        tell(Done("", True))
    else:
        tell(Done(str(folder / RESULT_FILE), light.stopped_by == "interrupted"))
    finally:
        executor.shutdown(cancel_futures=True)
        folders.forget_folders()  # the next bake may use the same folder


def _describe_late(run: Run) -> str:
    longest = max(run.seconds, key=lambda name: run.seconds[name], default="load")
    return (
        f"the time limit of {run.job.settings.time_limit:g} s ended before there was any light (most of it went into: {longest}); raise "
        "the time limit, choose a smaller page size, or bake fewer objects."
    )


@dataclass(frozen=True)
class _Loaded:
    """What there is to bake.

    given      the snapshot as it was exported; snapshot has the sides turned that are to be shown
    surfaces   of what has an effect
    left_out   of pruning.prune_scene
    charts     of the last bake there
    settings   of the job, without what nobody will see
    """

    given: SceneSnapshot
    snapshot: SceneSnapshot
    tri_turned: NDArray[np.bool_]
    surfaces: SurfaceMaterials
    left_out: Mapping[str, int]
    needs: Needs
    charts: KeptCharts
    settings: Settings

    @classmethod
    def of(cls, run: Run) -> _Loaded:
        given = load_snapshot(run.folder / SNAPSHOT_FILE)
        run.warn(clamp_warnings(given))
        settled = settle_sides(given, run.job.settings.sides)
        run.warn(settled.warnings)
        snapshot = settled.snapshot
        if snapshot is not given:  # the processes that trace read it there
            save_snapshot(run.folder / SNAPSHOT_FILE, snapshot)
        pruned, left_out = prune_scene(snapshot)
        surfaces = SurfaceMaterials(pruned)
        needs = Needs.of(run.job.settings, surfaces)
        charts = KeptCharts() if run.job.settings.force else KeptCharts.load(find_charts_file(run.job))
        return cls(given, snapshot, settled.tri_turned, surfaces, left_out, needs, charts, needs.trim(run.job.settings))


def _bake(run: Run, loaded: _Loaded, executor: Executor) -> LightField:
    """Writes the images and the result of the light that is found.

    Raises Interrupted where the bake was stopped before there was any.
    """
    job, folder, snapshot, needs, settings = run.job, run.folder, loaded.snapshot, loaded.needs, loaded.settings
    first = FirstPhotons.send(folder, settings, executor) if needs.photons and not job.resume else FirstPhotons()
    atlas = lay_out(run, snapshot, settings, loaded.charts, loaded.tri_turned)
    lack = image_room.find_lack(job, atlas, pages.list_names(job, snapshot, atlas))
    if lack:
        run.tell(Warning_("", lack))
    executors.wake(executor)  # not before: xatlas works beside this process
    if needs.direct and isinstance(executor, executors.LocalExecutor):
        executor.on_each(traced_scene.open_ahead, str(folder))
    # A state's texels are those of cut charts.
    receivers = find_receivers(run, snapshot, settings, atlas, executor, needs.direct, by_photons=needs.photons or bool(job.resume))
    hurried = run.deadline.is_over() and needs.photons and not job.resume
    if hurried:  # a round of photons, shown as it is, is all there is time for
        settings, first = dataclasses.replace(settings, direct="photons", gather=False), FirstPhotons()
    light, solver = LightSearch(run, settings, needs, receivers, executor, first, loaded.surfaces, snapshot.tri_object).find()
    run.warn(name_dark(snapshot, receivers.texels, light))
    with run.stage(_WRITING):
        files, spare, seam_report = _write_pages(run, hurried, snapshot, atlas, receivers.texels, light, loaded.surfaces, executor)
    stateless = False
    if job.keep:  # only now: a bake that is thrown away while it writes has changed nothing
        with run.stage(_KEEPING):
            stateless = _keep_state(job, None if hurried else solver, light.error, run.tell)
    result = {
        "files": [dataclasses.asdict(file) for file in files],
        "spare": spare,
        "seconds": run.seconds,
        "busy_seconds": executors.read_busy_seconds(executor),
        "cpu_seconds": executors.read_cpu_seconds(executor) - run.cpu_began_s,
        "processes": executors.count_processors(settings.workers),
        "peak_memory_mb": report.measure_memory_mb(),
        **report.describe_light(light),
        "error_of": settings.error_of,
        **({"without": without} if (without := ablation.list_without()) else {}),
        "page_size": atlas.page_size,
        "pages": atlas.page_count,
        "objects": report.list_objects(snapshot, atlas, receivers.facets.chart_object[receivers.texels.texel_chart], light.object_error),
        "seams": dataclasses.asdict(seam_report),
        "skipped": count_skipped(needs, loaded.left_out, snapshot, receivers.facets, light, settings, loaded.charts.known),
    }
    left_over = earlier_bakes.find_left_over(job, files, atlas.page_count)
    for text in earlier_bakes.describe_left_over(job, left_over):
        run.tell(Warning_("", text))  # not in the note, for they may be gone when a bake is kept
    # What Blender is to make by the scene's view transform is not there yet, and its settings are no part of the job.
    if light.stopped_by != "interrupted" and not spare and not any(file.linear for file in files):
        try:
            kept_bake.note_bake(folder, loaded.given, job, result, run.warnings, stateless, left_over)
        except OSError as reason:
            run.tell(Warning_("", f"this bake cannot be noted in {job.output} ({reason}), so the same bake will be done again"))
    (folder / RESULT_FILE).write_text(json.dumps(result), encoding="utf-8")
    return light


def _open_output(folder: Path) -> None:
    """Makes the folder of the images; who cannot write there is told before the work, not after it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as reason:
        raise OSError(f"{folder}: images cannot be written there ({reason.strerror}); choose a folder that can be written to.") from reason


def _keep_state(job: Job, solver: solve.Solver | None, error: float, tell: Callable[[Message], None]) -> bool:
    """Whether the bake has no state to keep, as it would have none the next time; a full disk is another matter.

    None is a bake that was stopped before it had a state, or needs none; an earlier one's fits the images no longer.
    """
    try:
        if solver is None:
            checkpoint.remove_checkpoint(Path(job.keep))
        else:
            checkpoint.save_checkpoint(Path(job.keep), solver, error, job.keep_mb * 10**6)
        return solver is None
    except (ValueError, OSError) as reason:  # the images are there all the same
        tell(Warning_("", str(reason)))
        return isinstance(reason, ValueError)


def _write_pages(
    run: Run,
    hurried: bool,
    snapshot: SceneSnapshot,
    atlas: ChartAtlas,
    texel_map: TexelMap,
    light: LightField,
    surfaces: SurfaceMaterials,
    executor: Executor,
) -> tuple[list[pages.PageFile], str, seams.SeamReport]:
    """The files, the folder that they had to go to in place of the output folder or "", and what was done at seams."""
    job, margin = run.job, run.job.settings.margin
    threads = executors.count_processors(job.settings.workers)
    points = None
    if job.settings.seams and margin and not hurried:  # without a margin filtering reads the empty page, and no texel helps
        points = seam_points.find_seams(snapshot, atlas.tri_chart, atlas.tri_uv, atlas.object_page[snapshot.tri_object])
    doubt = "stderr" in job.settings.passes or (points is not None and points.place.size > 0)
    limited = run.deadline.limit_spread(partial(executors.spread, executor), run.deadline.is_write_late)
    at_texels = texel_light.light_at_texels(
        light, texel_map, job.settings.denoise and not hurried, threads, limited, doubt, spend=not job.keep
    )
    executors.send_home(executor)
    seam_report = seams.SeamReport(0, 0, 0.0, 0.0)
    if points is not None:
        at_texels, seam_report = resolve.close_seams(at_texels, points, texel_map)
    resolver = resolve.Resolver(at_texels, texel_map, surfaces, margin, threads)
    debug = debug_passes.DebugPages(light, texel_map, margin)

    def draw(name: str, page: int, look: bool) -> NDArray[np.float32]:
        if name not in DEBUG_PASSES:
            return resolver.page(name, page)
        return debug.look(name, page, lambda: resolver.page("combined", page)) if look else debug.page(name, page)

    metadata: dict[str, str | int | float] = {"leaflight:photons": light.photons, "leaflight:estimated_error": light.error}

    def write(to: Job) -> list[pages.PageFile]:
        return pages.write_pages(to, run.folder, snapshot, atlas, metadata, draw)

    files, spare, told = image_room.write_somewhere(job, run.folder.parent, write)
    if told:
        run.tell(Warning_("", told))
    return files, spare, seam_report
