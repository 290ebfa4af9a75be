"""Scenes for the zoo's benchmark, kept in a cache folder, and bakes of them: Leaflight's, Cycles', and Cycles' after OIDN's filter."""

import hashlib
import json
import math
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import speed_rivals
from leaflight.core.output import image_file
from leaflight.core.util import ablation
from speed_curves import Point, list_more_samples
from zoo_plan import draw_plan
from zoo_reference import ABOUT, SCENE, PageReference, Subject
from zoo_results import CYCLES, ERRORS, OIDN
from zoo_scene import describe

_INTERRUPTED = 130  # exit code of a bake that was asked for its best so far


class PageFullError(RuntimeError):
    """The charts do not fit the page: what was drawn is too many small objects for it."""


@dataclass(frozen=True)
class Bake:
    """What a bake gave.

    pages    (size, size, 4) float32 of each object by name, or of all under ""
    report   of the command line; its seconds have a further entry: `loaded`, all after the .blend was loaded
    cpu_s    of all processes of the bake, with the start of Python
    """

    pages: dict[str, np.ndarray]
    report: dict
    cpu_s: float

    @property
    def layout(self) -> str:
        """What changes whenever the layer that Leaflight makes does."""
        return json.dumps(sorted((one["name"], one["texels"], one["charts"]) for one in self.report["objects"]))


def find_seed(seed: int, cache: Path, max_size: int = 0, max_triangles: int = 0) -> Subject:
    """The scene of a seed, built where the cache has none."""
    plan = draw_plan(seed, max_size, max_triangles)
    folder = cache / f"seed{seed}_{_digest(repr(plan).encode())}"
    if not (folder / SCENE).exists():
        command = [sys.executable, str(Path(__file__).with_name("scene_zoo.py")), str(seed), str(folder / SCENE)]
        command += ["--max-size", str(max_size), "--max-triangles", str(max_triangles)]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    if (folder / ABOUT).exists():
        return Subject.load(folder)
    objects = ("Joined",) if plan.joined else tuple(thing.name for thing in plan.things if thing.baked)
    subject = Subject(
        folder, f"seed {seed}", objects, "Lightmap" if plan.layout == "smart" else "", plan.size, plan.triangles, describe(plan)
    )
    subject.save()
    return subject


def find_file(blend: Path, cache: Path, size: int) -> Subject:
    """A .blend with a lightmap layer of its own, made where the cache has none; see zoo_files.py."""
    folder = cache / f"{blend.stem}_{size}_{_digest(blend.read_bytes())}"
    if not (folder / ABOUT).exists():
        command = [sys.executable, str(Path(__file__).with_name("zoo_files.py")), str(blend.resolve()), str(folder), str(size)]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return Subject.load(folder)


def bake_leaflight(subject: Subject, *options: str, without: Sequence[str] = (), patience_s: float = math.inf) -> Bake:
    """A bake of `lighting` by the command line. Raises RuntimeError with its last words where it fails, PageFullError.

    without      mechanisms of core/util/ablation.py that are switched off, besides those that the environment switches off
    patience_s   seconds after which it is asked for the best so far; a time limit would change what is done before
    """
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        command = [sys.executable, "-m", "leaflight", "bake", str(subject.blend), "--size", str(subject.size), "--pass", "lighting"]
        command += ["--output", folder, "--report", str(report), "--no-assign", "--own-meshes", "--quiet"]
        command += ["--sides", "front"]  # as Cycles, which bakes the front of a face however it is seen
        command += ["--max-pages", "1", "--no-even-out"]  # the layer of the reference, see cycles_bake.py
        command += ["--objects", *subject.objects, *(("--uv-layer", subject.uv_layer) if subject.uv_layer else ()), *options]
        before = _count_cpu_s()
        code, said = _run(command, without, patience_s)
        if code:
            kind = PageFullError if "do not fit a page" in said else RuntimeError
            raise kind(f"{subject.name}: the bake failed: {said[-500:]}")
        cpu_s = _count_cpu_s() - before
        told = json.loads(report.read_text(encoding="utf-8"))
        told["seconds"]["loaded"] = told["seconds"]["total"] - told["seconds"]["open"]
        images = {file["page"]: image_file.read_image(Path(file["path"]))[0] for file in told["files"]}
    pages = {"": images[0]} if len(images) == 1 else {one["name"]: images[one["page"]] for one in told["objects"]}
    return Bake(pages, told, cpu_s)


def _run(command: list[str], without: Sequence[str], patience_s: float) -> tuple[int, str]:
    """Exit code, 0 also of a bake that wrote its best so far because it was asked to; and what it said."""
    names = ",".join(filter(None, [os.environ.get(ablation.VARIABLE, ""), *without]))
    process = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, env=os.environ | {ablation.VARIABLE: names}
    )
    stopped = False
    try:
        _, said = process.communicate(timeout=None if math.isinf(patience_s) else patience_s)
    except subprocess.TimeoutExpired:
        stopped = True
        process.send_signal(signal.SIGINT)
        _, said = process.communicate()
    wrote = "before there was any light" not in said
    return 0 if stopped and wrote and process.returncode == _INTERRUPTED else process.returncode, said


def bake_rivals(
    subject: Subject, reference: PageReference, samples: Sequence[int], budget_s: float, turns: int
) -> dict[str, tuple[Point, ...]]:
    """Cycles and Cycles + OIDN with ever more samples, until a bake takes longer than the budget; or PATIENCE times that, while what the
    filter makes of them has not come to the least of ERRORS.
    """
    series: dict[str, list[Point]] = {CYCLES: [], OIDN: []}
    asked, limit_s = list(samples), budget_s
    while asked:
        made, _ = speed_rivals.bake_rival(subject.blend, subject.size, limit_s, asked, turns, subject.objects, subject.uv_layer)
        for label, bakes in ((CYCLES, made), (OIDN, [speed_rivals.denoise(bake, turns) for bake in made])):
            for bake in bakes:
                errors = reference.measure({"": bake.page}, subject.objects)
                series[label].append(Point(bake.seconds, errors.rel, errors.nrmse, bake.samples))
        asked = list_more_samples(series[CYCLES], series[OIDN], samples, budget_s, min(ERRORS))
        limit_s = math.inf
    return {label: tuple(points) for label, points in series.items()}


def _count_cpu_s() -> float:
    """Seconds of all processes that this one has waited for; 0 where the system does not count them."""
    if sys.platform == "win32":
        return 0.0
    import resource  # not on Windows

    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:12]
