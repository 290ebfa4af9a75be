"""Seconds against error: Leaflight beside Cycles' bake, and Cycles with OIDN's filter, on the same UV layer and machine; see docs/speed.md.

python tests/bench/bench_speed.py [--docs] [--quick] [--cache DIR]     an hour, with nothing else running; needs the extra `bench`
python tests/bench/bench_speed.py --probes     minutes: only the targets that are about Leaflight alone

References that are not committed are made once and kept in the cache folder. --quick is for checking this script alone: its
figures say nothing.
"""

from __future__ import annotations

import argparse
import dataclasses
import datetime
import functools
import hashlib
import json
import math
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import speed_probes
import speed_rivals
from cycles_reference import COMMITTED, ROOT, SAMPLES, WHOLE_SIZE, Reference
from export_samples import export_samples
from image_io_path import add_image_io
from leaflight.core.scene.snapshot import load_snapshot
from speed_curves import PATIENCE, Point, Reach, bake_in_turns, geometric_mean, join_turns, list_more_samples, ratio_text, reach_error
from tables import Table, fill_page

DOCS = ROOT / "docs"
HISTORY = DOCS / "speed" / "history.jsonl"
OURS, PHOTONS, CYCLES, OIDN = "Leaflight", "Leaflight, photons only", "Cycles", "Cycles + OIDN"
MEASURED_ERRORS = (0.10, 0.05, 0.02)


@dataclass(frozen=True)
class Effort:
    """How much is run.

    errors     that Leaflight is asked for, ascending in time
    samples    that Cycles is asked for, until one bake would take longer than `budget_s`; see speed_curves.list_more_samples
    turns      how often a short bake is made, of which the median counts
    """

    scenes: tuple[str, ...] = ("cornell_box", "furnished_room", "instances", "two_rooms")
    sizes: tuple[int, ...] = (256, 1024)
    errors: tuple[float, ...] = (0.3, 0.15, 0.08, 0.05, 0.03, 0.02, 0.012, 0.008)
    photon_errors: tuple[float, ...] = (0.3, 0.15, 0.08, 0.05, 0.03)
    samples: tuple[int, ...] = (4, 16, 64, 256, 1024)
    budget_s: float = 300.0
    turns: int = 3
    reference_samples: int = 0  # 0: as many as the noise asks for
    probes: speed_probes.Sizes = dataclasses.field(default_factory=speed_probes.Sizes)


QUICK = Effort(("cornell_box", "instances"), (256, 128), (0.3, 0.1), (0.3,), (1, 2), 2.0, 1, 8, speed_probes.QUICK)
Curves = dict[str, list[Point]]


@dataclass(frozen=True)
class Target:
    """One row of what speed must be.

    figure   nan where it could not be measured
    """

    text: str
    figure: float
    bound: str
    holds: bool

    @classmethod
    def at_least(cls, text: str, figure: float, bound: float) -> Target:
        return cls(text, figure, f">= {bound:g}", figure >= bound)

    @classmethod
    def at_most(cls, text: str, figure: float, bound: float) -> Target:
        return cls(text, figure, f"<= {bound:g}", figure <= bound)


# -- curves --


def find_reference(name: str, size: int, cache: Path, samples: int) -> Reference:
    """The committed reference, or that of the cache, made where there is none."""
    if name in COMMITTED.get(size, ()):
        return Reference.load(name, size)
    folder = cache / f"{samples or 'full'}"
    if not (folder / f"{name}_{size}.npz").exists():
        command = [sys.executable, str(Path(__file__).with_name("cycles_reference.py")), name, "--size", str(size)]
        subprocess.run([*command, "--samples", str(samples), "--folder", str(folder)], check=True, stdout=subprocess.DEVNULL)
    return Reference.load(name, size, folder)


def trace_curves(name: str, size: int, reference: Reference, effort: Effort) -> Curves:
    """Every way of baking the scene at that size, as points of time and error."""
    bakes, tri_uv = speed_rivals.bake_rival(SAMPLES / f"{name}.blend", size, effort.budget_s, effort.samples, effort.turns)
    measure = functools.partial(speed_rivals.measure_point, reference, tri_uv)
    curves: Curves = {CYCLES: [], OIDN: []}
    while bakes:
        for label, pages in ((CYCLES, bakes), (OIDN, [speed_rivals.denoise(one, effort.turns) for one in bakes])):
            curves[label] += [measure(one.page, one.seconds, one.samples) for one in pages]
        more = list_more_samples(curves[CYCLES], curves[OIDN], effort.samples, effort.budget_s, min(MEASURED_ERRORS))
        bakes = speed_rivals.bake_rival(SAMPLES / f"{name}.blend", size, math.inf, more, effort.turns)[0] if more else []
    for label, errors, options in ((OURS, effort.errors, []), (PHOTONS, effort.photon_errors, ["--direct", "photons"])):
        curves[label] = trace_leaflight(name, size, effort, errors, options, measure)
    return curves


def trace_leaflight(
    name: str, size: int, effort: Effort, errors: Sequence[float], options: list[str], measure: Callable[[np.ndarray, float, float], Point]
) -> list[Point]:
    """Bakes by the command line to ever smaller errors, until one takes longer than the budget.

    Each turn has a seed of its own: whether a bake needs another round can hang on the photons it was dealt.
    """

    def bake(error: float, turn: int = 0) -> Point:
        asked = ["--error", str(error), "--max-photons", "1000000000", "--seed", str(1 + turn)]
        page, report = speed_rivals.bake_leaflight(name, size, [*asked, *options])
        return measure(page, report["seconds"]["loaded"], error)

    first: dict[float, Point] = {}
    for error in errors:
        first[error] = bake(error)
        if ends_series(first[error], effort.budget_s):
            break
    return [join_turns(points) for points in bake_in_turns(first, bake, effort.turns, lambda point: point.seconds)]


def ends_series(point: Point, budget_s: float) -> bool:
    """Whether a bake took so long that the next, of a smaller error, is left out."""
    return point.seconds > budget_s * (1.0 if point.rel <= min(MEASURED_ERRORS) else PATIENCE)


def reach_all(curves: Curves, error: float, measure: str = "rel") -> dict[str, Reach | None]:
    """When each way comes to the error; Cycles' times are extrapolated where it was not run for so long."""
    return {label: reach_error(points, error, measure, extrapolate=label == CYCLES) for label, points in curves.items()}


def table_times(curves: dict[tuple[str, int], Curves]) -> Table:
    """Seconds to 10, 5 and 2 % `rel`, and their ratios."""
    rows = []
    for (name, size), of_scene in curves.items():
        for error in MEASURED_ERRORS:
            reach = reach_all(of_scene, error)
            times = [str(reach[label]) if reach[label] else "never" for label in (OURS, PHOTONS, CYCLES, OIDN)]
            ratios = [ratio_text(reach[label], reach[OURS]) for label in (CYCLES, OIDN)]
            rows.append([f"{name} {size}²", f"{error:.0%}", *times, *ratios])
    return Table(("scene", "rel", OURS, PHOTONS, CYCLES, OIDN, f"{CYCLES} / {OURS}", f"{OIDN} / {OURS}"), rows)


def table_points(curves: dict[tuple[str, int], Curves]) -> Table:
    """Every bake that was run."""
    rows = [
        [f"{name} {size}²", label, f"{point.asked:g}", f"{point.seconds:.2f}", f"{point.rel:.2%}", f"{point.nrmse:.2%}"]
        for (name, size), of_scene in curves.items()
        for label, points in of_scene.items()
        for point in points
    ]
    return Table(("scene", "by", "samples or error", "seconds", "rel", "nrmse"), rows)


def draw_curves(curves: Curves, title: str, path: Path) -> None:
    """Error over time, both by powers of ten: full lines rel, dotted lines nrmse."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(6.4, 4.8))
    for (label, points), color in zip(curves.items(), ("#777777", "#d08020", "#1060c0", "#60a0e0"), strict=True):
        points = sorted(points, key=lambda point: point.seconds)
        seconds = [point.seconds for point in points]
        axes.loglog(seconds, [100 * point.rel for point in points], "o-", color=color, label=label)
        axes.loglog(seconds, [100 * point.nrmse for point in points], ":", color=color)
    axes.set_xlabel("seconds")
    axes.set_ylabel("error, % (full: rel, dotted: nrmse)")
    axes.set_title(title)
    axes.grid(True, which="both", alpha=0.25)
    axes.legend()
    figure.tight_layout()
    figure.savefig(path, dpi=80)
    pyplot.close(figure)


# -- targets --


def judge_curves(curves: dict[tuple[str, int], Curves]) -> list[Target]:
    """The targets that compare times to an error."""
    targets = []
    for error, mean, least in ((0.05, 30.0, 1.0), (0.02, 50.0, 3.0)):
        ratios = ratios_to(curves, CYCLES, error)
        text = f"time to {error:.0%} rel, {CYCLES} / {OURS}"
        targets.append(Target.at_least(f"{text}, geometric mean", geometric_mean(ratios), mean))
        targets.append(Target.at_least(f"{text}, least", min(ratios), least))
    ratios = [ratio for error in (0.05, 0.02) for ratio in ratios_to(curves, OIDN, error) if ratio < float("inf")]
    text = f"time to 5 % and 2 % rel, {OIDN} / {OURS}, where both come to it"
    targets.append(Target.at_least(f"{text}, geometric mean", geometric_mean(ratios), 5.0))
    targets.append(Target.at_least(f"{text}, least", min(ratios, default=float("nan")), 1.0))
    cornell = curves.get(("cornell_box", WHOLE_SIZE), {})
    ours = reach_error(cornell.get(OURS, []), 0.02, "nrmse")
    sixteen = [point.seconds for point in cornell.get(CYCLES, []) if point.asked == 16]
    ratio = ours.seconds / sixteen[0] if ours and sixteen else float("nan")
    targets.append(Target.at_most("cornell_box 256² to 2 % nrmse / Cycles' 16 samples", ratio, 1.0))
    return targets


def ratios_to(curves: dict[tuple[str, int], Curves], rival: str, error: float) -> list[float]:
    """The rival's time over ours for each scene and size; 0 where we never come to the error, infinite where only the rival does not."""
    ratios = []
    for of_scene in curves.values():
        reach = reach_all(of_scene, error)
        ours, theirs = reach[OURS], reach[rival]
        ratios.append(0.0 if ours is None else theirs.seconds / ours.seconds if theirs else float("inf"))
    return ratios


def run_probes(folder: Path, sizes: speed_probes.Sizes) -> list[Target]:
    """The targets that are about Leaflight alone; each is printed as it is measured."""
    export_samples(folder, "cornell_box", "furnished_room")
    box, room = (load_snapshot(folder / f"{name}.npz") for name in ("cornell_box", "furnished_room"))
    targets: list[Target] = []

    def tell(*new: Target) -> None:
        targets.extend(new)
        for one in new:
            print(f"{one.text}: {one.figure:.3g} ({one.bound})", file=sys.stderr, flush=True)

    rates = speed_probes.wavefront_share(folder / "rays", room, sizes)
    text = f"wavefront {rates['wavefront_per_s'] / 1e6:.2f} M rays/s / embreex {rates['embreex_per_s'] / 1e6:.2f} M rays/s, one core"
    tell(Target.at_least(text, rates["share"], 0.4))
    workers = speed_probes.worker_gain(folder / "workers", room, sizes)
    text = f"photons a second, 2 workers / 1 worker (two bakes of 1 worker that share nothing: {workers['machine']:.2f})"
    tell(Target.at_least(text, workers["gain"], 1.8))
    pages = speed_probes.page_growth(folder / "pages", box, sizes)
    small, large = sizes.pages
    tell(Target.at_most(f"{small}² -> {large}², the same 5 %, times", pages["ratio"], 8.0))
    tell(Target.at_most(f"{large}², peak memory, GB", pages["peak_mb"] / 1e3, 4.0))
    hills = speed_probes.triangle_growth(folder / "triangles", sizes)
    few, many = sizes.triangles
    tell(Target.at_most(f"{few:,} -> {many:,} triangles, tracing, times", hills["ratio"], 4.0))
    tell(Target.at_most(f"{many:,} triangles, peak memory of a worker, GB", hills["worker_mb"] / 1e3, 4.0))
    ground = speed_probes.unwrap_growth(sizes)
    few, many = sizes.unwrapped
    text = f"{few:,} -> {many:,} triangles of a bumpy ground, unwrapping, times ({ground['seconds']:.1f} s)"
    tell(Target.at_most(text, ground["ratio"], 6.0))
    tell(Target.at_most(f"{sizes.objects:,} boxes, no two alike, unwrapping, s", speed_probes.unwrap_objects(sizes), 1.0))
    few, many = sizes.lights
    tell(Target.at_most(f"{few:,} -> {many:,} lights, the same 5 %, times", speed_probes.light_growth(folder / "lights", sizes), 3.0))
    few, many = sizes.glowing
    glowing = speed_probes.glow_growth(folder / "glowing", sizes)
    tell(Target.at_most(f"{few:,} -> {many:,} glowing boxes, the same 5 %, times", glowing, 12.0))
    tell(Target.at_most("start to first photon beyond importing bpy, s", speed_probes.start_seconds(sizes), 0.5))
    tell(Target.at_most("re-bake of an unchanged scene after load, s", speed_probes.rebake_seconds(), 0.3))
    return targets


def table_targets(targets: Sequence[Target], before: dict[str, float]) -> Table:
    """Each target with what the last run of the history had."""
    rows = []
    for target in targets:
        earlier = next((figure for text, figure in before.items() if key_of(text) == key_of(target.text)), None)
        figures = [f"{target.figure:.3g}", "" if earlier is None else f"{earlier:.3g}"]
        rows.append([target.text, *figures, target.bound, "holds" if target.holds else "FAILS"])
    return Table(("what", "measured", "before", "target", ""), rows)


def key_of(text: str) -> str:
    """A target's text without the figures that change from run to run."""
    text = text.partition(" (")[0]
    return "".join(letter for letter in text if not letter.isdigit() and letter != ".") if text.startswith("wavefront") else text


# -- history --


def read_history(path: Path) -> list[dict[str, Any]]:
    """Every run that was kept, oldest first."""
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.exists() else []


def append_history(path: Path, targets: Sequence[Target]) -> None:
    """Date, version, a digest of the sources, and all figures."""
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    digest = hashlib.sha256()
    for source in sorted([*ROOT.glob("core/**/*.py"), *ROOT.glob("addon/**/*.py")]):
        digest.update(source.read_bytes())
    figures = {target.text: round(target.figure, 4) if abs(target.figure) < float("inf") else None for target in targets}
    line = {"date": datetime.date.today().isoformat(), "version": version, "sources": digest.hexdigest()[:12], "figures": figures}
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(line) + "\n")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--docs", action="store_true", help="write tables and pictures into docs/speed.md and docs/speed, and add to the history"
    )
    parser.add_argument("--quick", action="store_true", help="check this script, with sizes that measure nothing")
    parser.add_argument("--probes", action="store_true", help="no curves; nothing is written")
    parser.add_argument("--cache", type=Path, default=ROOT / "out" / "references", help="folder of references that are not committed")
    parser.add_argument("--scenes", nargs="+", help="only these, NAME:SIZE of that size only")
    parser.add_argument("--sizes", nargs="+", type=int, help="sides of pages, only these")
    parser.add_argument("--budget", type=float, help="seconds that one bake may take")
    arguments = parser.parse_args()
    effort = QUICK if arguments.quick else Effort()
    effort = dataclasses.replace(
        effort,
        scenes=() if arguments.probes else tuple(arguments.scenes or effort.scenes),
        sizes=tuple(arguments.sizes or effort.sizes),
        budget_s=arguments.budget or effort.budget_s,
    )
    add_image_io()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        pictures = DOCS / "speed" if arguments.docs else folder
        pictures.mkdir(exist_ok=True)
        curves: dict[tuple[str, int], Curves] = {}
        for size in effort.sizes:
            for scene in (name for name, _, only in (scene.partition(":") for scene in effort.scenes) if only in ("", str(size))):
                reference = find_reference(scene, size, arguments.cache, effort.reference_samples)
                curves[scene, size] = trace_curves(scene, size, reference, effort)
                draw_curves(curves[scene, size], f"{scene}, {size}²", pictures / f"{scene}_{size}.png")
                print(table_times({(scene, size): curves[scene, size]}), file=sys.stderr, flush=True)
        targets = [*(judge_curves(curves) if curves else ()), *run_probes(folder, effort.probes)]
    history = read_history(HISTORY)
    before = {text: figure for text, figure in (history[-1]["figures"] if history else {}).items() if figure is not None}
    tables = {"targets": table_targets(targets, before)}
    if curves:
        tables |= {"times": table_times(curves), "bakes": table_points(curves)}
    print(*tables.values(), sep="\n\n")
    if arguments.docs and curves:
        fill_page(DOCS / "speed.md", tables)
        append_history(HISTORY, targets)
    return int(not all(target.holds for target in targets))


if __name__ == "__main__":
    sys.exit(main())
