"""The sphere of directions as an equirectangular map of cells, and sampling of the cells.

Blender's layout: row 0 looks straight down, the last row up; columns go from -X by +Y, +X and -Y back to -X.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .arrays import Float32, Float64, FloatArray, IntArray

_TINY = 1e-300  # keeps 0 / 0 at 0


def find_solid_angles(height: int, width: int) -> Float64:
    """(height,) float64: steradians of a cell in each row of a map."""
    edge = np.cos(np.pi / height * np.arange(height + 1))
    return (edge[:-1] - edge[1:]) * (2 * np.pi / width)


def place_in_cells(shape: tuple[int, ...], cell: IntArray, along: FloatArray, up: FloatArray) -> Float32:
    """(n, 3) float32: unit directions at coordinates (along, up) in [0, 1] of cells (n,); uniform coordinates are uniform per steradian."""
    height, width = shape[:2]
    row, column = np.divmod(cell, width)
    across, z = _place_in_rows(height, row, up)
    phi = np.pi * (1 - 2 * (column + along) / width)
    out = np.empty((3, len(cell)), np.float32)
    out[0], out[1], out[2] = across * np.cos(phi), across * np.sin(phi), z
    return out.T


def find_middles(shape: tuple[int, ...]) -> Float32:
    """(h * w, 3) float32: unit directions to the middles of all cells of a map, much faster than place_in_cells."""
    height, width = shape[:2]
    across, z = _place_in_rows(height, np.arange(height), np.full(height, 0.5))
    phi = np.pi * (1 - 2 * (np.arange(width) + 0.5) / width)
    out = np.empty((3, height, width), np.float32)
    np.multiply(across[:, None], np.cos(phi), out=out[0], casting="same_kind")
    np.multiply(across[:, None], np.sin(phi), out=out[1], casting="same_kind")
    out[2] = z[:, None]
    return out.reshape(3, -1).T


def _place_in_rows(height: int, row: IntArray, up: FloatArray) -> tuple[Float64, Float64]:
    """Distances (n,) from the vertical axis and heights (n,) of unit directions, at `up` (n,) in [0, 1] within rows (n,) of a map."""
    edge = np.pi / height * np.arange(height + 1)
    # 1 + z and 1 - z are precise at the poles, and linear in `up`.
    low, high = 2 * np.sin(edge / 2) ** 2, 2 * np.cos(edge / 2) ** 2
    above, below = low[row] + (low[row + 1] - low[row]) * up, high[row] + (high[row + 1] - high[row]) * up
    return np.sqrt(np.maximum(above * below, 0)), above - 1


def find_cells(shape: tuple[int, ...], direction: FloatArray) -> IntArray:
    """(n,) int64: cells, row * width + column, in which unit directions (n, 3) lie."""
    height, width = shape[:2]
    x, y, z = np.asarray(direction, np.float64).T
    column = np.floor((0.5 - np.arctan2(y, x) / (2 * np.pi)) * width).astype(np.int64) % width
    row = np.clip(np.floor((np.arctan2(z, np.hypot(x, y)) / np.pi + 0.5) * height).astype(np.int64), 0, height - 1)
    return row * width + column


class LineTable:
    """Sampling of entries of lines by inversion of the cdf, so that nearby numbers give nearby entries.

    weight   (n_line, n_entry) float, >= 0
    """

    def __init__(self, weight: FloatArray) -> None:
        n_line, self._count = weight.shape
        end = np.zeros((n_line, self._count + 1))
        np.cumsum(weight, axis=1, out=end[:, 1:])
        end /= np.maximum(end[:, -1:], _TINY)
        self._end = end.ravel()
        # All lines in one ascending array: line i has values from i to i + 1.
        end = end + np.arange(n_line)[:, None]
        self._ascending = end.ravel()

    def find(
        self, line: IntArray, u: FloatArray, first: IntArray | int = 0, last: IntArray | None = None
    ) -> tuple[IntArray, Float64, Float64]:
        """Entries (n,) of lines (n,), the numbers (n,) rescaled to [0, 1], and the probabilities of the entries (n,).

        u             (n,) float in [0, 1]
        first, last   (n,) int: only entries first ... last - 1 are chosen; all if left out
        """
        start = line * (self._count + 1)
        begin, stop = start + first, start + (self._count if last is None else last)
        low, width = self._end[begin], self._end[stop] - self._end[begin]
        target = low + u * width
        # Bisection of a short range: searchsorted over all lines would miss the cache at every step.
        found, in_line = begin.copy(), target + line
        for bit in reversed(range(int((stop - begin).max(initial=1)).bit_length())):
            found += (self._ascending.take(found + (1 << bit), mode="clip") <= in_line) << bit
        np.minimum(found, stop - 1, out=found)
        below = self._end[found]
        own = np.maximum(self._end[found + 1] - below, 0.0)
        rest = np.clip((target - below) / np.maximum(own, _TINY), 0.0, 1.0)
        return found - start, rest, own / np.maximum(width, _TINY)


@dataclass(frozen=True)
class CellTable:
    """Directions with a density that is constant in each cell of a map and proportional to the cell's weight.

    weight   (h, w) float64, >= 0, at least one above 0

    Source: Pharr, Jakob & Humphreys 2023, "Physically Based Rendering", A.5.2 (piecewise-constant distributions).
    """

    weight: Float64

    @cached_property
    def _rows(self) -> LineTable:
        return LineTable(self.weight.sum(axis=1)[None])

    @cached_property
    def _columns(self) -> LineTable:
        return LineTable(self.weight)

    def sample(self, u: FloatArray) -> tuple[Float32, IntArray, Float64]:
        """Unit directions (n, 3), their cells (n,) int64, row * w + column, and the cells' probabilities (n,).

        u   (n, 2) float, uniform in [0, 1): up and along
        """
        row, up, of_row = self._rows.find(np.zeros(len(u), np.int64), u[:, 0])
        column, along, of_column = self._columns.find(row, u[:, 1])
        cell = row * self.weight.shape[1] + column
        return place_in_cells(self.weight.shape, cell, along, up), cell, of_row * of_column

    def pdf(self, direction: FloatArray) -> Float64:
        """(n,) float64, per steradian: density of sample() at unit directions (n, 3)."""
        cell = find_cells(self.weight.shape, direction)
        solid_angle = find_solid_angles(*self.weight.shape)[cell // self.weight.shape[1]]
        return self.weight.ravel()[cell] / self.weight.sum() / solid_angle
