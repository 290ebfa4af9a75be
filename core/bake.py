"""A whole bake without Blender: a folder with a snapshot and a job goes in, image files and a result come out (see job)."""

from __future__ import annotations

import dataclasses
import json
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from . import (
    basis,
    chart_search,
    charts,
    checkpoint,
    contact_map,
    creases,
    debug_passes,
    earlier_bakes,
    executors,
    kept_bake,
    pages,
    preview,
    report,
    resolve,
    seam_points,
    seams,
    shared_arrays,
    solve,
    texels,
    workers,
)
from .direct_field import DirectField
from .direct_only import settle_direct
from .first_photons import FirstPhotons
from .job import LAYOUT_FILE, RESULT_FILE, SNAPSHOT_FILE, Job
from .light_field import LightField
from .lost_light import state_lost
from .materials import SurfaceMaterials, clamp_warnings
from .messages import Done, Message, Status, Warning_
from .needs import Needs, count_skipped
from .pruning import prune_scene
from .scene import SceneSnapshot
from .settings import DEBUG_PASSES, Settings
from .snapshot import load_snapshot
from .texel_map import TexelMap
from .told import group_warnings
from .words import Interrupted, Words

PREVIEW_FOLDER = "preview"


@dataclass
class Stages:
    """Seconds of each stage, told as it begins."""

    tell: Callable[[Message], None]
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str, text: str) -> Iterator[None]:
        self.tell(Status(name, text))
        begin = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - begin


def run_bake(
    folder: Path,
    tell: Callable[[Message], None],
    should_stop: Callable[[], bool],
    open_executor: Callable[[Settings], Executor] = executors.open_executor,
) -> None:
    """Bake the job in `folder`; the last message is Done.

    tell            hears every message
    should_stop     asked after every round, and while rays are sent from texels: the best so far is then written; and while an unwrapping,
                    the measuring of texels or the search for contacts takes long, which is before there is any light: then nothing is
    open_executor   where the shards run; it is shut down at the end
    Raises ValueError or OSError with a sentence for the user; no image is then left half-written.
    """
    job = Job.load(folder)
    settings = job.settings
    stages = Stages(tell)
    _open_output(Path(job.output))
    executor: Executor = executors.InlineExecutor()
    stateless = False
    try:
        with stages.stage("load", "Reading the scene"):
            snapshot = load_snapshot(folder / SNAPSHOT_FILE)
            warnings = clamp_warnings(snapshot)
            pruned, left_out = prune_scene(snapshot)
            surfaces = SurfaceMaterials(pruned)
            needs = Needs.of(settings, surfaces)
            settings = needs.trim(settings)
            if needs.direct or needs.photons:
                executor = open_executor(settings)
            first = FirstPhotons.send(folder, settings, executor) if needs.photons and not job.resume else FirstPhotons()
        with stages.stage(chart_search.UNWRAPPING.stage, chart_search.UNWRAPPING.text):
            atlas = charts.make_charts(snapshot, settings, Words(tell, should_stop).say)
            if not atlas.page_count:
                raise ValueError(_describe_no_charts(atlas))
            layout = {name: getattr(atlas, name) for name in ("tri_chart", "object_page", "object_block", "object_place")}
            np.savez(folder / LAYOUT_FILE, tri_uv=atlas.tri_uv / atlas.page_size, **layout)
            for text in earlier_bakes.describe_others(job, pages.list_names(job, snapshot, atlas)):
                tell(Warning_("", text))  # now, for there is time to stop; and not in the note, for a bake that is kept writes over nothing
        executors.wake(executor)  # not before: xatlas works beside this process
        if needs.direct and isinstance(executor, executors.LocalExecutor):
            executor.on_each(workers.open_ahead, str(folder))
        with stages.stage(texels.MEASURING.stage, texels.MEASURING.text):
            watch = Words(tell, should_stop).say
            facets = creases.cut_at_creases(snapshot, atlas)
            place = folder / workers.TEXELS_FOLDER
            shared_arrays.remove_struct(place)  # of an earlier bake in the same folder
            texel_map = texels.build_texel_map(snapshot, facets, 2 * basis.DEGREES[settings.basis], shared_arrays.Room(place), watch)
        warnings += atlas.warnings
        touched = rising = np.zeros(len(texel_map), bool)
        if needs.direct:
            with stages.stage("scene", "Building the ray tracer's tree"):
                opened = workers.open_scene(str(folder))
            warnings += opened.warnings
            if settings.contact and (needs.photons or job.resume):  # a state's texels are those of cut charts
                with stages.stage(contact_map.LOOKING.stage, contact_map.LOOKING.text):
                    threads, watch = executors.count_processors(settings.workers), Words(tell, should_stop).say
                    contacts = contact_map.find_contacts(opened, texel_map, threads, watch)
                    texel_map, facets, touched, rising = contact_map.cut_at_contacts(texel_map, facets, contacts, watch)
        shared_arrays.save_struct(place, texel_map)
        if needs.direct:
            texel_map = workers.open_tracing(str(folder)).texels  # read-only from here on, as for all processes
        for subject, text in warnings:
            tell(Warning_(subject, text))
        n_texel = len(texel_map)
        kept = checkpoint.load_checkpoint(Path(job.resume), folder, settings) if job.resume else None
        direct, shot = kept.direct if kept else DirectField.none(n_texel), True
        live, tell_live = None, tell
        if job.preview and needs.direct:
            with stages.stage("preview", "First light"):
                live = preview.PreviewPages(folder / PREVIEW_FOLDER, texel_map, surfaces, settings, tell)
                if not kept:
                    tell_live = live.join(preview.find_first_light(folder, settings, texel_map), direct)
        solver = None
        if needs.photons and not kept and settings.direct == "rays":
            with stages.stage(solve.TRACING.stage, solve.TRACING.text):
                solver = solve.Solver(folder, settings, executor, direct, touched, first=first, rising_texels=rising)
                solver.begin()
        if needs.direct and not kept:
            with stages.stage("direct", "Direct light"):
                if solver:
                    shot = solver.shoot_direct(tell_live, should_stop)
                elif settings.direct == "rays":
                    shot = direct.shoot(folder, settings, executor, range(n_texel), tell_live, should_stop)
                if not shot:  # stopped before there was anything to show: one round of photons shows all of the light, coarsely
                    settings, direct = dataclasses.replace(settings, direct="photons"), DirectField.none(n_texel)
                    solver, first = None, FirstPhotons()
                elif solver:  # processes that wait for its next photons have that to do
                    direct.begin_show(texel_map, settings.denoise, partial(executors.spread, executor))
        if needs.photons or not shot:
            with stages.stage(solve.TRACING.stage, solve.TRACING.text):
                solver = solver or solve.Solver(folder, settings, executor, direct, touched, first=first, rising_texels=rising)
                if kept:
                    kept.give_to(solver)
                if live:
                    solver.watch = live.show
                light = solver.run(tell, should_stop)
        else:
            light = settle_direct(folder, texel_map, snapshot.tri_object, settings, executor, direct, tell, should_stop)
        light, lost = state_lost(light, settings)
        for subject, text in lost:
            tell(Warning_(subject, text))
        warnings += lost
        with stages.stage("write", "Writing images"):
            files, seam_report = _write_pages(job, folder, snapshot, atlas, texel_map, light, surfaces, executor)
        if job.keep:  # only now: a bake that is thrown away while it writes has changed nothing
            with stages.stage("keep", "Keeping the state"):
                stateless = _keep_state(job, solver if shot else None, light.error, tell)
    except Interrupted:
        tell(Done("", True))
        return
    finally:
        executor.shutdown(cancel_futures=True)
        workers.forget_folders()  # the next bake may use the same folder
    result = {
        "files": [dataclasses.asdict(file) for file in files],
        "seconds": stages.seconds,
        "peak_memory_mb": report.measure_memory_mb(),
        "photons": light.photons,
        "rounds": light.rounds,
        "rays": light.ledger.rays + light.ledger.gathered + direct.counters.get("rays", 0),
        "direct": direct.counters,
        "gathered": light.gathered.counters if light.gathered else {},
        "leaves": len(light.leaves),
        "nodes": len(light.tree),
        "estimated_error": light.error,
        "error_of": settings.error_of,
        "stopped_by": light.stopped_by,
        "energy_audit_w": light.ledger.audit_w(),
        "page_size": atlas.page_size,
        "pages": atlas.page_count,
        "objects": report.list_objects(snapshot, atlas, facets.chart_object[texel_map.texel_chart], light.object_error),
        "seams": dataclasses.asdict(seam_report),
        "skipped": count_skipped(needs, left_out, snapshot, facets, light, settings),
    }
    for text in earlier_bakes.describe_left_over(job, files, atlas.page_count):
        tell(Warning_("", text))  # not in the note, for they may be gone when a bake is kept
    # What Blender is to make by the scene's view transform is not there yet, and its settings are no part of the job.
    if light.stopped_by != "interrupted" and not any(file.linear for file in files):
        try:
            kept_bake.note_bake(folder, snapshot, job, result, warnings, stateless)
        except OSError as reason:
            tell(Warning_("", f"this bake cannot be noted in {job.output} ({reason}), so the same bake will be done again"))
    (folder / RESULT_FILE).write_text(json.dumps(result), encoding="utf-8")
    tell(Done(str(folder / RESULT_FILE), light.stopped_by == "interrupted"))


def _open_output(folder: Path) -> None:
    """Makes the folder of the images; who cannot write there is told before the work, not after it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as reason:
        raise OSError(f"{folder}: images cannot be written there ({reason.strerror}); choose a folder that can be written to.") from reason


def _describe_no_charts(atlas: charts.ChartAtlas) -> str:
    told = "; ".join(told.text.removesuffix(".") for told in group_warnings(atlas.warnings))
    return f"nothing to bake: no object has a face that takes light ({told})."


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
    job: Job,
    folder: Path,
    snapshot: SceneSnapshot,
    atlas: charts.ChartAtlas,
    texel_map: TexelMap,
    light: LightField,
    surfaces: SurfaceMaterials,
    executor: Executor,
) -> tuple[list[pages.PageFile], seams.SeamReport]:
    margin = job.settings.margin
    threads = executors.count_processors(job.settings.workers)
    points = None
    if job.settings.seams and margin:  # without a margin filtering reads the empty page, and no texel helps
        points = seam_points.find_seams(snapshot, atlas.tri_chart, atlas.tri_uv, atlas.object_page[snapshot.tri_object])
    doubt = "stderr" in job.settings.passes or (points is not None and points.place.size > 0)
    at_texels = resolve.light_at_texels(
        light, texel_map, job.settings.denoise, threads, partial(executors.spread, executor), doubt, spend=not job.keep
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
    return pages.write_pages(job, folder, snapshot, atlas, metadata, draw), seam_report
