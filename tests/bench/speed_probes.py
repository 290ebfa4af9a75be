"""One figure each of how the bake's time grows, and of what it is spent on."""

import dataclasses
import json
import math
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from boxes import prepare_folder, room_mesh
from cycles_reference import SAMPLES
from leaflight.addon.app.job import BakeProcess
from leaflight.core.atlas import unfolding
from leaflight.core.atlas.chart_search import find_charts
from leaflight.core.atlas.unwrap import Unwrapping
from leaflight.core.parallel import folders
from leaflight.core.scene.rays import Hits, RayScene
from leaflight.core.scene.scene import Light, Material, SceneSnapshot
from leaflight.core.scene.snapshot import save_snapshot
from leaflight.core.transport import photons, rounds, traced_scene
from leaflight.core.util import sampling
from leaflight.core.util.job import RESULT_FILE, SNAPSHOT_FILE, Job
from leaflight.core.util.messages import Error
from leaflight.core.util.settings import Settings
from scenes import box_mesh, grid_mesh, make_scene, moved, quad_mesh

NEVER = 1e-4  # an error that no bake here comes to, so that the photons decide
FIRST_PHOTON = "Tracing photons"  # what the command line says then


@dataclass(frozen=True)
class Sizes:
    """How large the probes are."""

    shard_photons: int = rounds.SHARD_PHOTONS
    photons: int = 16_000_000
    triangle_photons: int = 4_000_000
    triangles: tuple[int, int] = (1_000, 1_000_000)
    unwrapped: tuple[int, int] = (20_000, 80_000)
    lights: tuple[int, int] = (1, 1_000)
    glowing: tuple[int, int] = (1, 225)
    pages: tuple[int, int] = (1024, 4096)
    repeats: int = 3
    looks: int = 40  # turns of what takes less than a tenth of a second
    pairs: int = 7  # turns of two workers and one, of which a single one tells little
    objects: int = 1_000


_Bake = tuple[SceneSnapshot, Settings]
QUICK = Sizes(1 << 13, 300_000, 100_000, (200, 5_000), (200, 800), (1, 20), (1, 16), (64, 128), 1, 1, 1, 20)


def run_core(folder: Path, scene: SceneSnapshot, settings: Settings) -> dict[str, Any]:
    """The result of a bake in a process of its own, so that its peak of memory is its own; `seconds` are joined by `all`."""
    folder.mkdir()
    save_snapshot(folder / SNAPSHOT_FILE, scene)
    Job(settings, str(folder / "images"), "lightmap").save(folder)
    begin = time.perf_counter()
    for message in BakeProcess(folder).messages():
        if isinstance(message, Error):
            raise RuntimeError(message.text)
    seconds = time.perf_counter() - begin
    result: dict[str, Any] = json.loads((folder / RESULT_FILE).read_text(encoding="utf-8"))
    result["seconds"]["all"] = seconds
    return result


def compare_cores(folder: Path, first: _Bake, second: _Bake, stage: str, sizes: Sizes) -> tuple[float, dict[str, Any]]:
    """Seconds of that stage of the second bake over those of the first, medians of bakes that take turns; and a result of the second."""
    folder.mkdir()
    results = [[run_core(folder / f"{turn}_{k}", *bake) for k, bake in enumerate((first, second))] for turn in range(sizes.repeats)]
    one, other = (statistics.median(result["seconds"][stage] for result in of_bake) for of_bake in zip(*results, strict=True))
    return other / one, results[0][1]


# -- tracing --


@dataclass
class _Recorder:
    """Stands in for a scene of rays and keeps what it is asked."""

    rays: RayScene
    asked: list[tuple[np.ndarray, np.ndarray]] = dataclasses.field(default_factory=list)

    def closest(self, origin: np.ndarray, direction: np.ndarray) -> Hits:
        self.asked.append((np.ascontiguousarray(origin), np.ascontiguousarray(direction)))
        return self.rays.closest(origin, direction)


def wavefront_share(folder: Path, snapshot: SceneSnapshot, sizes: Sizes) -> dict[str, float]:
    """Rays a second of the wavefront and of embreex alone on the same rays, on one core, and their ratio `share`; the best of turns."""
    prepare_folder(folder, snapshot, Settings(size=256))
    scene = traced_scene.open_tracing(str(folder)).scene
    recorder = _Recorder(scene.rays)
    recording = dataclasses.replace(scene, rays=recorder)

    def trace(scene: photons.TraceScene) -> int:
        pieces = photons.trace_shard(scene, sizes.shard_photons, 1.0, sampling.shard_rng(1, 0, 0), 1000, True)
        return sum(hits.counters.rays for hits in pieces)

    count = trace(recording)

    def run_embree() -> None:
        for origin, direction in recorder.asked:
            scene.rays.closest(origin, direction)

    turns = [(_least_seconds(lambda: trace(scene), 1), _least_seconds(run_embree, 1)) for _ in range(sizes.looks)]
    wavefront_s, embree_s = map(min, zip(*turns, strict=True))
    folders.forget_folders()
    return {"wavefront_per_s": count / wavefront_s, "embreex_per_s": count / embree_s, "share": embree_s / wavefront_s}


def _least_seconds(call: Any, repeats: int) -> float:
    seconds = []
    for _ in range(repeats):
        begin = time.perf_counter()
        call()
        seconds.append(time.perf_counter() - begin)
    return min(seconds)


def worker_gain(folder: Path, snapshot: SceneSnapshot, sizes: Sizes) -> dict[str, float]:
    """Photons a second, refinement and all, of two workers over those of one: medians of bakes that take turns.

    As `machine`, of two bakes of one worker that share nothing over those of one: what the second core brings at the same hour.
    """
    folder.mkdir()
    settings = Settings(size=256, error=NEVER, max_photons=sizes.photons, direct="photons")

    def trace(name: str, count: int) -> float:
        return float(run_core(folder / name, snapshot, dataclasses.replace(settings, workers=count))["seconds"]["photons"])

    def trace_beside(turn: int) -> float:
        with ThreadPoolExecutor(2) as pool:
            return statistics.mean(pool.map(lambda k: trace(f"beside_{turn}_{k}", 1), range(2)))

    turns = [(trace(f"two_{turn}", 2), trace(f"one_{turn}", 1)) for turn in range(sizes.pairs)]
    beside = statistics.median(trace_beside(turn) for turn in range(sizes.repeats))
    two, one = (statistics.median(seconds) for seconds in zip(*turns, strict=True))
    return {"gain": one / two, "machine": 2.0 * one / beside}


# -- how time grows --


def page_growth(folder: Path, snapshot: SceneSnapshot, sizes: Sizes) -> dict[str, float]:
    """Time to a stated error of 5 % at the larger page size over that at the smaller, and the larger's peak of memory, MB."""
    small, large = ((snapshot, Settings(size=size)) for size in sizes.pages)
    ratio, result = compare_cores(folder, small, large, "all", sizes)
    return {"ratio": ratio, "peak_mb": peak_mb(result)}


def triangle_growth(folder: Path, sizes: Sizes) -> dict[str, float]:
    """Time of tracing over the larger number of triangles over that over the smaller, and the larger's peak of memory, MB."""
    settings = Settings(size=1024, error=NEVER, max_photons=sizes.triangle_photons, direct="photons")
    few, many = ((hills_scene(count), settings) for count in sizes.triangles)
    ratio, result = compare_cores(folder, few, many, "photons", sizes)
    return {"ratio": ratio, "peak_mb": peak_mb(result), "worker_mb": result["peak_memory_mb"].get("worker", float("nan"))}


def unwrap_growth(sizes: Sizes) -> dict[str, float]:
    """Seconds to unwrap a bumpy ground of the larger number of triangles, and their ratio to those of the smaller."""
    few, many = (make_scene([grid_mesh("Ground", math.isqrt(count // 2), noise=0.05)]) for count in sizes.unwrapped)
    unfolding.own_unfolder().start()

    def unwrap(ground: SceneSnapshot) -> None:
        Unwrapping(ground.tri_position, ground.tri_vertex, ground.tri_polygon, ground.tri_corner, ground.tri_object).finish()

    few_s, many_s = (_least_seconds(lambda ground=ground: unwrap(ground), sizes.repeats) for ground in (few, many))
    return {"ratio": many_s / few_s, "seconds": many_s}


def unwrap_objects(sizes: Sizes) -> float:
    """Seconds to unwrap so many boxes, of which no two are alike."""
    sides = np.random.default_rng(1).uniform(0.5, 2.0, (sizes.objects, 3))
    scene = make_scene([moved(box_mesh(f"Box {k}", tuple(side)), (3.0 * k, 0.0, 0.0)) for k, side in enumerate(sides.tolist())])
    unfolding.own_unfolder().start()
    return _least_seconds(lambda: find_charts(scene, True), sizes.repeats)


def light_growth(folder: Path, sizes: Sizes) -> float:
    """Time to a stated error of 5 % of many lights over that of few, of the same power together."""
    few, many = ((lights_scene(count), Settings(size=256)) for count in sizes.lights)
    return compare_cores(folder, few, many, "all", sizes)[0]


def glow_growth(folder: Path, sizes: Sizes) -> float:
    """The same of glowing boxes."""
    few, many = ((glowing_scene(count), Settings(size=256)) for count in sizes.glowing)
    return compare_cores(folder, few, many, "all", sizes)[0]


def peak_mb(result: dict[str, Any]) -> float:
    """Of the core or of its largest worker."""
    return max(result["peak_memory_mb"].values(), default=float("nan"))


def hills_scene(triangles: int) -> SceneSnapshot:
    """A bumpy square in a room, with a UV layer of its own, under a lamp: so many triangles, most of them on the square."""
    cells = max(int(np.sqrt(triangles / 2)), 1)
    grid = moved(grid_mesh("Hills", cells, noise=0.3), scale=1.8 / cells, offset_m=(-0.9, -0.9, -0.9))
    layer = [(grid.vertex[polygon, :2] + 0.9) / 1.8 for polygon in grid.polygons]
    hills = dataclasses.replace(grid, uv=layer)
    room = dataclasses.replace(room_mesh("Room", (2.0, 2.0, 2.0)), receives=False)
    lamp = Light("POINT", "Lamp", (0.2, 0.1, 0.7), power_rgb=(20.0,) * 3, radius_m=0.02)
    return make_scene([hills, room], [lamp], [Material("Grey", (0.5,) * 3)])


def lights_scene(count: int) -> SceneSnapshot:
    """A low hall of 20 x 20 m under so many lamps, of 1 kW together."""
    rng = np.random.default_rng(1)
    place = np.column_stack([rng.uniform(-9.0, 9.0, (count, 2)), rng.uniform(1.5, 1.9, count)])
    lamps = [Light("POINT", f"Lamp {i}", tuple(place[i]), power_rgb=(1000.0 / count,) * 3, radius_m=0.02) for i in range(count)]
    return make_scene([room_mesh("Hall", (20.0, 20.0, 4.0))], lamps, [Material("Grey", (0.5,) * 3)])


def glowing_scene(count: int) -> SceneSnapshot:
    """A floor of 4 x 4 m with so many glowing boxes on it, of 1 m2 of faces together, in rows and a little above it."""
    side = int(np.sqrt(count))
    edge_m = float(np.sqrt(1.0 / 6.0 / count))
    place = [((i % side + 0.5) / side * 3.6 - 1.8, (i // side + 0.5) / side * 3.6 - 1.8, 0.6 * edge_m) for i in range(side * side)]
    boxes = [dataclasses.replace(box_mesh(f"Box {i}", (edge_m,) * 3, at), receives=False) for i, at in enumerate(place)]
    scene = make_scene([moved(quad_mesh("Floor", 4.0, 4.0), (-2.0, -2.0, 0.0)), *boxes])
    materials = (Material("Grey", (0.4,) * 3), Material("Glow", (0.8,) * 3, emission_rgb=(2.0,) * 3))
    return dataclasses.replace(scene, materials=materials, tri_material=(scene.tri_object > 0).astype(np.int32))


# -- the command line --


def start_seconds(sizes: Sizes) -> float:
    """From the start of the command line to the first photon, less what importing bpy alone takes: the median of such pairs."""
    bake = ["-m", "leaflight", "bake", str(SAMPLES / "cornell_box.blend"), "--size", "256", "--direct", "photons", "--max-photons", "1000"]

    def import_alone() -> None:
        subprocess.run([sys.executable, "-c", "import bpy"], check=True)

    # Both take turns: over a second each, by the hour, and what is asked for is a small difference of them.
    turns = range(2 * sizes.repeats + 1)
    return statistics.median(_seconds_to_line([*bake, "--no-assign"], FIRST_PHOTON) - _least_seconds(import_alone, 1) for _ in turns)


def _seconds_to_line(arguments: Sequence[str], text: str) -> float:
    """Raises RuntimeError where the process ends without that line on standard error."""
    with tempfile.TemporaryDirectory() as output:
        begin = time.perf_counter()
        command = [sys.executable, *arguments, "--output", output]
        env = {**os.environ, "PYTHONDONTWRITEBYTECODE": ""}  # else each start would compile what any but a user's first finds compiled
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, encoding="utf-8", env=env) as process:
            assert process.stderr is not None
            found = None
            for line in process.stderr:
                if found is None and text in line:
                    found = time.perf_counter() - begin
    if found is None:
        raise RuntimeError(f"{' '.join(arguments)}: never said {text!r}")
    return found


def rebake_seconds(name: str = "cornell_box") -> float:
    """Of a second bake of a scene that has not changed, into the same folder, after the .blend was loaded."""
    with tempfile.TemporaryDirectory() as output:
        for _ in range(2):
            report = Path(output) / "report.json"
            command = [sys.executable, "-m", "leaflight", "bake", str(SAMPLES / f"{name}.blend"), "--size", "256", "--no-assign", "--quiet"]
            subprocess.run([*command, "--output", output, "--report", str(report)], check=True, stdout=subprocess.DEVNULL)
            seconds = json.loads(report.read_text(encoding="utf-8"))["seconds"]
    return seconds["total"] - seconds["open"]
