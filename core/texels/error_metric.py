"""Texels over which the error is measured: for the bake as a whole, or for each object relative to its own brightness.

The error of the whole is a mean, in which a dim room counts little beside a sunlit outside, and a small object little beside a large one.
With error_of="objects" the stopping rule uses the object of the greatest error, and objects of greater error get more samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..util.arrays import BoolArray, Float32, Float64, FloatArray, Int32, Int64, IntArray
from .texel_map import TexelMap

# Floor of the denominator of relative errors, as a share of the group's mean brightness: else one black texel would dominate the error.
# In a group of several the mean is at least DARK_FLOOR times that of the whole: errors of what is nearly black are hardly visible.
DARK_FLOOR = 0.1
# The worst texels are left out: on a hard edge of light, the error depends on whether a texel holds the value at its centre or its mean.
# Texels whose centres lie outside of the chart are left out too: little of them is visible, and other bakers leave them empty.
BEST_TEXELS = 0.99
_NONE = -1  # group of texel entries outside of all groups
_SAMPLE = 1 << 13  # sample size of the whole
# Greatest sample size per object and of all objects; objects with fewer texels than the least form one group.
_MOST_OF_EACH, _MOST_OF_ALL, _LEAST_OF_EACH = 1 << 10, 1 << 14, 1 << 5
_CHUNK = 1 << 16
_GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0


@dataclass(frozen=True)
class ErrorMetric:
    """A sample of m texels for the error, and its groups.

    entry          (m,) int64, ascending: texel entries with covered centres, aperiodically spaced so as not to alias with the pages' rows
    area_m2        (m,) float64: surface area that each represents
    objects        object index -> rows (k,) int64 of the sample; only objects with enough of them
    groups         (p,) of rows (k,) int64: one group per object, and one of all objects with few texels; or only the whole
    entry_group    (n,) int32: the group of each texel entry, -1 outside of all groups; None if the only group is the whole
    """

    entry: Int64
    area_m2: Float64
    objects: dict[int, Int64]
    groups: list[Int64]
    entry_group: Int32 | None = None

    @classmethod
    def of(cls, error_of: str, texels: TexelMap, tri_object: IntArray) -> ErrorMetric:
        """The sample for a value of Settings.error_of.

        tri_object   (n_tri,) int: the object of each triangle
        """
        return cls.by_object(texels, tri_object) if error_of == "objects" else cls.whole(texels, tri_object)

    @classmethod
    def whole(cls, texels: TexelMap, tri_object: IntArray | None = None) -> ErrorMetric:
        """One group; tri_object as in `of`, None leaves `objects` empty."""
        entry = choose_sample(texels)
        rows_of = {} if tri_object is None else _group(tri_object[texels.texel_tri[entry]])
        area_m2 = texels.texel_area[entry] * (len(texels) / max(len(entry), 1))
        objects = {thing: rows for thing, rows in rows_of.items() if len(rows) >= _LEAST_OF_EACH}
        return cls(entry, area_m2, objects, [np.arange(len(entry))])

    @classmethod
    def by_object(cls, texels: TexelMap, tri_object: IntArray) -> ErrorMetric:
        """A sample of equal size for each object that has enough texels; the whole if none has."""
        thing = tri_object[texels.texel_tri].astype(np.int32)
        asked = np.flatnonzero(texels.shown & texels.is_central)
        all_of = _group(thing[asked])
        each = max(min(_MOST_OF_EACH, _MOST_OF_ALL // max(len(all_of), 1)), _LEAST_OF_EACH)
        chosen = [asked[rows[_spread(len(rows), each)]] for rows in all_of.values()]
        entry = np.sort(np.concatenate([np.zeros(0, np.int64), *chosen]))
        rows_of = {one: np.searchsorted(entry, entries) for one, entries in zip(all_of, chosen, strict=True)}
        large = {one: rows for one, rows in rows_of.items() if len(rows) >= _LEAST_OF_EACH}
        small = [one for one in rows_of if one not in large]
        groups = list(large.values())
        group_of = np.full(int(tri_object.max(initial=0)) + 1, _NONE, np.int32)
        group_of[list(large)] = np.arange(len(large))
        if sum(len(rows_of[one]) for one in small) >= _LEAST_OF_EACH:
            group_of[small] = len(groups)
            groups.append(np.sort(np.concatenate([rows_of[one] for one in small])))
        if not groups:
            return cls.whole(texels, tri_object)
        area_m2 = texels.texel_area[entry].astype(np.float64)
        for one, rows in rows_of.items():
            area_m2[rows] *= len(all_of[one]) / len(rows)
        return cls(entry, area_m2, large, groups, group_of[thing])

    def find_share(self, chosen: BoolArray) -> float:
        """Estimated share of all texels that the `chosen` (m,) rows of the sample represent; 1 if none is chosen.

        Rows of the whole have equal weights; rows of objects, whose sampling rates differ, are weighted by area as an approximation.
        """
        share = float(np.average(chosen, weights=self.area_m2 if self.entry_group is not None else None)) if chosen.any() else 0.0
        return share or 1.0

    def find_object_errors(self, find_error_alone: Callable[[Int64], float]) -> dict[int, float]:
        """object index -> find_error_alone(rows (k,) int64) for each object with enough rows."""
        return {thing: find_error_alone(rows) for thing, rows in self.objects.items()}

    def part(self, light: FloatArray, dark: float) -> Parts:
        """The groups with their brightness floors.

        light   (m, 3), W/m^2, at the sample
        dark    DARK_FLOOR of the whole, W/m^2
        """
        if self.entry_group is None:
            return Parts.whole(len(self.entry), dark)
        return Parts(self.groups, np.array([find_dark2(light[rows], dark) for rows in self.groups]), self.entry_group)


@dataclass(frozen=True)
class Parts:
    """The p groups over which errors are averaged.

    rows       (p,) of (k,) int64: rows of the sample
    dark2      (p,) float32, (W/m^2)^2: squared brightness floor of relative errors
    of_entry   (n,) int32: the group of each texel entry, -1 outside of all groups; None if the only group is the whole
    """

    rows: list[Int64]
    dark2: Float32
    of_entry: Int32 | None = None

    @classmethod
    def whole(cls, count: int, dark: float) -> Parts:
        return cls([np.arange(count)], np.array([dark], np.float32) ** 2)

    def find_dark2(self, entry: IntArray) -> Float32:
        """(k, 1) or (1,): `dark2` of texel entries (k,); infinite outside of all groups."""
        return self.dark2 if self.of_entry is None else self.spread(self.dark2, entry, np.inf)[:, None]

    def spread(self, values: NDArray[Any], entry: IntArray | slice, elsewhere: float) -> NDArray[Any]:
        """(k,): values (p,) of the groups, gathered at texel entries (k,); `elsewhere` outside of all groups."""
        assert self.of_entry is not None
        return np.append(values, values.dtype.type(elsewhere))[self.of_entry[entry]]  # _NONE is the last


def choose_lit(rows: Int64, lit: BoolArray) -> Int64:
    """The rows (k,) of lit (n,) texels, or all rows if none is lit.

    Texels that no light reaches, as on the outer side of a thick wall, have no error and would only lower the mean error of the others.
    """
    found = rows[lit[rows]]
    return found if len(found) else rows


def find_dark2(light: FloatArray, dark: float) -> np.float32:
    """Parts.dark2 of one group with light (k, 3), W/m^2; dark is the whole's floor of the group's mean, W/m^2."""
    lit = choose_lit(np.arange(len(light)), light.any(axis=1))
    mean = float(light[lit].mean(dtype=np.float64)) if len(lit) else 0.0
    return np.float32(DARK_FLOOR * max(mean, dark)) ** 2


def _group(value: IntArray) -> dict[int, Int64]:
    """Each distinct value, ascending, with its rows (k,) int64, ascending."""
    order = np.argsort(value, kind="stable")
    found, first = np.unique(value[order], return_index=True)
    return {int(one): order[start:end] for one, (start, end) in zip(found, pairwise([*first, len(value)]), strict=True)}


def choose_sample(texels: TexelMap) -> Int64:
    """(m,) int64, ascending: at most _SAMPLE shown texels with covered centres, aperiodically spaced; all texels if there are none."""
    middle = texels.shown & texels.is_central
    parts = list(cut_entries(len(middle)))
    count = np.array([np.count_nonzero(middle[part]) for part in parts], np.int64)
    total = int(count.sum())
    if not total:
        return np.arange(len(middle))
    if total <= _SAMPLE:
        return np.flatnonzero(middle)
    place = _spread(total, _SAMPLE)
    ends = np.searchsorted(place, np.append(0, np.cumsum(count)))
    found = [
        part.start + np.flatnonzero(middle[part])[place[first:last] - place_before]
        for part, first, last, place_before in zip(parts, ends[:-1], ends[1:], np.cumsum(count) - count, strict=True)
    ]
    return np.concatenate(found)


def _spread(total: int, most: int) -> Int64:
    """(min(total, most),) int64, ascending: indices below `total`, one jittered by the golden ratio in each of `most` strata."""
    if total <= most:
        return np.arange(total)
    return ((np.arange(most) + (np.arange(most) * _GOLDEN) % 1.0) * (total / most)).astype(np.int64)


def cut_entries(count: int) -> Iterator[slice]:
    """Slices of `count` texel entries, each small enough for the cache."""
    return (slice(start, min(start + _CHUNK, count)) for start in range(0, count, _CHUNK))
