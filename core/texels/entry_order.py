"""Another order of a texel map's entries, in place.

New memory is cleared by the system page by page, which takes longer than to move what is there: on a page of 4096 x 4096 a second copy of
all that is known of texels would take as long as to find out where to cut charts.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..util.coverage import expand_ranges
from ..util.progress import Say
from .texel_map import TexelMap

_CHUNK = 1 << 18  # cells at a time

_Int64 = NDArray[np.int64]


@dataclass(frozen=True)
class EntryOrder:
    """Entries that go to the end, while those behind them move up; both in runs, most of them long.

    stay   (2, j) int64, ascending: of entries low ... high - 1
    go     (2, k) int64: the same, in their order at the end
    """

    stay: _Int64
    go: _Int64

    @classmethod
    def of(cls, start: _Int64, size: _Int64, order: _Int64, count: int) -> EntryOrder:
        """The patches (k,) at start, ascending, go to the end in their order, of `count` entries."""
        end = start + size
        between = np.stack([np.append(0, end), np.append(start, count)])
        return cls(between[:, between[0] < between[1]], _join_runs(np.stack([start[order], end[order]])))

    def apply(self, values: NDArray[Any]) -> None:
        """In place, along the first axis of values (n, ...). Raises ValueError where these are not one after the other in memory."""
        if not values.flags.c_contiguous:
            raise ValueError("values that do not lie one after the other in memory cannot be moved in place.")
        row = max(values[:1].size, 1)
        flat = values.reshape(-1)  # rows of their own would be copied before they move
        gone = [flat[low * row : high * row].copy() for low, high in self.go.T.tolist()]
        end = 0
        for low, high in self.stay.T.tolist():
            if low > end:
                flat[end * row : (end + high - low) * row] = flat[low * row : high * row]
            end += high - low
        np.concatenate([flat[:0], *gone], out=flat[end * row :])

    def place(self) -> NDArray[np.int32]:
        """(n + 1,) int32: where each entry is then; -1, the last one, is nowhere."""
        low, high = np.concatenate([self.stay, self.go], axis=1)
        end = np.cumsum(high - low)
        out = np.empty(int(end[-1]) + 1, np.int32)
        out[-1] = -1
        for first, last, begin, stop in zip(*(one.tolist() for one in (low, high, end - (high - low), end)), strict=True):
            out[first:last] = np.arange(begin, stop, dtype=np.int32)
        return out


def _join_runs(runs: _Int64) -> _Int64:
    """(2, j): runs (2, k) with those joined that follow each other."""
    apart = runs[0, 1:] != runs[1, :-1]
    return np.stack([runs[0, np.append(True, apart)[: runs.shape[1]]], runs[1, np.append(apart, True)[: runs.shape[1]]]])


def put_in_order(texels: TexelMap, order: EntryOrder, say: Say = lambda share: None) -> TexelMap:
    """The map with its entries in that order, the chart_ fields as they are. The map that was is used up: this one has its arrays.

    say   receives the share that is done
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
