"""Leaflight on scenes that nobody has seen before: drawn from seeds (scene_zoo.py), or any .blend files.

python tests/bench/bench_zoo.py --quick [--seeds 1 2 3]     Leaflight alone against a reference, on small pages: minutes
python tests/bench/bench_zoo.py [--seeds ... | --count N] [--scenes FOLDER] [--budget S] [--docs]     beside Cycles and Cycles + OIDN

Without seeds the date decides which are drawn. References are made by Cycles as they are needed and kept in the cache folder; a scene of
the cache needs none again. Times count on an idle machine only; CPU seconds and errors do on any.
"""

from __future__ import annotations

import argparse
import dataclasses
import datetime
import sys
from dataclasses import dataclass
from pathlib import Path

from image_io_path import add_image_io
from zoo_bakes import Bake, PageFullError, bake_leaflight, find_seed
from zoo_reference import PageReference, Subject, find_reference
from zoo_results import Outcome, SceneResult, summarize, tabulate_quick

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Effort:
    """How much is run.

    count          seeds, where none are named
    errors         that Leaflight is asked for, until a bake takes longer than `budget_s` or is ended by something else than the error
    max_size       of pages, texels; 0: as drawn
    side           of the windows of a page that are held against Cycles, texels
    reference_s    seconds that a reference may take, of both seeds and all processors together
    noise          of the reference at which no more is done, as `rel` counts it
    """

    count: int
    errors: tuple[float, ...]
    budget_s: float
    max_size: int
    max_triangles: int
    side: int
    reference_s: float
    noise: float


QUICK = Effort(12, (0.05, 0.02), 20.0, 256, 0, 10, 40.0, 0.025)
FULL = Effort(16, (0.1, 0.05, 0.03, 0.02, 0.012, 0.008), 120.0, 0, 0, 32, 400.0, 0.01)


def draw_seeds(count: int, day: datetime.date) -> list[int]:
    """Seeds of a day: no two days have one in common while there are fewer than a hundred."""
    return [day.toordinal() % 1_000_000 * 100 + index for index in range(count)]


def judge_bake(subject: Subject, bake: Bake, reference: PageReference, asked: float) -> Outcome:
    errors, report = reference.measure(bake.pages, subject.objects), bake.report
    seconds = report["seconds"]
    return Outcome(
        asked,
        report["estimated_error"],
        errors.rel,
        errors.nrmse,
        errors.bias,
        seconds["loaded"],
        bake.cpu_s,
        report["photons"],
        report["stopped_by"],
        seconds,
        report.get("tracing_share"),
    )


def bake_series(subject: Subject, effort: Effort, options: list[str]) -> list[tuple[float, Bake]]:
    """Bakes to ever smaller errors, until one takes as long as the budget."""
    made: list[tuple[float, Bake]] = []
    for error in effort.errors:
        bake = bake_leaflight(subject, "--error", str(error), "--time-limit", str(effort.budget_s), *options)
        made.append((error, bake))
        if bake.report["seconds"]["loaded"] >= effort.budget_s or bake.report["stopped_by"] != "error":
            break
    return made


def run_scene(subject: Subject, effort: Effort, options: list[str]) -> SceneResult:
    """All bakes of a scene; on a larger page where its charts do not fit."""
    try:
        bakes = bake_series(subject, effort, options)
    except PageFullError:
        larger = dataclasses.replace(subject, size=subject.size * 3 // 2)
        larger.save()
        print(f"{subject.name}: the charts need a page of {larger.size}²", file=sys.stderr, flush=True)
        return run_scene(larger, effort, options)
    reference = find_reference(subject, bakes[0][1].layout, effort.side, effort.reference_s, effort.noise)
    ours = tuple(judge_bake(subject, bake, reference, asked) for asked, bake in bakes)
    return SceneResult(subject.name, subject.about, reference.noise, ours)


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", nargs="+", type=int, help="scenes; without them the date decides")
    parser.add_argument("--count", type=int, help="how many seeds are drawn where none are named")
    parser.add_argument("--budget", type=float, help="seconds that one bake may take")
    parser.add_argument("--quick", action="store_true", help="Leaflight alone, on small pages, against a reference")
    parser.add_argument("--cache", type=Path, default=ROOT / "out" / "zoo", help="folder of scenes and references")
    parser.add_argument("--reference-seconds", type=float, help="of all processors together, that a new reference may take")
    parser.add_argument("--max-size", type=int, help="largest side of a page, texels")
    parser.add_argument("options", nargs="*", help="for Leaflight, behind --")
    arguments = parser.parse_args(words)
    effort = QUICK if arguments.quick else FULL
    effort = dataclasses.replace(
        effort,
        budget_s=arguments.budget or effort.budget_s,
        reference_s=arguments.reference_seconds or effort.reference_s,
        max_size=arguments.max_size or effort.max_size,
    )
    add_image_io()
    seeds = arguments.seeds or draw_seeds(arguments.count or effort.count, datetime.date.today())
    results = []
    for seed in seeds:
        subject = find_seed(seed, arguments.cache, effort.max_size, effort.max_triangles)
        print(subject.about, file=sys.stderr, flush=True)
        results.append(run_scene(subject, effort, arguments.options))
        print(tabulate_quick(results[-1:]), file=sys.stderr, flush=True)
    print(tabulate_quick(results), summarize(results), sep="\n\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
