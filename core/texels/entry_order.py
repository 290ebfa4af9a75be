"""Reorders a texel map's entries in place.

The system clears new memory page by page, which takes longer than moving data within an array: on a page of 4096 x 4096, a second copy of
the texel map would take as long as the search for the cuts.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..util.arrays import Int32, Int64
from ..util.coverage import expand_ranges
from ..util.progress import Say
from .texel_map import TexelMap

_CHUNK = 1 << 18  # cells at a time


@dataclass(frozen=True)
class EntryOrder:
    """A permutation of entries: some move to the end, and the others close the gaps. Both are listed as runs low ... high - 1.

    stay   (2, j) int64, ascending: low and high of the runs that stay
    go     (2, k) int64: low and high of the runs that move, in their order at the end
    """

    stay: Int64
    go: Int64

    @classmethod
    def of(cls, start: Int64, size: Int64, order: Int64, count: int) -> EntryOrder:
        """Patches of `count` entries move to the end: start and size (k,), ascending, and order (k,) their new order."""
        end = start + size
        between = np.stack([np.append(0, end), np.append(start, count)])
        return cls(between[:, between[0] < between[1]], _join_runs(np.stack([start[order], end[order]])))

    def apply(self, values: NDArray[Any]) -> None:
        """Reorder values (n, ...) along their first axis, in place. Raises ValueError if they are not contiguous in memory."""
        if not values.flags.c_contiguous:
            raise ValueError("values that do not lie one after the other in memory cannot be moved in place.")
        row = max(values[:1].size, 1)
        flat = values.reshape(-1)  # numpy would copy overlapping rows before it moves them
        gone = [flat[low * row : high * row].copy() for low, high in self.go.T.tolist()]
        end = 0
        for low, high in self.stay.T.tolist():
            if low > end:
                flat[end * row : (end + high - low) * row] = flat[low * row : high * row]
            end += high - low
        np.concatenate([flat[:0], *gone], out=flat[end * row :])

    def place(self) -> Int32:
        """(n + 1,) int32: new index of each entry; the last maps -1 to -1."""
        low, high = np.concatenate([self.stay, self.go], axis=1)
        end = np.cumsum(high - low)
        out = np.empty(int(end[-1]) + 1, np.int32)
        out[-1] = -1
        for first, last, begin, stop in zip(*(one.tolist() for one in (low, high, end - (high - low), end)), strict=True):
            out[first:last] = np.arange(begin, stop, dtype=np.int32)
        return out


def _join_runs(runs: Int64) -> Int64:
    """(2, j): runs (2, k), where a run that starts at another's end is joined to it."""
    apart = runs[0, 1:] != runs[1, :-1]
    return np.stack([runs[0, np.append(True, apart)[: runs.shape[1]]], runs[1, np.append(apart, True)[: runs.shape[1]]]])


def put_in_order(texels: TexelMap, order: EntryOrder, say: Say = lambda share: None) -> TexelMap:
    """The map with its entries in another order; the chart_ fields stay. The old map must not be used again: its arrays are overwritten.

    say   receives the finished share of the work
    """
    place = order.place()
    fields: list[NDArray[Any]] = [texels.texel_xy, texels.texel_code, texels.texel_area, texels.texel_tri, texels.texel_chart]
    for k, values in enumerate(fields):
        say(0.1 * k)
        order.apply(values)
    cell_entry = texels.grid.cell_entry
    for start in range(0, len(cell_entry), _CHUNK):
        cell_entry[start : start + _CHUNK] = place.take(cell_entry[start : start + _CHUNK], mode="wrap")
    say(0.5)
    part = np.argsort(place[texels.part_entry])
    say(0.6)
    pair = expand_ranges(texels.pair_start[part], texels.pair_start[part + 1])[1]
    say(0.7)
    moments = texels.part_moments[part]
    say(0.8)
    return dataclasses.replace(
        texels,
        part_entry=place[texels.part_entry[part]].astype(np.int64),
        part_point=texels.part_point[part],
        part_moments=moments,
        pair_start=np.append(0, np.cumsum(np.diff(texels.pair_start)[part])),
        pair_tri=texels.pair_tri[pair],
        borders=texels.borders.renumber(place[:-1]),
    )
