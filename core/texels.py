"""Exact world area of each chart inside each texel, and its moments."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from .coverage import (
    Float64,
    Int32,
    Int64,
    chunk_ranges,
    clip_to_texels,
    expand_ranges,
    monomial_exponents,
    piece_moments,
)
from .row_spans import RowSpans, find_row_spans
from .scene import SceneSnapshot
from .texel_grid import TexelGrid, build_grid, fill_border, interleave_bits
from .texel_map import TexelMap, centred_strata

if TYPE_CHECKING:
    from .charts import ChartAtlas

__all__ = ["TexelMap", "build_texel_map", "centred_strata"]

_SLIVER = 1e-11  # share of a texel, or of a smaller triangle, below which a clipped part is rounding noise
_MIN_UV_AREA = 1e-18  # texels^2; below it a triangle has no texels
_EDGE = 1e-6  # texels from a triangle's edge up to which a centre lies on it
_ON_EDGE = 1e30  # makes a piece with the centre on its edge larger than any without, of several such the largest
_MOST_SLOTS = 4  # for each key up to which a table sorts them: more would take more memory than sorting does
_PAGE_TOLERANCE = 1e-3  # texels that rounding may carry a chart beyond its page


def build_texel_map(snapshot: SceneSnapshot, atlas: ChartAtlas, degree: int) -> TexelMap:
    """Covered area and moments up to `degree` (0, 2 or 4) of every texel of every chart.

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
    used = np.flatnonzero((atlas.tri_chart >= 0) & (_uv_areas(uv) > _MIN_UV_AREA) & (world_area > 0.0))
    spans = find_row_spans(uv[used])
    spans = dataclasses.replace(spans, tri=used[spans.tri].astype(np.int32))
    grid = build_grid(spans, atlas.tri_chart, len(atlas.chart_page))

    pairs = _measure_pairs(uv, spans, grid, degree)
    covered = np.zeros(len(uv))
    covered += np.bincount(spans.tri, spans.full_end - spans.full_start, minlength=len(uv))
    covered += np.bincount(pairs.tri, pairs.area, minlength=len(uv))
    # Not the world area over the area in UV: a needle's clipped parts are rounded more than its whole.
    density = np.divide(world_area, covered, out=np.zeros_like(covered), where=covered > 0.0)
    by_area = np.argsort(pairs.best_area * density[pairs.tri])  # of several assignments to one place the last, the largest, stays
    entries = _collect_entries(density, spans, grid, pairs, by_area, len(atlas.chart_page))
    parts = _collect_parts(density, grid, pairs, by_area)
    fill_border(grid)
    return TexelMap(
        page_size=size,
        page_count=atlas.page_count,
        degree=degree,
        chart_page=atlas.chart_page,
        grid=grid,
        tri_uv=np.concatenate([uv, np.zeros((1, 3, 2))]),
        tri_density=density,
        **entries,
        **parts,
    )


def _uv_areas(uv: Float64) -> Float64:
    (x_1, y_1), (x_2, y_2) = (uv[:, 1] - uv[:, 0]).T, (uv[:, 2] - uv[:, 0]).T
    areas: Float64 = 0.5 * np.abs(x_1 * y_2 - y_1 * x_2)
    return areas


@dataclass(frozen=True)
class _Pairs:
    """Triangles and the texels that they cover in part.

    tri         (n,) int32
    cell        (n,) int64         cell of the grid
    area        (n,) float64       texels^2
    excess      (M, n) float64     moments about the texel's centre, texels^2, less those of a full texel of the same area
    best_area   (n,) float64       texels^2, of the largest piece; infinite where the texel's centre is inside, huge on the edge
    best_point  (2, n) float64     its centroid, texels from the texel's centre; 0 where that is inside
    """

    tri: Int32
    cell: Int64
    area: Float64
    excess: Float64
    best_area: Float64
    best_point: Float64


def _measure_pairs(uv: Float64, spans: RowSpans, grid: TexelGrid, degree: int) -> _Pairs:
    # Left and right of the wholly covered texels of each row; one span where there are none.
    start = np.stack([spans.touched_start, spans.full_end], axis=1).ravel()
    end = np.stack([spans.full_start, spans.touched_end], axis=1).ravel()
    least_area = _SLIVER * np.minimum(1.0, _uv_areas(uv))
    full = np.array([[_interval_mean(i) * _interval_mean(j)] for i, j in monomial_exponents(degree)])
    parts = [_Pairs(np.empty(0, np.int32), np.empty(0, np.int64), np.empty(0), full[:, :0], np.empty(0), np.empty((2, 0)))]
    for index, first, last in chunk_ranges(start, end):
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
        depth = _centre_depth(uv[tri], np.stack([x, y], axis=1)[kept] + 0.5)
        best_area[np.abs(depth) <= _EDGE] *= _ON_EDGE
        best_area[depth > _EDGE] = np.inf
        centroid[:, depth >= -_EDGE] = 0.0
        excess = np.stack([row[kept] for row in moments]) - full * area
        parts.append(_Pairs(tri, cell, area, excess, best_area, centroid))
    return _Pairs(*(np.concatenate([getattr(part, field.name) for part in parts], axis=-1) for field in dataclasses.fields(_Pairs)))


def _centre_depth(uv: Float64, centre: Float64) -> Float64:
    """(n,) float64, texels: how far inside a triangle (n, 3, 2) the centre (n, 2) of a texel lies; below 0 outside."""
    edge = np.roll(uv, -1, axis=1) - uv
    to_centre = centre[:, None] - uv
    side = edge[..., 0] * to_centre[..., 1] - edge[..., 1] * to_centre[..., 0]
    side /= np.maximum(np.linalg.norm(edge, axis=2), _MIN_UV_AREA)  # distance from each edge's line, signed by orientation
    depth: Float64 = np.maximum(side.min(axis=1), -side.max(axis=1))
    return depth


def _collect_entries(density: Float64, spans: RowSpans, grid: TexelGrid, pairs: _Pairs, by_area: Int64, n_chart: int) -> dict[str, Any]:
    """The chart_ and texel_ fields of the map; fills grid.cell_entry."""
    cell_area = np.zeros(len(grid.cell_entry))
    cell_tri = np.full(len(grid.cell_entry), -1, np.int32)
    to_cell = grid.row_cell[grid.tri_row[spans.tri, 2] + spans.y, 2]
    for span, first, last in chunk_ranges(spans.full_start + to_cell, spans.full_end + to_cell):
        owner, cell = expand_ranges(first, last)
        tri = spans.tri[span[owner]]
        np.add.at(cell_area, cell, density[tri])
        cell_tri[cell] = tri
    np.add.at(cell_area, pairs.cell, pairs.area * density[pairs.tri])
    cell_tri[pairs.cell[by_area]] = pairs.tri[by_area]

    cell = np.flatnonzero(cell_tri >= 0)
    row = np.repeat(np.arange(len(grid.row_y), dtype=np.int32), grid.cells_of_rows()[1])[cell]
    chart = grid.row_chart[row]
    xy = np.stack([(cell - grid.row_cell[row, 2]).astype(np.int32), grid.row_y[row]], axis=1)
    chart_start = np.searchsorted(chart, np.arange(n_chart + 1, dtype=np.int32)).astype(np.int64)
    origin, log2 = _find_roots(xy, chart_start)
    code = interleave_bits(xy[:, 0] - origin[chart, 0], xy[:, 1] - origin[chart, 1])
    root_texels = 1 << 2 * log2.astype(np.int64)
    first = np.cumsum(root_texels) - root_texels
    order = _find_order(first[chart] + code, int(root_texels.sum()))
    cell = cell[order]
    grid.cell_entry[cell] = np.arange(len(cell), dtype=np.int32)
    return {
        "chart_origin": origin,
        "chart_log2": log2,
        "chart_start": chart_start,
        "texel_chart": chart,
        "texel_xy": xy[order],
        "texel_code": code[order],
        "texel_area": cell_area[cell],
        "texel_tri": cell_tri[cell],
    }


def _find_order(key: Int64, count: int) -> Int64 | Int32:
    """(n,) what sorts keys (n,), of which no two are alike, from 0 to below `count`."""
    if count > _MOST_SLOTS * len(key):
        return np.argsort(key)
    place = np.full(count, -1, np.int32)
    place[key] = np.arange(len(key), dtype=np.int32)
    order: Int32 = place[place >= 0]
    return order


def _collect_parts(density: Float64, grid: TexelGrid, pairs: _Pairs, by_area: Int64) -> dict[str, Any]:
    """The part_ and pair_ fields of the map."""
    entry = grid.cell_entry[pairs.cell]
    is_part = np.zeros(int(entry.max(initial=-1)) + 1, bool)
    is_part[entry] = True
    part_entry, part = np.flatnonzero(is_part), (np.cumsum(is_part) - 1)[entry]
    point = np.zeros((len(part_entry), 2))
    point[part[by_area]] = pairs.best_point[:, by_area].T
    moments = np.empty((len(part_entry), len(pairs.excess)))
    for k, row in enumerate(pairs.excess):
        moments[:, k] = np.bincount(part, row * density[pairs.tri], minlength=len(part_entry))
    return {
        "part_entry": part_entry.astype(np.int64),
        "part_point": point,
        "part_moments": moments,
        "pair_start": np.append(0, np.cumsum(np.bincount(part, minlength=len(part_entry)))),
        "pair_tri": pairs.tri[np.argsort(part, kind="stable")],
    }


def _find_roots(xy: Int32, chart_start: Int64) -> tuple[Int32, Int32]:
    """Origin (n_chart, 2) and log2 of the side (n_chart,) of each chart's root; zeros for a chart without texels."""
    n_chart = len(chart_start) - 1
    origin, log2 = np.zeros((n_chart, 2), np.int32), np.zeros(n_chart, np.int32)
    filled = np.flatnonzero(chart_start[1:] > chart_start[:-1])
    if len(filled):
        begins = chart_start[filled]
        origin[filled] = np.minimum.reduceat(xy, begins, axis=0)
        extent = np.maximum.reduceat(xy, begins, axis=0) - origin[filled] + 1
        log2[filled] = np.ceil(np.log2(extent.max(axis=1)))
    return origin, log2


def _interval_mean(power: int) -> float:
    """Mean of x^power over -1/2 < x < 1/2."""
    return 0.0 if power % 2 else 0.5**power / (power + 1)
