"""The greatest density at which charts fit one page."""

import math
from collections.abc import Callable

from .outlines import Outlines
from .packing import Layout, Page, place_charts, shape_charts
from .page_plan import FILLED_SHARE, find_gap, solve_density

_PRECISION = 1.01  # ratio of densities at which the search stops
_STEP_UP, _STEP_DOWN = 1.08, 0.92  # steps without a prediction
_WANTED_HEIGHT = 0.995  # of a page: predicted heights are slightly off, and a layout that is too high is useless
# The first _MOST_TRIES tries predict the next one if there are at least _MANY charts; with fewer, heights jump and a try takes little time.
_MOST_TRIES, _MANY = 4, 1000
_POWERS = (0.2, 2.0)  # bounds of p in height ~ density^p; measured 0.2 where padding is most of the height, 2 without padding
_TOO_HIGH = 1.5  # of a page's inside: a try with many charts is abandoned at this height
_LEAST_EXTENT_M = 1e-30  # keeps the density of charts that are points finite
_LEAST_SHARE = 1e-8  # of the greatest possible density; below it charts are points


def find_greatest_density(outlines: Outlines, page: Page, lay_out: Callable[[float], Outlines | None] | None = None) -> Layout | None:
    """The charts on one page at the greatest density at which they fit it, to about 1 %; None if there is none.

    With many charts, the heights of earlier tries predict the density at which they fill the page.

    lay_out   returns the outlines to place at a density, or None if they do not fit a page; by default `outlines`
    """
    if not page.inside:
        return None
    lay_out = lay_out or (lambda density: outlines)
    limit = _density_limit(outlines, page)
    density = min(_guess_density(outlines, page, FILLED_SHARE) or limit * _LEAST_SHARE, limit)
    found: Layout | None = None
    too_great, step = limit * _PRECISION, _STEP_DOWN
    ceiling = int(_TOO_HIGH * page.inside) if len(outlines.extent) >= _MANY else None  # a height beyond it predicts nothing
    tries: list[Layout] = []
    while found is None or (too_great / found.density > _PRECISION and found.density < limit):
        if density < limit * _LEAST_SHARE:
            return None
        tried = _try_density(lay_out(density), density, page, ceiling)
        full = wanted = 0.0
        if tried and ceiling and len(tries) < _MOST_TRIES:
            tries.append(tried)
            full, wanted = (_foresee(outlines, tries, height) for height in (1.0, _WANTED_HEIGHT))
        if tried and tried.top <= page.inside:
            found = tried
            if 0.0 < full < _PRECISION * density and limit > _STEP_UP * density:
                break
        else:
            too_great = density
        if found is None:
            density, step = (wanted, step) if wanted else (density * step, step**2)
        elif found.density < wanted < min(too_great, limit):
            density = max(wanted, _PRECISION * found.density)
        else:
            density = min(_STEP_UP * found.density, limit if too_great > limit else (too_great * found.density) ** 0.5)
    return found


def _try_density(outlines: Outlines | None, density: float, page: Page, ceiling: int | None) -> Layout | None:
    """Charts placed at a density; None if a chart is longer than the page, or the layout exceeds `ceiling`, see place_charts."""
    shapes = None if outlines is None else shape_charts(outlines, density, page)
    return None if shapes is None else place_charts(shapes, page.empty_horizon(), ceiling)


def _foresee(outlines: Outlines, tries: list[Layout], height: float) -> float:
    """Predicted density at which charts take the share `height` of the page: by a power law through the last two tries, or after the first
    try by the charts' boxes.
    """
    last = tries[-1]
    if len(tries) == 1:
        return _guess_density(outlines, last.shapes.page, _share_of_boxes(outlines, last) * height / _find_height(last))
    before = tries[-2]
    power = math.log(_find_height(last) / _find_height(before)) / math.log(last.density / before.density)
    return last.density * float((height / _find_height(last)) ** (1.0 / min(max(power, _POWERS[0]), _POWERS[1])))


def _find_height(tried: Layout) -> float:
    """Height of a layout over that of its page."""
    page = tried.shapes.page
    return (tried.top + page.padding) / (page.inside + page.padding)


def _density_limit(outlines: Outlines, page: Page) -> float:
    return page.inside / max(float(outlines.extent.max()), math.sqrt(float(outlines.area.sum())), _LEAST_EXTENT_M)


def _share_of_boxes(outlines: Outlines, tried: Layout) -> float:
    """Share of the page that the charts' boxes with their padding would fill, side by side."""
    page = tried.shapes.page
    return float((outlines.extent * tried.density + find_gap(page)).prod(axis=1).sum()) / (page.inside + page.padding) ** 2


def _guess_density(outlines: Outlines, page: Page, share: float) -> float:
    """The density at which _share_of_boxes is `share`; 0 if the padding alone takes as much."""
    texels = share * (page.inside + page.padding) ** 2
    box, extent = float(outlines.extent.prod(axis=1).sum()), float(outlines.extent.sum())
    return solve_density(len(outlines.extent), box, extent, texels, page)
