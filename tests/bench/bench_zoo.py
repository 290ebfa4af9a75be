"""Leaflight on scenes that nobody has seen before: drawn from seeds (scene_zoo.py), or any .blend files.

python tests/bench/bench_zoo.py --quick [--seeds 1 2 3]     Leaflight alone against a reference, on small pages: minutes
python tests/bench/bench_zoo.py [--seeds ... | --count N] [--scenes FOLDER] [--budget S] [--docs]     beside Cycles and Cycles + OIDN

Without seeds the date decides which are drawn. References are made by Cycles as they are needed and kept in the cache folder; a scene of
the cache needs none again. Times count on an idle machine only; CPU seconds and errors do on any.
"""

import argparse
import dataclasses
import datetime
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from image_io_path import add_image_io
from speed_curves import PATIENCE, bake_in_turns
from tables import fill_page
from zoo_bakes import Bake, PageFullError, bake_leaflight, bake_rivals, find_file, find_seed
from zoo_reference import PageReference, Subject, find_reference
from zoo_results import Outcome, SceneResult, join_outcomes, list_scenes, share_of_tracing, summarize, tabulate_quick, tabulate_times

ROOT = Path(__file__).resolve().parents[2]
FILE_SIZE = 512  # texels a side


@dataclass(frozen=True)
class Effort:
    """How much is run.

    count          seeds, where none are named
    samples        that Cycles is asked for, until a bake takes longer than `budget_s`; none in a quick run
    turns          how often a short bake is made, of which the median counts
    errors         that Leaflight is asked for, until a bake takes longer than `budget_s` or is ended by something else than the error
    max_size       of pages, texels; 0: as drawn, FILE_SIZE of files
    side           of the windows of a page that are held against Cycles, texels
    reference_s    seconds that a reference may take, of both seeds and all processors together
    noise          of the reference at which no more is done, as `rel` counts it
    """

    count: int
    errors: tuple[float, ...]
    samples: tuple[int, ...]
    turns: int
    budget_s: float
    max_size: int
    side: int
    reference_s: float
    noise: float


QUICK = Effort(12, (0.05, 0.02), (), 1, 20.0, 256, 10, 40.0, 0.025)
FULL = Effort(16, (0.1, 0.05, 0.03, 0.02, 0.012, 0.008), (4, 16, 64, 256, 1024), 3, 120.0, 0, 32, 400.0, 0.01)


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
        share_of_tracing(report["busy_seconds"], report["processes"] * seconds["loaded"]),
    )


def bake_series(subject: Subject, effort: Effort, options: list[str]) -> list[list[tuple[float, Bake]]]:
    """Bakes to ever smaller errors, each with what was asked for, until one takes as long as the budget; of short ones several turns."""

    patience = PATIENCE if effort.samples else 1.0  # the filtered bakes of Cycles are waited for as long

    def bake(error: float, turn: int = 0) -> tuple[float, Bake]:
        words = ("--error", str(error), "--time-limit", str(patience * effort.budget_s), "--seed", str(1 + turn), *options)
        return error, bake_leaflight(subject, *words)

    first: dict[float, tuple[float, Bake]] = {}
    for error in effort.errors:
        first[error] = bake(error)
        report = first[error][1].report
        if report["seconds"]["loaded"] >= effort.budget_s or report["stopped_by"] != "error":
            break
    return bake_in_turns(first, bake, effort.turns, lambda made: made[1].report["seconds"]["loaded"])


def run_scene(subject: Subject, effort: Effort, options: list[str]) -> SceneResult:
    """All bakes of a scene."""
    bakes = bake_series(subject, effort, options)
    layout = "" if subject.uv_layer else bakes[0][0][1].layout
    reference = find_reference(subject, layout, effort.side, effort.reference_s, effort.noise)
    ours = tuple(join_outcomes([judge_bake(subject, bake, reference, asked) for asked, bake in turns]) for turns in bakes)
    rivals = bake_rivals(subject, reference, effort.samples, effort.budget_s, effort.turns) if effort.samples else {}
    return SceneResult(subject.name, subject.about, reference.noise, ours, rivals)


def list_subjects(arguments: argparse.Namespace, effort: Effort) -> list[tuple[str, Callable[[], Subject]]]:
    """The scenes: name, and what makes it ready."""
    if arguments.scenes:
        size = effort.max_size or FILE_SIZE
        return [(blend.name, partial(find_file, blend, arguments.cache, size)) for blend in sorted(arguments.scenes.glob("*.blend"))]
    seeds = arguments.seeds or draw_seeds(arguments.count or effort.count, datetime.date.today())
    return [(f"seed {seed}", partial(find_seed, seed, arguments.cache, effort.max_size)) for seed in seeds]


def run_scenes(scenes: Sequence[tuple[str, Callable[[], Subject]]], run: Callable[[Subject], object]) -> int:
    """Run each scene, on a larger page where its charts do not fit; 1 if one failed, which is told again at the end."""
    failed: list[str] = []
    for name, find_subject in scenes:
        try:
            subject = find_subject()
            print(subject.about, file=sys.stderr, flush=True)
            run_on_fitting_page(subject, run)
        except (RuntimeError, subprocess.CalledProcessError) as reason:  # hours of other scenes are not to be lost
            failed.append(f"{name} FAILED: {reason}")
            print(failed[-1], file=sys.stderr, flush=True)
    print(*failed, sep="\n")
    return int(bool(failed))


def run_on_fitting_page(subject: Subject, run: Callable[[Subject], object]) -> None:
    try:
        run(subject)
    except PageFullError:
        larger = dataclasses.replace(subject, size=subject.size * 3 // 2)
        larger.save()
        print(f"{subject.name}: the charts need a page of {larger.size}²", file=sys.stderr, flush=True)
        run_on_fitting_page(larger, run)


def add_scene_options(parser: argparse.ArgumentParser, page: str) -> None:
    """Which scenes are run, and where they are kept and told; read by list_subjects."""
    parser.add_argument("--seeds", nargs="+", type=int, help="scenes; without them the date decides")
    parser.add_argument("--count", type=int, help="how many seeds are drawn where none are named")
    parser.add_argument("--scenes", type=Path, metavar="FOLDER", help="its .blend files in place of seeds, each on a new UV layer")
    parser.add_argument("--cache", type=Path, default=ROOT / "out" / "zoo", help="folder of scenes and references")
    parser.add_argument("--max-size", type=int, help="largest side of a page, texels")
    parser.add_argument("--docs", action="store_true", help=f"write the tables into docs/{page}")


def write_page(page: Path, results: Sequence[SceneResult], files: bool) -> None:
    """The tables of a run into their places in a page of docs/; scenes from files have places of their own."""
    tables = {
        "summary": summarize(results),
        "times": tabulate_times(results),
        "bakes": tabulate_quick(results),
        "scenes": list_scenes(results),
    }
    tables = {f"files {name}" if files else name: table for name, table in tables.items()}
    fill_page(page, tables)


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_scene_options(parser, "zoo.md")
    parser.add_argument("--turns", type=int, help="how often a short bake is made")
    parser.add_argument("--budget", type=float, help="seconds that one bake may take")
    parser.add_argument("--quick", action="store_true", help="Leaflight alone, on small pages, against a reference")
    parser.add_argument("--reference-seconds", type=float, help="of all processors together, that a new reference may take")
    parser.add_argument("options", nargs="*", help="for Leaflight, behind --")
    arguments = parser.parse_args(words)
    effort = QUICK if arguments.quick else FULL
    effort = dataclasses.replace(
        effort,
        budget_s=arguments.budget or effort.budget_s,
        reference_s=arguments.reference_seconds or effort.reference_s,
        max_size=arguments.max_size or effort.max_size,
        turns=arguments.turns or effort.turns,
    )
    add_image_io()
    results: list[SceneResult] = []

    def run(subject: Subject) -> None:
        results.append(run_scene(subject, effort, arguments.options))
        tables = [tabulate_quick(results[-1:]), *([tabulate_times(results[-1:])] if effort.samples else [])]
        print(*tables, sep="\n", file=sys.stderr, flush=True)
        if arguments.docs and effort.samples:  # now, so that a run that is stopped leaves what it has
            write_page(ROOT / "docs" / "zoo.md", results, bool(arguments.scenes))

    code = run_scenes(list_subjects(arguments, effort), run)
    tables = [tabulate_quick(results), *([tabulate_times(results)] if effort.samples else []), summarize(results)]
    print(*tables, sep="\n\n")
    return code


if __name__ == "__main__":
    sys.exit(main())
