"""Exact world area of each chart inside each texel, and its moments."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..atlas.layer_check import signed_areas
from ..parallel.shared_arrays import IN_MEMORY, Room
from ..scene.scene import SceneSnapshot
from ..util.arrays import BoolArray, Float64, Int32, Int64
from ..util.coverage import (
    RowSpans,
    as_slice,
    chunk_ranges,
    clip_to_texels,
    expand_ranges,
    find_row_spans,
    monomial_exponents,
    piece_moments,
)
from ..util.geometry import gather
from ..util.messages import Status
from ..util.progress import Say, Watch, stretch, unwatched
from .texel_grid import TexelGrid, build_grid, fill_border, part_bits
from .texel_map import TexelMap

if TYPE_CHECKING:
    from ..atlas.charts import ChartAtlas

__all__ = ["TexelMap", "build_texel_map"]

MEASURING = Status("texels", "Measuring texels")
_SLIVER = 1e-11  # share of a texel, or of a smaller triangle, below which a clipped part is rounding noise
_MIN_UV_AREA = 1e-18  # texels^2; below it a triangle has no texels
_EDGE = 1e-6  # texels from a triangle's edge up to which a centre lies on it
_ON_EDGE = 1e30  # factor that ranks pieces with the centre on their edge above all others, by area among themselves
_SQUARE_LOG2 = 5  # log2 of the side, texels, of squares processed together
_SLOTS = 1 << 16  # texels at a time: the intermediate arrays fit the cache
_PAGE_TOLERANCE = 1e-3  # texels that rounding may carry a chart beyond its page


def build_texel_map(snapshot: SceneSnapshot, atlas: ChartAtlas, degree: int, room: Room = IN_MEMORY, watch: Watch = unwatched) -> TexelMap:
    """Covered area and moments up to `degree` (0, 2 or 4) of every texel of every chart.

    room    where its large arrays are allocated
    watch   receives MEASURING and the finished share of the work; it may raise
    The areas of a triangle's texels sum to its world area to rounding. Triangles without area in UV have no texels.
    Raises ValueError for another degree and for charts outside their page.
    """
    monomial_exponents(degree)
    size = atlas.page_size
    uv = np.clip(atlas.tri_uv, 0.0, float(size))
    if np.abs(uv - atlas.tri_uv).max(initial=0.0) > _PAGE_TOLERANCE:
        raise ValueError(f"tri_uv: expected texels 0 to {size}, got {atlas.tri_uv.min():g} to {atlas.tri_uv.max():g}")
    corner = snapshot.tri_position
    world_area = 0.5 * np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    used = np.flatnonzero((atlas.tri_chart >= 0) & (np.abs(signed_areas(uv)) > _MIN_UV_AREA) & (world_area > 0.0))
    spans = find_row_spans(uv[used], stretch(watch, MEASURING, 0.0, 0.05))
    spans = dataclasses.replace(spans, tri=used[spans.tri].astype(np.int32))
    grid = build_grid(spans, atlas.tri_chart, len(atlas.chart_page), room.within("grid"), stretch(watch, MEASURING, 0.05, 0.1))

    pairs = _measure_pairs(uv, spans, grid, degree, stretch(watch, MEASURING, 0.1, 0.7))
    covered = np.zeros(len(uv))
    covered += np.bincount(spans.tri, spans.full_end - spans.full_start, minlength=len(uv))
    covered += np.bincount(pairs.tri, pairs.area, minlength=len(uv))
    # Not divided by the area in UV: a needle's clipped parts, whose areas are multiplied by this, are rounded more than its whole.
    density = np.divide(world_area, covered, out=np.zeros_like(covered), where=covered > 0.0)
    by_area = np.argsort(pairs.best_area * density[pairs.tri])  # of several assignments to one place the last, the largest, stays
    entries = _collect_entries(density, spans, grid, pairs, by_area, len(atlas.chart_page), room, stretch(watch, MEASURING, 0.7, 0.8))
    parts = _collect_parts(density, grid, pairs, by_area, stretch(watch, MEASURING, 0.8, 0.95))
    fill_border(grid, stretch(watch, MEASURING, 0.95, 1.0))
    return TexelMap(
        page_size=size,
        page_count=atlas.page_count,
        degree=degree,
        chart_page=atlas.chart_page,
        chart_piece=np.arange(len(atlas.chart_page), dtype=np.int32),
        grid=grid,
        tri_uv=np.concatenate([uv, np.zeros((1, 3, 2))]),
        tri_density=density,
        **entries,
        **parts,
    )


@dataclass(frozen=True)
class _Pairs:
    """Pairs of a triangle and a texel that it covers in part.

    tri         (n,) int32
    cell        (n,) int64         cell of the grid
    area        (n,) float64       texels^2
    excess      (M, n) float64     moments about the texel's centre, texels^2, less those of a full texel of the same area
    best_area   (n,) float64       area of the largest piece, texels^2; infinite if it contains the texel's centre, huge if on its edge
    best_point  (2, n) float64     centroid of that piece, texels from the texel's centre; 0 if it contains the centre
    """

    tri: Int32
    cell: Int64
    area: Float64
    excess: Float64
    best_area: Float64
    best_point: Float64


def _measure_pairs(uv: Float64, spans: RowSpans, grid: TexelGrid, degree: int, say: Say) -> _Pairs:
    # In each row the partly covered texels lie left and right of the wholly covered ones; without such they are one span.
    start = np.stack([spans.touched_start, spans.full_end], axis=1).ravel()
    end = np.stack([spans.full_start, spans.touched_end], axis=1).ravel()
    least_area, sides = _SLIVER * np.minimum(1.0, np.abs(signed_areas(uv))), _list_sides(uv)
    full = np.array([[_interval_mean(i) * _interval_mean(j)] for i, j in monomial_exponents(degree)])
    parts = [_Pairs(np.empty(0, np.int32), np.empty(0, np.int64), np.empty(0), full[:, :0], np.empty(0), np.empty((2, 0)))]
    for index, first, last in chunk_ranges(start, end):
        say(0.85 * int(index[0]) / len(start))
        owner, x = expand_ranges(first, last)
        span = index[owner] // 2
        tri, y = spans.tri[span], spans.y[span]
        pieces = clip_to_texels(uv[tri], np.stack([x, y], axis=1))
        by_area = np.argsort(pieces.area)  # of several assignments to one place the last stays
        best = np.zeros(len(tri), np.int64)
        best[pieces.pair[by_area]] = by_area
        moments = [np.bincount(pieces.pair, row, minlength=len(tri)).astype(np.float64) for row in piece_moments(pieces, degree)]
        area = moments[0]
        kept = np.flatnonzero(area > least_area[tri])
        tri, best, area = tri[kept], best[kept], area[kept]
        cell = grid.row_cell[grid.tri_row[tri, 2] + y[kept], 2] + x[kept]
        centroid = np.stack([pieces.x[:, best].mean(axis=0), pieces.y[:, best].mean(axis=0)])
        best_area = pieces.area[best]
        depth = _centre_depth(sides, tri, x[kept] + 0.5, y[kept] + 0.5)
        best_area[np.abs(depth) <= _EDGE] *= _ON_EDGE
        best_area[depth > _EDGE] = np.inf
        centroid[:, depth >= -_EDGE] = 0.0
        excess = np.stack([row[kept] for row in moments]) - full * area
        parts.append(_Pairs(tri, cell, area, excess, best_area, centroid))
    return _join_pairs(parts, lambda share: say(0.85 + 0.15 * share))


def _join_pairs(parts: list[_Pairs], say: Say) -> _Pairs:
    names, count = [field.name for field in dataclasses.fields(_Pairs)], sum(len(part.tri) for part in parts)
    joined: list[NDArray[Any]] = []
    for name in names:
        rows = [getattr(part, name) for part in parts]
        out = np.empty((*rows[0].shape[:-1], count), rows[0].dtype)
        for k in np.ndindex(out.shape[:-1]):  # one row at a time, so that progress is reported often
            say(len(joined) / len(names))
            np.concatenate([row[k] for row in rows], out=out[k])
        joined.append(out)
    return _Pairs(*joined)


def _list_sides(uv: Float64) -> Float64:
    """(3, 5, n_tri) float64: for each side of triangles (n_tri, 3, 2), x and y of its start, x and y of its vector, and its length."""
    edge = np.roll(uv, -1, axis=1) - uv
    length = np.maximum(np.linalg.norm(edge, axis=2), _MIN_UV_AREA)
    return np.ascontiguousarray(np.concatenate([uv, edge, length[..., None]], axis=2).transpose(1, 2, 0))


def _centre_depth(sides: Float64, tri: Int32, x: Float64, y: Float64) -> Float64:
    """(n,) float64, texels: depth of points x, y (n,) inside triangles (n,), whose sides are from _list_sides; negative outside."""
    least, greatest = np.full(len(tri), np.inf), np.full(len(tri), -np.inf)
    for start_x, start_y, edge_x, edge_y, length in gather(sides, tri):
        distance = (edge_x * (y - start_y) - edge_y * (x - start_x)) / length  # from the side's line, signed by orientation
        least, greatest = np.minimum(least, distance), np.maximum(greatest, distance)
    return np.maximum(least, -greatest)


def _collect_entries(
    density: Float64, spans: RowSpans, grid: TexelGrid, pairs: _Pairs, by_area: Int64, n_chart: int, room: Room, say: Say
) -> dict[str, Any]:
    """The chart_ and texel_ fields of the map; fills grid.cell_entry."""
    cell_area = np.zeros(len(grid.cell_entry))
    cell_tri = np.full(len(grid.cell_entry), -1, np.int32)
    to_cell = grid.row_cell[grid.tri_row[spans.tri, 2] + spans.y, 2]
    for span, first, last in chunk_ranges(spans.full_start + to_cell, spans.full_end + to_cell):
        say(0.2 * int(span[0]) / len(spans.tri))
        owner, cell = expand_ranges(first, last)
        tri = spans.tri[span[owner]]
        np.add.at(cell_area, cell, density[tri])
        cell_tri[cell] = tri
    np.add.at(cell_area, pairs.cell, pairs.area * density[pairs.tri])
    cell_tri[pairs.cell[by_area]] = pairs.tri[by_area]

    say(0.2)
    low, high = _find_extents(spans, grid, pairs, n_chart, say)
    say(0.5)
    log2 = np.zeros(n_chart, np.int32)
    filled = high[:, 0] >= 0
    log2[filled] = np.ceil(np.log2((high[filled] - low[filled]).max(axis=1) + 1))
    low[~filled] = 0

    first_row = np.minimum(np.searchsorted(grid.row_chart, np.arange(n_chart)), len(grid.row_chart) - 1)
    row_of_zero = first_row - grid.row_y[first_row]
    n_texel = sum(int(np.count_nonzero(cell_tri[start : start + _SLOTS] >= 0)) for start in range(0, len(cell_tri), _SLOTS))
    texel_chart, texel_tri = (room.empty(name, (n_texel,), np.int32) for name in ("texel_chart", "texel_tri"))
    texel_xy, texel_code = room.empty("texel_xy", (n_texel, 2), np.int32), room.empty("texel_code", (n_texel,), np.int32)
    texel_area = room.empty("texel_area", (n_texel,), np.float64)
    row_first, row_last, row_zero = np.ascontiguousarray(grid.row_cell.T)
    end = 0
    for chart, x, y, code in _walk_squares(low, high, log2, filled):
        say(0.5 + 0.5 * end / n_texel)
        row = row_of_zero[chart] + y
        inside = (x >= row_first[row]) & (x <= row_last[row])
        cell = np.where(inside, row_zero[row] + x, 0)  # the cell of triangles without texels
        tri = cell_tri[cell]
        kept = as_slice(np.flatnonzero(tri >= 0))
        cell = cell[kept]
        part = slice(end, end + len(cell))
        end = part.stop
        texel_chart[part], texel_xy[part, 0], texel_xy[part, 1] = chart[kept], x[kept], y[kept]
        texel_code[part], texel_area[part], texel_tri[part] = code[kept], cell_area[cell], tri[kept]
        grid.cell_entry[cell] = np.arange(part.start, part.stop, dtype=np.int32)
    return {
        "chart_origin": low,
        "chart_log2": log2,
        "chart_start": np.searchsorted(texel_chart, np.arange(n_chart + 1, dtype=np.int32)).astype(np.int64),
        "texel_chart": texel_chart,
        "texel_xy": texel_xy,
        "texel_code": texel_code,
        "texel_area": texel_area,
        "texel_tri": texel_tri,
    }


def _find_extents(spans: RowSpans, grid: TexelGrid, pairs: _Pairs, n_chart: int, say: Say) -> tuple[Int32, Int32]:
    """Least and greatest texel (n_chart, 2) that each chart covers; the greatest is -1 for a chart without texels."""
    row_of_pair = np.searchsorted(grid.cells_of_rows()[0], pairs.cell, side="right") - 1
    x_of_pair = pairs.cell - grid.row_cell[row_of_pair, 2]
    whole = np.flatnonzero(spans.full_end > spans.full_start)
    row_of_span = grid.tri_row[spans.tri[whole], 2] + spans.y[whole]
    row = np.concatenate([row_of_pair, row_of_span])
    chart, y = grid.row_chart[row], grid.row_y[row]
    low, high = np.full((n_chart, 2), np.iinfo(np.int32).max, np.int32), np.full((n_chart, 2), -1, np.int32)
    for axis, first, last in ((0, [x_of_pair, spans.full_start[whole]], [x_of_pair, spans.full_end[whole] - 1]), (1, [y], [y])):
        say(0.3 + 0.1 * axis)
        np.minimum.at(low[:, axis], chart, np.concatenate(first).astype(np.int32))
        np.maximum.at(high[:, axis], chart, np.concatenate(last).astype(np.int32))
    return low, high


def _walk_squares(low: Int32, high: Int32, log2: Int32, filled: BoolArray) -> Iterator[tuple[Int32, Int32, Int32, Int64]]:
    """Chunks of all slots of the charts' roots that may hold texels, in order: charts, page texels x and y, and Morton codes.

    low, high   (n_chart, 2) int32, from _find_extents
    log2        (n_chart,) int32, log2 of the roots' sides
    """
    side_log2 = np.minimum(log2, _SQUARE_LOG2)
    count = np.where(filled, 1 << 2 * (log2 - side_log2).astype(np.int64), 0)
    chart, square = expand_ranges(np.zeros_like(count), count)
    x, y = (part << side_log2[chart] for part in part_bits(square))
    room = (high - low).astype(np.int64)[chart] - np.stack([x, y], axis=1)  # from a square's first texel to the chart's last
    reached = (room >= 0).all(axis=1)
    chart, square, x, y, room = chart[reached].astype(np.int32), square[reached], x[reached], y[reached], room[reached]
    is_whole = (room >= (1 << side_log2[chart])[:, None] - 1).all(axis=1)
    first_x, first_y = x.astype(np.int32) + low[chart, 0], y.astype(np.int32) + low[chart, 1]
    inner_x, inner_y = (part.astype(np.int32) for part in part_bits(np.arange(1 << 2 * _SQUARE_LOG2)))
    slots = np.int64(1) << 2 * side_log2[chart].astype(np.int64)
    first_code = square * slots
    for some, first, last in chunk_ranges(np.zeros_like(slots), slots, _SLOTS):
        owner, inner = expand_ranges(first, last)
        owner = some[owner]
        if not is_whole[some].all():
            on_chart = np.flatnonzero((inner_x[inner] <= room[owner, 0]) & (inner_y[inner] <= room[owner, 1]))
            owner, inner = owner[on_chart], inner[on_chart]
        yield chart[owner], first_x[owner] + inner_x[inner], first_y[owner] + inner_y[inner], first_code[owner] + inner


def _collect_parts(density: Float64, grid: TexelGrid, pairs: _Pairs, by_area: Int64, say: Say) -> dict[str, Any]:
    """The part_ and pair_ fields of the map."""
    entry = grid.cell_entry[pairs.cell]
    is_part = np.zeros(int(entry.max(initial=-1)) + 1, bool)
    is_part[entry] = True
    part_entry = np.flatnonzero(is_part)
    part = np.searchsorted(part_entry, entry)
    point = np.zeros((len(part_entry), 2))
    say(0.25)
    point[part[by_area]] = pairs.best_point[:, by_area].T
    moments = np.empty((len(part_entry), len(pairs.excess)))
    for k, row in enumerate(pairs.excess):
        say(0.5 + 0.3 * k / len(pairs.excess))
        moments[:, k] = np.bincount(part, row * density[pairs.tri], minlength=len(part_entry))
    return {
        "part_entry": part_entry.astype(np.int64),
        "part_point": point,
        "part_moments": moments,
        "pair_start": np.append(0, np.cumsum(np.bincount(part, minlength=len(part_entry)))),
        "pair_tri": pairs.tri[np.argsort(part, kind="stable")],
    }


def _interval_mean(power: int) -> float:
    """Mean of x^power over -1/2 < x < 1/2."""
    return 0.0 if power % 2 else 0.5**power / (power + 1)
