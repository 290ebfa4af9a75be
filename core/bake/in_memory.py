"""A bake for programs: from a scene to arrays, in this process alone, without leaving files."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from itertools import starmap
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..output import debug_passes, report
from ..parallel import executors, folders
from ..scene.scene import SceneSnapshot
from ..scene.snapshot import save_snapshot
from ..util.job import LAYOUT_FILE, SNAPSHOT_FILE, Job
from ..util.messages import Message
from ..util.settings import DEBUG_PASSES, Settings
from .find_light import Loaded, find_light, name_dark, resolve_light
from .run import Run


@dataclass(frozen=True)
class SolvedLight:
    """The light of a scene on its lightmaps.

    pages         pass -> (page_count, size, size, 4) float32, row 0 at the bottom; alpha 1 on charts; see docs/units.md
    tri_uv        (n_tri, 3, 2) float64, [0, 1]: corners of the scene's triangles
    object_page   (n_object,) int32: the page of each object, -1 without one
    error         stated relative error; nan if no photons were needed
    stopped_by    "error", "max_photons", "max_rays", "time_limit" or "interrupted"
    report        photons, rounds, rays, energy audit, and `objects` with the stated error of each
    warnings      (subject, sentence) of what was replaced or left out
    """

    pages: dict[str, NDArray[np.float32]]
    tri_uv: NDArray[np.float64]
    object_page: NDArray[np.int32]
    error: float
    stopped_by: str
    report: dict[str, Any]
    warnings: tuple[tuple[str, str], ...]


def solve_scene(
    scene: SceneSnapshot,
    settings: Settings,
    tell: Callable[[Message], None] = lambda message: None,
    should_stop: Callable[[], bool] = lambda: False,
) -> SolvedLight:
    """The light of a scene; settings.passes selects the pages. It equals that of run_bake, with any number of workers, to the byte.

    tell          receives progress
    should_stop   returns whether to stop with the best light so far
    Raises ValueError with a sentence if nothing can be baked, util.progress.Interrupted if it was stopped before there was any light.
    """
    settings = dataclasses.replace(settings, workers=1)
    # During the bake shared arrays are temporary files: large arrays are mapped, not held twice.
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as place:
        folder, executor = Path(place), executors.InlineExecutor()
        save_snapshot(folder / SNAPSHOT_FILE, scene)
        run = Run(folder, Job(settings, output=place, atlas_name="page"), tell, should_stop)
        settings = run.job.settings
        try:
            loaded = Loaded.of(run)
            found = find_light(run, loaded, executor)
            run.warn(name_dark(loaded.snapshot, found.receivers.texels, found.light))
            resolver, _ = resolve_light(found, loaded.snapshot, loaded.surfaces, settings, starmap)
            debug = debug_passes.DebugPages(found.light, found.receivers.texels, settings.margin)
            drawers = {name: debug if name in DEBUG_PASSES else resolver for name in settings.passes}
            count = found.atlas.page_count
            pages = {name: np.stack([drawer.page(name, page) for page in range(count)]) for name, drawer in drawers.items()}
            chart_object = found.receivers.facets.chart_object[found.receivers.texels.texel_chart]
            objects = report.list_objects(loaded.snapshot, found.atlas, chart_object, found.light.object_error, resolver.find_lighting())
            with np.load(folder / LAYOUT_FILE) as layout:
                tri_uv = layout["tri_uv"]
        finally:
            executor.shutdown()
            folders.forget_folders()
    light = found.light
    about = {**report.describe_light(light), "objects": objects}
    return SolvedLight(pages, tri_uv, found.atlas.object_page, light.error, light.stopped_by, about, tuple(run.warnings))
