"""Moments over ranges of texel entries; a square of texels with equal areas is integrated as one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from math import comb

import numpy as np

from ..util.arrays import Float64, FloatArray, Int32, Int64, IntArray
from ..util.coverage import CHUNK_SIZE, chunk_ranges, expand_ranges, monomial_exponents, powers

_SIDE = 16  # texels, of squares
_SQUARE = _SIDE**2


@dataclass(frozen=True)
class EvenSquares:
    """A partition of the entries into squares of wholly covered texels with equal areas, and single texels.

    texel_xy     (n, 2) int32            page texel
    texel_area   (n,) float64, m^2
    first        (m,) int64, ascending   first texel entry of each; the others of a square follow, in Morton order
    side         (m,) int32, texels      1 for single texels
    """

    texel_xy: Int32
    texel_area: Float64
    first: Int64
    side: Int32

    @classmethod
    def of(cls, chart: Int32, code: Int32, xy: Int32, area: Float64, part_entry: Int64) -> EvenSquares:
        """Arguments are as the fields of TexelMap."""
        square = _find_even(chart, code, area, part_entry)
        leads = np.ones(len(code), bool)
        for start in range(0, len(square), CHUNK_SIZE // _SQUARE):
            leads[square[start : start + CHUNK_SIZE // _SQUARE, None] + np.arange(1, _SQUARE)] = False
        first = np.flatnonzero(leads)
        side = np.ones(len(first), np.int32)
        side[np.searchsorted(first, square)] = _SIDE
        return cls(xy, area, first, side)

    def range_moments(self, start: IntArray, end: IntArray, centre: FloatArray, half: FloatArray, degree: int) -> Float64:
        """(M, k) float64, m^2: integrals over ranges of entries as if every texel were covered evenly; see TexelMap.range_moments."""
        moments = np.zeros((len(monomial_exponents(degree)), len(start)))
        ends = np.append(self.first, len(self.texel_area))
        first, last = np.searchsorted(self.first, start), np.searchsorted(self.first, end)
        whole = self._find_sides(start, end)
        one = np.flatnonzero(whole)  # these are most nodes of a large page
        terms = _square_moments(self.texel_xy[start[one]].T, whole[one], centre[one].T, 1.0 / half[one], degree)
        for row, term in zip(moments, terms, strict=True):
            row[one] = self.texel_area[start[one]] * whole[one] ** 2 * term
        ends_whole = (ends[first] == start) & (ends[last] == end)  # other ranges begin or end within a square
        for rows, from_texels in ((np.flatnonzero(ends_whole & (whole == 0)), False), (np.flatnonzero(~ends_whole & (whole == 0)), True)):
            lines = start[rows] if from_texels else first[rows], end[rows] if from_texels else last[rows]
            for some, begin, stop in chunk_ranges(*lines):
                square = expand_ranges(begin, stop)[1]
                node = rows[some]
                entry, side = (square, 1) if from_texels else (self.first[square], self.side[square])
                size, *middle = (along.repeat(stop - begin) for along in (1.0 / half[node], *centre[node].T))
                terms = _square_moments(self.texel_xy[entry].T, side, middle, size, degree)
                area = self.texel_area[entry] * (side * side)
                begins = np.append(0, np.cumsum(stop - begin)[:-1])
                for row, term in zip(moments, terms, strict=True):
                    row[node] += np.add.reduceat(area * term, begins)
        return moments

    def _find_sides(self, start: IntArray, end: IntArray) -> Int64:
        """(k,) int64, texels: sides of ranges of entries that form a square of equal areas; 0 for other ranges."""
        count = np.maximum(end - start, 0)
        side: Int64 = np.rint(np.sqrt(count)).astype(np.int64)
        if not len(self.first):
            return side
        holder = np.searchsorted(self.first, start, side="right") - 1
        is_square = (side * side == count) & (self.side[holder] % np.maximum(side, 1) == 0)
        is_square &= (start - self.first[holder]) % np.maximum(count, 1) == 0  # where squares of `count` texels start in Morton order
        return np.where(is_square, side, 0)


def _find_even(chart: Int32, code: Int32, area: Float64, part_entry: Int64) -> Int64:
    """(m,) int64: first entries of the squares."""
    found = [np.zeros(0, np.int64)]
    for start in range(0, len(code), CHUNK_SIZE):
        first = start + np.flatnonzero(code[start : start + CHUNK_SIZE] % _SQUARE == 0)
        last = first + _SQUARE - 1
        first = first[last < len(code)]
        last = last[: len(first)]
        whole = (code[last] == code[first] + _SQUARE - 1) & (chart[last] == chart[first])
        whole &= np.searchsorted(part_entry, first) == np.searchsorted(part_entry, last, side="right")
        first = first[whole]
        found.append(first[(area[first[:, None] + np.arange(1, _SQUARE)] == area[first, None]).all(axis=1)])
    return np.concatenate(found)


def _square_moments(xy: Int32, side: IntArray | int, centre: Iterable[FloatArray], size: FloatArray, degree: int) -> Iterator[FloatArray]:
    """Means of the monomials in s = (x - centre) * size over squares (n,) of texels at xy (2, n), in the order of monomial_exponents."""
    s, t = ((corner + 0.5 * side - middle) * size for corner, middle in zip(xy, centre, strict=True))
    s_power, t_power = (_texel_means(along, size * side, degree) for along in (s, t))
    return ((s_power[i] * t_power[j] if i else t_power[j]) if j else s_power[i] for i, j in monomial_exponents(degree))


@dataclass(frozen=True)
class PartMoments:
    """Differences of the moments of partly covered texels from those of even ones; fields as in TexelMap."""

    part_entry: Int64
    texel_xy: Int32
    part_moments: Float64

    def range_moments(self, start: IntArray, end: IntArray, centre: FloatArray, half: FloatArray, degree: int) -> Float64:
        """(M, k) float64, m^2, over ranges of entries; degree > 0."""
        exponents = monomial_exponents(degree)
        moments = np.zeros((len(exponents), len(start)))
        part_start, part_end = np.searchsorted(self.part_entry, start), np.searchsorted(self.part_entry, end)
        for rows, first, last in chunk_ranges(part_start, part_end):
            owner, part = expand_ranges(first, last)
            h = 1.0 / half[rows][owner]
            s, t = ((self.texel_xy[self.part_entry[part], axis] + 0.5 - centre[rows, axis][owner]) * h for axis in (0, 1))
            s_power, t_power, h_power = powers(s, degree), powers(t, degree), powers(h, degree)
            excess = [self.part_moments[part, m] * h_power[i + j] for m, (i, j) in enumerate(exponents)]
            begins = np.append(0, np.cumsum(last - first)[:-1])
            for k, (a, b) in enumerate(exponents[1:], start=1):
                total = np.zeros(len(part))
                for m, (i, j) in enumerate(exponents[1:], start=1):
                    if i <= a and j <= b:
                        total += comb(a, i) * comb(b, j) * s_power[a - i] * t_power[b - j] * excess[m]
                moments[k, rows] += np.add.reduceat(total, begins)
        return moments


def _texel_means(offset: FloatArray, size: FloatArray, degree: int) -> list[FloatArray]:
    """Means of s^0 ... s^degree over an interval of length `size` about `offset`."""
    power = powers(offset, degree)
    square = size * size
    if degree >= 2:
        power[2] = power[2] + square / 12.0
    if degree >= 4:
        power[4] = power[4] + (offset * offset / 2.0 + square / 80.0) * square
        power[3] = power[3] + offset * square / 4.0
    return power
