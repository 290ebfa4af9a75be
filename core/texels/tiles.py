"""Tiles are squares of 8 x 8 covered texels, within which slowly varying light can be interpolated from few of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..util.arrays import BoolArray, Float64, Int64, IntArray
from ..util.coverage import CHUNK_SIZE
from .texel_grid import interleave_bits, part_bits

_SIDE_BITS = 3
TILE_SIDE = 1 << _SIDE_BITS
TILE_TEXELS = TILE_SIDE**2
TILE_LINES = (0, 3, 7)  # columns and rows of a tile; the nodes of the interpolation are where they cross
_PLACE_BITS = 14  # bits of a tile's column or row in a page


@dataclass(frozen=True)
class Tiles:
    """Tiles among an array of texels.

    start   (m,) int64      rows of their first texels; the others follow in Morton order
    place   (m, 3) int64    chart, column and row, which differ by one between neighbours
    """

    start: Int64
    place: Int64

    @classmethod
    def none(cls) -> Tiles:
        return cls(np.zeros(0, np.int64), np.zeros((0, 3), np.int64))

    @classmethod
    def of(cls, chart: IntArray, code: IntArray) -> Tiles:
        """Tiles among texels of charts (n,) with Morton codes (n,), both ascending."""
        first = find_tiles(chart, code)
        x, y = part_bits(code[first] >> 2 * _SIDE_BITS)
        return cls(first, np.stack([chart[first].astype(np.int64), x, y], axis=1))

    def __len__(self) -> int:
        return len(self.start)

    def within(self, rows: IntArray) -> Tiles:
        """Tiles whose texels are all among `rows` (k,), ascending; start then counts in `rows`."""
        at, end = np.searchsorted(rows, self.start), np.searchsorted(rows, self.start + TILE_TEXELS)
        whole = end - at == TILE_TEXELS
        return Tiles(at[whole], self.place[whole])

    def without(self, texels: BoolArray) -> Tiles:
        """Tiles without any of the marked texels (n,)."""
        free = ~texels[self.texels()].any(axis=1) if texels.any() else np.ones(len(self), bool)
        return Tiles(self.start[free], self.place[free])

    def on_one_triangle(self, tri: IntArray) -> Tiles:
        """Tiles whose texels all lie on one triangle; tri (n,) of the texels."""
        changes = np.flatnonzero(tri[1:] != tri[:-1]) + 1
        same = np.searchsorted(changes, self.start, side="right") == np.searchsorted(changes, self.start + TILE_TEXELS)
        return Tiles(self.start[same], self.place[same])

    def texels(self) -> Int64:
        """(m, 64) int64: rows of the tiles' texels."""
        return self.start[:, None] + np.arange(TILE_TEXELS)

    def near(self, marked: BoolArray) -> BoolArray:
        """(m,) bool: the marked tiles and their 8 neighbours."""
        key = (self.place[:, 0] << 2 * _PLACE_BITS) + (self.place[:, 2] << _PLACE_BITS) + self.place[:, 1]
        wanted = np.sort(key[marked])
        out = marked.copy()
        if len(wanted):
            for dy in (-1, 0, 1):
                for dx in (-1, 0, 1):
                    other = key + (dy << _PLACE_BITS) + dx
                    out |= wanted[np.minimum(np.searchsorted(wanted, other), len(wanted) - 1)] == other
        return out


def find_tiles(chart: IntArray, code: IntArray) -> Int64:
    """(m,) int64: Tiles.start of Tiles.of."""
    count = max(len(code) - TILE_TEXELS + 1, 0)
    parts = [np.zeros(0, np.int64)]
    for start in range(0, count, CHUNK_SIZE):
        parts.append(start + np.flatnonzero(code[start : min(start + CHUNK_SIZE, count)] & (TILE_TEXELS - 1) == 0))
    first = np.concatenate(parts)
    last = first + TILE_TEXELS - 1
    return first[(code[last] == code[first] + TILE_TEXELS - 1) & (chart[last] == chart[first])]


def _node_weights() -> Float64:
    """(64, 9) float64: weights of TILE_NODES at the texels of a tile, in Morton order, by Lagrange polynomials."""
    x, y = part_bits(np.arange(TILE_TEXELS))
    along = np.stack([np.prod([(np.arange(TILE_SIDE) - b) / (a - b) for b in TILE_LINES if b != a], axis=0) for a in TILE_LINES], axis=1)
    out: Float64 = (along[y][:, :, None] * along[x][:, None, :]).reshape(TILE_TEXELS, -1)
    out.flags.writeable = False
    return out


def _texels_at(x: IntArray, y: IntArray) -> Int64:
    """(n,) int64: indices in a tile's Morton order of the texels in columns x and rows y."""
    out = interleave_bits(x, y)
    out.flags.writeable = False
    return out


TILE_CORNERS = _texels_at(np.array([0, TILE_SIDE - 1, 0]), np.array([0, 0, TILE_SIDE - 1]))
TILE_NODES = _texels_at(np.tile(TILE_LINES, len(TILE_LINES)), np.repeat(TILE_LINES, len(TILE_LINES)))
NODE_WEIGHTS = _node_weights()
