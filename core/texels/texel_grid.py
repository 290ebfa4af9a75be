"""Dense lookup from (triangle, page texel) to texel entry, one run of cells per chart and row of texels."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..parallel.shared_arrays import IN_MEMORY, Room
from ..util.arrays import FloatArray, Int32, Int64, IntArray
from ..util.coverage import RowSpans
from ..util.progress import Say

_NEIGHBOURS = ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, 1), (1, -1), (-1, -1))  # the nearest first
_BORDER = 2  # texels around a chart whose hits still find it; rounding needs one
_FAR = np.iinfo(np.int32).max
_EVEN_BITS = 0x15555555  # of x in a Morton code


@dataclass(frozen=True)
class TexelGrid:
    """Rows of cells. Row 0 has one empty cell, for triangles without texels; the rows of a chart follow each other upwards.

    tri_row     (n_tri + 1, 3) int32   first row, last row, row of y = 0; the last entry stands for no triangle
    row_cell    (n_row, 3) int64       first x, last x, cell of x = 0
    row_chart   (n_row,) int32
    row_y       (n_row,) int32
    cell_entry  (n_cell,) int32        -1 where there is no entry near
    """

    tri_row: Int32
    row_cell: Int64
    row_chart: Int32
    row_y: Int32
    cell_entry: Int32

    def find(self, tri: IntArray, x: FloatArray, y: FloatArray) -> Int32:
        """Entries (m,) at page texel coordinates x, y (m,) on triangles (m,); see `TexelMap.entry_of`."""
        rows = self.tri_row.take(tri, axis=0, mode="wrap")  # -1 is the last
        row = np.floor(y).astype(np.int32) + rows[:, 2]
        cells = self.row_cell.take(np.clip(row, rows[:, 0], rows[:, 1]), axis=0, mode="wrap")
        column = np.clip(np.floor(x).astype(np.int64), cells[:, 0], cells[:, 1])
        return self.cell_entry.take(cells[:, 2] + column, mode="wrap")

    def cells_of_rows(self) -> tuple[Int64, Int64]:
        """First cell of each row (n_row,) and their number (n_row,)."""
        return self.row_cell[:, 2] + self.row_cell[:, 0], self.row_cell[:, 1] - self.row_cell[:, 0] + 1


def build_grid(spans: RowSpans, tri_chart: Int32, n_chart: int, room: Room = IN_MEMORY, say: Say = lambda share: None) -> TexelGrid:
    """An empty grid with cells for all texels in the spans and those next to them.

    tri_chart   (n_tri,) int32
    room        for its cells
    say         receives the share of the work that is done
    """
    say(0.0)
    n_tri = len(tri_chart)
    tri_low, tri_high = np.full(n_tri, _FAR, np.int64), np.full(n_tri, -1, np.int64)
    np.minimum.at(tri_low, spans.tri, spans.y)
    np.maximum.at(tri_high, spans.tri, spans.y)
    say(0.3)
    used = np.flatnonzero(tri_high >= 0)
    chart_low, chart_high = np.full(n_chart, _FAR, np.int64), np.full(n_chart, -1, np.int64)
    np.minimum.at(chart_low, tri_chart[used], tri_low[used])
    np.maximum.at(chart_high, tri_chart[used], tri_high[used])

    height = np.maximum(chart_high - chart_low + 1, 0)
    chart_row = 1 + np.cumsum(height) - height
    row_chart = np.append(-1, np.repeat(np.arange(n_chart), height)).astype(np.int32)
    row_of_zero = np.append(chart_row - chart_low, 0)  # the last is row 0's
    row_y = np.arange(len(row_chart)) - row_of_zero[row_chart]
    tri_row = np.zeros((n_tri + 1, 3), np.int32)
    tri_row[:-1][used, 2] = row_of_zero[tri_chart[used]]
    tri_row[:-1][used, 0] = tri_row[used, 2] + tri_low[used]
    tri_row[:-1][used, 1] = tri_row[used, 2] + tri_high[used]

    say(0.5)
    first, last = np.full(len(row_chart), _FAR, np.int64), np.full(len(row_chart), -1, np.int64)
    row = tri_row[spans.tri, 2] + spans.y
    say(0.7)
    np.minimum.at(first, row, spans.touched_start)
    np.maximum.at(last, row, spans.touched_end.astype(np.int64) - 1)
    first, last = _extend_to_neighbours(first, row_chart, np.minimum) - 1, _extend_to_neighbours(last, row_chart, np.maximum) + 1
    empty = first > last
    first[empty], last[empty] = 0, 0
    say(0.9)
    width = last - first + 1
    row_cell = np.stack([first, last, np.cumsum(width) - width - first], axis=1)
    cell_entry = room.empty("cell_entry", (int(width.sum()),), np.int32)
    cell_entry.fill(-1)
    return TexelGrid(tri_row, row_cell, row_chart, row_y.astype(np.int32), cell_entry)


def _extend_to_neighbours(bound: Int64, row_chart: Int32, pick: np.ufunc) -> Int64:
    same = np.flatnonzero(row_chart[1:] == row_chart[:-1])
    extended = bound.copy()
    extended[same] = pick(extended[same], bound[same + 1])
    extended[same + 1] = pick(extended[same + 1], bound[same])
    return extended


def fill_border(grid: TexelGrid, say: Say = lambda share: None) -> None:
    """Give empty cells next to filled ones the entry of the nearest, ring by ring, in place; `say` receives the finished share."""
    start, width = grid.cells_of_rows()
    for ring in range(_BORDER):
        cell = np.flatnonzero(grid.cell_entry < 0)
        row = np.searchsorted(start, cell, side="right") - 1
        x = cell - grid.row_cell[row, 2]
        found = np.full(len(cell), -1, np.int32)
        for k, (step_x, step_y) in enumerate(_NEIGHBOURS):
            say((ring + k / len(_NEIGHBOURS)) / _BORDER)
            other = np.clip(row + step_y, 0, len(start) - 1)
            place = x + step_x - grid.row_cell[other, 0]
            valid = (found < 0) & (place >= 0) & (place < width[other]) & (grid.row_chart[other] == grid.row_chart[row])
            valid[(other == row) & (step_y != 0)] = False
            found[valid] = grid.cell_entry[start[other[valid]] + place[valid]]
        grid.cell_entry[cell] = found


def interleave_bits(x: IntArray, y: IntArray) -> Int64:
    """Morton codes: bit i of x goes to bit 2 i, bit i of y to bit 2 i + 1.

    x, y   (n,) int, 0 to 65535
    """
    even, odd = _spread_bits(x), _spread_bits(y)
    return (even | (odd << np.uint32(1))).astype(np.int64)


def _spread_bits(value: IntArray) -> NDArray[np.uint32]:
    spread = value.astype(np.uint32)
    for shift, mask in ((8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)):
        spread |= spread << np.uint32(shift)
        spread &= np.uint32(mask)
    return spread


def part_bits(code: Int64) -> tuple[Int64, Int64]:
    """x and y of Morton codes (n,), of 16 bits each at most."""
    x, y = (_join_bits(some) for some in (code, code >> 1))
    return x, y


def _join_bits(spread: Int64) -> Int64:
    joined = spread & 0x55555555
    for shift, mask in ((1, 0x33333333), (2, 0x0F0F0F0F), (4, 0x00FF00FF), (8, 0x0000FFFF)):
        joined |= joined >> shift
        joined &= mask
    return joined


def step_codes(code: Int64, right: int, up: int) -> Int64:
    """Morton codes (n,) of texels offset by columns and rows from those of codes (n,), of 14 bits each.

    Beyond the lower and left edges of a root the results are codes that no texel has; beyond the others, codes of a larger root.
    Source: Schrack 1992, "Finding neighbors of equal size in linear quadtrees and octrees in constant time".
    """
    out = np.zeros_like(code)
    for bits, step in ((_EVEN_BITS, right), (_EVEN_BITS << 1, up)):
        if not step:
            out |= code & bits
            continue
        # A carry goes through set bits, a borrow through cleared ones.
        between = code | ~bits if step > 0 else code & bits
        size = int(interleave_bits(*np.array([[abs(step)]] * 2))[0]) & bits
        out |= (between + (size if step > 0 else -size)) & bits
    return out
