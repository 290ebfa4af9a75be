"""Squares of 2 x 2 texels that are lit as one: on a large page light changes so little over most of them that four looks tell no more.

Quads make up large tiles of 8 x 8, which texels follow as they do in a tile. Within one of these light is told by a surface of the second
degree, as it changes from texel to texel, and by what quads differ from it. Where quads do not suffice for that, nothing is told.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..util.arrays import FloatArray, IntArray
from ..util.coverage import Float64, Int64
from .texel_grid import part_bits
from .tiles import TILE_TEXELS, Tiles, fit_surfaces

_Index = TypeVar("_Index", bound=np.integer[Any])

QUAD_TEXELS = 4
_LARGE_TEXELS = QUAD_TEXELS * TILE_TEXELS
_LAST_TILE = np.array([0, 1, 1])  # of the four that make up a large one: how far from the first


@dataclass(frozen=True)
class Quads:
    """Those of large tiles among some texels.

    start   (m,) int64      rows of the tiles' first texels; the others follow in Morton order
    place   (m, 3) int64    chart, column and row of each tile, as in Tiles
    """

    start: Int64
    place: Int64

    @classmethod
    def none(cls) -> Quads:
        return cls(np.zeros(0, np.int64), np.zeros((0, 3), np.int64))

    @classmethod
    def of(cls, tiles: Tiles, tri: IntArray, alone: NDArray[np.bool_]) -> Quads:
        """Those that four tiles make up, on one triangle.

        tri     (n,) int    of the texels
        alone   (n,) bool   texels that are not like others: there must be none
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
        """How many tiles they make up."""
        return len(self.start)

    @property
    def first(self) -> Int64:
        """(m * 64,) int64, ascending: rows of each quad's first texel."""
        return (self.start[:, None] + np.arange(0, _LARGE_TEXELS, QUAD_TEXELS)).ravel()

    def tiles(self) -> Tiles:
        """Their tiles, among the quads."""
        return Tiles(np.arange(len(self)) * TILE_TEXELS, self.place)

    def texels(self, some: NDArray[np.bool_]) -> Int64:
        """(k * 256,) int64, ascending: rows of the texels of some of the tiles, (m,) bool."""
        return (self.start[some, None] + np.arange(_LARGE_TEXELS)).ravel()


def list_texels(first: NDArray[_Index]) -> NDArray[_Index]:
    """(k * 4,): the texels of quads whose first ones are (k,) int."""
    out = np.repeat(first, QUAD_TEXELS)
    out += np.tile(np.arange(QUAD_TEXELS, dtype=first.dtype), len(first))
    return out


def find_whole_quads(by_quads: NDArray[np.bool_], code: IntArray) -> Int64:
    """(k,) int64, ascending: first entries of the quads of which all texels are marked.

    by_quads   (n,) bool: texel entries that were told by one
    code       (n,) int: Morton codes of them
    """
    first = np.flatnonzero(by_quads & (code & (QUAD_TEXELS - 1) == 0))
    whole: Int64 = first[by_quads[list_texels(first)].reshape(-1, QUAD_TEXELS).all(axis=1)]
    return whole


def find_misfit(value: Float64, variance: Float64) -> Float64:
    """(m,) float64, (W/m^2)^2: what quads differ by from a surface of the second degree, squared, beyond their noise.

    value, variance   (m * 64,) float64, W/m^2 and its square: of quads
    """
    off2 = fit_surfaces(value.reshape(-1, TILE_TEXELS))[1]
    misfit2: Float64 = np.maximum(off2 - variance.reshape(-1, TILE_TEXELS).mean(axis=1), 0.0)
    return misfit2


def spread_over_texels(value: Float64) -> Float64:
    """(m * 256, c): what quads (m * 64, c) tell of their texels, by that surface; the mean over each quad is what the quad has."""
    by_tile = np.moveaxis(value.reshape(-1, TILE_TEXELS, value.shape[1]), 1, 2)
    out = np.repeat(by_tile, QUAD_TEXELS, axis=2)
    out += by_tile @ _SURFACE_OF_QUADS @ _CHANGE  # of many small matrices: one large product would start threads
    return np.moveaxis(out, 2, 1).reshape(-1, value.shape[1])


def _monomials(x: FloatArray, y: FloatArray) -> Float64:
    """(n, 6) float64, of the second degree."""
    return np.stack([np.ones(len(x)), x, y, x * x, x * y, y * y], axis=1)


def _find_surface() -> tuple[Float64, Float64]:
    """(64, 6) by which quads give the surface nearest to them; (6, 256) by which that differs at a texel from its mean over the quad."""
    surface = np.linalg.pinv(_monomials(*part_bits(np.arange(TILE_TEXELS)))).T
    x, y = part_bits(np.arange(_LARGE_TEXELS))
    at_texels = _monomials((x - 0.5) / 2.0, (y - 0.5) / 2.0).T.reshape(-1, TILE_TEXELS, QUAD_TEXELS)
    change = (at_texels - at_texels.mean(axis=2, keepdims=True)).reshape(-1, _LARGE_TEXELS)
    surface.flags.writeable = change.flags.writeable = False
    return surface, change


_SURFACE_OF_QUADS, _CHANGE = _find_surface()
