"""A world whose radiance varies with direction: its map, its photons, and sampling of it for shadow rays: patches by their irradiance at
normals, then cells by power.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..scene.scene_cover import SceneCover
from ..util.arrays import Float32, Float64, FloatArray, Int64
from ..util.brightness import weigh_channels
from ..util.sphere_map import CellTable, LineTable, find_cells, find_middles, find_solid_angles, place_in_cells
from .lights import EmittedPhotons, Emitter, make_photons


@dataclass(frozen=True)
class Environment:
    """Radiance from every direction of infinity, constant in each cell of a map (see sphere_map).

    radiance   (h, w, 3) float32, W/m^2/sr; finite and >= 0
    """

    radiance: Float32

    @cached_property
    def cell_power(self) -> Float64:
        """(h, w) float64: brightness (weigh_channels) times solid angle of each cell."""
        height, width, _ = self.radiance.shape
        brightness = weigh_channels(self.radiance.reshape(-1, 3)).reshape(height, width)
        return brightness * find_solid_angles(height, width)[:, None]

    @property
    def shines(self) -> bool:
        return bool(self.radiance.any())

    def look_up(self, direction: FloatArray) -> Float32:
        """(n, 3) float32, W/m^2/sr: radiance from unit directions (n, 3)."""
        return self.radiance.reshape(-1, 3)[find_cells(self.radiance.shape, direction)]


@dataclass(frozen=True)
class EnvironmentEmitter(Emitter):
    """Photons of an environment: a direction is chosen by power, then a point on the scene's outline perpendicular to it.

    table         cells, weighted by the power that each sends into the scene
    cell_share    (h * w, 3) float32: power of a cell over its probability and over power_rgb, for an outline of 1
    """

    table: CellTable
    cell_share: Float32
    cover: SceneCover

    @classmethod
    def of(cls, name: str, environment: Environment, cover: SceneCover, per_area: float) -> EnvironmentEmitter:
        """per_area   square metres per unit of area in the unit box"""
        height, width, _ = environment.radiance.shape
        outline = cover.outline_area(find_middles((height, width))) * per_area
        weight = environment.cell_power.ravel() * outline
        solid_angle = np.repeat(find_solid_angles(height, width), width)
        in_sight = environment.radiance.reshape(-1, 3) * solid_angle[:, None]
        power = (in_sight * outline[:, None]).sum(axis=0)
        probability = weight / weight.sum()
        share = in_sight * per_area * np.divide(1, power, out=np.zeros(3), where=power > 0)
        share = np.divide(share, probability[:, None], out=np.zeros_like(share), where=probability[:, None] > 0)
        return cls(name, power, CellTable(weight.reshape(height, width)), share.astype(np.float32), cover)

    def emit(self, u: Float32) -> EmittedPhotons:
        toward, cell, _ = self.table.sample(u[:, 2:4])
        direction = -toward
        across, rest = self.cover.choose_faces(u[:, 0], np.abs(direction) * self.cover.face_area.astype(np.float32))
        entering_high = (across * direction.T).sum(axis=0) < 0
        relative = self.cell_share[cell] * self.cover.outline_area(direction)[:, None]
        return make_photons(self.cover.place(across, entering_high, rest, u[:, 1]), direction, relative)


_PATCH_ROWS, _PATCH_COLUMNS = 16, 32  # patches of the map
_NORMAL_ROWS = 48  # rows of the table of irradiance by normal, which has twice as many columns


@dataclass(frozen=True)
class EnvironmentTable:
    """An environment prepared for shadow rays. The power of a cell or patch is its brightness times its solid angle."""

    environment: Environment

    @classmethod
    def of(cls, environment: Environment) -> EnvironmentTable:
        """The table of an environment. Cells of a coarse map are divided until none is larger than a patch."""
        height, width, _ = environment.radiance.shape
        radiance = environment.radiance.repeat(-(-4 * _PATCH_ROWS // height), axis=0).repeat(-(-4 * _PATCH_COLUMNS // width), axis=1)
        return cls(Environment(radiance))

    @property
    def _shape(self) -> tuple[int, int]:
        height, width, _ = self.environment.radiance.shape
        return height, width

    @cached_property
    def _row_start(self) -> Int64:
        """(17,) int64: first row of the map in each row of patches, and the end."""
        return -(-np.arange(_PATCH_ROWS + 1) * self._shape[0] // _PATCH_ROWS)

    @cached_property
    def _column_start(self) -> Int64:
        """(33,) int64: the same for columns."""
        return -(-np.arange(_PATCH_COLUMNS + 1) * self._shape[1] // _PATCH_COLUMNS)

    @cached_property
    def _patch_of_cell(self) -> Int64:
        """(h * w,) int64: row of patches times their columns, plus column."""
        row = np.repeat(np.arange(_PATCH_ROWS), np.diff(self._row_start))
        column = np.repeat(np.arange(_PATCH_COLUMNS), np.diff(self._column_start))
        return (row[:, None] * _PATCH_COLUMNS + column).ravel()

    @cached_property
    def _along(self) -> LineTable:
        """The cells of each row of the map."""
        return LineTable(self.environment.cell_power)

    @cached_property
    def _up(self) -> LineTable:
        """The rows of the map in each column of patches."""
        return LineTable(np.add.reduceat(self.environment.cell_power, self._column_start[:-1], axis=1).T)

    @cached_property
    def power(self) -> Float64:
        """(n_patch,) float64."""
        return np.add.reduceat(np.add.reduceat(self.environment.cell_power, self._row_start[:-1]), self._column_start[:-1], axis=1).ravel()

    @cached_property
    def direction(self) -> Float32:
        """(n_patch, 3) float32, unit: mean directions of patches, weighted by power."""
        toward = find_middles(self._shape).astype(np.float64)
        power = self.environment.cell_power.ravel()
        sums = np.stack([np.bincount(self._patch_of_cell, power * axis, len(self.power)) for axis in toward.T], axis=1)
        return (sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-300)).astype(np.float32)

    @cached_property
    def _irradiance_by_normal(self) -> Float32:
        """(rows + 1, columns, 3) float32, W/m^2: unoccluded, for normals at even steps of angle, poles included."""
        polar = np.pi * np.arange(_NORMAL_ROWS + 1) / _NORMAL_ROWS
        azimuth = np.pi * np.arange(2 * _NORMAL_ROWS) / _NORMAL_ROWS
        normal = np.stack(
            np.broadcast_arrays(
                np.sin(polar)[:, None] * np.cos(azimuth), np.sin(polar)[:, None] * np.sin(azimuth), -np.cos(polar)[:, None]
            ),
            axis=-1,
        )
        toward, flux = self._condense()
        out = np.empty((len(polar), len(azimuth), 3), np.float32)
        for row, line in zip(out, normal.astype(np.float32), strict=True):
            # Small matrix products, since large ones would start threads.
            cosine = np.maximum(line @ toward.T, 0)
            row[:] = cosine @ flux
        return out

    def _condense(self) -> tuple[Float32, Float32]:
        """Directions (n, 3) of blocks of cells and their radiance times solid angle (n, 3), fine enough for cosine-weighted integrals."""
        height, width = self._shape
        rows, columns = min(4 * _PATCH_ROWS, height), min(4 * _PATCH_COLUMNS, width)
        block = ((np.arange(height) * rows // height)[:, None] * columns + np.arange(width) * columns // width).ravel()
        toward = find_middles(self._shape).astype(np.float64)
        solid_angle = np.repeat(find_solid_angles(height, width), width)
        rgb = self.environment.radiance.reshape(-1, 3) * solid_angle[:, None]
        weight = self.environment.cell_power.ravel()
        middle: Float64 = np.stack([np.bincount(block, weight * axis, rows * columns) for axis in toward.T], axis=1)
        # The mean vector of a block is slightly shorter than 1; its dot product with a normal is the mean cosine.
        middle /= np.maximum(np.bincount(block, weight, rows * columns), 1e-300)[:, None]
        flux = np.stack([np.bincount(block, channel, rows * columns) for channel in rgb.T], axis=1)
        lit = flux.any(axis=1)
        return middle[lit].astype(np.float32), flux[lit].astype(np.float32)

    def find_irradiance(self, normal: FloatArray) -> Float64:
        """(n, 3) float64, W/m^2: unoccluded irradiance at unit normals (n, 3), interpolated to 0.1 % of that at the brightest normal."""
        table = self._irradiance_by_normal
        x, y, z = np.asarray(normal, np.float64).T
        up = np.arctan2(np.hypot(x, y), -z) * (_NORMAL_ROWS / np.pi)
        along = np.arctan2(y, x) * (_NORMAL_ROWS / np.pi) % (2 * _NORMAL_ROWS)
        row = np.minimum(up.astype(np.int64), _NORMAL_ROWS - 1)
        column = np.minimum(along.astype(np.int64), 2 * _NORMAL_ROWS - 1)
        following = (column + 1) % (2 * _NORMAL_ROWS)
        v, u = (up - row)[:, None], (along - column)[:, None]
        out: Float64 = (table[row, column] * (1 - u) + table[row, following] * u) * (1 - v)
        out += (table[row + 1, column] * (1 - u) + table[row + 1, following] * u) * v
        return out

    def choose(self, patch: Int64, u: FloatArray) -> tuple[Float32, Int64, Float64]:
        """Directions (n, 3) in patches (n,) by power, their cells (n,), and their densities within the patch (n,), per steradian.

        u   (n, 2) float in [0, 1]: along and up
        """
        height, width = self._shape
        patch_row, patch_column = np.divmod(patch, _PATCH_COLUMNS)
        row, up, _ = self._up.find(patch_column, u[:, 1], self._row_start[patch_row], self._row_start[patch_row + 1])
        column, along, _ = self._along.find(row, u[:, 0], self._column_start[patch_column], self._column_start[patch_column + 1])
        cell = row * width + column
        of_patch = self.power[patch] * find_solid_angles(height, width)[row]
        density = self.environment.cell_power.ravel()[cell] / np.maximum(of_patch, 1e-300)
        return place_in_cells(self._shape, cell, along, up), cell, density

    def rate_by_normals(self, normal: FloatArray) -> Float64:
        """(n_group, n_patch) float64: approximate irradiance from each patch, averaged over a group of normals (n_group, k, 3)."""
        out = np.zeros((len(normal), len(self.power)))
        for one in np.moveaxis(normal, 1, 0):
            cosine = one.astype(np.float32) @ self.direction.T
            out += np.maximum(cosine + np.float32(math.pi / _PATCH_ROWS / 2), 0)
        out *= self.power / normal.shape[1]
        return out

    @staticmethod
    def blur(values: Float64) -> Float64:
        """Values (n, n_patch) filtered by the kernel (1, 2, 1) / 4 along rows and columns of patches."""
        grid = values.reshape(-1, _PATCH_ROWS, _PATCH_COLUMNS)
        grid = (np.roll(grid, 1, axis=2) + 2 * grid + np.roll(grid, -1, axis=2)) / 4
        padded = np.pad(grid, ((0, 0), (1, 1), (0, 0)))
        return ((padded[:, :-2] + 2 * grid + padded[:, 2:]) / 4).reshape(values.shape)


class PatchChoice:
    """Sampling of patches for blocks of texels: first their row, then their column.

    chance   (n_block, n_patch) float64, probabilities
    """

    def __init__(self, chance: Float64) -> None:
        by_row = chance.reshape(len(chance), _PATCH_ROWS, _PATCH_COLUMNS)
        self._rows, self._columns = LineTable(by_row.sum(axis=2)), LineTable(by_row.reshape(-1, _PATCH_COLUMNS))

    def choose(self, block: Int64, u: FloatArray) -> tuple[Int64, Float64, Float64]:
        """Patches for blocks (n,), their probabilities, and the numbers (n, 2) rescaled to [0, 1]: along and up."""
        row, up, of_row = self._rows.find(block, u[:, 1])
        column, along, of_column = self._columns.find(block * _PATCH_ROWS + row, u[:, 0])
        return row * _PATCH_COLUMNS + column, of_row * of_column, np.stack([along, up], axis=1)
