"""Texels divided by another surface: the area beyond it belongs to the neighbouring texel.

The foot of a wall seldom coincides with the border of two texels. Light on the far side of it within a texel belongs to the texel there;
otherwise it would leak to this side's leaf, which may be many texels wide.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..util.arrays import FloatArray, IntArray
from ..util.coverage import Float64, Int32, Int64, expand_ranges, monomial_exponents
from ..util.progress import Say

if TYPE_CHECKING:
    from .texel_map import TexelMap

WAYS = ((1, 0), (0, 1), (-1, 0), (0, -1))  # offsets in columns and rows to the adjacent texels
OPPOSITE = (2, 3, 0, 1)  # of WAYS
_HALF = 0.5  # texels, from the centre to the edge


@dataclass(frozen=True)
class TexelBorders:
    """Extents of texels that a surface separates from a neighbour.

    crossed   (n,) bool: whether an entry is divided; empty if none is
    entry     (b,) int64, ascending: the divided entries
    reach     (4, b) float32, texels: extent from the centre towards each of WAYS; inf without a surface there, and where it is unknown,
              as for partly covered texels, which keep all of their area
    other     (4, b) int32: the entry beyond; -1 without a surface there
    """

    crossed: NDArray[np.bool_]
    entry: Int64
    reach: NDArray[np.float32]
    other: Int32

    @classmethod
    def none(cls) -> TexelBorders:
        return cls(np.zeros(0, bool), np.zeros(0, np.int64), np.zeros((4, 0), np.float32), np.zeros((4, 0), np.int32))

    @classmethod
    def of(cls, n_texel: int, way: Int64, entry: Int64, beyond: Int64, reach: FloatArray) -> TexelBorders:
        """From pairs (m,) of entries with a surface between their centres, each pair in both directions; other arguments as the fields."""
        crossed = np.zeros(n_texel, bool)
        crossed[entry] = True
        every, own = np.unique(entry, return_inverse=True)
        borders = cls(crossed, every, np.full((4, len(every)), np.inf, np.float32), np.full((4, len(every)), -1, np.int32))
        borders.reach[way, own], borders.other[way, own] = reach, beyond
        return borders

    @classmethod
    def join(cls, parts: Sequence[TexelBorders]) -> TexelBorders:
        """Those of all entries, of parts of them that follow each other, each numbered for itself."""
        first = [0, *accumulate(len(part.crossed) for part in parts[:-1])]
        return cls(
            np.concatenate([part.crossed for part in parts]),
            np.concatenate([low + part.entry for low, part in zip(first, parts, strict=True)]),
            np.concatenate([part.reach for part in parts], axis=1),
            np.concatenate(
                [np.where(part.other >= 0, low + part.other, np.int32(-1)) for low, part in zip(first, parts, strict=True)], axis=1
            ),
        )

    def renumber(self, place: Int32) -> TexelBorders:
        """The same where entries have other numbers: place (n,) int32 of each."""
        crossed = np.zeros(len(self.crossed), bool)
        crossed[place[self.entry]] = True
        rows = np.argsort(place[self.entry])
        other = np.where(self.other >= 0, place[self.other], np.int32(-1))[:, rows]
        return TexelBorders(crossed, place[self.entry[rows]].astype(np.int64), self.reach[:, rows], other)

    def see_beyond(self, entry: IntArray, look: float) -> NDArray[np.bool_]:
        """(m,) bool: whether the square of side `look`, texels, around the centre of entries (m,) reaches beyond a surface."""
        found = np.zeros(len(entry), bool)
        if len(self.entry):
            rows = np.flatnonzero(self.crossed[entry])
            found[rows] = self.reach[:, np.searchsorted(self.entry, entry[rows])].min(axis=0) < 0.5 * look
        return found

    def are_between(self, way: int, one: IntArray, other: IntArray) -> NDArray[np.bool_]:
        """(m,) bool: whether a surface separates the entries `one` (m,) from `other` (m,) in that direction."""
        between = np.zeros(len(one), bool)
        if len(self.entry):
            rows = np.flatnonzero(self.crossed[one])
            between[rows] = self.other[way, np.searchsorted(self.entry, one[rows])] == other[rows]
        return between

    def find_owners(self, entry: Int32, right: FloatArray, up: FloatArray) -> Int32:
        """(m,) int32: the owners of points in texel entries (m,), at offsets right and up (m,) from the centres, texels."""
        rows = np.flatnonzero(self.crossed.take(entry)) if len(self.entry) else np.zeros(0, np.intp)
        if not len(rows):
            return entry
        own = np.searchsorted(self.entry, entry.take(rows))
        right, up, owner = right.take(rows), up.take(rows), np.full(len(rows), -1, np.int32)
        for k in (1, 3, 0, 2):  # neighbours to the left or right take the texel's area there, those above or below the rest
            x, y = WAYS[k]
            owner = np.where(x * right + y * up > self.reach[k].take(own), self.other[k].take(own), owner)
        found = entry.copy()
        found[rows] = np.where(owner >= 0, owner, entry.take(rows))
        return found

    def list_beyond(self, look: float) -> tuple[Int64, Int32, Float64]:
        """Entries (m,) whose square of side `look`, texels, reaches beyond a surface; the entry there; and its share."""
        inside = np.maximum(0.5 * look - self.reach.astype(np.float64), 0.0)
        way, row = np.nonzero(inside)
        return self.entry[row], self.other[way, row], inside[way, row] / look

    def measure(self, degree: int) -> Float64:
        """(M, b) float64: moments of the texels' own areas about their centres, in texels; a whole texel has the area 1."""
        rows = np.searchsorted(self.entry, self.other)  # arbitrary without a surface there, where the gain is 0
        reach = self.reach.astype(np.float64)
        inner = np.minimum(reach, _HALF)
        right, up, left, down = inner
        pieces = [(-left, right, -down, up)]
        for k, (x, y) in enumerate(WAYS):
            beyond = rows[k]
            lost = np.where(self.other[k] >= 0, _HALF - inner[OPPOSITE[k], beyond], 0.0)
            gained = np.clip(reach[k] - _HALF, 0.0, lost)
            low, high = np.sort([np.full_like(gained, _HALF * (x + y)), (_HALF + gained) * (x + y)], axis=0)
            pieces.append((low, high, -_HALF, _HALF) if x else (-left[beyond], right[beyond], low, high))
        return np.stack(
            [sum(_integrate(x_0, x_1, i) * _integrate(y_0, y_1, j) for x_0, x_1, y_0, y_1 in pieces) for i, j in monomial_exponents(degree)]
        )


def whole_texel(degree: int) -> Float64:
    """(M, 1) float64: moments of a whole texel about its centre."""
    return np.array([[_integrate(-_HALF, _HALF, i) * _integrate(-_HALF, _HALF, j)] for i, j in monomial_exponents(degree)])


def _integrate(low: FloatArray | float, high: FloatArray | float, power: int) -> Float64:
    """Integral of x^power from low to high."""
    out: Float64 = np.asarray((high ** (power + 1) - low ** (power + 1)) / (power + 1))
    return out


def share_texels(texels: TexelMap, borders: TexelBorders, say: Say = lambda share: None) -> TexelMap:
    """The map with borders and the areas and moments that follow, the areas in place; reports the share that is done."""
    if not len(borders.entry):
        return texels
    shares = np.isfinite(borders.reach).any(axis=0)
    entry = borders.entry[shares]
    moments = borders.measure(texels.degree)[:, shares] * texels.texel_area[entry]
    say(0.1)
    texels.texel_area[entry] = moments[0]
    excess = moments - whole_texel(texels.degree) * moments[0]
    every = np.concatenate([texels.part_entry, entry])
    order = np.argsort(every)
    say(0.2)
    start = np.concatenate([texels.pair_start, texels.pair_start[-1] + 1 + np.arange(len(entry))])
    pair = expand_ranges(start[order], start[order + 1])[1]
    say(0.4)
    point = np.concatenate([texels.part_point, np.zeros((len(entry), 2))])[order]
    say(0.6)
    moments = np.concatenate([texels.part_moments, excess.T])[order]
    say(0.9)
    return dataclasses.replace(
        texels,
        borders=borders,
        part_entry=every[order],
        part_point=point,
        part_moments=moments,
        pair_start=np.append(0, np.cumsum(np.diff(start)[order])),
        pair_tri=np.concatenate([texels.pair_tri, texels.texel_tri[entry]])[pair],
    )
