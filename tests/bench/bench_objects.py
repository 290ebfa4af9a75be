"""The samples object by object: how far is each from Cycles beside its own brightness, where the whole or where each has to be right?

python tests/bench/bench_objects.py [NAME ...] [--docs]     some ten minutes on two cores; needs pip's bpy for the export

Exits with 1 when a claim fails.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from bench_accuracy import FINEST, SIZE, bake_page, root_mean_square
from bench_paper import DOCS
from claims import Claim, publish_claims
from cycles_reference import Reference
from export_samples import export_samples
from image_io_path import add_image_io
from leaflight.core.parallel import folders
from leaflight.core.transport import traced_scene
from leaflight.core.util.job import SNAPSHOT_FILE
from leaflight.core.util.settings import ERROR_OF, Settings
from lightmap_errors import BEST_TEXELS, DARK_FLOOR, find_lit
from tables import Table, fill_page

NAMES = ("bent_quads", "cornell_box", "furnished_room", "instances", "two_rooms")  # of more than one object, lit otherwise than evenly
ERROR = 0.05  # that is asked for
SEEDS = (1, 2, 3, 4)
LEAST_TOLD = 0.002  # error beyond the finest bake's, below which nothing is said of a ratio to it
LEAST_TEXELS = 256  # of an object that is measured: of fewer the noise of the reference does not cancel
MEDIAN_OVER_ASKED, WORST_OVER_WORST, STATED_WITHIN = 1.0, 0.75, (0.6, 2.0)


@dataclass(frozen=True)
class Measured:
    """Bakes of one sample that differ in their seeds only; values of each of b bakes.

    whole    (b,) rel of all texels
    names    (n,) the objects that were measured
    rel      (b, n) of each beside its own brightness
    stated   (b, n) the same, as the bake says
    finest   (n,) rel of a bake at the finest settings, hardly any of it noise: small things differ from Cycles', see docs/cycles.md
    """

    sample: str
    error_of: str
    seconds: Sequence[float]
    photons: Sequence[int]
    whole: Sequence[float]
    names: tuple[str, ...]
    rel: np.ndarray
    stated: np.ndarray
    finest: np.ndarray

    @property
    def of_objects(self) -> np.ndarray:
        """(n,): root mean squares over the bakes."""
        return np.sqrt((self.rel**2).mean(axis=0))

    @property
    def beyond(self) -> np.ndarray:
        """(n,): of that, what no finer bake has."""
        return np.sqrt(np.maximum(self.of_objects**2 - self.finest**2, 0.0))

    @property
    def ratios(self) -> np.ndarray:
        """(k,): stated error of objects over what they err by beyond the finest bake; of those of which that can be told."""
        told = self.beyond > LEAST_TOLD
        return np.sqrt((self.stated[:, told] ** 2).mean(axis=0)) / self.beyond[told]

    @property
    def worst(self) -> int:
        return int(self.of_objects.argmax())

    def row(self) -> list[str]:
        ratios = np.sort(self.ratios)
        return [
            self.sample,
            self.error_of,
            f"{np.median(self.seconds):.1f} s",
            f"{np.median(self.photons) / 1e6:.1f} M",
            f"{root_mean_square(self.whole):.2%}",
            f"{self.names[self.worst]}, {self.of_objects[self.worst]:.1%}",
            f"{self.finest[self.worst]:.1%}",
            f"{np.median(self.of_objects):.1%}",
            f"{np.median(ratios):.2f} ({ratios[0]:.2f} to {ratios[-1]:.2f})",
        ]


HEAD = (
    "sample",
    "error of",
    "seconds",
    "photons",
    "rel of the whole",
    "worst object, its rel",
    "at the finest",
    "median",
    "stated / rel of objects",
)


def measure_sample(reference: Reference, folder: Path, error_of: str, finest: np.ndarray, seeds: Sequence[int] = SEEDS) -> Measured:
    """The sample whose snapshot lies in `folder`, baked with each seed; and a page at the finest settings."""
    bakes = []
    for seed in seeds:
        settings = replace(FINEST, error=ERROR, max_photons=Settings.max_photons, error_of=error_of, seed=seed)
        begin = time.perf_counter()
        page, tri_uv, result = bake_page(folder, settings)
        bakes.append((time.perf_counter() - begin, page, tri_uv, result))
    owner = map_objects(folder)[reference.covered]
    found = [(i, row["name"]) for i, row in zip(sorted(set(owner[owner >= 0])), bakes[0][3]["objects"], strict=True)]
    found = [(i, name) for i, name in found if np.count_nonzero(owner == i) >= LEAST_TEXELS]
    rel, stated = np.zeros((2, len(bakes), len(found)))
    for b, (_, page, _, result) in enumerate(bakes):
        told = {row["name"]: row["estimated_error"] for row in result["objects"]}
        for n, (i, name) in enumerate(found):
            own = owner == i
            rel[b, n] = measure_alone(page[reference.covered][:, :3], reference, own)
            stated[b, n] = told[name]
    return Measured(
        reference.name,
        error_of,
        [seconds for seconds, *_ in bakes],
        [result["photons"] for *_, result in bakes],
        [reference.measure(page, tri_uv).rel for _, page, tri_uv, _ in bakes],
        tuple(name for _, name in found),
        rel,
        stated,
        np.array([measure_alone(finest[reference.covered][:, :3], reference, owner == i) for i, _ in found]),
    )


def measure_alone(value: np.ndarray, reference: Reference, own: np.ndarray) -> float:
    """`rel` of some of the texels as if they were all, but that what is next to black on the whole page is judged as dark there too.

    value   (n, 3) of the covered texels
    own     (n,) bool
    """
    level = (reference.first + reference.second).mean() / 2.0
    own = own & find_lit(reference.first, reference.second)
    value, first, second = (light[own].astype(np.float64) for light in (value, reference.first, reference.second))
    mean = (first + second) / 2.0
    dark = DARK_FLOOR * max(mean.mean(), DARK_FLOOR * level)
    relative = ((value - first) * (value - second) / (mean**2 + dark**2)).mean(1)
    local = np.abs(value - mean).sum(1) / (mean + dark).sum(1)
    return float(np.sqrt(max(relative[local <= np.quantile(local, BEST_TEXELS)].mean(), 0.0)))


def map_objects(folder: Path) -> np.ndarray:
    """(SIZE, SIZE) int: the object that each texel of the last bake in the folder shows, row 0 at the bottom; -1 where there is none."""
    tracing = traced_scene.open_tracing(str(folder))
    texels, owner = tracing.texels, np.full((SIZE, SIZE), -1)
    shown = np.flatnonzero(texels.shown)
    column, row = texels.texel_xy[shown].T
    owner[row, column] = tracing.snapshot.tri_object[texels.texel_tri[shown]]
    folders.forget_folders()
    return owner


def judge(whole: Measured, each: Measured) -> list[Claim]:
    """What is claimed of bakes of which each object has to be right, beside those of which the whole has."""
    worst = each.of_objects.max() / whole.of_objects.max()
    values = {
        "error of the median one over the one asked for": (np.median(each.beyond) / ERROR, 0.0, MEDIAN_OVER_ASKED),
        "error of the worst one over that where the whole is judged": (worst, 0.0, WORST_OVER_WORST),
        "stated error over measured, median": (np.median(each.ratios), *STATED_WITHIN),
    }
    return [Claim(f"Objects: {name}", float(value), low, high, case=each.sample) for name, (value, low, high) in values.items()]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="samples, without them all that have several objects")
    parser.add_argument("--docs", action="store_true", help="write the table into docs/cycles.md")
    arguments = parser.parse_args()
    names = arguments.names or NAMES
    add_image_io()
    measured, claims = [], []
    with tempfile.TemporaryDirectory() as work:
        export_samples(Path(work), *names)
        for name in names:
            reference, folder = Reference.load(name, SIZE), Path(work) / name
            folder.mkdir()
            (Path(work) / f"{name}.npz").rename(folder / SNAPSHOT_FILE)
            finest = bake_page(folder, FINEST)[0]
            pair = [measure_sample(reference, folder, error_of, finest) for error_of in ERROR_OF]
            print(*(text for one in pair for text in (*one.row(), "\n")), sep="  ", file=sys.stderr, flush=True)
            measured += pair
            claims += judge(*pair)
    table = Table(HEAD, [one.row() for one in measured])
    print(table)
    if arguments.docs:
        fill_page(DOCS / "cycles.md", {"objects": table})
    return publish_claims("objects", claims)


if __name__ == "__main__":
    sys.exit(main())
