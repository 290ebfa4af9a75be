"""Quads are squares of 2 x 2 texels that are sampled as one: over most of a large page light hardly changes within them.

8 x 8 quads form a large tile, in Morton order as the texels of a tile. There the light at texels is reconstructed as a fitted quadratic
surface plus the quads' residuals. Quads are not used where the surface does not fit (find_misfit).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..util.arrays import BoolArray, Float64, FloatArray, Int64, IntArray
from .texel_grid import part_bits
from .tiles import TILE_TEXELS, Tiles, find_residual2

_Index = TypeVar("_Index", bound=np.integer[Any])

QUAD_TEXELS = 4
_LARGE_TEXELS = QUAD_TEXELS * TILE_TEXELS
_LAST_TILE = np.array([0, 1, 1])  # of the four that form a large one: its offset from the first


@dataclass(frozen=True)
class Quads:
    """Quads of the large tiles among some texels.

    start   (m,) int64      rows of the tiles' first texels; the others follow in Morton order
    place   (m, 3) int64    chart, column and row of each tile, as in Tiles
    """

    start: Int64
    place: Int64

    @classmethod
    def none(cls) -> Quads:
        return cls(np.zeros(0, np.int64), np.zeros((0, 3), np.int64))

    @classmethod
    def of(cls, tiles: Tiles, tri: IntArray, alone: BoolArray) -> Quads:
        """Large tiles of four tiles on one triangle.

        tri     (n,) int    triangles of the texels
        alone   (n,) bool   texels unlike their neighbours; large tiles with any are left out
        """
        first = np.flatnonzero(~(tiles.place[:-3, 1:] & 1).any(axis=1))
        start, place = tiles.start[first], tiles.place[first]
        whole = (tiles.start[first + 3] == start + _LARGE_TEXELS - TILE_TEXELS) & (tiles.place[first + 3] == place + _LAST_TILE).all(axis=1)
        start, place = start[whole], place[whole]
        is_other = np.append(False, tri[1:] != tri[:-1])
        others, odd = (np.append(0, np.cumsum(marked, dtype=np.int32)) for marked in (is_other, alone))
        end = start + _LARGE_TEXELS
        even = (others[end] == others[start + 1]) & (odd[end] == odd[start])
        return cls(start[even], place[even] // np.array([1, 2, 2]))

    def __len__(self) -> int:
        """Number of large tiles."""
        return len(self.start)

    @property
    def first(self) -> Int64:
        """(m * 64,) int64, ascending: rows of each quad's first texel."""
        return (self.start[:, None] + np.arange(0, _LARGE_TEXELS, QUAD_TEXELS)).ravel()

    def tiles(self) -> Tiles:
        """The large tiles as Tiles among the quads."""
        return Tiles(np.arange(len(self)) * TILE_TEXELS, self.place)

    def texels(self, some: BoolArray) -> Int64:
        """(k * 256,) int64, ascending: rows of the texels of some of the tiles, (m,) bool."""
        return (self.start[some, None] + np.arange(_LARGE_TEXELS)).ravel()


def list_texels(first: NDArray[_Index]) -> NDArray[_Index]:
    """(k * 4,): the texels of quads whose first ones are (k,) int."""
    out = np.repeat(first, QUAD_TEXELS)
    out += np.tile(np.arange(QUAD_TEXELS, dtype=first.dtype), len(first))
    return out


def find_whole_quads(by_quads: BoolArray, code: IntArray) -> Int64:
    """(k,) int64, ascending: first entries of the quads whose texels are all marked.

    by_quads   (n,) bool: texel entries that were sampled by quads
    code       (n,) int: their Morton codes
    """
    first = np.flatnonzero(by_quads & (code & (QUAD_TEXELS - 1) == 0))
    return first[by_quads[list_texels(first)].reshape(-1, QUAD_TEXELS).all(axis=1)]


def find_misfit(value: Float64, variance: Float64) -> Float64:
    """(m,) float64, (W/m^2)^2: mean squared residual of quads from a quadratic surface, minus their variance, at least 0.

    value, variance   (m * 64,) float64, W/m^2 and its square, of quads
    """
    off2 = find_residual2(value.reshape(-1, TILE_TEXELS))
    return np.maximum(off2 - variance.reshape(-1, TILE_TEXELS).mean(axis=1), 0.0)


def spread_over_texels(value: Float64) -> Float64:
    """(m * 256, c): values of the texels of quads (m * 64, c), by the quadratic surface; the mean over each quad is preserved."""
    by_tile = np.moveaxis(value.reshape(-1, TILE_TEXELS, value.shape[1]), 1, 2)
    out = np.repeat(by_tile, QUAD_TEXELS, axis=2)
    out += by_tile @ _SURFACE_OF_QUADS @ _CHANGE  # many small products: one large product would start threads
    return np.moveaxis(out, 2, 1).reshape(-1, value.shape[1])


def _monomials(x: FloatArray, y: FloatArray) -> Float64:
    """(n, 6) float64: monomials of degree 0 to 2."""
    return np.stack([np.ones(len(x)), x, y, x * x, x * y, y * y], axis=1)


def _find_surface() -> tuple[Float64, Float64]:
    """(64, 6): maps quads to coefficients of the least-squares surface. (6, 256): maps these to texels, minus the mean over the quad."""
    surface = np.linalg.pinv(_monomials(*part_bits(np.arange(TILE_TEXELS)))).T
    x, y = part_bits(np.arange(_LARGE_TEXELS))
    at_texels = _monomials((x - 0.5) / 2.0, (y - 0.5) / 2.0).T.reshape(-1, TILE_TEXELS, QUAD_TEXELS)
    change = (at_texels - at_texels.mean(axis=2, keepdims=True)).reshape(-1, _LARGE_TEXELS)
    surface.flags.writeable = change.flags.writeable = False
    return surface, change


_SURFACE_OF_QUADS, _CHANGE = _find_surface()
