"""A whole bake without Blender, from a folder with a snapshot and a job to image files and a result (see util.job)."""

from __future__ import annotations

import dataclasses
import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..filter import seams
from ..integrate.light_field import LightField
from ..output import debug_passes, image_room, pages, report
from ..parallel import executors, folders
from ..scene.materials import SurfaceMaterials
from ..scene.scene import SceneSnapshot
from ..util.arrays import Float32
from ..util.job import RESULT_FILE, Job
from ..util.messages import Done, Message, Status, Warning_
from ..util.progress import Interrupted
from ..util.settings import DEBUG_PASSES, Settings
from . import bake_cache, checkpoint, earlier_bakes, solve, tasks
from .deadline import Deadline
from .find_light import FoundLight, Loaded, find_light, name_dark, resolve_light
from .run import Run
from .work_plan import count_skipped

_LOADING, _WRITING, _KEEPING = Status("load", "Opening the scene"), Status("write", "Writing images"), Status("keep", "Keeping the state")


def run_bake(
    folder: Path,
    tell: Callable[[Message], None],
    should_stop: Callable[[], bool],
    open_executor: Callable[[Settings], executors.ShardExecutor] = tasks.open_executor,
) -> None:
    """Bake the job in `folder`; the last message is Done.

    tell            receives every message
    should_stop     polled after every round and while rays are sent from texels: once it is true, the best light so far is written. Also
                    polled during unwrapping, measuring of texels and the search for contacts: then there is no light and nothing is written
    open_executor   makes the executor of the shards; it is shut down at the end
    Raises ValueError or OSError with a sentence for the user; no image is then left half-written.
    """
    job = Job.load(folder)
    now = time.monotonic()
    deadline = Deadline(job.settings.time_limit, job.began if 0.0 < job.began <= now else now, job.after_s)
    run = Run(folder, job, tell, should_stop, deadline=deadline)
    _open_output(Path(run.job.output))
    with run.stage(_LOADING):
        loaded = Loaded.of(run)
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


def _bake(run: Run, loaded: Loaded, executor: executors.ShardExecutor) -> LightField:
    """Find the light and write its images and the result.

    Raises Interrupted if the bake was stopped before there was any light.
    """
    job, folder, snapshot, needs = run.job, run.folder, loaded.snapshot, loaded.needs
    found = find_light(run, loaded, executor)
    light, atlas, receivers, settings = found.light, found.atlas, found.receivers, found.settings
    run.warn(name_dark(snapshot, receivers.texels, light))
    with run.stage(_WRITING):
        files, spare, seam_report, lighting = _write_pages(run, snapshot, found, loaded.surfaces, executor)
    texel_object = receivers.facets.chart_object[receivers.texels.texel_chart]
    stateless = False
    if job.keep:  # after the images, so that a bake killed while it writes them leaves the earlier state as it was
        with run.stage(_KEEPING):
            stateless = _keep_state(job, None if found.is_hurried else found.solver, light.error, run.tell)
    result = {
        "files": [dataclasses.asdict(file) for file in files],
        "spare": spare,
        "seconds": run.seconds,
        "busy_seconds": executor.busy.read(),
        "cpu_seconds": executor.busy.read_cpu_s() - run.cpu_began_s,
        "processes": executors.count_processors(settings.workers),
        "peak_memory_mb": report.measure_memory_mb(),
        **report.describe_light(light),
        "error_of": settings.error_of,
        "page_size": atlas.page_size,
        "pages": atlas.page_count,
        "objects": report.list_objects(snapshot, atlas, texel_object, light.object_error, lighting),
        "seams": dataclasses.asdict(seam_report),
        "skipped": count_skipped(needs, loaded.left_out, snapshot, receivers.facets, light, settings, loaded.charts.known),
    }
    left_over = earlier_bakes.find_left_over(job, files, atlas.page_count)
    for text in earlier_bakes.describe_left_over(job, left_over):
        run.tell(Warning_("", text))  # not part of the note, since the files may be gone when the bake is reused
    # A bake is not noted where Blender still has to apply the view transform, whose settings are not part of the job.
    if light.stopped_by != "interrupted" and not spare and not any(file.linear for file in files):
        try:
            bake_cache.note_bake(folder, loaded.given, job, result, run.warnings, stateless, left_over)
        except OSError as reason:
            run.tell(Warning_("", f"this bake cannot be noted in {job.output} ({reason}), so the same bake will be done again"))
    (folder / RESULT_FILE).write_text(json.dumps(result), encoding="utf-8")
    return light


def _open_output(folder: Path) -> None:
    """Create the output folder and test that it is writable before the work begins."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as reason:
        raise OSError(f"{folder}: images cannot be written there ({reason.strerror}); choose a folder that can be written to.") from reason


def _keep_state(job: Job, solver: solve.Solver | None, error: float, tell: Callable[[Message], None]) -> bool:
    """Keep the solver's state. Returns whether the bake has none to keep and would have none if repeated; False if the disk is full.

    solver   None if the bake stopped before it had a state, or needs none; an earlier state, which does not fit the images, is removed
    """
    try:
        if solver is None:
            checkpoint.remove_checkpoint(Path(job.keep))
        else:
            checkpoint.save_checkpoint(Path(job.keep), solver, error, job.keep_mb * 10**6)
        return solver is None
    except (ValueError, OSError) as reason:  # the images are written regardless
        tell(Warning_("", str(reason)))
        return isinstance(reason, ValueError)


def _write_pages(
    run: Run, snapshot: SceneSnapshot, found: FoundLight, surfaces: SurfaceMaterials, executor: executors.ShardExecutor
) -> tuple[list[pages.PageFile], str, seams.SeamReport, Float32]:
    """Write the images.

    Returns their files, the spare folder if the output folder failed, else "", a report on seams, and Resolver.find_lighting().
    """
    job, margin, atlas, texel_map = run.job, run.job.settings.margin, found.atlas, found.receivers.texels
    limited = run.deadline.limit_spread(executor.spread, run.deadline.is_write_late)
    resolver, seam_report = resolve_light(found, snapshot, surfaces, job.settings, limited, spend=not job.keep)
    executor.send_home()
    light = found.light
    debug = debug_passes.DebugPages(light, texel_map, margin)

    def draw(name: str, page: int, look: bool) -> NDArray[np.float32]:
        if name not in DEBUG_PASSES:
            return resolver.page(name, page)
        return debug.look(name, page, lambda: resolver.page("combined", page)) if look else debug.page(name, page)

    metadata: dict[str, str | int | float] = {"leaflight:photons": light.photons, "leaflight:estimated_error": light.error}

    def write(to: Job) -> list[pages.PageFile]:
        return pages.write_pages(to, run.folder, snapshot, atlas, metadata, draw)

    files, spare, sentence = image_room.write_somewhere(job, run.folder.parent, write)
    if sentence:
        run.tell(Warning_("", sentence))
    return files, spare, seam_report, resolver.find_lighting()
