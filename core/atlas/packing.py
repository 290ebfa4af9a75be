"""Packing of charts on square pages: each is placed as low as possible above the horizon, the upper contour of the placed ones.

Source: Levy, Petitjean, Ray & Maillot 2002, "Least Squares Conformal Maps", section 5; with four turns of each chart.
Measured against xatlas's own packer (100 and 1,000 rectangles, 1,024 texels, padding 4): 80 and 61 % of the page instead of
63 and 34 %, at the same speed; and the density is exact, where xatlas stretches every chart to whole texels.
"""

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ..util.arrays import Float64, Int32, Int64
from ..util.coverage import expand_ranges
from .outlines import Outlines

_ROUNDING = 1e-6  # tolerance, texels, by which a chart may reach over the edge of a texel
_MAX_COLUMNS = 1024  # a wider page is searched in steps of several texels
_BOXY = 0.995  # a chart that fills this share of its box is not turned upside down, which would save nothing
_SMALL = 16  # texels; turning smaller charts upside down saves nothing measurable


@dataclass(frozen=True)
class Page:
    """A square page. Its inside, which is without the padding at its border, is searched in columns of `step` texels."""

    size: int
    padding: int

    @property
    def inside(self) -> int:
        """Texels along a side that charts may cover."""
        return max(self.size - 2 * self.padding, 0)

    @property
    def step(self) -> int:
        """Texels of a column."""
        return max(1, self.size // _MAX_COLUMNS)

    @property
    def reach(self) -> int:
        """Number of columns that the padding takes."""
        return -(-self.padding // self.step)

    def empty_horizon(self) -> Int32:
        """(columns + 2 reach,) int32: height to which each column is filled; -padding, as no padding is needed above the page's border."""
        return np.full(self.inside // self.step + 2 * self.reach, -self.padding, np.int32)


@dataclass(frozen=True)
class _Profiles:
    """Lowest and highest texels of charts in each of their columns, and in `reach` columns more on both sides.

    low, high   (n,) int32   of the chart with its padding
    roof        (n,) int32   highest texel of the chart alone
    floor       (n,) int32   lowest texel of the chart alone
    start       (n_chart + 1,) int64
    """

    low: Int32
    high: Int32
    roof: Int32
    floor: Int32
    start: Int64


@dataclass(frozen=True)
class Shapes:
    """Charts at a density, ready to be placed.

    density   texels/m
    along     profiles along x and along y
    side      (n, 2) int64, texels
    order     (n,) int64    order in which they are placed
    turns     (n,) int64    number of quarter turns to try
    """

    page: Page
    density: float
    along: tuple[_Profiles, _Profiles]
    side: Int64
    order: Int64
    turns: Int64


@dataclass(frozen=True)
class Layout:
    """Charts placed on a page.

    turn     (n,) int64      quarter turns, counterclockwise
    offset   (n, 2) int64    texels: page texel of the turned chart's lower left corner
    top      its height within the page's inside, texels
    """

    shapes: Shapes
    turn: Int64
    offset: Int64
    top: int

    @property
    def density(self) -> float:
        """Texels/m."""
        return self.shapes.density

    def place(self, points: Float64, chart: Int64) -> Float64:
        """(n, k, 2) float64: points of charts, in texels of the page.

        points   (n, k, 2) float64, m, as in the outlines
        chart    (n,) int64
        """
        x, y = points[..., 0] * self.density, points[..., 1] * self.density
        step = self.shapes.page.step
        side = self.shapes.side[chart]
        # Turned charts are aligned to whole columns at their left, like their reversed profiles.
        reversed_x, reversed_y = (-(-side // step) * step).T[:, :, None]
        width, height = side.T[:, :, None]
        turn = self.turn[chart][:, None]
        new_x = np.choose(turn, [x, reversed_y - y, reversed_x - x, y])
        new_y = np.choose(turn, [y, x, height - y, width - x])
        return np.stack([new_x, new_y], axis=2) + self.offset[chart][:, None]


def shape_charts(outlines: Outlines, density: float, page: Page) -> Shapes | None:
    """The charts at `density` texels/m; None if one is longer than the page, or all are larger than it, so that they cannot fit it."""
    longest, area = outlines.extent.max(initial=0.0) * density, float(outlines.area.sum()) * density**2
    if longest > page.inside + _ROUNDING or area > page.inside**2 * (1 + 1e-9):
        return None
    side = np.maximum(np.ceil(outlines.extent * density - _ROUNDING), 1).astype(np.int64)
    edge, chart = outlines.edge * density, outlines.edge_chart
    along = (_measure_profiles(edge, chart, side, page), _measure_profiles(edge[..., ::-1], chart, side[:, ::-1], page))
    order = np.lexsort((-side.min(axis=1), -side.max(axis=1)))  # long charts first; lexsort is stable
    boxy = (outlines.area > _BOXY * outlines.extent.prod(axis=1)) | (side.max(axis=1) <= _SMALL)
    turns = np.where(outlines.rigid | (side.max(axis=1) == 1), 1, np.where(boxy, 2, 4))
    return Shapes(page, density, along, side, order, turns)


def _measure_profiles(edge: Float64, chart: Int64, side: Int64, page: Page) -> _Profiles:
    step, reach = page.step, page.reach
    columns = -(-side[:, 0] // step)
    start = np.concatenate([[0], np.cumsum(columns + 2 * reach)])
    swap = edge[:, 0, 0] > edge[:, 1, 0]
    left, right = np.where(swap[:, None, None], edge[:, ::-1], edge).transpose(1, 0, 2)
    last = columns[chart] - 1
    first_column = np.clip(np.floor(left[:, 0] / step + _ROUNDING).astype(np.int64), 0, last)
    last_column = np.clip(np.ceil(right[:, 0] / step - _ROUNDING).astype(np.int64) - 1, first_column, last)
    piece, column = expand_ranges(first_column, last_column + 1)
    left, right = left[piece], right[piece]
    width = right[:, 0] - left[:, 0]
    upright = width <= 0
    width = np.where(upright, 1.0, width)
    # A vertical edge is one point along x; both of its ends count.
    share = np.clip((np.stack([column * step, (column + 1) * step]) - left[:, 0]) / width, 0.0, 1.0)
    share = np.where(upright, np.array([[0.0], [1.0]]), share)
    height = left[:, 1] + share * (right[:, 1] - left[:, 1])
    position = start[chart[piece]] + reach + column
    low, high = np.full(start[-1], np.inf), np.full(start[-1], -np.inf)
    np.minimum.at(low, position, height.min(axis=0))
    np.maximum.at(high, position, height.max(axis=0))
    far = int(side.max(initial=0)) + 4 * page.size  # never the extreme of a window, unless nothing else is in it
    empty = np.isinf(low)
    floor = np.where(empty, far, np.floor(np.where(empty, 0.0, low) + _ROUNDING)).astype(np.int32)
    roof = np.where(empty, -far, np.ceil(np.where(empty, 0.0, high) - _ROUNDING)).astype(np.int32)
    roof = np.where(empty, -far, np.maximum(roof, floor + 1))
    # One long row for each shift within the reach, on which numpy is fast.
    outer_low = sliding_window_view(np.pad(floor, reach, constant_values=far), len(floor)).min(axis=0)
    outer_high = sliding_window_view(np.pad(roof, reach, constant_values=-far), len(roof)).max(axis=0)
    return _Profiles(outer_low - page.padding, outer_high + page.padding, roof, floor, start)


class _Sides:
    """The undersides and upper sides of charts after quarter turns. Uses lists, whose items are read faster one by one."""

    def __init__(self, shapes: Shapes) -> None:
        self._along = [(along, along.start.tolist()) for along in shapes.along]
        self._side = shapes.side.tolist()
        self._reach = shapes.page.reach

    def across(self, chart: int, turn: int) -> int:
        """Height of the turned chart, texels."""
        return self._side[chart][1 - turn % 2]

    def under(self, chart: int, turn: int) -> Int32:
        """The underside of the turned chart with its padding."""
        profiles, start = self._along[turn % 2]
        rows = slice(start[chart], start[chart + 1])
        under = profiles.low[rows] if turn in (0, 1) else self.across(chart, turn) - profiles.high[rows]
        return under if turn in (0, 3) else under[::-1]

    def upper(self, chart: int, turn: int) -> Int32:
        """The upper side of the turned chart without padding."""
        profiles, start = self._along[turn % 2]
        rows = slice(start[chart] + self._reach, start[chart + 1] - self._reach)
        upper = profiles.roof[rows] if turn in (0, 1) else self.across(chart, turn) - profiles.floor[rows]
        return upper if turn in (0, 3) else upper[::-1]


def place_charts(shapes: Shapes, horizon: Int32, ceiling: int | None = None) -> Layout | None:
    """Place the charts above the horizon, which is raised. Returns None and leaves the horizon as it is if they do not fit.

    ceiling   greatest height, texels; by default that of the page's inside
    """
    page, sides = shapes.page, _Sides(shapes)
    padding, step, reach = page.padding, page.step, page.reach
    most, top = page.inside if ceiling is None else ceiling, 0
    turn = np.zeros(len(shapes.side), np.int64)
    offset = np.zeros((len(shapes.side), 2), np.int64)
    columns = len(horizon)
    taken = np.concatenate([horizon, np.zeros(columns, np.int32)])
    # Row k is the horizon shifted by k columns. A chart is tried at all columns at once, with one long row for each of its own columns.
    ahead = sliding_window_view(taken, columns) if columns else taken
    turns = shapes.turns.tolist()
    is_point = shapes.side.max(axis=1, initial=0)[shapes.order] == 1  # these are the last in order
    for chart in shapes.order[~is_point].tolist():
        best: tuple[int, int, int, int] | None = None
        for candidate in range(turns[chart]):
            under = sides.under(chart, candidate)
            shifts = columns - len(under) + 1
            if shifts <= 0:
                continue
            height = np.maximum.reduce(ahead[: len(under), :shifts] - under[:, None], axis=0)
            column = int(height.argmin())
            bottom = int(height[column])
            key = (bottom + sides.across(chart, candidate), candidate, column, bottom)
            best = key if best is None or key < best else best
        if best is None or best[0] > most:
            return None
        top = max(top, best[0])
        _, candidate, column, bottom = best
        upper = sides.upper(chart, candidate)
        below = taken[column + reach : column + reach + len(upper)]
        np.maximum(below, bottom + upper, out=below)
        turn[chart] = candidate
        offset[chart] = (padding + column * step, padding + bottom)
    if is_point.any():
        width = 2 * reach + 1
        if columns < width:
            return None
        bottoms = np.maximum.reduce(ahead[:width, : columns - width + 1], axis=0) + padding
        placed = _place_points(int(is_point.sum()), bottoms, page, most)
        if placed is None:
            return None
        np.maximum.at(taken, placed[:, 0] + reach, placed[:, 1] + 1)
        offset[shapes.order[is_point]] = padding + placed * [step, 1]
        top = max(top, int(placed[:, 1].max()) + 1)
    horizon[:] = taken[:columns]
    return Layout(shapes, turn, offset, top)


def _place_points(count: int, bottoms: Int32, page: Page, most: int) -> Int64 | None:
    """Columns and bottoms (count, 2) of `count` > 0 charts of one texel, which most charts of an interior are; None if they do not fit.

    All are alike, so the heights found for one hold for the next, except around the place where that one was put.

    bottoms   (columns,) int32, not empty, texels: height at which a chart would lie in each column; overwritten
    """
    placed: list[tuple[int, int]] = []
    while len(placed) < count:
        column = int(bottoms.argmin())
        bottom = int(bottoms[column])
        if bottom >= most:
            return None
        around = bottoms[max(column - page.reach, 0) : column + page.reach + 1]
        np.maximum(around, bottom + 1 + page.padding, out=around)
        placed.append((column, bottom))
    return np.array(placed, np.int64)
