"""The light at texels, put together from the parts that a bake has found. No other module does this.

A texel's light is direct + indirect. Direct light comes from shadow rays, or from photons where the bake sends no rays; light from lamps by
mirrors and glass is direct too, and always comes from photons. Indirect light is that of the texel's leaf in the quadtree, or gathered
light where gather rays were sent. Two levels of detail:

    light_at_texels   all texels, with leaves blended, tallies at contacts mixed in, and grain filtered: what pages show
    glance_at         some texels, with neither blending nor filters: what a viewport shows while a bake runs, and what gather rays find on
                      the surfaces that they meet
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import starmap

import numpy as np
from numpy.typing import NDArray

from ..filter import denoise, reconstruct, seams, subtexel_tally
from ..filter.border_feathering import close_cuts
from ..filter.clip_light import clip_light
from ..filter.firefly_clamp import clip_flecks
from ..filter.neighbours import Neighbours
from ..radiosity.quadtree import node_at_entries, node_of_texel
from ..texels.texel_map import FOOTPRINT_SIDE, TexelMap
from ..util.ablation import uses
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

    doubt   compute the standard error too, as it is before grain is filtered
    spend   the field's direct light is no longer needed: the result may take its place in memory
    """
    by_rays = field.direct.take_shown(texels, smooth_grain, spread, in_place=spend)
    leaf = node_of_texel(field.tree, field.leaves, len(texels))
    side = field.tree.side[leaf]
    variance = field.direct.variance if spend and not doubt else np.empty((len(texels), 3), np.float32)
    # (1 or 2, n, 3): direct light, where photons carry any, and indirect light.
    by_photons = _blend_leaves(field, texels, leaf, variance, threads)
    if field.few:
        field.few.show(by_photons[-1], variance, leaf)
    clip_flecks(by_photons[-1], variance, leaf, side, texels)
    close_cuts(by_photons, texels, side)
    _share_across_occluders(by_photons, texels)
    is_grainy = side <= denoise.SMALL_LEAF
    if field.squares is not None:
        is_grainy |= subtexel_tally.mix(by_photons.transpose(0, 2, 1), variance.T, field.squares, texels)
    if field.gathered:
        gathered = field.gathered.show_gathered(texels, smooth_grain, spread)
        entry = np.flatnonzero(gathered.is_shown)
        is_grainy[entry] = False
        by_photons[-1, entry] = np.maximum(gathered.light.irradiance_at(entry), 0.0)
        variance[entry] = field.gathered.variance[entry] + gathered.doubt2[entry, None]
    if smooth_grain and uses("leaf_filter"):  # without light by rays, which is far more accurate and would be blurred
        found = denoise.denoise(by_photons, variance, is_grainy, texels, spread)
        by_photons[:, found.entry] = found.light
    noise = field.direct.variance if doubt else None

    def finish(part: slice) -> None:
        if len(by_photons) == 2:
            by_photons[0, part] += by_rays[part]
        if noise is not None:
            variance[part] += noise[part]
            np.sqrt(variance[part], out=variance[part])

    run_on_threads(finish, len(texels), threads)
    direct = by_photons[0] if len(by_photons) == 2 else by_rays
    return TexelLight(direct, by_photons[-1], variance if doubt else None, leaf)


def glance_at(field: LightField, texels: TexelMap, entry: IntArray, rays_alone: bool = False) -> Float32:
    """(2, m, 3) float32, W/m^2: direct and indirect light at texel entries (m,), unfiltered and quick to compute; never negative.

    The flux of a leaf is preserved over its texels in `entry`, see clip_light.

    rays_alone   where shadow rays were sent, leave out the photons' direct light, because photons carried the same light; otherwise
                 theirs is light by mirrors and glass, and is added
    """
    tree, leaf = field.tree, node_at_entries(field.tree, field.leaves, entry)
    x, y = texels.own_points_at(entry)
    irradiance = reconstruct.evaluate_leaf(tree, field.solution, leaf, x, y).irradiance
    for values in irradiance.reshape(-1, len(entry)):
        clip_light(values, texels.texel_area[entry], leaf, tree)
    direct, indirect = light = np.ascontiguousarray(irradiance.transpose(0, 2, 1), np.float32)
    if field.few:
        field.few.show(indirect, None, leaf)
    if field.gathered:
        found = np.flatnonzero(field.gathered.passes[entry])
        indirect[found] = np.maximum(field.gathered.irradiance[entry[found]], 0.0)
    if rays_alone:
        direct[field.direct.passes[entry] > 0] = 0.0
    direct += field.direct.irradiance[entry]
    return light


def find_known(field: LightField, texels: TexelMap) -> tuple[Float32, Float32]:
    """Light at all texel entries, in the form of gather.KnownLight: (3, n) float32, W/m^2, the sum of both parts of glance_at; and (n,)
    float32, W/m^2, half of the difference between the two halves of the photons.

    Gathered light is left out: gather rays that meet it would add one more reflection with every batch.
    """
    leaves = replace(field, gathered=None)
    n_texel = len(texels)
    light, doubt = np.empty((3, n_texel), np.float32), np.empty(n_texel, np.float32)
    for start in range(0, n_texel, _CHUNK):
        part = slice(start, min(start + _CHUNK, n_texel))
        entry = np.arange(part.start, part.stop)
        light[:, part] = glance_at(leaves, texels, entry).sum(axis=0).T
        node = node_at_entries(field.tree, field.leaves, entry)
        x, y = texels.own_points_at(entry)
        halves = reconstruct.evaluate_leaf(field.tree, field.solution, node, x, y, halves=True).irradiance
        doubt[part] = (halves[0] - halves[1]).mean(axis=0) / 2.0
    return light, doubt


def _blend_leaves(field: LightField, texels: TexelMap, leaf: NDArray[np.int32], variance: Float32, threads: int) -> NDArray[np.float32]:
    """(C, n, 3) float32, W/m^2: light carried by photons, blended between leaves: direct and indirect if C = 2, else indirect alone.

    variance   (n, 3) float32, of their sum: filled here
    """
    first = 0 if _any_direct(field) else 1
    light = np.empty((2 - first, len(texels), 3), np.float32)
    neighbours = field.neighbours or Neighbours.of(field.tree, leaf, texels)
    blend = reconstruct.Blend(texels, field.tree, field.solution, leaf, neighbours, halves=False)

    def fill(part: slice) -> None:
        found = blend.range(part.start, part.stop)
        for channel in range(3):  # several times faster than on transposed arrays
            for of_part, values in zip(light, found.irradiance[first:, channel], strict=True):
                of_part[part, channel] = values
            variance[part, channel] = found.variance[channel] * field.correction[channel]

    run_on_threads(fill, len(texels), threads)
    for of_part in light:
        for channel in range(3):  # a fitted plane may dip below zero beside a spot of light
            clip_light(of_part[:, channel], texels.texel_area, leaf, field.tree)
    return light


def _share_across_occluders(light: Float32, texels: TexelMap) -> None:
    """Mix light from beyond an occluder into the texels that it cuts, in place, as shadow rays do, which start on the texel's whole square.

    light   (C, n, 3) float32
    """
    entry, beyond, share = texels.borders.list_beyond(FOOTPRINT_SIDE)
    for of_part, moved in zip(light, share[:, None] * (light[:, beyond] - light[:, entry]), strict=True):
        np.add.at(of_part, entry, moved)


def _any_direct(field: LightField) -> bool:
    """Whether photons carried direct light, from lamps or by mirrors and glass."""
    return bool(field.solution.coefficient[0].any() or (field.squares is not None and field.squares.irradiance[0].any()))
