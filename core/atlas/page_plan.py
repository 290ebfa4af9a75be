"""Number of pages and density of charts if only the page size is chosen.

A chart of w x h texels takes (w + gap) (h + gap) texels of a page. So all charts take

    C(d) = d^2 sum w h + d gap sum (w + h) + gap^2 n

at d texels per metre. One page is enough if the charts fit it and most of them keep a texel. Otherwise there are as many pages as make the
charts' mean area gap^2: d^2 sum w h = gap^2 n. Up to there the texels of square charts grow with the square of the number of pages; each
further page gains less. The pages have at most 4 gap^2 n texels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..util.arrays import BoolArray, Float64
from .packing import Page

FILLED_SHARE = 0.9  # share of a page that charts with their gaps fill
_USUAL_GAPS = 20.0  # number of paddings along a page's side, with the charts of a usual scene
FEWEST_TEXELS = 1.0  # median texels of a chart below which a page is too coarse


@dataclass(frozen=True)
class ChartDemand:
    """Number and extents of the charts of each object.

    count      (n,) float64
    box_m2     (n,) float64, m^2   total area of the charts' boxes
    extent_m   (n,) float64, m     sum of the boxes' widths and heights
    """

    count: Float64
    box_m2: Float64
    extent_m: Float64

    @classmethod
    def of_squares(cls, count: ArrayLike, area_m2: ArrayLike, side_m: ArrayLike = 0.0) -> ChartDemand:
        """The demand of charts that are taken to be nearly square.

        side_m   (n,) sum of the roots of the charts' areas; where it is 0, those of an object are taken to be of one size
        """
        number = np.maximum(np.asarray(count, np.float64), 1.0)
        box_m2 = np.asarray(area_m2, np.float64) / _SHARE_OF_BOX
        side = np.asarray(side_m, np.float64) / math.sqrt(_SHARE_OF_BOX)
        return cls(number, box_m2, 2.0 * np.where(side > 0.0, side, np.sqrt(box_m2 * number)))

    def count_texels(self, density: float, page: Page) -> Float64:
        """(n,) float64: texels of a page that each object takes, gaps included."""
        gap = find_gap(page)
        return self.box_m2 * density**2 + self.extent_m * gap * density + self.count * gap**2

    def find_density(self, pages: float, page: Page) -> float:
        """Density in texels/m at which all charts fill `pages`; 0 if the gaps alone fill them."""
        return solve_density(float(self.count.sum()), float(self.box_m2.sum()), float(self.extent_m.sum()), pages * _room(page), page)

    def find_least_density(self, page: Page) -> float:
        """Density in texels/m at which the charts are as wide as their gaps, in the mean."""
        return find_gap(page) * math.sqrt(float(self.count.sum()) / float(self.box_m2.sum()))

    def keep(self, kept: BoolArray) -> ChartDemand:
        """The demand of the objects `kept` (n,) bool."""
        return ChartDemand(self.count[kept], self.box_m2[kept], self.extent_m[kept])


_SHARE_OF_BOX = 0.8  # that a usual chart covers


@dataclass(frozen=True)
class PagePlan:
    """Number of pages, and density in texels/m; 0 if the charts do not fit them."""

    pages: int
    density: float


def count_usual_texels(page: Page) -> float:
    """Texels of a page that the charts of a usual scene cover."""
    return max(page.inside, 1) ** 2 * FILLED_SHARE / (1.0 + _USUAL_GAPS * page.padding / page.size) ** 2


def find_gap(page: Page) -> float:
    """Texels by which a chart's box is longer on a page, in the mean."""
    return page.padding + 0.5


def solve_density(count: float, box_m2: float, extent_m: float, texels: float, page: Page) -> float:
    """Density in texels/m at which charts with their gaps take so many texels, see C(d) above; 0 if the gaps alone take them.

    count, box_m2, extent_m   totals as in ChartDemand
    """
    gap = find_gap(page)
    linear, constant = gap * extent_m, count * gap**2 - texels
    if constant >= 0.0:
        return 0.0
    divisor = linear + math.sqrt(linear**2 - 4.0 * box_m2 * constant)  # of the stable root, since box_m2 may vanish
    return -2.0 * constant / divisor if divisor > 0.0 else math.inf  # charts without extent take gaps alone


def is_one_enough(chart_m2: float, density: float, least: float) -> bool:
    """Whether charts are fine enough at the density at which they fit one page.

    chart_m2   area of the median chart
    least      density at which charts are as wide as their gaps, texels/m
    """
    return density >= least or chart_m2 * density**2 >= FEWEST_TEXELS


def plan_pages(demand: ChartDemand, page: Page, most: int = 0) -> PagePlan:
    """Number of pages for charts as wide as their gaps, and the density that fills these pages.

    An object that is larger than a page gets one of its own, at the density that fits.

    most   greatest number of pages, 0 for any
    """
    least = demand.find_least_density(page)
    is_large = demand.count_texels(least, page) > _room(page)
    rest = demand.keep(~is_large)
    taken = float(rest.count_texels(least, page).sum()) / _room(page)
    pages = int(is_large.sum()) + math.ceil(taken - 1e-9)
    if most and pages > most:
        return PagePlan(most, demand.find_density(most, page))
    filled = rest.find_density(pages - int(is_large.sum()), page) if len(rest.count) else least
    return PagePlan(pages, max(filled, least))


def count_full_pages(demand: ChartDemand, density: float, page: Page) -> int:
    """Number of pages that charts fill at a density; an object that is larger than a page gets one of its own."""
    return math.ceil(float(np.minimum(demand.count_texels(density, page), _room(page)).sum()) / _room(page) - 1e-9)


def find_page_size(charts: int, page: Page, largest: int) -> int:
    """Side of the smallest page, 2, 4, 8 ... times as large, that holds `charts` as wide as their gaps; 0 if it exceeds `largest`."""
    size = 2 * page.size
    while size <= largest:
        larger = Page(size, page.padding)
        if larger.inside and 4.0 * charts * find_gap(larger) ** 2 <= _room(larger):
            return size
        size *= 2
    return 0


def _room(page: Page) -> float:
    """Texels of a page that charts and their gaps may take; at least 1."""
    return max(FILLED_SHARE * (page.inside + page.padding) ** 2, 1.0)
