"""References: the samples as Cycles bakes them, two seeds each, on the UV layer that Leaflight makes.

python tests/bench/cycles_reference.py [NAME ...] [--size N] [--samples N] [--folder DIR]     an hour for each size on two cores

DIFFUSE with Direct and Indirect, without Color; nothing is clamped, filtered or denoised, and no path is cut short. What a texel of Cycles
is: see cycles_bake.py; Blender 5.2's is another one, so make them with 5.0. Of pages larger than 256 texels windows are baked, spread
over the page, with as many texels in all: the noise of a texel counts in the measure, and would take hours to bake away on all of them.
Files are NAME_SIZE.npz, their arrays:
  covered         (size * size / 8,) uint8, bits: texels that Cycles baked in the windows, row 0 at the bottom
  first, second   (n, 3) float16: lighting of the covered texels, W/m^2/pi, of either seed
  tri_uv          (n_tri, 3, 2) uint16: the layout in 65535ths of the page, by which a bake on another layout is told
  size, samples, blender
"""

from __future__ import annotations

import argparse
import math
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from lightmap_errors import LightmapErrors, measure_errors, reference_noise

ROOT = Path(__file__).resolve().parents[2]
SAMPLES = ROOT / "sample_blends"
REFERENCES = Path(__file__).resolve().parent / "references"
SEEDS = (1, 2)
# Samples of each seed by which the noise of both seeds' mean is below 2 % of local brightness. Of cornell_box it is 0.8 %: bakes of 16 M
# photons err by 1 % there, and seen through the noise of a quarter of the samples, 1.7 %, that was 0.84 %.
SAMPLE_COUNTS = {
    "bent_quads": 1024,
    "cornell_box": 4096,
    "figure2_square": 256,
    "furnace": 256,
    "furnished_room": 24576,
    "instances": 256,
    "two_rooms": 2048,
}
_WINDOW_SAMPLE_COUNTS = {**SAMPLE_COUNTS, "furnished_room": 12288}  # the same of larger pages
# Samples whose references are committed, by the side of their page, texels.
COMMITTED = {256: tuple(SAMPLE_COUNTS), 1024: ("cornell_box", "furnished_room", "instances", "two_rooms")}
# What is baked of a sample, if not all of it: Cycles divides light by colour, so that black objects have none to be held against.
OBJECTS = {"figure2_square": ("Square",)}
WHOLE_SIZE = 256  # side of the largest page of which all is baked, texels
_WINDOWS = 16  # of a larger one, as many texels in all
_STEP = 5  # columns from window to window: prime to their number, so that no row and no column of windows has two
_UV_STEPS = 65535
_SAME_TEXELS = 0.02  # texels by which a layout may differ: float32 on another machine, not another packing


@dataclass(frozen=True)
class Reference:
    """One sample as Cycles bakes it.

    covered         (size, size) bool
    first, second   (n, 3) float32, of the covered texels in the order of rows
    tri_uv          (n_tri, 3, 2) float64, [0, 1]
    """

    name: str
    covered: np.ndarray
    first: np.ndarray
    second: np.ndarray
    tri_uv: np.ndarray

    @classmethod
    def load(cls, name: str, size: int = 256, folder: Path = REFERENCES) -> Reference:
        """Raises OSError where there is none."""
        with np.load(folder / f"{name}_{size}.npz") as file:
            covered = np.unpackbits(file["covered"], count=size * size).reshape(size, size).astype(bool)
            light = (file[key].astype(np.float32) for key in ("first", "second"))
            return cls(name, covered, *light, file["tri_uv"] / float(_UV_STEPS))

    def save(self, folder: Path, samples: int, blender: str) -> Path:
        size = len(self.covered)
        path = folder / f"{self.name}_{size}.npz"
        np.savez_compressed(
            path,
            covered=np.packbits(self.covered),
            first=self.first.astype(np.float16),
            second=self.second.astype(np.float16),
            tri_uv=np.round(self.tri_uv * _UV_STEPS).astype(np.uint16),
            size=size,
            samples=samples,
            blender=blender,
        )
        return path

    @property
    def noise(self) -> float:
        """Of the mean of both seeds, as `rel` counts it."""
        return reference_noise(self.first, self.second)

    def check_layout(self, tri_uv: np.ndarray) -> None:
        """Raises ValueError with a sentence where a bake is laid out otherwise.

        tri_uv   (n_tri, 3, 2) float, [0, 1]
        """
        limit = (_SAME_TEXELS / len(self.covered)) + 1.0 / _UV_STEPS
        if tri_uv.shape == self.tri_uv.shape and np.abs(tri_uv - self.tri_uv).max() <= limit:
            return
        raise ValueError(
            f"{self.name}: the bake's UV layout is not that of the reference, so their texels cannot be compared; "
            f"make it anew: python tests/bench/cycles_reference.py {self.name}"
        )

    def measure(self, page: np.ndarray, tri_uv: np.ndarray) -> LightmapErrors:
        """Errors of a baked `lighting` page.

        page   (size, size, 3 or 4) float, row 0 at the bottom
        Raises ValueError with a sentence where page or layout are not of the reference's kind.
        """
        self.check_layout(tri_uv)
        if page.shape[:2] != self.covered.shape:
            raise ValueError(
                f"{self.name}: the reference has {len(self.covered)} texels a side, the page {page.shape[0]}; bake it at that size."
            )
        return measure_errors(page[self.covered][:, :3], self.first, self.second)


def count_samples(name: str, size: int) -> int:
    """Samples of each seed of a committed reference."""
    return (SAMPLE_COUNTS if size <= WHOLE_SIZE else _WINDOW_SAMPLE_COUNTS)[name]


def spread_windows(size: int) -> tuple[int, list[tuple[int, int]]]:
    """Side of the windows of a page, texels, and the left and low end of each. Raises ValueError where they would not be whole."""
    if size <= WHOLE_SIZE:
        return size, [(0, 0)]
    pitch, side = size // _WINDOWS, WHOLE_SIZE // math.isqrt(_WINDOWS)
    if size % _WINDOWS or pitch < side:
        least = side * _WINDOWS
        raise ValueError(f"{size}: a page that is baked in windows must have a multiple of {_WINDOWS} texels a side, {least} or more.")
    return side, [(column * _STEP % _WINDOWS * pitch, column * pitch) for column in range(_WINDOWS)]


def make_reference(name: str, size: int, samples: int, folder: Path) -> None:
    """Bake one sample in this process, which loads bpy; says on standard error what came out."""
    import bpy
    from cycles_bake import bake_windows, set_stage

    side, corners = spread_windows(size)
    with tempfile.TemporaryDirectory() as work:
        stage = set_stage(SAMPLES / f"{name}.blend", size, Path(work), OBJECTS.get(name, ()), side)
    (first, seconds), (second, _) = (bake_windows(stage, corners, samples, seed) for seed in SEEDS)
    covered = (first[..., 3] > 0.0) & (second[..., 3] > 0.0)
    reference = Reference(name, covered, *(light[covered][:, :3] for light in (first, second)), stage.tri_uv)
    path = reference.save(folder, samples, bpy.app.version_string)
    print(
        f"{path.name}: {samples} samples, {seconds:.0f} s a seed, {covered.sum()} texels, "
        f"noise {reference.noise:.2%}, {path.stat().st_size / 1e3:.0f} kB",
        file=sys.stderr,
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="samples, without them all that are committed")
    parser.add_argument("--size", type=int, default=256, help="side of the page, texels")
    parser.add_argument("--samples", type=int, default=0, help="of each seed, instead of what the noise asks for")
    parser.add_argument("--folder", type=Path, default=REFERENCES)
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    names = arguments.names or sorted(COMMITTED.get(arguments.size, SAMPLE_COUNTS))
    if len(names) == 1:
        make_reference(names[0], arguments.size, arguments.samples or count_samples(names[0], arguments.size), arguments.folder)
        return
    for name in names:  # a process for each: Blender talks on standard output, and a crash takes one scene only
        options = ["--size", str(arguments.size), "--samples", str(arguments.samples), "--folder", str(arguments.folder)]
        subprocess.run([sys.executable, __file__, name, *options], check=True, stdout=subprocess.DEVNULL)


if __name__ == "__main__":
    main()
