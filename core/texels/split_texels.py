"""Texels that another surface divides: the area beyond the surface belongs to the neighbouring texel.

The foot of a wall seldom coincides with the border of two texels. The light within a texel on the far side of the wall belongs to the
texel there; otherwise it would leak to this side's leaf, which may be many texels wide.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import TYPE_CHECKING

import numpy as np

from ..util.arrays import BoolArray, Float32, Float64, FloatArray, Int32, Int64, IntArray
from ..util.coverage import expand_ranges, monomial_exponents
from ..util.progress import Say

if TYPE_CHECKING:
    from .texel_map import TexelMap

WAYS = ((1, 0), (0, 1), (-1, 0), (0, -1))  # offsets in columns and rows to the adjacent texels
OPPOSITE = (2, 3, 0, 1)  # of WAYS
QUADRANTS = ((0, 1), (2, 1), (2, 3), (0, 3))  # of a texel: indices of the two of WAYS that enclose each, columns first
_HALF = 0.5  # texels, from the centre to the edge


@dataclass(frozen=True)
class TexelBorders:
    """Extents of texels that a surface separates from a neighbour.

    crossed   (n,) bool: whether an entry is divided; empty if none is
    entry     (b,) int64, ascending: the divided entries
    reach     (4, b) float32, texels: distance of the surface from the centre towards each of WAYS; inf without a surface, and where it is
              unknown, as for partly covered texels, which keep all of their area
    other     (4, b) int32: the entry beyond; -1 without a surface there
    corner    (4, 2, b) float32, texels: if the corner of a hut or a pillar stands in one of QUADRANTS, distances in columns and rows beyond
              which a point is inside of it; inf without one
    diagonal  (4, b) int32: the diagonal neighbour, to which the inside of that corner belongs; -1 without a corner
    """

    crossed: BoolArray
    entry: Int64
    reach: Float32
    other: Int32
    corner: Float32
    diagonal: Int32

    @classmethod
    def none(cls) -> TexelBorders:
        return cls(np.zeros(0, bool), np.zeros(0, np.int64), *_no_borders(0))

    @classmethod
    def of(cls, n_texel: int, way: Int64, entry: Int64, beyond: Int64, reach: FloatArray) -> TexelBorders:
        """From pairs (m,) of entries with a surface between their centres, each pair in both directions; way (m,) indexes WAYS."""
        crossed = np.zeros(n_texel, bool)
        crossed[entry] = True
        every, own = np.unique(entry, return_inverse=True)
        borders = cls(crossed, every, *_no_borders(len(every)))
        borders.reach[way, own], borders.other[way, own] = reach, beyond
        return borders

    def with_corners(self, quadrant: IntArray, entry: IntArray, extent: FloatArray, diagonal: IntArray) -> TexelBorders:
        """These borders with corners of other things within texels: (m,) each, and extent (2, m), as in the fields."""
        if not len(entry):
            return self
        crossed = self.crossed.copy()
        crossed[entry] = True
        every = np.union1d(self.entry, entry)
        borders = TexelBorders(crossed, every, *_no_borders(len(every)))
        old, own = np.searchsorted(every, self.entry), np.searchsorted(every, entry)
        for name in ("reach", "other", "corner", "diagonal"):
            getattr(borders, name)[..., old] = getattr(self, name)
        borders.corner[quadrant, :, own], borders.diagonal[quadrant, own] = extent.T, diagonal
        return borders

    def find_corners(self, beside: Callable[[Int64, tuple[int, int]], Int64]) -> tuple[Int64, Int64, Float64, Int64]:
        """Corners as arguments of with_corners: texels that are open to two neighbours, each of which a surface separates from the texel
        diagonal to the first. Both surfaces then end at a corner within the quadrant between the neighbours.

        beside   maps entries (m,) and an offset in columns and rows to the entries there; -1 if there is none that is covered in full
        """
        found: list[tuple[Int64, ...]] = []
        extents = []
        for k, (along, across) in enumerate(QUADRANTS):
            row = np.flatnonzero(self.reach[across] < _HALF)
            entry = beside(self.entry[row], WAYS[OPPOSITE[along]])
            second = beside(np.maximum(entry, 0), WAYS[across])
            is_open = (entry >= 0) & (second >= 0) & self.crossed[second]
            is_open &= ~self.are_between(along, entry, self.entry[row]) & ~self.are_between(across, entry, second)
            row, entry, second = row[is_open], entry[is_open], np.searchsorted(self.entry, second[is_open])
            meet = (self.reach[along, second] < _HALF) & (self.other[along, second] == self.other[across, row])
            row, entry, second = row[meet], entry[meet], second[meet]
            found.append((np.full(len(row), k), entry, self.other[across, row].astype(np.int64)))
            extents.append(np.stack([self.reach[along, second], self.reach[across, row]]).astype(np.float64))
        quadrant, entry, diagonal = (np.concatenate(parts) for parts in zip(*found, strict=True))
        return quadrant, entry, np.concatenate(extents, axis=1), diagonal

    @classmethod
    def join(cls, parts: Sequence[TexelBorders]) -> TexelBorders:
        """The borders of consecutive ranges of entries, each numbered from 0, joined."""
        first = [0, *accumulate(len(part.crossed) for part in parts[:-1])]
        return cls(
            np.concatenate([part.crossed for part in parts]),
            np.concatenate([low + part.entry for low, part in zip(first, parts, strict=True)]),
            np.concatenate([part.reach for part in parts], axis=1),
            np.concatenate([_number_on(part.other, low) for low, part in zip(first, parts, strict=True)], axis=1),
            np.concatenate([part.corner for part in parts], axis=2),
            np.concatenate([_number_on(part.diagonal, low) for low, part in zip(first, parts, strict=True)], axis=1),
        )

    def renumber(self, place: Int32) -> TexelBorders:
        """The same borders after entries were reordered: place (n,) int32 is the new number of each."""
        crossed = np.zeros(len(self.crossed), bool)
        crossed[place[self.entry]] = True
        rows = np.argsort(place[self.entry])
        other, diagonal = (np.where(beyond >= 0, place[beyond], np.int32(-1))[:, rows] for beyond in (self.other, self.diagonal))
        entry = place[self.entry[rows]].astype(np.int64)
        return TexelBorders(crossed, entry, self.reach[:, rows], other, self.corner[:, :, rows], diagonal)

    @property
    def are_divided(self) -> BoolArray:
        """(b,) bool: whether a part of the area is known to lie beyond a surface."""
        return np.isfinite(self.reach).any(axis=0) | (self.diagonal >= 0).any(axis=0)

    def are_crossed(self, entry: IntArray) -> BoolArray:
        """(m,) bool: whether entries (m,) are divided, or next to one that is."""
        return self.crossed[entry] if len(self.crossed) else np.zeros(len(entry), bool)

    def see_beyond(self, entry: IntArray, side: float) -> BoolArray:
        """(m,) bool: whether the square of side `side`, texels, around the centre of entries (m,) reaches beyond a surface."""
        found = np.zeros(len(entry), bool)
        if len(self.entry):
            rows = np.flatnonzero(self.crossed[entry])
            own = np.searchsorted(self.entry, entry[rows])
            found[rows] = np.minimum(self.reach[:, own].min(axis=0), self.corner[:, :, own].max(axis=1).min(axis=0)) < 0.5 * side
        return found

    def are_between(self, way: int, one: IntArray, other: IntArray) -> BoolArray:
        """(m,) bool: whether a surface separates entries `one` (m,) from `other` (m,), which lie in that direction."""
        between = np.zeros(len(one), bool)
        if len(self.entry):
            rows = np.flatnonzero(self.crossed[one])
            between[rows] = self.other[way, np.searchsorted(self.entry, one[rows])] == other[rows]
        return between

    def find_owners(self, entry: Int32, right: FloatArray, up: FloatArray) -> Int32:
        """(m,) int32: entries that own points in texels entry (m,), at offsets right and up (m,) from the centres, texels."""
        rows = np.flatnonzero(self.crossed.take(entry)) if len(self.entry) else np.zeros(0, np.intp)
        if not len(rows):
            return entry
        own = np.searchsorted(self.entry, entry.take(rows))
        right, up, owner = right.take(rows), up.take(rows), np.full(len(rows), -1, np.int32)
        for k in (1, 3, 0, 2):  # neighbours to the left or right take the texel's area there, those above or below the rest
            x, y = WAYS[k]
            owner = np.where(x * right + y * up > self.reach[k].take(own), self.other[k].take(own), owner)
        for (along, across), corner, diagonal in zip(QUADRANTS, self.corner, self.diagonal, strict=True):
            is_inside = (WAYS[along][0] * right > corner[0].take(own)) & (WAYS[across][1] * up > corner[1].take(own))
            owner = np.where(is_inside, diagonal.take(own), owner)
        found = entry.copy()
        found[rows] = np.where(owner >= 0, owner, entry.take(rows))
        return found

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
        moments = np.stack(
            [sum(_integrate(x_0, x_1, i) * _integrate(y_0, y_1, j) for x_0, x_1, y_0, y_1 in pieces) for i, j in monomial_exponents(degree)]
        )
        for (along, across), corner, diagonal in zip(QUADRANTS, self.corner, self.diagonal, strict=True):
            own = np.flatnonzero(diagonal >= 0)
            beyond = np.searchsorted(self.entry, diagonal[own])
            right, up, (x, y) = WAYS[along][0], WAYS[across][1], corner[:, own].astype(np.float64)
            wide = np.clip(reach[OPPOSITE[along], beyond] - _HALF, 0.0, _HALF - x)
            high = np.clip(reach[OPPOSITE[across], beyond] - _HALF, 0.0, _HALF - y)
            for k, (i, j) in enumerate(monomial_exponents(degree)):
                lost = _between(right * x, right * _HALF, i) * _between(up * y, up * _HALF, j)
                gained = _between(-right * _HALF, -right * (_HALF + wide), i) * _between(-up * _HALF, -up * (_HALF + high), j)
                moments[k, own] -= lost
                np.add.at(moments[k], beyond, gained)
        return moments


def whole_texel(degree: int) -> Float64:
    """(M, 1) float64: moments of a whole texel about its centre."""
    return np.array([[_integrate(-_HALF, _HALF, i) * _integrate(-_HALF, _HALF, j)] for i, j in monomial_exponents(degree)])


def _no_borders(count: int) -> tuple[Float32, Int32, Float32, Int32]:
    """The fields of TexelBorders from `reach` on, for `count` texels without a surface."""
    reach, corner = np.full((4, count), np.inf, np.float32), np.full((4, 2, count), np.inf, np.float32)
    return reach, np.full((4, count), -1, np.int32), corner, np.full((4, count), -1, np.int32)


def _number_on(entry: Int32, first: int) -> Int32:
    """Entries numbered from 0 renumbered from `first`; -1 for none stays."""
    return np.where(entry >= 0, first + entry, np.int32(-1)).astype(np.int32)


def _between(one: FloatArray | float, other: FloatArray | float, power: int) -> Float64:
    """Integral of x^power between two ends in any order."""
    return _integrate(np.minimum(one, other), np.maximum(one, other), power)


def _integrate(low: FloatArray | float, high: FloatArray | float, power: int) -> Float64:
    """Integral of x^power from low to high."""
    return np.asarray((high ** (power + 1) - low ** (power + 1)) / (power + 1))


def share_texels(texels: TexelMap, borders: TexelBorders, say: Say = lambda share: None) -> TexelMap:
    """The map with these borders, and the areas and moments of texels changed accordingly; areas are changed in place.

    say   receives the finished share of the work
    """
    if not len(borders.entry):
        return texels
    shares = borders.are_divided
    entry = borders.entry[shares]
    moments = borders.measure(texels.degree)[:, shares] * texels.texel_area[entry]
    say(0.1)
    texels.texel_area[entry] = moments[0]
    excess = moments - whole_texel(texels.degree) * moments[0]
    row = np.searchsorted(texels.part_entry, entry)
    is_part = np.append(texels.part_entry, -1)[row] == entry  # an entry of several triangles that are as even as one
    part_moments = texels.part_moments.copy()
    part_moments[row[is_part]] = excess.T[is_part]
    entry, excess = entry[~is_part], excess[:, ~is_part]
    every = np.concatenate([texels.part_entry, entry])
    order = np.argsort(every)
    say(0.2)
    start = np.concatenate([texels.pair_start, texels.pair_start[-1] + 1 + np.arange(len(entry))])
    pair = expand_ranges(start[order], start[order + 1])[1]
    say(0.4)
    point = np.concatenate([texels.part_point, np.zeros((len(entry), 2))])[order]
    say(0.6)
    moments = np.concatenate([part_moments, excess.T])[order]
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
