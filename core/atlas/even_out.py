"""Even Out: a density for each object without a chosen one, so that small objects keep a usable part of the page.

At one density for all, texels go by area: a ground of 200 m takes 96 % of a page, and each of 60 props on it has about 100 texels.
How large a texel may be depends on the distance from which it is seen. Two guesses bound that:

  all are seen from one distance                    texels ~ area         density the same
  each is looked at until it fills the view         texels ~ 1            density ~ area^-1/2

Small things lie between, at the geometric mean of both: texels ~ area^1/2, density ~ area^-1/4. They are those that would have fewer
than USABLE texels at one density. By that rule they share half of the page, but none is lifted above USABLE texels; all others share what
is left at one density. So large things keep half of their texels at least, which is 71 % of their density, and nothing changes on a page
where all is usable already.
"""

from __future__ import annotations

import dataclasses
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..scene.scene import SceneSnapshot
from ..util.geometry import triangle_normals_areas
from ..util.settings import Settings
from .packing import Page
from .page_plan import count_usual_texels

Float64: TypeAlias = NDArray[np.float64]

USABLE = 1024.0  # texels of an object, 32 x 32: a side of a box then has 13 x 13, which hold a gradient and the edge of a shadow
_MOST_SHARE = 0.5  # of a page, for all small things together


def acts(settings: Settings) -> bool:
    """Whether densities are evened out: not where the user chose one, nor where every object fills a page by itself."""
    return settings.even_out and settings.atlas and settings.density == 0.0


def find_factors(area_m2: Float64, is_set: NDArray[np.bool_], texels: float) -> Float64:
    """(n,) float64, 1 or more: times as many texels per metre as the others have.

    area_m2   (n,) float64   surfaces, times the square of the density factor that is set
    is_set    (n,) bool      whose density the user set: it stays as it is, relative to the others
    texels    of a page
    """
    factor = np.ones(len(area_m2))
    total = float(area_m2.sum())
    if not (np.isfinite(total) and total > 0.0):
        return factor
    small = ~is_set & (area_m2 > 0.0) & (area_m2 * (texels / total) < USABLE)
    if not small.any():
        return factor
    root = np.sqrt(area_m2)
    wanted = np.where(small, np.minimum(USABLE, _MOST_SHARE * texels * root / root[small].sum()), 0.0)
    lifted = np.zeros(len(area_m2), bool)
    while True:  # what is lifted takes texels of the others, and some of them may want to be lifted then
        rest = float(area_m2[~lifted].sum())
        if rest <= 0.0:
            return np.ones(len(area_m2))  # no object has texels to spare
        level = (texels - float(wanted[lifted].sum())) / rest  # texels per square metre
        more = ~lifted & (area_m2 * level < wanted)
        if not more.any():
            factor[lifted] = np.sqrt(wanted[lifted] / (area_m2[lifted] * level))
            return factor
        lifted |= more


def even_out(snapshot: SceneSnapshot, settings: Settings) -> SceneSnapshot:
    """The scene with density factors that are evened out; the same scene where they need not be."""
    packed = np.array([one.receives and not one.has_layer for one in snapshot.objects], bool)
    if not (acts(settings) and packed.any()):
        return snapshot
    own = np.array([one.density_factor for one in snapshot.objects])
    area = triangle_normals_areas(snapshot.vertex_position[snapshot.tri_vertex])[1]
    area_m2 = np.bincount(snapshot.tri_object, area, len(snapshot.objects)) * own**2
    factor = np.ones(len(own))
    factor[packed] = find_factors(area_m2[packed], own[packed] != 1.0, count_usual_texels(Page(settings.size, settings.padding)))
    if (factor == 1.0).all():
        return snapshot
    changed = (dataclasses.replace(one, density_factor=float(own[i] * factor[i])) for i, one in enumerate(snapshot.objects))
    return dataclasses.replace(snapshot, objects=tuple(changed))
