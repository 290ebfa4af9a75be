"""What each mechanism of the estimator is worth: bakes of random scenes without it, beside bakes with everything.

python tests/bench/bench_ablation.py [--seeds ... | --count N] [--scenes FOLDER] [--mechanisms NAME ...] [--docs]

Each scene is baked with everything with two seeds, whose difference is the noise, and once without each mechanism of
core/util/ablation.py, or each group of them joined by "+", with the first seed. Errors are those against a reference by Cycles, as in
bench_zoo.py. Costs are CPU seconds: a busy machine will do. Without seeds the date decides which scenes are drawn.
"""

import argparse
import dataclasses
import math
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from ablation_results import SceneTrials, Trial, tabulate_scenes, tabulate_worth
from bench_zoo import QUICK, ROOT, add_scene_options, list_subjects, run_scenes
from image_io_path import add_image_io
from leaflight.core.util.ablation import MECHANISMS
from leaflight.core.util.threads import count_usable
from tables import Table, fill_page
from zoo_bakes import Bake, bake_leaflight
from zoo_reference import PageReference, Subject, find_reference


@dataclasses.dataclass(frozen=True)
class Asked:
    """What every bake is asked for.

    error         relative
    max_photons   after which it ends
    patience_s    wall time after which its best so far is taken
    seeds         of the bakes with everything, of which the first is that of all others
    jobs          bakes at once, between which the processors are shared out
    """

    error: float
    max_photons: int
    patience_s: float
    seeds: tuple[int, ...]
    jobs: int = 1

    @property
    def workers(self) -> int:
        """Of each bake."""
        return max(count_usable() // self.jobs, 1)


def bake(subject: Subject, asked: Asked, seed: int, without: Sequence[str] = ()) -> Bake:
    words = ("--error", str(asked.error), "--max-photons", str(asked.max_photons), "--seed", str(seed), "--workers", str(asked.workers))
    return bake_leaflight(subject, *words, without=without, patience_s=asked.patience_s)


def judge(subject: Subject, made: Bake, reference: PageReference, whole: Bake | None = None) -> Trial:
    """What a bake is worth; `whole` is that with everything."""
    errors = reference.measure(made.pages, subject.objects)
    changed = whole is None or any(not np.array_equal(made.pages[name], page) for name, page in whole.pages.items())
    stated = made.report["estimated_error"]
    return Trial(errors.rel, math.nan if stated is None else stated, made.report["cpu_seconds"], changed)


def run_scene(subject: Subject, asked: Asked, mechanisms: Sequence[str]) -> SceneTrials:
    """All bakes of a scene."""
    with ThreadPoolExecutor(asked.jobs) as pool:
        wholes = list(pool.map(lambda seed: bake(subject, asked, seed), asked.seeds))
        layout = "" if subject.uv_layer else wholes[0].layout
        reference = find_reference(subject, layout, QUICK.side, QUICK.reference_s, QUICK.noise)
        trials = SceneTrials(subject.name, subject.about, tuple(judge(subject, made, reference) for made in wholes))
        without = {name: pool.submit(bake, subject, asked, asked.seeds[0], name.split("+")) for name in mechanisms}
        for name, one in without.items():
            try:
                trials.without[name] = judge(subject, one.result(), reference, wholes[0])
            except RuntimeError as reason:
                print(f"{subject.name} without {name} FAILED: {reason}", file=sys.stderr, flush=True)
    return trials


def read_names(text: str) -> str:
    """Names of mechanisms joined by "+". Raises ArgumentTypeError where one is unknown."""
    unknown = [name for name in text.split("+") if name not in MECHANISMS]
    if unknown:
        raise argparse.ArgumentTypeError(f"no mechanism: {', '.join(unknown)}; known are {', '.join(MECHANISMS)}")
    return text


def describe_mechanisms() -> Table:
    return Table(("name", "what it does"), list(MECHANISMS.items()))


def write_page(page: Path, scenes: Sequence[SceneTrials], mechanisms: Sequence[str], files: bool) -> None:
    """The tables of a run into their places in a page of docs/; scenes from files have places of their own."""
    tables = {"worth": tabulate_worth(scenes, mechanisms), "scenes": tabulate_scenes(scenes)}
    tables = {f"files {name}" if files else name: table for name, table in tables.items()} | {"names": describe_mechanisms()}
    fill_page(page, tables)


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_scene_options(parser, "ablation.md")
    parser.add_argument("--mechanisms", nargs="+", metavar="NAME", type=read_names, help="only these; A+B are switched off together")
    parser.add_argument("--error", type=float, default=0.03, help="that every bake is asked for")
    parser.add_argument("--max-photons", type=int, default=32_000_000, help="after which a bake ends")
    parser.add_argument("--budget", type=float, default=300.0, help="seconds after which the best so far of a bake is taken")
    parser.add_argument("--jobs", type=int, default=1, help="bakes at once; errors are the same, and CPU seconds nearly so")
    parser.add_argument("--turns", type=int, default=2, help="bakes with everything, each with another seed, which tell the noise")
    arguments = parser.parse_args(words)
    if arguments.turns < 2:
        parser.error("--turns: expected at least 2, for without another seed nothing tells what is noise.")
    add_image_io()
    mechanisms = arguments.mechanisms or list(MECHANISMS)
    asked = Asked(arguments.error, arguments.max_photons, arguments.budget, tuple(range(1, 1 + arguments.turns)), arguments.jobs)
    scenes: list[SceneTrials] = []

    def run(subject: Subject) -> None:
        scenes.append(run_scene(subject, asked, mechanisms))
        print(tabulate_worth(scenes, mechanisms), file=sys.stderr, flush=True)
        if arguments.docs:  # now, so that a run that is stopped leaves what it has
            write_page(ROOT / "docs" / "ablation.md", scenes, mechanisms, bool(arguments.scenes))

    effort = dataclasses.replace(QUICK, max_size=arguments.max_size or QUICK.max_size)
    code = run_scenes(list_subjects(arguments, effort), run)
    print(tabulate_worth(scenes, mechanisms), tabulate_scenes(scenes), sep="\n\n")
    return code


if __name__ == "__main__":
    sys.exit(main())
