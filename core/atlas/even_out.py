"""Even Out: a density for each object without a chosen one, so that small objects keep a usable part of the page.

With one density for all, texels are proportional to area: a ground of 200 m takes 96 % of a page, and each of 60 props on it has about 100
texels. How large a texel may be depends on the distance from which it is seen. Two assumptions bound that:

  all objects are seen from one distance            texels ~ area         equal density
  each object is seen until it fills the view       texels ~ 1            density ~ area^-1/2

Small objects, which are those with fewer than USABLE texels at one density, get the geometric mean of both: texels ~ area^1/2,
density ~ area^-1/4. Together they share at most half of the page, and none is raised above USABLE texels. All others share the rest at
one density. So large objects keep at least half of their texels, or 71 % of their density, and a page without small objects is unchanged.
"""

import dataclasses

import numpy as np

from ..scene.scene import SceneSnapshot
from ..util.arrays import BoolArray, Float64
from ..util.geometry import triangle_normals_areas
from ..util.settings import Settings
from .packing import Page
from .page_plan import count_usual_texels

USABLE = 1024.0  # texels of an object, 32 x 32: a side of a box then has 13 x 13, which hold a gradient and the edge of a shadow
_MOST_SHARE = 0.5  # of a page, for all small objects together


def acts(settings: Settings) -> bool:
    """Whether densities are evened out: not if the user chose one, nor if every object has a page of its own."""
    return settings.even_out and settings.atlas and settings.density == 0.0


def find_factors(area_m2: Float64, is_set: BoolArray, texels: float) -> Float64:
    """(n,) float64, at least 1: density of each object relative to that of large objects.

    area_m2   (n,) float64   surface areas times the squared density factors that are set
    is_set    (n,) bool      objects whose relative density the user set, which stays
    texels    usable texels of a page
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
    while True:  # raised objects take texels from the others, some of which may then need to be raised too
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
    """The scene with density factors that are evened out; the same scene if they need not be."""
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
