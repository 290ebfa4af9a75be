"""The samples against Cycles, texel by texel: is there a bias, how small does the error get, is the stated error true?

python tests/bench/bench_accuracy.py [NAME ...] [--docs] [--maps DIR]     about ten minutes on two cores; needs pip's bpy for the export

Exits with 1 when a claim fails.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from bench_paper import DOCS, put_tables
from claims import Claim, publish_claims
from cycles_reference import SAMPLE_COUNTS, Reference
from export_samples import export_samples
from image_io_path import add_image_io
from leaflight.core import bake, image_file
from leaflight.core.job import LAYOUT_FILE, RESULT_FILE, SNAPSHOT_FILE, Job
from leaflight.core.settings import Settings
from lightmap_errors import LightmapErrors
from paper_tables import Table

SIZE = 256
NEVER = 1e-4  # an error that no bake here comes to, so that the photons decide
COUNTS = (1_000_000, 4_000_000, 16_000_000)
FINEST = Settings(size=SIZE, share_meshes=False, passes=("lighting",), error=0.005, max_photons=128_000_000)
MOST_BIAS, MOST_REL, STATED_WITHIN = 0.5, 2.0, 0.25  # %, %, 1


@dataclass(frozen=True)
class Measured:
    """One bake of a sample beside its reference.

    page   (SIZE, SIZE, 4) float32, `lighting`
    """

    sample: str
    finest: bool
    photons: int
    errors: LightmapErrors
    stated: float
    seconds: float
    page: np.ndarray

    @property
    def ratio(self) -> float:
        """Stated error over measured one; infinite where none was measured."""
        return self.stated / self.errors.rel if self.errors.rel > 0.0 else float("inf")

    def row(self) -> list[str]:
        errors = self.errors
        return [
            self.sample + (", finest" if self.finest else ""),
            f"{self.photons / 1e6:.1f} M",
            f"{errors.rel:.2%}",
            f"{errors.nrmse:.2%}",
            f"{errors.bias:+.2%}",
            f"{self.stated:.2%}",
            f"{self.ratio:.2f}",
        ]


HEAD = ("sample", "photons", "rel", "nrmse", "bias", "stated error", "stated / rel")


def bake_page(folder: Path, settings: Settings) -> tuple[np.ndarray, np.ndarray, dict]:
    """The lighting page, the layout and the result of a bake of the snapshot in `folder`.

    out   (h, w, 4) float32; (n_tri, 3, 2) float64, [0, 1]; the core's result
    """
    Job(settings, str(folder / "images"), "lightmap").save(folder)
    bake.run_bake(folder, lambda message: None, lambda: False)
    result = json.loads((folder / RESULT_FILE).read_text(encoding="utf-8"))
    path = next(file["path"] for file in result["files"] if file["pass_name"] == "lighting")
    return image_file.read_image(Path(path))[0], np.load(folder / LAYOUT_FILE)["tri_uv"], result


def measure_sample(reference: Reference, folder: Path) -> Iterable[Measured]:
    """The sample whose snapshot lies in `folder`, baked with each number of photons and at the finest settings."""
    runs = [Settings(size=SIZE, share_meshes=False, passes=("lighting",), error=NEVER, max_photons=count) for count in COUNTS]
    for settings in (*runs, FINEST):
        begin = time.perf_counter()
        page, tri_uv, result = bake_page(folder, settings)
        seconds = time.perf_counter() - begin
        errors = reference.measure(page, tri_uv)
        yield Measured(reference.name, settings == FINEST, result["photons"], errors, result["estimated_error"], seconds, page)


def judge(measured: list[Measured]) -> list[Claim]:
    """The claims on each bake."""
    claims = []
    for one in measured:
        if one.finest:
            bias, rel = 100 * one.errors.bias, 100 * one.errors.rel
            claims.append(Claim("Cycles: bias against it", bias, -MOST_BIAS, MOST_BIAS, "%", one.sample))
            claims.append(Claim("Cycles: rel at the finest settings", rel, high=MOST_REL, unit="%", case=one.sample))
        else:
            case = f"{one.sample}, {one.photons / 1e6:.0f} M photons"
            claims.append(Claim("Cycles: stated error over measured", one.ratio, 1 - STATED_WITHIN, 1 + STATED_WITHIN, case=case))
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
        export_samples(Path(work), *names)
        for name in names:
            reference = Reference.load(name, SIZE)
            folder = Path(work) / name
            folder.mkdir()
            (Path(work) / f"{name}.npz").rename(folder / SNAPSHOT_FILE)
            for one in measure_sample(reference, folder):
                measured.append(one)
                print(*one.row(), f"{one.seconds:.0f} s", sep="  ", file=sys.stderr, flush=True)
                if arguments.maps and one.finest:
                    arguments.maps.mkdir(parents=True, exist_ok=True)
                    draw_map(one, reference, arguments.maps / f"{name}.png")
    claims = judge(measured)
    tables = {"errors": Table(HEAD, [one.row() for one in measured]), "claims": table_claims(claims)}
    print(*tables.values(), sep="\n\n")
    if arguments.docs:
        page = DOCS / "cycles.md"
        page.write_text(put_tables(page.read_text(encoding="utf-8"), tables), encoding="utf-8")
    return publish_claims("accuracy", claims)


if __name__ == "__main__":
    sys.exit(main())
