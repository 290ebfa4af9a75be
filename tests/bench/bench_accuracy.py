"""The samples against Cycles, texel by texel: is there a bias, how small does the error get, is the stated error true?

python tests/bench/bench_accuracy.py [NAME ...] [--docs] [--maps DIR]     about half an hour on two cores; needs pip's bpy for the export

A bake's error is one of many that it could have had, so that what it states is held against the root mean square of several seeds. Where a
sample has a closed form, that is the truth: Cycles' noise is the larger there.

Exits with 1 when a claim fails.
"""

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from bench_paper import DOCS
from claims import Claim, publish_claims
from cycles_reference import OBJECTS, SAMPLE_COUNTS, Reference
from export_samples import export_samples
from image_io_path import add_image_io
from leaflight.core.bake import bake
from leaflight.core.output import image_file
from leaflight.core.scene.snapshot import load_snapshot
from leaflight.core.util.job import LAYOUT_FILE, RESULT_FILE, SNAPSHOT_FILE, Job
from leaflight.core.util.settings import Settings
from lightmap_errors import LightmapErrors
from sample_truths import measure_truth
from tables import Table, fill_page

SIZE = 256
NEVER = 1e-4  # an error that no bake here comes to, so that the photons decide
SEEDS_OF_COUNT = {1_000_000: 8, 4_000_000: 4, 16_000_000: 2}  # at least: the fewer photons, the fewer leaves, and the more chance
MOST_SEEDS = 32  # where few leaves make bakes differ much
SURE = 0.03  # standard error of stated / rel, at which seeds are enough
FINEST = Settings(size=SIZE, share_meshes=False, even_out=False, passes=("lighting",), error=0.005, max_photons=128_000_000)
MOST_BIAS, MOST_REL, STATED_WITHIN = 0.5, 2.0, 0.25  # %, %, 1


@dataclass(frozen=True)
class Measured:
    """One bake of a sample beside its reference.

    errors   against Cycles
    truth    against the sample's closed form; None where it has none
    page     (SIZE, SIZE, 4) float32, `lighting`
    """

    sample: str
    finest: bool
    photons: int
    errors: LightmapErrors
    truth: LightmapErrors | None
    stated: float
    seconds: float
    page: np.ndarray

    @property
    def rel(self) -> float:
        """What the stated error is held against."""
        return (self.truth or self.errors).rel


@dataclass(frozen=True)
class Series:
    """Bakes of one sample that differ in their seeds only."""

    bakes: tuple[Measured, ...]

    @property
    def ratio(self) -> float:
        """Stated error over measured one, root mean squares of each; infinite where none was measured."""
        return self._divide(root_mean_square([one.stated for one in self.bakes]), root_mean_square([one.rel for one in self.bakes]))

    @property
    def doubt(self) -> float:
        """Standard error of the ratio, told by how single bakes' differ; infinite for one bake, 0 where nothing could be measured."""
        single = [self._divide(one.stated, one.rel) for one in self.bakes]
        if len(single) < 2:
            return float("inf")
        return float(np.std(single, ddof=1) / np.sqrt(len(single))) if np.isfinite(single).all() else 0.0

    @staticmethod
    def _divide(stated: float, rel: float) -> float:
        return stated / rel if rel > 0.0 else float("inf")

    @property
    def case(self) -> str:
        """The sample and how it was baked."""
        one = self.bakes[0]
        return one.sample + (", finest" if one.finest else f", {one.photons / 1e6:.0f} M photons")

    def row(self) -> list[str]:
        first = self.bakes[0]
        rel, nrmse = (root_mean_square([getattr(one.errors, name) for one in self.bakes]) for name in ("rel", "nrmse"))
        single = sorted(self._divide(one.stated, one.rel) for one in self.bakes)
        return [
            first.sample + (", finest" if first.finest else ""),
            f"{first.photons / 1e6:.1f} M",
            f"{rel:.2%}",
            f"{nrmse:.2%}",
            f"{np.mean([one.errors.bias for one in self.bakes]):+.2%}",
            f"{root_mean_square([one.truth.rel for one in self.bakes if one.truth]):.2%}" if first.truth else "",
            f"{root_mean_square([one.stated for one in self.bakes]):.2%}",
            f"{self.ratio:.2f}",
            f"{single[0]:.2f} to {single[-1]:.2f}" if len(single) > 1 else "",
        ]


HEAD = ("sample", "photons", "rel", "nrmse", "bias", "rel to closed form", "stated error", "stated / rel", "of single bakes")


def root_mean_square(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def bake_page(folder: Path, settings: Settings) -> tuple[np.ndarray, np.ndarray, dict]:
    """The lighting page, the layout and the result of a bake of the snapshot in `folder`.

    out   (h, w, 4) float32; (n_tri, 3, 2) float64, [0, 1]; the core's result
    """
    Job(settings, str(folder / "images"), "lightmap").save(folder)
    bake.run_bake(folder, lambda message: None, lambda: False)
    result = json.loads((folder / RESULT_FILE).read_text(encoding="utf-8"))
    path = next(file["path"] for file in result["files"] if file["pass_name"] == "lighting")
    return image_file.read_image(Path(path))[0], np.load(folder / LAYOUT_FILE)["tri_uv"], result


def measure_sample(reference: Reference, folder: Path) -> Iterable[Series]:
    """The sample whose snapshot lies in `folder`, baked with each number of photons and at the finest settings."""
    snapshot = load_snapshot(folder / SNAPSHOT_FILE)

    def measure(settings: Settings) -> Measured:
        begin = time.perf_counter()
        page, tri_uv, result = bake_page(folder, settings)
        seconds = time.perf_counter() - begin
        errors, truth = reference.measure(page, tri_uv), measure_truth(reference.name, page, tri_uv, snapshot)
        stated, photons = result["estimated_error"], result["photons"]
        return Measured(reference.name, settings == FINEST, photons, errors, truth, stated, seconds, page)

    plain = Settings(size=SIZE, share_meshes=False, even_out=False, passes=("lighting",), error=NEVER)
    for count, least in SEEDS_OF_COUNT.items():
        yield repeat(lambda seed, count=count: measure(replace(plain, max_photons=count, seed=seed)), least)
    yield Series((measure(FINEST),))


def repeat(measure: Callable[[int], Measured], least: int) -> Series:
    """Bakes of the seeds from 1: `least` of them, and more while chance could decide what their ratio is."""
    series = Series(tuple(measure(seed) for seed in range(1, least + 1)))
    while len(series.bakes) < MOST_SEEDS and series.doubt > SURE:
        series = Series((*series.bakes, measure(len(series.bakes) + 1)))
    return series


def judge(measured: list[Series]) -> list[Claim]:
    """The claims on each series."""
    claims = []
    for series in measured:
        one = series.bakes[0]
        if one.finest:
            bias, rel = 100 * one.errors.bias, 100 * one.errors.rel
            claims.append(Claim("Cycles: bias against it", bias, -MOST_BIAS, MOST_BIAS, "%", one.sample))
            claims.append(Claim("Cycles: rel at the finest settings", rel, high=MOST_REL, unit="%", case=one.sample))
        else:
            within = (1 - STATED_WITHIN, 1 + STATED_WITHIN)
            claims.append(Claim("Cycles: stated error over measured", series.ratio, *within, case=series.case))
    return claims


def table_claims(claims: list[Claim]) -> Table:
    """Claims, measured beside claimed."""
    rows = [[f"{claim.case}: {claim.name.partition(': ')[2]}", *claim.texts, "holds" if claim.holds else "FAILS"] for claim in claims]
    return Table(("claim", "measured", "bound", ""), rows)


def draw_map(one: Measured, reference: Reference, path: Path) -> None:
    """Signed error relative to local brightness on the page: red is too bright, blue too dark, white is covered and right."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    mean = ((reference.first + reference.second) / 2.0).mean(1)
    value = one.page[reference.covered][:, :3].mean(1)
    picture = np.full(reference.covered.shape, np.nan)
    picture[reference.covered] = (value - mean) / (mean + 0.1 * mean[mean > 0.0].mean())
    figure, axes = pyplot.subplots(figsize=(11, 10))
    image = axes.imshow(picture, origin="lower", cmap="RdBu_r", vmin=-0.15, vmax=0.15, interpolation="nearest")
    axes.set_facecolor("0.6")
    figure.colorbar(image)
    figure.tight_layout()
    figure.savefig(path, dpi=90)
    pyplot.close(figure)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="samples, without them all")
    parser.add_argument("--docs", action="store_true", help="write the tables into docs/cycles.md")
    parser.add_argument("--maps", type=Path, help="draw maps of the error at the finest settings into this folder")
    arguments = parser.parse_args()
    names = arguments.names or sorted(SAMPLE_COUNTS)
    add_image_io()
    measured = []
    with tempfile.TemporaryDirectory() as work:
        export_samples(Path(work), *(":".join([name, *filter(None, [",".join(OBJECTS.get(name, ()))])]) for name in names))
        for name in names:
            reference = Reference.load(name, SIZE)
            folder = Path(work) / name
            folder.mkdir()
            (Path(work) / f"{name}.npz").rename(folder / SNAPSHOT_FILE)
            for series in measure_sample(reference, folder):
                measured.append(series)
                last = series.bakes[-1]
                print(*series.row(), f"{sum(one.seconds for one in series.bakes):.0f} s", sep="  ", file=sys.stderr, flush=True)
                if arguments.maps and last.finest:
                    arguments.maps.mkdir(parents=True, exist_ok=True)
                    draw_map(last, reference, arguments.maps / f"{name}.png")
    claims = judge(measured)
    tables = {"errors": Table(HEAD, [one.row() for one in measured]), "claims": table_claims(claims)}
    print(*tables.values(), sep="\n\n")
    if arguments.docs:
        fill_page(DOCS / "cycles.md", tables)
    return publish_claims("accuracy", claims)


if __name__ == "__main__":
    sys.exit(main())
