"""Reproduces the two figures and the claims of [Tobler97], and measures every knob of the subdivision; see docs/paper.md.

python tests/bench/bench_paper.py [--docs]     about seven minutes on two cores; needs pip's bpy for the export, and matplotlib
"""

import argparse
import dataclasses
import json
import sys
import tempfile
import time
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path

import paper_claims
import paper_split
import paper_tables
from claims import Claim, publish_claims
from export_samples import export_samples
from leaflight.core.parallel.executors import make_executor
from leaflight.core.scene.scene import SceneSnapshot
from leaflight.core.scene.snapshot import load_snapshot
from leaflight.core.util.settings import Settings
from paper_bakes import Bake, Reference, Stage
from paper_tables import Point
from tables import Table, fill_page

DOCS = Path(__file__).resolve().parents[2] / "docs"
ROOM, SQUARE = "furnished_room", "figure2_square"
# The skin outside takes most of the photons and shows nothing: left out, as sample_blends/README.md says.
LEFT_OUT = ("Exterior",)


@dataclass(frozen=True)
class Effort:
    """How large the runs are."""

    size: int = 384  # page of the room, texels
    square_size: int = 256
    figure_2: float = 1e6  # photons that arrive
    figure_3: float = 8e6  # photons that are emitted, as from here on
    sweep: float = 2e6

    @property
    def curve(self) -> list[float]:
        return [self.figure_3 / 2**k for k in (4, 3, 2, 1, 0)]


@dataclass(frozen=True)
class Measured:
    """All that was measured: tables by name, what is claimed, and what the pictures are made from."""

    tables: dict[str, Table]
    claims: list[Claim]
    square: dict[str, Bake]
    room: dict[str, Bake]
    curves: dict[str, list[Point]]
    reference: Reference


def measure_paper(folder: Path, room: SceneSnapshot, square: SceneSnapshot, effort: Effort, executor: Executor) -> Measured:
    """Run everything; stages are printed as they are done."""
    tables: dict[str, Table] = {}
    began = time.monotonic()

    def tell(name: str, table: Table) -> None:
        tables[name] = table
        print(f"\n{name}, after {time.monotonic() - began:.0f} s\n\n{table}", flush=True)

    stage = Stage(folder / "square", square, Settings(size=effort.square_size), executor)
    square_rows, square_bakes = paper_tables.bake_square(stage, effort.figure_2)
    tell("figure 2", paper_tables.table_square(square_rows))
    stage = Stage(folder / "room", room, Settings(size=effort.size), executor)
    reference = paper_tables.make_reference(stage, effort.figure_3)
    curves, room_bakes = paper_tables.trace_curves(stage, reference, effort.curve)
    tell("figure 3", paper_tables.table_curves(curves))
    needs = paper_tables.read_needs(curves)
    tell("leaves for the same error", paper_tables.table_needs(needs))
    truth = paper_tables.make_reference(stage, effort.figure_3, paper_tables.TRUTH_SEED, paper_tables.TRUTH_RUNS)
    tell("where the error comes from", paper_split.table_split(paper_split.measure_split(stage, truth, reference, effort.figure_3)))
    overhead = paper_tables.measure_overhead(stage, reference, effort.figure_3)
    tell("overhead", paper_tables.table_overhead(overhead))
    hints, knobs = (paper_tables.sweep(stage, reference, effort.sweep, choices) for choices in (paper_tables.HINTS, paper_tables.KNOBS))
    tell("hints", paper_tables.table_sweep(hints))
    tell("knobs", paper_tables.table_sweep(knobs))
    claims = [
        *paper_claims.judge_square(square_rows),
        *paper_claims.judge_curves(curves, needs),
        *paper_claims.judge_overhead(overhead),
        *paper_claims.judge_hints(hints),
        *paper_claims.judge_knobs(knobs),
    ]
    return Measured(tables, claims, square_bakes, room_bakes, curves, reference)


def draw_paper(measured: Measured, camera: dict, folder: Path) -> None:
    """All pictures."""
    import paper_pictures

    paper_pictures.draw_square(measured.square, folder / "figure2.png")
    paper_pictures.draw_room(measured.room, camera, folder)
    paper_pictures.draw_floor(measured.room, measured.reference, folder / "floor.png")
    paper_pictures.draw_curves(measured.curves, folder / "curves.png")


def leave_out(scene: SceneSnapshot, names: tuple[str, ...]) -> SceneSnapshot:
    """The scene in which the named objects get no lightmap."""
    objects = tuple(dataclasses.replace(one, receives=one.receives and one.name not in names) for one in scene.objects)
    return dataclasses.replace(scene, objects=objects)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--docs", action="store_true", help="write pictures and tables into docs/paper and docs/paper.md")
    parser.add_argument("--share", type=float, default=1.0, help="of the photons, for a shorter run")
    arguments = parser.parse_args()
    whole = Effort()
    effort = dataclasses.replace(whole, **{name: getattr(whole, name) * arguments.share for name in ("figure_2", "figure_3", "sweep")})
    with tempfile.TemporaryDirectory() as name, make_executor(0) as executor:
        folder = Path(name)
        export_samples(folder, ROOM, f"{SQUARE}:Square")
        room, square = (load_snapshot(folder / f"{scene}.npz") for scene in (ROOM, SQUARE))
        measured = measure_paper(folder, leave_out(room, LEFT_OUT), square, effort, executor)
        camera = json.loads((folder / f"{ROOM}.camera.json").read_text(encoding="utf-8"))
        draw_paper(measured, camera, DOCS / "paper" if arguments.docs else folder / "pictures")
    if arguments.docs:
        fill_page(DOCS / "paper.md", measured.tables)
    return publish_claims("paper", measured.claims)


if __name__ == "__main__":
    sys.exit(main())
