"""What a bake will be, told before it begins, from areas and triangles alone: texels, pages, memory and time; no bpy here.

All of it is rough: charts are only made during the bake. The constants are those that fit the bakes in docs/samples, on two cores.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...core.atlas import even_out
from ...core.atlas.packing import Page
from ...core.atlas.page_plan import ChartDemand, count_full_pages, count_usual_texels, find_page_size, is_one_enough, plan_pages
from ...core.util.settings import MAX_PAGE_SIZE_TEXELS, Settings
from ..show.bake_pace import Pace

_MUCH, _NAMED = 0.2, 3  # of all texels: who takes so many is named, of so many objects at most
_CORE_MB, _WORKER_MB = 250.0, 90.0
_CORE_MB_PER_TEXEL, _WORKER_MB_PER_TEXEL = 2.5e-4, 9e-5
_START_S = 1.2
_CORE_S_PER_TEXEL = 2.2e-5  # direct light and writing, on one core
_CORE_S_OF_LIGHT, _USUAL_ERROR = 1.2e-5, 0.05  # of photons and gather rays of a texel, on one core, for this error
_UNCERTAIN = 2.0  # times sooner or later, as scenes and machines differ
# Times the photons, and times as uncertain, where each object has to come to it: 2 (bent_quads) to 39 (two_rooms) in docs/cycles.md.
_EACH_OBJECT, _EACH_UNCERTAIN = 8.0, 2.0


@dataclass(frozen=True)
class Measured:
    """One object before a bake, as it is shown.

    longest_m    longest edge, which no chart cuts
    n_chart      about, of chart_guess; 0 where nobody knows
    side_m       sum of the roots of the charts' areas; 0 where nobody knows
    """

    name: str
    area_m2: float
    density_factor: float
    longest_m: float = 0.0
    n_chart: int = 0
    side_m: float = 0.0


@dataclass(frozen=True)
class Estimate:
    """A bake before it begins.

    density    texels/m of an object whose density factor is 1
    seconds    least and most; equal after a bake of the scene
    too_large  names of objects that do not fit a page at the wanted density
    fitting    of each of these, the share of the wanted density at which it fits, about
    nearly     names of objects that may not fit a page either: they are about as large as one
    evened     (name, times as many texels per metre as it would have) of small ones that Even Out makes finer
    takers     (name, share of all texels) of those that take much of it, the most first
    """

    objects: int
    area_m2: float
    density: float
    texels: int
    pages: int
    page_size: int
    memory_mb: float
    seconds: tuple[float, float]
    too_large: tuple[str, ...] = ()
    fitting: tuple[float, ...] = ()
    nearly: tuple[str, ...] = ()
    takers: tuple[tuple[str, float], ...] = ()
    evened: tuple[tuple[str, float], ...] = ()


def estimate_bake(
    objects: Sequence[Measured], settings: Settings, own_layers: int, cores: int, pace: Pace | None = None
) -> Estimate | None:
    """What baking these objects will be; None where they have no area.

    own_layers   how many of them bring a UV layer of their own, each a page
    cores        of the machine
    """
    objects, factor = _even_out([one for one in objects if one.area_m2 > 0.0], settings)
    weighted_m2 = [one.area_m2 * one.density_factor**2 for one in objects]
    total_m2 = sum(weighted_m2)
    if not (math.isfinite(total_m2) and total_m2 > 0.0):
        return None
    page = Page(settings.size, settings.padding)
    inside = max(page.inside, 1)
    page_texels = count_usual_texels(page)
    demand = ChartDemand.of_squares([one.n_chart for one in objects], weighted_m2, [one.side_m * one.density_factor for one in objects])
    density, size, too_large, nearly = settings.density, settings.size, {}, []
    if density > 0.0:
        texels_of = [min(area * density**2, page_texels) for area in weighted_m2]
        wanted = [(one.name, area * density**2) for one, area in zip(objects, weighted_m2, strict=True)]
        along = [one.longest_m * density * one.density_factor for one in objects]
        for (name, texels), longest in zip(wanted, along, strict=True):
            room = math.sqrt(2.0) * inside / max(longest, 1.0)  # for it across the page, from corner to corner
            if texels > inside**2 or room < 1.0:
                too_large[name] = min(math.sqrt(page_texels / texels), room)
            elif texels > page_texels:
                nearly.append(name)
        pages = max(math.ceil(sum(texels_of) / page_texels), count_full_pages(demand, density, page))
    else:
        found = _plan_one_density(objects, demand, page, page_texels, settings)
        size, pages, density = found
        texels_of = [min(area * density**2, page_texels * (size / settings.size) ** 2) for area in weighted_m2]
        if not settings.atlas:
            texels_of = [page_texels] * len(objects)
    if not settings.atlas:
        pages = len(objects)
    texels = sum(texels_of)
    pages = min(pages + own_layers * settings.atlas, max(len(objects), 1))
    workers = settings.workers or cores
    return Estimate(
        objects=len(objects),
        area_m2=sum(one.area_m2 for one in objects),
        density=density,
        texels=round(texels),
        pages=pages,
        page_size=size,
        memory_mb=_CORE_MB + workers * _WORKER_MB + texels * (_CORE_MB_PER_TEXEL + workers * _WORKER_MB_PER_TEXEL),
        seconds=_estimate_seconds(texels, settings, min(workers, cores), pace),
        too_large=tuple(too_large),
        fitting=tuple(too_large.values()),
        nearly=tuple(nearly),
        evened=factor,
        takers=_list_takers(objects, texels_of) if settings.atlas else (),
    )


def _even_out(objects: list[Measured], settings: Settings) -> tuple[list[Measured], tuple[tuple[str, float], ...]]:
    """The objects with density factors that are evened out, and those that are finer by that."""
    if not even_out.acts(settings):
        return objects, ()
    own = np.array([one.density_factor for one in objects])
    area_m2 = np.array([one.area_m2 for one in objects]) * own**2
    factor = even_out.find_factors(area_m2, own != 1.0, count_usual_texels(Page(settings.size, settings.padding))).tolist()
    changed = [dataclasses.replace(one, density_factor=one.density_factor * times) for one, times in zip(objects, factor, strict=True)]
    return changed, tuple((one.name, times) for one, times in zip(objects, factor, strict=True) if times > 1.0)


def _plan_one_density(
    objects: Sequence[Measured], demand: ChartDemand, page: Page, page_texels: float, settings: Settings
) -> tuple[int, int, float]:
    """Page size, number of pages and density, texels/m, where only the size is chosen."""
    total_m2 = sum(one.area_m2 * one.density_factor**2 for one in objects)
    if not settings.atlas:
        return page.size, len(objects), math.sqrt(len(objects) * page_texels / total_m2)
    most = np.arange(len(objects)) == demand.count.argmax()
    if not demand.keep(most).find_density(1.0, page):  # an object lies on one page
        size = find_page_size(int(demand.count.max()), page, MAX_PAGE_SIZE_TEXELS) or page.size
        page, page_texels = Page(size, page.padding), page_texels * (size / page.size) ** 2
    fitting = demand.find_density(1.0, page)
    least = demand.find_least_density(page)
    chart_m2 = np.repeat(demand.box_m2 / demand.count, demand.count.astype(np.int64))
    is_alone = len(objects) == 1 or settings.max_pages == 1
    if fitting and (is_alone or is_one_enough(float(np.median(chart_m2)), fitting, least)):
        return page.size, 1, min(fitting, math.sqrt(page_texels / total_m2))
    if is_alone:
        return page.size, 1, least
    plan = plan_pages(demand, page, settings.max_pages)
    return page.size, plan.pages, plan.density or least


def _list_takers(objects: Sequence[Measured], texels_of: Sequence[float]) -> tuple[tuple[str, float], ...]:
    if len(objects) < 2:
        return ()
    shares = sorted(
        zip((one.name for one in objects), (texels / sum(texels_of) for texels in texels_of), strict=True), key=lambda one: -one[1]
    )
    return tuple(one for one in shares[:_NAMED] if one[1] >= _MUCH)


def _estimate_seconds(texels: float, settings: Settings, cores: int, pace: Pace | None) -> tuple[float, float]:
    if pace is not None and pace.error_of == settings.error_of:
        known_error, known_texels, spread = pace.error, float(pace.texels), 1.0
        other_s = pace.around_s + pace.other_s * max(texels / pace.texels, 0.1)
        light_s = pace.photon_s
    else:
        known_error, known_texels, spread = _USUAL_ERROR, texels, _UNCERTAIN
        other_s = _START_S + texels * _CORE_S_PER_TEXEL / cores
        light_s = texels * _CORE_S_OF_LIGHT / cores
        if settings.error_of == "objects":
            light_s, spread = light_s * _EACH_OBJECT, spread * _EACH_UNCERTAIN
    # Photons' noise falls with the root of their number; gather rays are as many as the inverse of the error, see gathered.count_rays.
    usual_s = other_s + light_s * (known_error / settings.error) ** (1 if settings.direct == "rays" else 2) * texels / known_texels
    least, most = usual_s / spread, usual_s * spread
    if settings.time_limit > 0.0:
        least, most = min(least, settings.time_limit), min(most, settings.time_limit)
    return least, most
