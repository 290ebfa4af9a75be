"""The light at texels, put together from the parts that a bake has found. No other module does this.

A texel's light is direct + indirect. Direct light comes from shadow rays, or from photons where the bake sends no rays; light from lamps by
mirrors and glass is direct too, and always comes from photons. Indirect light is gathered by rays; before it is, and where the bake sends
no rays, it is that of the texel's leaf in the quadtree. Two levels of detail:

    light_at_texels   all texels, with noise filtered: what pages show
    glance_at         some texels, without filters: what a viewport shows while a bake runs, and what gather rays find on the surfaces that
                      they meet
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import starmap

import numpy as np
from numpy.typing import NDArray

from ..filter import denoise, seams
from ..radiosity.leaf_light import clip_light, evaluate_nodes, find_variance
from ..radiosity.quadtree import node_at_entries, node_of_texel
from ..texels.texel_map import TexelMap
from ..util.arrays import Float32, IntArray
from ..util.threads import run_on_threads
from .light_field import LightField

_CHUNK = 1 << 16  # texel entries at a time, so that intermediate arrays stay in the cache


@dataclass(frozen=True)
class TexelLight:
    """Light at the texel entries.

    direct, indirect   (n, 3) float32, W/m^2, never negative
    stderr             (n, 3) float32, W/m^2: standard error of their sum; None where it is not computed
    leaf               (n,) int32: node of the tree that is each texel's leaf
    empty              direct and indirect light of empty texels beside charts, where seams need it
    """

    direct: Float32
    indirect: Float32
    stderr: Float32 | None
    leaf: NDArray[np.int32]
    empty: seams.EmptyTexels | None = None


def light_at_texels(
    field: LightField,
    texels: TexelMap,
    smooth_grain: bool = True,
    threads: int = 1,
    spread: denoise.Spread = starmap,
    doubt: bool = True,
    spend: bool = False,
) -> TexelLight:
    """Light at every texel, as pages show it.

    doubt   compute the standard error too, as it is before noise is filtered
    spend   the field's direct light is no longer needed: the result may take its place in memory
    """
    noise = field.direct.variance.copy() if doubt else None
    direct = field.direct.take_shown(texels, smooth_grain, spread, in_place=spend)
    leaf = node_of_texel(field.tree, field.leaves, len(texels))
    indirect = field.gathered.show(texels, smooth_grain, spread).irradiance if field.gathered else None
    if field.gathered and noise is not None:
        noise += field.gathered.variance + field.gathered.find_doubt2()[:, None]
    if indirect is None or field.has_direct_photons:
        by_photons, variance = _light_leaves(field, texels, leaf, threads)
        if smooth_grain:  # without light by rays, which is far more accurate and would be blurred
            is_grainy = field.tree.side[leaf] <= denoise.SMALL_LEAF
            found = denoise.denoise(by_photons, variance, is_grainy, texels, spread)
            by_photons[:, found.entry] = found.light
        if noise is not None:
            noise += variance
        if field.has_direct_photons:
            by_photons[0] += direct
            direct = by_photons[0]
        indirect = by_photons[-1] if indirect is None else indirect
    return TexelLight(direct, np.maximum(indirect, np.float32(0.0)), None if noise is None else np.sqrt(np.maximum(noise, 0)), leaf)


def glance_at(field: LightField, texels: TexelMap, entry: IntArray, rays_alone: bool = False) -> Float32:
    """(2, m, 3) float32, W/m^2: direct and indirect light at texel entries (m,), unfiltered and quick to compute; never negative.

    The flux of a leaf is preserved over its texels in `entry`, see leaf_light.clip_light.

    rays_alone   where shadow rays were sent, leave out the photons' direct light, because photons carried the same light; otherwise
                 theirs is light by mirrors and glass, and is added
    """
    node = node_at_entries(field.tree, field.leaves, entry)
    irradiance = evaluate_nodes(field.tree, field.solution.coefficient, node, *texels.own_points_at(entry))
    for values in irradiance.reshape(-1, len(entry)):
        clip_light(values, texels.texel_area[entry], node)
    direct, indirect = light = np.ascontiguousarray(irradiance.transpose(0, 2, 1), np.float32)
    if field.gathered:
        indirect[:] = np.maximum(field.gathered.irradiance[entry], 0.0)
    if rays_alone:
        direct[field.direct.passes[entry] > 0] = 0.0
    direct += field.direct.irradiance[entry]
    return light


def find_known(field: LightField, texels: TexelMap) -> tuple[Float32, Float32, NDArray[np.int32]]:
    """Light at all texel entries, in the form of gather.KnownLight: (3, n) float32, W/m^2, the sum of both parts of glance_at; (n,)
    float32, W/m^2, half of the difference between the two halves of the photons; and (n,) int32, the entries' leaves.

    Gathered light is left out: gather rays that meet it would add one more reflection with every batch.
    """
    leaves = replace(field, gathered=None)
    n_texel = len(texels)
    light, doubt, leaf = np.empty((3, n_texel), np.float32), np.empty(n_texel, np.float32), np.empty(n_texel, np.int32)
    for start in range(0, n_texel, _CHUNK):
        part = slice(start, min(start + _CHUNK, n_texel))
        entry = np.arange(part.start, part.stop)
        light[:, part] = glance_at(leaves, texels, entry).sum(axis=0).T
        leaf[part] = node = node_at_entries(field.tree, field.leaves, entry)
        halves = evaluate_nodes(field.tree, field.solution.half, node, *texels.own_points_at(entry))
        doubt[part] = (halves[0] - halves[1]).mean(axis=0) / 2.0
    return light, doubt, leaf


def _light_leaves(field: LightField, texels: TexelMap, leaf: NDArray[np.int32], threads: int) -> tuple[Float32, Float32]:
    """(C, n, 3) float32, W/m^2: light that pages take from leaves: direct, if photons carry any, and indirect, if it is not gathered; and
    (n, 3) float32, (W/m^2)^2: the variance of their sum.
    """
    which = slice(0 if field.has_direct_photons else 1, 1 if field.gathered else 2)
    coefficient = field.solution.coefficient[which]
    light, variance = np.empty((len(coefficient), len(texels), 3), np.float32), np.empty((len(texels), 3), np.float32)

    def fill(part: slice) -> None:
        node, points = leaf[part], texels.own_points(part.start, part.stop)
        light[:, part] = evaluate_nodes(field.tree, coefficient, node, *points).transpose(0, 2, 1)
        variance[part] = find_variance(field.tree, field.solution, node, *points).T

    run_on_threads(fill, len(texels), threads)
    for of_part in light:
        for channel in range(3):
            clip_light(of_part[:, channel], texels.texel_area, leaf)
    return light, variance
