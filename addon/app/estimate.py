"""What a bake will be, told before it begins, from areas and triangles alone: texels, pages, memory and time; no bpy here.

All of it is rough: charts are only made during the bake. The constants are those that fit the bakes in docs/samples, on two cores.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ...core.util.settings import Settings

_FILL = 0.9  # share of a large page that charts cover
_GAP = 20.0  # paddings along a page's side, for the charts of a usual scene
_CORE_MB, _WORKER_MB = 250.0, 90.0
_CORE_MB_PER_TEXEL, _WORKER_MB_PER_TEXEL = 2.5e-4, 9e-5
_START_S = 1.2
_CORE_S_PER_TEXEL = 2.2e-5  # direct light and writing, on one core
_CORE_S_PER_PHOTON = 1.7e-6
_LEAST_PHOTONS = 2.6e5  # two first rounds: in the second leaves are what they should be
_PHOTONS_AT = (6.4e4, 0.57)  # of one triangle to this error on so many texels, and the power with which more triangles need more
_USUAL_ERROR, _USUAL_TEXELS = 0.05, 1.7e5
_UNCERTAIN = 2.0  # times sooner or later, as scenes and machines differ
# Times the photons, and times as uncertain, where each object has to come to it: 2 (bent_quads) to 39 (two_rooms) in docs/cycles.md.
_EACH_OBJECT, _EACH_UNCERTAIN = 8.0, 2.0


@dataclass(frozen=True)
class Measured:
    """One object before a bake, as it is shown.

    n_triangle   a scene of more has more edges of light
    longest_m    longest edge, which no chart cuts
    """

    name: str
    area_m2: float
    n_triangle: int
    density_factor: float
    longest_m: float = 0.0


@dataclass(frozen=True)
class Estimate:
    """A bake before it begins.

    density    texels/m of an object whose density factor is 1
    seconds    least and most; equal after a bake of the scene
    too_large  names of objects that do not fit a page at the wanted density
    fitting    of each of these, the share of the wanted density at which it fits, about
    nearly     names of objects that may not fit a page either: they are about as large as one
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


@dataclass(frozen=True)
class Pace:
    """How the last bake of the scene went.

    around_s   that Blender took before and after the core's work: whoever waits counts them, too
    """

    texels: int
    photons: int
    error: float
    error_of: str
    photon_s: float
    other_s: float
    around_s: float = 0.0

    @classmethod
    def of_result(cls, result: dict[str, Any] | None, waited_s: float = 0.0) -> Pace | None:
        """The pace behind the result file of a bake that was waited for so long.

        None without one, or where it tells too little: a bake that was kept, or gone on with.
        """
        if (
            result is None
            or result["resumed"]
            or result["skipped"]["bake"]
            or not math.isfinite(result["estimated_error"])
            or result["estimated_error"] <= 0.0
        ):
            return None
        texels = sum(row["texels"] for row in result["objects"])
        photon_s = result["seconds"].get("photons", 0.0)
        total_s = sum(result["seconds"].values())
        around_s = max(waited_s - total_s, 0.0)
        if not texels:
            return None
        return cls(texels, result["photons"], result["estimated_error"], result["error_of"], photon_s, total_s - photon_s, around_s)


def estimate_bake(
    objects: Sequence[Measured], settings: Settings, own_layers: int, cores: int, pace: Pace | None = None
) -> Estimate | None:
    """What baking these objects will be; None where they have no area.

    own_layers   how many of them bring a UV layer of their own, each a page
    cores        of the machine
    """
    objects = [one for one in objects if one.area_m2 > 0.0]
    weighted_m2 = [one.area_m2 * one.density_factor**2 for one in objects]
    total_m2 = sum(weighted_m2)
    if not (math.isfinite(total_m2) and total_m2 > 0.0):
        return None
    inside = max(settings.size - 2 * settings.padding, 1)
    page_texels = inside**2 * _FILL / (1.0 + _GAP * settings.padding / settings.size) ** 2
    density, too_large, nearly = settings.density, {}, []
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
        pages = len(objects) if not settings.atlas else math.ceil(sum(texels_of) / page_texels)
        texels = sum(texels_of)
    else:
        pages = len(objects) if not settings.atlas else 1
        texels = pages * page_texels
        density = math.sqrt(texels / total_m2)
    pages = min(pages + own_layers * settings.atlas, max(len(objects), 1))
    workers = settings.workers or cores
    return Estimate(
        objects=len(objects),
        area_m2=sum(one.area_m2 for one in objects),
        density=density,
        texels=round(texels),
        pages=pages,
        page_size=settings.size,
        memory_mb=_CORE_MB + workers * _WORKER_MB + texels * (_CORE_MB_PER_TEXEL + workers * _WORKER_MB_PER_TEXEL),
        seconds=_estimate_seconds(texels, sum(one.n_triangle for one in objects), settings, min(workers, cores), pace),
        too_large=tuple(too_large),
        fitting=tuple(too_large.values()),
        nearly=tuple(nearly),
    )


def _estimate_seconds(texels: float, n_triangle: int, settings: Settings, cores: int, pace: Pace | None) -> tuple[float, float]:
    if pace is not None and pace.error_of == settings.error_of:
        other_s = pace.around_s + pace.other_s * max(texels / pace.texels, 0.1)
        photons = pace.photons * _scale_photons(texels, settings.error, pace.error, pace.texels)
        s_per_photon, spread = pace.photon_s / max(pace.photons, 1), 1.0
    else:
        of_one, power = _PHOTONS_AT
        other_s = _START_S + texels * _CORE_S_PER_TEXEL / cores
        photons = of_one * n_triangle**power * _scale_photons(texels, settings.error, _USUAL_ERROR, _USUAL_TEXELS)
        s_per_photon, spread = _CORE_S_PER_PHOTON / cores, _UNCERTAIN
        if settings.error_of == "objects":
            photons, spread = photons * _EACH_OBJECT, spread * _EACH_UNCERTAIN
    usual_s = other_s + min(max(photons, _LEAST_PHOTONS), settings.max_photons) * s_per_photon
    least, most = usual_s / spread, usual_s * spread
    if settings.time_limit > 0.0:
        least, most = min(least, settings.time_limit), min(most, settings.time_limit)
    return least, most


def _scale_photons(texels: float, error: float, known_error: float, known_texels: float) -> float:
    """Photons relative to a known bake: noise falls with their root, and finer texels show finer leaves."""
    return (known_error / error) ** 2 * math.sqrt(texels / known_texels)
