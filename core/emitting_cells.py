"""Emitting triangles, cut into cells where a texture lights them: small ones where it is uneven."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from .brightness import weigh_channels
from .geometry import take_rows, triangle_normals_areas
from .lights import Float32, Float64
from .materials import SurfaceMaterials
from .mipmap import Mipmap
from .sampling import square_to_uniform_triangle
from .scene import FloatArray, IntArray, SceneSnapshot

_MAX_CELLS = 2**17
_FIRST_CELLS = 2**16, 64  # at most, and per side of a triangle: who is near sees them at unlike distances
_CELL_SAMPLES = 4  # per side
_FLOOR = 0.05  # of the mean radiance, so that light the cell's samples missed is still found
# Variance of the radiance within cells, over the mean radiance squared, at which none is cut any more: what else shadow rays differ by is
# more.
_EVEN = 0.05
_LEAST_CUT = 1 / 64  # share of the cells for which there must be room to cut them


@dataclass(frozen=True)
class EmittingCells:
    """Emitting triangles, cut into cells where a texture lights them; a cell is a square of square_to_uniform_triangle's domain.

    tri          (n,) int64
    corner       (n, 2) float32     lower left corner of the square
    side         (n,) float32       1 where the whole triangle is the cell
    area_m2      (n,) float64
    mean_rgb     (n, 3) float64     W/m^2/sr, mean of the samples
    constant     whether the radiance is mean_rgb everywhere
    """

    tri: NDArray[np.int64]
    corner: Float32
    side: Float32
    area_m2: Float64
    mean_rgb: Float64
    constant: bool

    def place(self, cell: IntArray, u: FloatArray) -> tuple[NDArray[np.int64], Float32]:
        """Triangles (n,) and weights (n, 2) of their corners 1 and 2 at points u (n, 2) of cells (n,)."""
        corner, side = take_rows(self.corner, cell), self.side.take(cell)[:, None]
        return self.tri.take(cell), square_to_uniform_triangle(corner + side * u.astype(np.float32, copy=False))

    @property
    def importance(self) -> Float64:
        """(n,) float64: area times radiance, with a floor under textured ones."""
        radiance = weigh_channels(self.mean_rgb)
        if not self.constant:
            radiance = radiance + _FLOOR * np.average(radiance, weights=self.area_m2)
        return self.area_m2 * radiance


def find_emitting_cells(snapshot: SceneSnapshot, surfaces: SurfaceMaterials) -> list[tuple[int, EmittingCells]]:
    """(material, its cells) for every material that emits from a triangle with area."""
    emitting = [i for i, material in enumerate(snapshot.materials) if any(material.emission_rgb)]
    if not emitting:
        return []
    area = triangle_normals_areas(snapshot.tri_position)[1]
    found = []
    for index in emitting:
        tri = np.flatnonzero((snapshot.tri_material == index) & (area > 0))
        if len(tri):
            cells = _cut_cells(snapshot, surfaces, index, tri, area[tri])
            if cells.mean_rgb.any():
                found.append((index, cells))
    return found


def _cut_cells(
    snapshot: SceneSnapshot, surfaces: SurfaceMaterials, material: int, tri: NDArray[np.int64], area_m2: Float64
) -> EmittingCells:
    count = len(tri)
    corner, side = np.zeros((count, 2), np.float32), np.ones(count, np.float32)
    if snapshot.materials[material].emission_image < 0:
        rgb = surfaces.emission_at(tri, np.zeros(count), np.zeros(count)).astype(np.float64)
        return EmittingCells(tri, corner, side, area_m2, rgb, True)
    texture = _Texture.of(snapshot, surfaces, material)
    finest = min(_FIRST_CELLS[1], max(1, math.isqrt(_FIRST_CELLS[0] // count)))
    per_side = np.clip(np.ceil(texture.measure(tri, side)), 1, finest).astype(np.int64)
    cells = texture.look_at(*_cut_squares(per_side, tri, corner, side, area_m2))
    while len(rows := cells.find_uneven()):
        parts = _cut_squares(np.full(len(rows), 2), cells.tri[rows], cells.corner[rows], cells.side[rows], cells.area_m2[rows])
        cells = cells.replace_rows(rows, texture.look_at(*parts))
    return EmittingCells(cells.tri, cells.corner, cells.side, cells.area_m2, cells.mean_rgb, False)


def _cut_squares(
    per_side: NDArray[np.int64], tri: NDArray[np.int64], corner: Float32, side: Float32, area_m2: Float64
) -> tuple[NDArray[np.int64], Float32, Float32, Float64]:
    """Cells (n,), each cut into per_side ** 2 squares."""
    count = per_side**2
    owner = np.repeat(np.arange(len(tri)), count)
    within, across = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count), per_side[owner]
    short = (side[owner] / across).astype(np.float32)
    at = corner[owner] + np.stack([within % across, within // across], axis=1) * short[:, None]
    return tri[owner], at.astype(np.float32), short, area_m2[owner] / across**2


@dataclass(frozen=True)
class _TexturedCells:
    """As EmittingCells.

    variance   (n,) float64   of the radiance over each
    texels     (n,) float64   the longest side of each
    """

    tri: NDArray[np.int64]
    corner: Float32
    side: Float32
    area_m2: Float64
    mean_rgb: Float64
    variance: Float64
    texels: Float64

    def find_uneven(self) -> NDArray[np.int64]:
        """Those that had best be cut, as many as there is room for; none where all are even enough."""
        radiance, count = weigh_channels(self.mean_rgb), len(self.tri)
        power = self.area_m2 * radiance
        least = _FLOOR * power.sum() / self.area_m2.sum() + 1e-300
        # What a ray to a point of a cell that was chosen by its power adds to the variance of an estimate.
        uneven = np.where(self.texels > 1, self.area_m2 * self.variance / (radiance + least), 0.0)
        most, allowed = (_MAX_CELLS - count) // 6, _EVEN * power.sum()  # half of the room: parts may need it more
        if uneven.sum() <= allowed or most < _LEAST_CUT * count:
            return np.zeros(0, np.int64)
        worst = np.argsort(-uneven, kind="stable")[:most]
        cut: NDArray[np.int64] = worst[uneven[worst] > allowed / count]
        return cut

    def replace_rows(self, rows: NDArray[np.int64], parts: _TexturedCells) -> _TexturedCells:
        """Without some rows, but with others at their end."""
        return _TexturedCells(*(np.concatenate([np.delete(old, rows, axis=0), vars(parts)[name]]) for name, old in vars(self).items()))


@dataclass(frozen=True)
class _Texture:
    """What lights the triangles of a material."""

    surfaces: SurfaceMaterials
    tri_uv: Float32  # (n_tri, 3, 2)
    size: tuple[int, int]  # width and height
    mipmap: Mipmap

    @classmethod
    def of(cls, snapshot: SceneSnapshot, surfaces: SurfaceMaterials, material: int) -> _Texture:
        emission = snapshot.materials[material]
        image = snapshot.images[emission.emission_image]
        height, width = image.pixels.shape[:2]
        uv = np.nan_to_num(snapshot.tri_emission_uv, posinf=0, neginf=0)
        return cls(surfaces, uv, (width, height), Mipmap(image, emission.emission_rgb))

    def measure(self, tri: NDArray[np.int64], side: Float32) -> Float64:
        """(n,) float64, texels: the longest side of cells."""
        uv = self.tri_uv[tri].astype(np.float64) * self.size
        longest: Float64 = np.abs(uv - np.roll(uv, 1, axis=1)).max(axis=(1, 2)) * side
        return longest

    def look_at(self, tri: NDArray[np.int64], corner: Float32, side: Float32, area_m2: Float64) -> _TexturedCells:
        """Cells (n,) with what they show."""
        texels = self.measure(tri, side)
        # Means over more than lies between samples: what shines beyond the border does so half a texel into the cell.
        level = np.ceil(np.log2(np.clip(texels / (_CELL_SAMPLES - 1), 1, max(*self.size, 1)))).astype(np.int64)
        mean, square = np.zeros((2, len(tri), 3))
        for one in np.unique(level):
            rows = np.flatnonzero(level == one)
            for point in product(range(_CELL_SAMPLES), repeat=2):
                within = side[rows, None] * (np.array(point, np.float32) + np.float32(0.5)) / _CELL_SAMPLES
                rgb, squared = self._show(int(one), tri[rows], square_to_uniform_triangle(corner[rows] + within))
                mean[rows] += rgb
                square[rows] += squared
        mean, square = mean / _CELL_SAMPLES**2, square / _CELL_SAMPLES**2
        variance = weigh_channels(np.maximum(square - mean**2, 0))
        return _TexturedCells(tri, corner, side, area_m2, mean, variance, texels)

    def _show(self, level: int, tri: NDArray[np.int64], barycentric: Float32) -> tuple[Float64, Float64]:
        """Radiance and its square, (n, 3) each, about points of triangles."""
        u, v = barycentric.T
        if level:
            first, second, third = self.tri_uv[tri].transpose(1, 0, 2)
            mean, square = self.mipmap.at(level, first + u[:, None] * (second - first) + v[:, None] * (third - first))
            return mean.astype(np.float64), square.astype(np.float64)
        rgb = self.surfaces.emission_at(tri, u, v).astype(np.float64)
        return rgb, rgb**2
