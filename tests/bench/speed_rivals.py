"""Timed bakes of a sample on one UV layer: Leaflight, Cycles, and Cycles with OIDN's filter for lightmaps.

python tests/bench/speed_rivals.py FOLDER     the Cycles part, in a process of its own; the folder holds what is asked for
"""

import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from cycles_reference import SAMPLES, Reference
from leaflight.core.output import image_file
from speed_curves import Point, bake_in_turns

SEED = 3  # the references have 1 and 2
ASKED_FILE, TIMES_FILE, LAYOUT_FILE = "asked.json", "times.json", "layout.npy"


@dataclass(frozen=True)
class CyclesBake:
    """page   (size, size, 4) float32; alpha is 0 where nothing was baked"""

    samples: int
    seconds: float
    page: np.ndarray


def bake_leaflight(name: str, size: int, options: Sequence[str]) -> tuple[np.ndarray, dict]:
    """The lighting page and the report of a bake by the command line.

    out   (size, size, 4) float32; the report, whose seconds have a further entry: `loaded`, all after the .blend was loaded
    """
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        command = [sys.executable, "-m", "leaflight", "bake", str(SAMPLES / f"{name}.blend"), "--size", str(size), "--pass", "lighting"]
        command += ["--output", folder, "--report", str(report), "--no-assign", "--own-meshes", "--no-even-out", "--quiet", *options]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        told = json.loads(report.read_text(encoding="utf-8"))
        told["seconds"]["loaded"] = told["seconds"]["total"] - told["seconds"]["open"]
        return image_file.read_image(Path(told["files"][0]["path"]))[0], told


def bake_rival(
    blend: Path, size: int, budget_s: float, samples: Sequence[int], turns: int, objects: Sequence[str] = (), uv_layer: str = ""
) -> tuple[list[CyclesBake], np.ndarray]:
    """Bakes by Cycles with ever more samples, until the next would take longer than the budget; and the layout.

    turns               how often a short bake is timed
    objects, uv_layer   see cycles_bake.set_stage
    out                 quickest first; (n_tri, 3, 2) float64, [0, 1]
    """
    asked = {"blend": str(blend), "size": size, "budget_s": budget_s, "samples": list(samples), "turns": turns}
    with tempfile.TemporaryDirectory() as work:
        folder = Path(work)
        (folder / ASKED_FILE).write_text(json.dumps({**asked, "objects": list(objects), "uv_layer": uv_layer}), encoding="utf-8")
        subprocess.run([sys.executable, __file__, work], check=True, stdout=subprocess.DEVNULL)
        times = json.loads((folder / TIMES_FILE).read_text(encoding="utf-8"))
        bakes = [CyclesBake(int(count), seconds, np.load(folder / f"{count}.npy")) for count, seconds in times.items()]
        return bakes, np.load(folder / LAYOUT_FILE)


def denoise(bake: CyclesBake, turns: int) -> CyclesBake:
    """The page after OIDN's filter RTLightmap, and the seconds of both; empty texels take the nearest baked one's light first.

    turns   how often the filter is timed
    Raises ImportError without pyoidn or scipy, RuntimeError with OIDN's own words.
    """
    pages, seconds = zip(*(_filter_page(bake.page) for _ in range(turns)), strict=True)
    return CyclesBake(bake.samples, bake.seconds + statistics.median(seconds), pages[0])


def _filter_page(page: np.ndarray) -> tuple[np.ndarray, float]:
    import pyoidn
    from scipy.ndimage import distance_transform_edt

    begin = time.perf_counter()
    nearest = distance_transform_edt(page[..., 3] == 0.0, return_distances=False, return_indices=True)
    color = np.ascontiguousarray(page[tuple(nearest)][..., :3])
    smooth = np.zeros_like(color)
    with pyoidn.Device() as device:
        device.commit()
        with pyoidn.Filter(device, pyoidn.OIDN_FILTER_TYPE_RT_LIGHTMAP) as lightmap_filter:
            lightmap_filter.set_image(pyoidn.OIDN_IMAGE_COLOR, color, pyoidn.OIDN_FORMAT_FLOAT3)
            lightmap_filter.set_image(pyoidn.OIDN_IMAGE_OUTPUT, smooth, pyoidn.OIDN_FORMAT_FLOAT3)
            lightmap_filter.commit()
            lightmap_filter.execute()
        error = device.get_error()
    if error:
        raise RuntimeError(f"OIDN: {error}")
    return smooth, time.perf_counter() - begin


def measure_point(reference: Reference, tri_uv: np.ndarray, page: np.ndarray, seconds: float, asked: float) -> Point:
    errors = reference.measure(page, tri_uv)
    return Point(seconds, errors.rel, errors.nrmse, asked)


def main(folder: Path) -> None:
    """What bake_rival runs."""
    from cycles_bake import bake_cycles, set_stage

    asked = json.loads((folder / ASKED_FILE).read_text(encoding="utf-8"))
    samples = asked["samples"]
    with tempfile.TemporaryDirectory() as work:
        stage = set_stage(Path(asked["blend"]), asked["size"], Path(work), tuple(asked["objects"]), uv_layer=asked["uv_layer"])
    np.save(folder / LAYOUT_FILE, stage.tri_uv)
    bake_cycles(stage, 1, SEED)  # the first bake of a process loads what the others find loaded
    times: dict[float, float] = {}
    for count in samples:
        page, times[count] = bake_cycles(stage, count, SEED)
        np.save(folder / f"{count}.npy", page)
        following = samples[min(samples.index(count) + 1, len(samples) - 1)]
        if len(times) > 1 and times[count] * following / count > asked["budget_s"]:
            break
    made = bake_in_turns(times, lambda count, _: bake_cycles(stage, count, SEED)[1], asked["turns"], lambda seconds: seconds)
    times = dict(zip(times, map(statistics.median, made), strict=True))
    (folder / TIMES_FILE).write_text(json.dumps(times), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
