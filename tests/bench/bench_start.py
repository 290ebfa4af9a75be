"""How long a bake takes before its first photon, beyond importing bpy, and how long a bake that is kept takes after loading.

python tests/bench/bench_start.py [SCENE.blend]
"""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

RUNS = 5
FIRST_PHOTON = "leaflight: Tracing photons\n"
MOST_START_S, MOST_KEPT_S = 0.5, 0.3
CORNELL_BOX = Path(__file__).resolve().parents[2] / "sample_blends" / "cornell_box.blend"


def time_import() -> float:
    """Seconds until a process has imported bpy and is gone."""
    begin = time.perf_counter()
    subprocess.run([sys.executable, "-c", "import os, bpy; os._exit(0)"], check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - begin


def time_first_photon(argv: list[str]) -> float:
    """Seconds until the first photon is traced, here in the baking process itself: by one worker."""
    begin, first = time.perf_counter(), 0.0
    with subprocess.Popen([*argv, "--force", "--workers", "1"], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        for line in process.stderr:
            first = first or (time.perf_counter() - begin) * (line == FIRST_PHOTON)
    return first


def time_kept(argv: list[str], report: Path) -> float:
    """Seconds of a bake of an unchanged scene, without loading it."""
    subprocess.run([*argv, "--report", str(report), "--quiet"], check=True, stdout=subprocess.DEVNULL)
    told = json.loads(report.read_text(encoding="utf-8"))
    assert told["skipped"]["bake"] == 1
    return float(told["seconds"]["total"] - told["seconds"]["open"])


def main(scene: Path) -> None:
    with tempfile.TemporaryDirectory() as name:
        argv = [sys.executable, "-m", "leaflight", "bake", str(scene), "--output", name, "--direct", "photons", "--max-photons", "10000"]
        time_first_photon(argv)  # compiles what has not been imported yet
        start = statistics.median(time_first_photon(argv) for _ in range(RUNS)) - statistics.median(time_import() for _ in range(RUNS))
        kept = statistics.median(time_kept(argv, Path(name) / "report.json") for _ in range(RUNS))
    print(f"{scene.stem}: first photon {start:.2f} s after importing bpy, at most {MOST_START_S} wanted")
    print(f"{scene.stem}: unchanged {kept:.3f} s after loading, at most {MOST_KEPT_S} wanted")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else CORNELL_BOX)
