"""Turns steps of light into ramps where a chart was cut but nothing stands on the cut.

Leaves on both sides of a cut are chosen separately, and where light varies within them their functions differ by more than noise. If
nothing stands between them there is no edge of light, so the step should not show.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..texels.texel_map import TexelMap
from ..util.ablation import uses
from ..util.arrays import IntArray

_RAMP = 8  # texels on either side; or half of the smaller leaf, or the length of the cut, if that is less

_Float = NDArray[np.float32]


def close_cuts(light: _Float, texels: TexelMap, side: NDArray[np.int32]) -> None:
    """Replace steps between adjacent texels on charts of one piece by ramps, in place.

    light      (k, n, 3) float32, at the texel entries
    side       (n,) int32, texels: side of the leaf at each entry
    """
    is_cut_off = np.bincount(texels.chart_piece)[texels.chart_piece] > 1
    is_cut_off &= texels.chart_piece != np.arange(len(is_cut_off))  # true on at least one side of every cut
    if not is_cut_off.any() or not uses("border_feathering"):
        return
    cut_off = np.flatnonzero(is_cut_off[texels.texel_chart])
    on_page, xy = texels.page_of(cut_off), texels.texel_xy[cut_off]
    change = []
    for axis in (0, 1):
        for number, page in enumerate(texels.entry_at if axis == 0 else texels.entry_at.transpose(0, 2, 1)):
            across = xy[on_page == number]
            row, column = _find_cuts(page, across[:, 1 - axis], across[:, axis], axis, texels)
            sides = (page[row, column], -1), (page[row, column + 1], 1)
            reach = np.minimum(_measure_runs(row, column), np.minimum(side[sides[0][0]], side[sides[1][0]]) // 2)
            half = 0.5 * (light[:, sides[1][0]] - light[:, sides[0][0]])
            for (entry, way), first in zip(sides, (column, column + 1), strict=True):
                chart = texels.texel_chart[entry]
                change += _ramps(page, row, first, way, texels.texel_chart, chart, -way * half, np.minimum(reach, _RAMP))
    for entry, value in change:  # within one of them no entry occurs twice
        light[:, entry] += value
    changed = np.concatenate([entry for entry, _ in change])
    light[:, changed] = np.maximum(light[:, changed], 0.0)  # once at the end, so that the order of ramps does not matter


def _find_cuts(page: NDArray[np.int32], row: IntArray, column: IntArray, axis: int, texels: TexelMap) -> tuple[IntArray, IntArray]:
    """Rows and columns (m,) of texels whose next column has another chart of the same piece, with no surface between them.

    row, column   (k,) int: texels to look at; one of each pair is enough
    """
    size = page.shape[1]
    place = np.unique(np.concatenate([row * size + column, row * size + column - 1]).astype(np.int64))
    place = place[place % size < size - 1]
    row, column = np.divmod(place, size)
    one, other = page[row, column], page[row, column + 1]
    both = np.flatnonzero((one >= 0) & (other >= 0))
    row, column, one, other = row[both], column[both], one[both], other[both]
    chart, beyond = texels.texel_chart[one], texels.texel_chart[other]
    is_open = (chart != beyond) & (texels.chart_piece[chart] == texels.chart_piece[beyond])
    is_open &= ~texels.borders.are_between(axis, one, other)
    return row[is_open], column[is_open]


def _measure_runs(row: IntArray, column: IntArray) -> IntArray:
    """(m,) int: length of the run of consecutive rows in its column that each place (m,) belongs to."""
    order = np.lexsort((row, column))
    begins = np.append(True, (np.diff(column[order]) != 0) | (np.diff(row[order]) != 1))[: len(order)]
    run = np.cumsum(begins) - 1
    length = np.empty(len(row), np.int64)
    length[order] = np.bincount(run)[run]
    return length


def _ramps(
    page: NDArray[np.int32],
    row: IntArray,
    column: IntArray,
    way: int,
    texel_chart: NDArray[np.int32],
    chart: IntArray,
    step: _Float,
    reach: IntArray,
) -> list[tuple[IntArray, _Float]]:
    """For each distance below reach (m,) from places (m,): the entries there on charts (m,), and the part of steps (k, m, 3) to add."""
    out, here = [], np.arange(len(row))
    for distance in range(_RAMP):
        at = column[here] + way * distance
        inside = (at >= 0) & (at < page.shape[1]) & (distance < reach[here])
        here, at = here[inside], at[inside]
        entry = page[row[here], at]
        same = (entry >= 0) & (texel_chart.take(entry, mode="wrap") == chart[here])
        here, entry = here[same], entry[same]
        out.append((entry, step[:, here] * (1.0 - (distance + 0.5) / reach[here])[:, None].astype(np.float32)))
    return out
