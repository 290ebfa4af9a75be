"""A whole bake without Blender: a folder with a snapshot and a job goes in, image files and a result come out (see job)."""

from __future__ import annotations

import dataclasses
import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import basis, charts, contact, image_file, kept_bake, resolve, shared_arrays, solve, texels, workers
from .direct_field import DirectField
from .direct_only import settle_direct
from .job import LAYOUT_FILE, RESULT_FILE, SNAPSHOT_FILE, Job, make_file_name
from .materials import SurfaceMaterials, clamp_warnings
from .messages import Done, Message, Status, Warning_
from .needs import Needs, count_skipped
from .pruning import prune_scene
from .scene import SceneSnapshot
from .snapshot import load_snapshot
from .texel_map import TexelMap


@dataclass(frozen=True)
class PageFile:
    """One image file: a page of a pass; `objects` are indices into the snapshot's objects."""

    path: str
    pass_name: str
    kind: str
    page: int
    objects: list[int]


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


def run_bake(folder: Path, tell: Callable[[Message], None], should_stop: Callable[[], bool]) -> None:
    """Bake the job in `folder`; the last message is Done.

    tell          hears every message
    should_stop   asked after every round; the best so far is then written
    Raises ValueError or OSError with a sentence for the user; no image is then left half-written.
    """
    job = Job.load(folder)
    settings = job.settings
    stages = Stages(tell)
    _open_output(Path(job.output))
    executor: Executor = workers.InlineExecutor()
    try:
        with stages.stage("load", "Reading the scene"):
            snapshot = load_snapshot(folder / SNAPSHOT_FILE)
            warnings = clamp_warnings(snapshot)
            pruned, left_out = prune_scene(snapshot)
            surfaces = SurfaceMaterials(pruned)
            needs = Needs.of(settings, surfaces)
            settings = needs.trim(settings)
            if needs.direct or needs.photons:
                executor = workers.open_executor(settings)
        with stages.stage("charts", "Unwrapping"):
            atlas = charts.make_charts(snapshot, settings)
            if not atlas.page_count:
                raise ValueError(_describe_no_charts(atlas))
            np.savez(folder / LAYOUT_FILE, tri_uv=atlas.tri_uv / atlas.page_size, tri_chart=atlas.tri_chart, object_page=atlas.object_page)
        with stages.stage("texels", "Measuring texels"):
            texel_map = texels.build_texel_map(snapshot, atlas, 2 * basis.DEGREES[settings.basis])
            shared_arrays.remove_struct(folder / workers.TEXELS_FOLDER)  # of an earlier bake in the same folder
            shared_arrays.save_struct(folder / workers.TEXELS_FOLDER, texel_map)
        warnings += atlas.warnings
        if needs.direct:
            with stages.stage("scene", "Building the ray tracer's tree"):
                tracing = workers.open_tracing(str(folder))
            warnings += tracing.warnings
        for subject, text in warnings:
            tell(Warning_(subject, text))
        n_texel = len(texel_map.texel_area)
        direct, shot = DirectField.none(n_texel), True
        if needs.direct:
            with stages.stage("direct", "Direct light"):
                shot = settings.direct == "photons" or direct.shoot(folder, settings, executor, np.arange(n_texel), tell, should_stop)
                if not shot:  # stopped before there was anything to show: one round of photons shows all of the light, coarsely
                    settings, direct = dataclasses.replace(settings, direct="photons"), DirectField.none(n_texel)
        if needs.photons or not shot:
            with stages.stage("photons", "Tracing photons"):
                forced = _find_contacts(tracing, texel_map) if settings.contact else np.zeros(n_texel, bool)
                light = solve.Solver(folder, settings, executor, direct, forced).run(tell, should_stop)
        else:
            light = settle_direct(folder, texel_map, settings, executor, direct, tell, should_stop)
        with stages.stage("write", "Writing images"):
            files = _write_pages(job, snapshot, atlas, texel_map, light, surfaces)
    finally:
        executor.shutdown(cancel_futures=True)
        workers.forget_folders()  # the next bake may use the same folder
    result = {
        "files": [dataclasses.asdict(file) for file in files],
        "seconds": stages.seconds,
        "peak_memory_mb": peak_memory_mb(),
        "photons": light.photons,
        "rounds": light.rounds,
        "rays": light.ledger.rays + direct.counters.get("rays", 0),
        "direct": direct.counters,
        "leaves": len(light.leaves),
        "nodes": len(light.tree),
        "estimated_error": light.error,
        "stopped_by": light.stopped_by,
        "energy_audit_w": light.ledger.audit_w(light.photons),
        "page_size": atlas.page_size,
        "pages": atlas.page_count,
        "objects": _object_rows(snapshot, atlas, texel_map),
        "skipped": count_skipped(needs, left_out, snapshot, atlas, light, settings),
    }
    if light.stopped_by != "interrupted":
        try:
            kept_bake.note_bake(folder, snapshot, job, result, warnings)
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
    told = "; ".join(f"{subject}: {text}" for subject, text in atlas.warnings)
    return f"nothing to bake: no object has a face that takes light ({told})"


def _find_contacts(tracing: workers.Tracing, texel_map: TexelMap) -> NDArray[np.bool_]:
    tri = texel_map.texel_tri
    position_m = np.einsum("nk,nkj->nj", texel_map.texel_bary, tracing.snapshot.tri_position[tri])
    size = np.sqrt(texel_map.tri_density[tri]) * tracing.unit_box.scale
    return contact.find_contacts(tracing.scene.rays, tracing.unit_box.to_unit(position_m), tracing.scene.tri_normal[:, tri].T, size)


def _write_pages(
    job: Job, snapshot: SceneSnapshot, atlas: charts.ChartAtlas, texel_map: TexelMap, light: solve.LightField, surfaces: SurfaceMaterials
) -> list[PageFile]:
    settings = job.settings
    entry_page = atlas.chart_page[texel_map.texel_chart]
    at_texels = resolve.light_at_texels(light, texel_map, entry_page)
    resolver = resolve.Resolver(at_texels, texel_map, surfaces, entry_page, settings.margin)
    output = Path(job.output)
    names = _page_names(job, snapshot, atlas)
    files: list[PageFile] = []
    for page in range(atlas.page_count):
        for pass_name in settings.passes:
            metadata: dict[str, str | int | float] = {
                "leaflight:pass": pass_name,
                "leaflight:photons": light.photons,
                "leaflight:estimated_error": light.error,
            }
            pixels = resolver.page(pass_name, page)
            for kind in settings.formats:
                path = output / f"{names[page]}.{pass_name}.{kind}"
                try:
                    image_file.write_image(path, pixels, metadata, kind)
                except (OSError, ValueError):
                    for file in files:  # half a bake looks like a whole one
                        Path(file.path).unlink(missing_ok=True)
                    raise
                files.append(PageFile(str(path), pass_name, kind, page, np.flatnonzero(atlas.object_page == page).tolist()))
    return files


def _page_names(job: Job, snapshot: SceneSnapshot, atlas: charts.ChartAtlas) -> list[str]:
    """One file name for each page, unique also where names differ only by characters that files cannot have."""
    names: list[str] = []
    for page in range(atlas.page_count):
        owners = np.flatnonzero(atlas.object_page == page)
        alone = not job.settings.atlas and len(owners) == 1
        name = make_file_name(snapshot.objects[owners[0]].name) if alone else f"{make_file_name(job.atlas_name)}_{page}"
        while name.lower() in (other.lower() for other in names):
            name += "_"
        names.append(name)
    return names


def _object_rows(snapshot: SceneSnapshot, atlas: charts.ChartAtlas, texel_map: TexelMap) -> list[dict[str, Any]]:
    entry_object = atlas.chart_object[texel_map.texel_chart]
    texel_count = np.bincount(entry_object, minlength=len(snapshot.objects))
    chart_count = np.bincount(atlas.chart_object, minlength=len(snapshot.objects))
    return [
        {"name": one.name, "page": int(atlas.object_page[i]), "texels": int(texel_count[i]), "charts": int(chart_count[i])}
        for i, one in enumerate(snapshot.objects)
        if one.receives
    ]


def peak_memory_mb() -> dict[str, float]:
    """Peak resident memory of this process and of its largest worker, MB; empty where the system does not tell."""
    if sys.platform == "win32":
        return {}
    import resource  # not on Windows

    unit = 1e6 if sys.platform == "darwin" else 1e3  # macOS counts bytes, Linux kilobytes
    who = {"core": resource.RUSAGE_SELF, "worker": resource.RUSAGE_CHILDREN}
    return {name: round(resource.getrusage(usage).ru_maxrss / unit, 1) for name, usage in who.items()}
