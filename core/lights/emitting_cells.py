"""Subdivision of emitting triangles into cells: slender triangles are cut, textured ones are refined where the radiance varies."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from ..scene.materials import SurfaceMaterials
from ..scene.mipmap import Mipmap
from ..scene.scene import SceneSnapshot
from ..scene.slender_triangles import cut_slender, find_between, find_corners
from ..util.arrays import BoolArray, Float32, Float64, FloatArray, Int64, IntArray
from ..util.brightness import weigh_channels
from ..util.coverage import expand_ranges
from ..util.geometry import triangle_normals_areas
from ..util.sampling import square_to_uniform_triangle
from .light_links import LightLinks

_MAX_CELLS = 2**17
_FIRST_CELLS = 2**16, 64  # before refinement, in all and per side of a triangle, since the distance of near receivers varies over it
_CELL_SAMPLES = 4  # per side
_FLOOR = 0.05  # of the mean radiance, added so that the pdf is positive where the cell's samples missed the light
# Refinement ends at this variance of the radiance within cells, relative to the squared mean radiance: the other variance of shadow rays
# (distance, cosines, visibility) is larger.
_EVEN = 0.05
_ALIKE = 1e-6  # greatest relative variance of a radiance that counts as constant: the rounding of half floats
_LEAST_CUT = 1 / 64  # refinement ends when there is no room to cut at least this share of the cells


@dataclass(frozen=True)
class EmittingCells:
    """Cells of emitting triangles; a cell is a square in the domain of square_to_uniform_triangle.

    tri          (n,) int64
    corner       (n, 2) float32     lower left corner of the square
    side         (n,) float32       1 if the cell is the whole domain
    area_m2      (n,) float64
    mean_rgb     (n, 3) float64     W/m^2/sr, mean of the samples
    constant     whether every cell's radiance is its mean_rgb everywhere
    part         (n, 3, 2) float32  weights of the triangle's corners 1 and 2 at the corners of the part to which the domain maps, see
                                    slender_triangles; None if no triangle is cut into parts
    link         row of LightLinks, -1 for none
    """

    tri: Int64
    corner: Float32
    side: Float32
    area_m2: Float64
    mean_rgb: Float64
    constant: bool
    part: Float32 | None = None
    link: int = -1

    def place(self, cell: IntArray, u: FloatArray) -> tuple[Int64, Float32]:
        """Triangles (n,) and weights (n, 2) of their corners 1 and 2 at points u (n, 2) of cells (n,)."""
        corner, side = self.corner.take(cell, axis=0), self.side.take(cell)[:, None]
        within = square_to_uniform_triangle(corner + side * u.astype(np.float32, copy=False))
        return self.tri.take(cell), within if self.part is None else find_between(self.part[cell], within)

    def join_parts(self) -> EmittingCells:
        """The same light from whole triangles, if the parts of each have the same radiance: photon emission needs no parts."""
        if self.part is None or not self.constant:
            return self
        tri, first, whose = np.unique(self.tri, return_index=True, return_inverse=True)
        if not np.array_equal(self.mean_rgb, self.mean_rgb[first][whose]):
            return self
        area: Float64 = np.bincount(whose, self.area_m2).astype(np.float64)
        return EmittingCells(tri, self.corner[first], self.side[first], area, self.mean_rgb[first], True, link=self.link)

    @property
    def importance(self) -> Float64:
        """(n,) float64: area times radiance; textured cells have _FLOOR of the mean radiance added."""
        radiance = weigh_channels(self.mean_rgb)
        if not self.constant:
            radiance = radiance + _FLOOR * np.average(radiance, weights=self.area_m2)
        return self.area_m2 * radiance


def find_emitting_cells(snapshot: SceneSnapshot, surfaces: SurfaceMaterials, links: LightLinks) -> list[tuple[int, EmittingCells]]:
    """(material, cells) of every emitting material with area, on objects that other surfaces see; those of each row of LightLinks, and
    textured cells of constant radiance, are separate entries.
    """
    emitting = [i for i, material in enumerate(snapshot.materials) if any(material.emission_rgb)]
    if not emitting:
        return []
    position = snapshot.tri_position
    area = triangle_normals_areas(position)[1]
    seen = links.seen_rgb.any(axis=(0, 1))
    lights_others = (area > 0) & ((links.of_tri < 0) | seen[links.of_tri] if len(seen) else True)
    found = []
    for index in emitting:
        own = np.flatnonzero((snapshot.tri_material == index) & lights_others)
        for link in np.unique(links.of_tri[own]).tolist():
            tri = own[links.of_tri[own] == link]
            owner, part, part_area = cut_slender(position[tri], area[tri])
            every = _cut_cells(snapshot, surfaces, index, tri[owner], part if len(owner) > len(tri) else None, part_area)
            found += [(index, replace(cells, link=link)) for cells in every if cells.mean_rgb.any()]
    return found


def _cut_cells(
    snapshot: SceneSnapshot, surfaces: SurfaceMaterials, material: int, tri: Int64, part: Float32 | None, area_m2: Float64
) -> list[EmittingCells]:
    """Cells of triangles or their parts (n,); `part` as in EmittingCells."""
    count = len(tri)
    corner, side = np.zeros((count, 2), np.float32), np.ones(count, np.float32)
    if snapshot.materials[material].emission_image < 0:
        rgb = surfaces.emission.at(tri, np.zeros(count), np.zeros(count)).astype(np.float64)
        return [EmittingCells(tri, corner, side, area_m2, rgb, True, part)]
    texture = _Texture.of(snapshot, surfaces, material, tri, part)
    whole = texture.look_at(np.arange(count), corner, side, area_m2)
    even, rest = np.flatnonzero(whole.is_even()), np.flatnonzero(~whole.is_even())
    found = []
    if len(even):  # separate, as closed forms give their irradiance at near receivers
        own = None if part is None else part[even]
        found.append(EmittingCells(tri[even], corner[even], side[even], area_m2[even], whole.mean_rgb[even], True, own))
    if not len(rest):
        return found
    finest = min(_FIRST_CELLS[1], max(1, math.isqrt(_FIRST_CELLS[0] // len(rest))))
    per_side = np.clip(np.ceil(whole.texels[rest]), 1, finest).astype(np.int64)
    cells = texture.look_at(*_cut_squares(per_side, rest, corner[rest], side[rest], area_m2[rest]))
    while len(rows := cells.find_uneven()):
        parts = _cut_squares(np.full(len(rows), 2), cells.whose[rows], cells.corner[rows], cells.side[rows], cells.area_m2[rows])
        cells = cells.replace_rows(rows, texture.look_at(*parts))
    own = None if part is None else part[cells.whose]
    found.append(EmittingCells(tri[cells.whose], cells.corner, cells.side, cells.area_m2, cells.mean_rgb, False, own))
    return found


def _cut_squares(
    per_side: Int64, whose: Int64, corner: Float32, side: Float32, area_m2: Float64
) -> tuple[Int64, Float32, Float32, Float64]:
    """Cuts cells (n,) into per_side ** 2 squares each."""
    count = per_side**2
    owner, within = expand_ranges(np.zeros_like(count), count)
    across = per_side[owner]
    short = (side[owner] / across).astype(np.float32)
    at = corner[owner] + np.stack([within % across, within // across], axis=1) * short[:, None]
    return whose[owner], at.astype(np.float32), short, area_m2[owner] / across**2


@dataclass(frozen=True)
class _TexturedCells:
    """As EmittingCells, with statistics of the texture.

    whose      (n,) int64     row of _Texture
    variance   (n,) float64   of the radiance within the cell
    texels     (n,) float64   longest side
    """

    whose: Int64
    corner: Float32
    side: Float32
    area_m2: Float64
    mean_rgb: Float64
    variance: Float64
    texels: Float64

    def is_even(self) -> BoolArray:
        """(n,) bool: cells of constant, positive radiance. A black cell may be lit between the samples, so it does not count."""
        radiance = weigh_channels(self.mean_rgb)
        return (radiance > 0) & (self.variance <= _ALIKE * radiance**2)

    def find_uneven(self) -> Int64:
        """Rows of the cells to cut, as many as there is room for; none once the variance is at most _EVEN."""
        radiance, count = weigh_channels(self.mean_rgb), len(self.whose)
        power = self.area_m2 * radiance
        least = _FLOOR * power.sum() / self.area_m2.sum() + 1e-300
        # Contribution to the variance of a one-ray estimate that chooses cells in proportion to power.
        uneven = np.where(self.texels > 1, self.area_m2 * self.variance / (radiance + least), 0.0)
        most, allowed = (_MAX_CELLS - count) // 6, _EVEN * power.sum()  # half of the room; the rest is for the next pass
        if uneven.sum() <= allowed or most < _LEAST_CUT * count:
            return np.zeros(0, np.int64)
        worst = np.argsort(-uneven, kind="stable")[:most]
        return worst[uneven[worst] > allowed / count]

    def replace_rows(self, rows: Int64, parts: _TexturedCells) -> _TexturedCells:
        """Removes some rows and appends others."""
        return _TexturedCells(*(np.concatenate([np.delete(old, rows, axis=0), vars(parts)[name]]) for name, old in vars(self).items()))


@dataclass(frozen=True)
class _Texture:
    """Emission texture of a material on its triangles or their parts (n,).

    tri    (n,) int64; part (n, 3, 2) or None, as in EmittingCells
    uv     (n, 3, 2) float32
    size   width and height
    """

    surfaces: SurfaceMaterials
    tri: Int64
    part: Float32 | None
    uv: Float32
    size: tuple[int, int]
    mipmap: Mipmap

    @classmethod
    def of(cls, snapshot: SceneSnapshot, surfaces: SurfaceMaterials, material: int, tri: Int64, part: Float32 | None) -> _Texture:
        emission = snapshot.materials[material]
        image = snapshot.images[emission.emission_image]
        height, width = image.pixels.shape[:2]
        uv = np.nan_to_num(snapshot.tri_emission_uv[tri], posinf=0, neginf=0)
        if part is not None:
            uv = find_corners(uv, part)
        return cls(surfaces, tri, part, uv, (width, height), Mipmap(image, emission.emission_rgb))

    def measure(self, whose: Int64, side: Float32) -> Float64:
        """(n,) float64: longest side of cells, in texels."""
        uv = self.uv[whose].astype(np.float64) * self.size
        return np.abs(uv - np.roll(uv, 1, axis=1)).max(axis=(1, 2)) * side

    def look_at(self, whose: Int64, corner: Float32, side: Float32, area_m2: Float64) -> _TexturedCells:
        """Cells (n,) with mean and variance of the radiance from stratified texture samples."""
        texels = self.measure(whose, side)
        # The mipmap's texels are at least as wide as the spacing of samples: bilinear filtering spreads light half a texel over a border.
        level = np.ceil(np.log2(np.clip(texels / (_CELL_SAMPLES - 1), 1, max(*self.size, 1)))).astype(np.int64)
        mean, square = np.zeros((2, len(whose), 3))
        for one in np.unique(level):
            rows = np.flatnonzero(level == one)
            for point in product(range(_CELL_SAMPLES), repeat=2):
                within = side[rows, None] * (np.array(point, np.float32) + np.float32(0.5)) / _CELL_SAMPLES
                rgb, squared = self._show(int(one), whose[rows], square_to_uniform_triangle(corner[rows] + within))
                mean[rows] += rgb
                square[rows] += squared
        mean, square = mean / _CELL_SAMPLES**2, square / _CELL_SAMPLES**2
        variance = weigh_channels(np.maximum(square - mean**2, 0))
        return _TexturedCells(whose, corner, side, area_m2, mean, variance, texels)

    def _show(self, level: int, whose: Int64, barycentric: Float32) -> tuple[Float64, Float64]:
        """Means of the radiance and of its square, (n, 3) each, in the mipmap's texels about points."""
        if level:
            mean, square = self.mipmap.at(level, find_between(self.uv[whose], barycentric))
            return mean.astype(np.float64), square.astype(np.float64)
        if self.part is not None:
            barycentric = find_between(self.part[whose], barycentric)
        rgb = self.surfaces.emission.at(self.tri[whose], *barycentric.T).astype(np.float64)
        return rgb, rgb**2
