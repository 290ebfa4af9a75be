"""Blocks: charts shared by several objects, packed once, then moved and scaled as one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..util.arrays import Float64, Int64
from .outlines import Outlines
from .packing import Page, Placement, Shapes, fits_alone, place_charts, place_uv, shape_charts

_WIDTHS = (0.6, 0.75, 0.95, 1.2)  # candidate widths, relative to the side of a square of the same area as the charts' boxes with padding


@dataclass(frozen=True)
class BlockLayout:
    """The packing of a block at the density of its smallest object.

    density   texels/m
    low       (2,) float64, texels: lower left corner in the placement
    side      (2,) float64, texels: width and height
    """

    density: float
    shapes: Shapes
    placement: Placement
    low: Float64
    side: Float64

    def place(self, points: Float64, chart: Int64) -> Float64:
        """(n, k, 2) float64: points of charts, in texels of the block.

        points   (n, k, 2) float64, m, as in the outlines
        chart    (n,) int64
        """
        return place_uv(points, chart, self.density, self.shapes, self.placement) - self.low


def lay_block(outlines: Outlines, density: float, page: Page) -> BlockLayout | None:
    """The smallest packing found for the charts of a block's smallest object; None if they do not fit a page.

    The gaps are a texel wider than the padding, since a block may be placed at fractions of a texel.
    """
    inner = Page(page.size + 2, page.padding + 1)
    if not fits_alone(outlines, density, inner):
        return None
    shapes = shape_charts(outlines, density, inner)
    room = math.sqrt(float((shapes.side + inner.padding).prod(axis=1).sum()))
    widest = inner.inside // inner.step
    found: list[BlockLayout] = []
    for columns in sorted({min(widest, max(1, round(room * share / inner.step))) for share in _WIDTHS}):
        placement = place_charts(shapes, np.full(columns + 2 * inner.reach, -inner.padding, np.int32))
        if placement is not None:
            found.append(_measure_layout(outlines, density, shapes, placement))
    return min(found, key=lambda layout: float((layout.side + page.padding).prod()), default=None)


def outline_block(outlines: Outlines, layout: BlockLayout) -> Outlines:
    """The block as one outline that must not be turned, in metres of its smallest object."""
    edge = layout.place(outlines.edge, outlines.edge_chart) / layout.density
    extent, area = layout.side[None] / layout.density, outlines.area.sum(keepdims=True)
    return Outlines(edge, np.array([0, len(edge)]), extent, area, np.ones(1, bool))


def _measure_layout(outlines: Outlines, density: float, shapes: Shapes, placement: Placement) -> BlockLayout:
    placed = place_uv(outlines.edge, outlines.edge_chart, density, shapes, placement)
    low = placed.min(axis=(0, 1))
    return BlockLayout(density, shapes, placement, low, placed.max(axis=(0, 1)) - low)


def join_outlines(parts: Sequence[Outlines]) -> Outlines:
    """The outlines of all parts, concatenated."""
    counts = [0, *(len(part.edge) for part in parts)]
    first = np.cumsum(counts)
    start = [part.start[:-1] + before for part, before in zip(parts, first[:-1], strict=True)]
    return Outlines(
        np.concatenate([part.edge for part in parts]),
        np.append(np.concatenate(start), first[-1]),
        np.concatenate([part.extent for part in parts]),
        np.concatenate([part.area for part in parts]),
        np.concatenate([part.rigid for part in parts]),
    )
