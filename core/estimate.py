"""The stated error: how far the bake is likely to be from the converged light, told from the bake itself.

Three parts: noise of each leaf from the squared powers of its photons, corrected by how the two halves of the bake differ, and on
small leaves by what smoothing takes off; light that the leaves cannot hold, from their children; and the noise of direct light
by shadow rays.
The error of a bake is relative to local brightness, so that dark corners count as the eye counts them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from . import refine, shrinkage
from .denoise import GRAIN_LEFT, SMALL_LEAF
from .direct_shown import ShownDirect, ShownGathered
from .quadtree import Quadtree, node_of_texel
from .reconstruct import LeafBlender, PointLight, evaluate_leaf
from .scene import IntArray
from .tally import Solution, Totals
from .texel_map import TexelMap

# Brightness below this share of the mean is judged against that share: else one black texel would decide the whole.
DARK_FLOOR = 0.1
# Texels whose centre lies outside of the chart are left out too: little of them is seen, and no other baker has light there.
# The worst texels are left out: on a hard edge of light, whether a texel is its centre or its mean decides its error.
BEST_TEXELS = 0.99
# Squared light that a node cannot hold, over what its parent could not: 1/2 along edges, 1/16 where light is smooth.
BIAS_DECAY = 0.25
# A bake that stops at the first round whose error is small enough picks one that came out small by chance: so many standard errors of
# the bias are held against it. Measured over bakes of few leaves.
_BIAS_DOUBT = 0.58
_SAMPLE = 1 << 13  # texels that are asked
_CHUNK = 1 << 16
_GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
# The halves of few leaves say little about noise; the prior says "as independent photons" with this many values' weight.
_PRIOR_VALUES = 64.0
_TINY = float(np.finfo(float).tiny)
# Variances (k, 3) float32, (W/m^2)^2, of some texel entries (k,).
_VarianceAt: TypeAlias = Callable[[NDArray[np.int64]], NDArray[np.float32]]


def noise_correction(tree: Quadtree, solution: Solution, nodes: IntArray) -> NDArray[np.float64]:
    """Variance seen between the halves of the bake over the variance that independent photons would have, (3,) float64: of each channel.

    Light that is reflected more often comes by photons that fall on a leaf more than once.

    nodes   (m,) int, nodes that tile the charts
    """
    area = np.maximum(tree.area[nodes], _TINY)
    seen = ((solution.flux_half[0] - solution.flux_half[1])[:, nodes] / (2.0 * area)) ** 2
    predicted = solution.variance[:, nodes]
    ratio = np.divide(seen, predicted, out=np.zeros_like(seen), where=predicted > 0.0)
    # Photons of a leaf are few and their powers differ, so single ratios have long tails: weigh leaves by their light.
    weight = np.sqrt(np.maximum(solution.flux[:, nodes], 0.0)) * (predicted > 0.0)
    weight /= np.maximum(weight.max(axis=1, keepdims=True, initial=0.0), _TINY)
    total, squares = weight.sum(axis=1), (weight**2).sum(axis=1)
    effective = np.divide(total**2, squares, out=np.zeros(len(total)), where=squares > 0.0)
    told = np.divide((ratio * weight).sum(axis=1), total, out=np.ones(len(total)), where=total > 0.0)
    prior = _PRIOR_VALUES / len(told)
    out: NDArray[np.float64] = (told * effective + prior) / (effective + prior)
    return out


@dataclass(frozen=True)
class StatedError:
    """What the bake says of itself, relative to local brightness.

    relative      error of the whole: root mean square over the best texels and over channels; nan before any photon
    chosen        the same for whoever stops at this round because it is small, which is to choose among rounds
    direct        the part of it that is noise of direct light by rays, which no photon makes less
    correction    of noise_correction
    texel_direct2 gives (n,) float32: the squared part of direct light by rays at each texel
    gathered, texel_gathered2   as direct and texel_direct2, of gathered light; None where there is none
    """

    relative: float
    chosen: float
    direct: float
    correction: NDArray[np.float64]
    texel_direct2: Callable[[], NDArray[np.float32]]
    gathered: float = 0.0
    texel_gathered2: Callable[[], NDArray[np.float32]] | None = None


def state_error(
    tree: Quadtree,
    totals: Totals,
    solution: Solution,
    comparison: refine.Comparison,
    nodes: IntArray,
    shown_direct: ShownDirect,
    blender: LeafBlender,
    smooth_grain: bool = True,
    gathered: ShownGathered | None = None,
    risk: NDArray[np.float64] | None = None,
) -> StatedError:
    """Error of the light on the `nodes`, which tile the charts, as it is shown, and of direct light by rays, 0 without.

    smooth_grain   whether it is shown with its grain smoothed
    gathered       light that is shown in place of the nodes'
    risk           (m,) float64 of each of `nodes`, of shrinkage.shrink_leaves; None where they are not shrunk
    """
    correction = noise_correction(tree, solution, nodes)
    area = np.maximum(tree.area, _TINY)
    leaf = node_of_texel(tree, nodes, len(shown_direct))
    node_light = np.ascontiguousarray((solution.flux / area).astype(np.float32).T)
    dark2 = _find_dark(tree, nodes, node_light, shown_direct)

    def relative2_at(variance_at: _VarianceAt, rows: NDArray[np.int64]) -> NDArray[np.float32]:
        light = node_light[leaf[rows]] + shown_direct.irradiance_at(rows)
        found: NDArray[np.float32] = (_weigh(light, dark2) * variance_at(rows)).mean(1)
        return found

    def of_texels(variance_at: _VarianceAt) -> NDArray[np.float32]:
        parts = (np.arange(part.start, part.stop) for part in _parts(len(leaf)))
        return np.concatenate([np.zeros(0, np.float32), *(relative2_at(variance_at, part) for part in parts)])

    sample = _choose_sample(blender.texels)
    count = int(np.ceil(BEST_TEXELS * len(sample)))
    direct2 = relative2_at(shown_direct.variance_at, sample)
    texel_direct2 = partial(of_texels, shown_direct.variance_at)
    if not totals.photons.sum() or not count:
        return StatedError(math.nan, math.nan, math.sqrt(np.sort(direct2)[:count].sum() / max(count, 1)), correction, texel_direct2)
    # What is shown are blended leaves, which err less than leaves do: asked of so many texels that the mean is sure.
    shown = blender.join(tree, solution, leaf, halves=True).at(sample)
    weight = _weigh(node_light[leaf[sample]] + shown_direct.irradiance_at(sample), dark2)
    photons2 = (weight.T * shown.variance * correction[:, None]).mean(0)
    shrunk2 = (
        np.zeros(len(sample))
        if risk is None
        else shrinkage.find_shrunk_noise(tree, solution, leaf[sample], photons2, *blender.texels.own_points_at(sample))
    )
    taken, taken_surely = (0.0, 0.0) if risk is None else shrinkage.find_share_taken(leaf[sample], shrunk2, nodes, risk)
    photons2 -= taken * shrunk2
    if smooth_grain:
        left = np.where(tree.side[leaf[sample]] <= SMALL_LEAF, GRAIN_LEFT, 1.0)
        photons2, shrunk2 = photons2 * left, shrunk2 * left
    blind2 = weight.mean(1) * missing_light(tree, totals, solution, comparison, nodes)[leaf[sample]]
    judge = _find_judges(tree, nodes, blender)
    bias2, gap2, noise2 = _missing_from_blend(tree, solution, leaf, judge, sample, blender, shown, correction, weight, blind2)
    blur2 = (weight * shown_direct.blur2_at(sample)).mean(1)
    gathered2, gathered_blur2 = np.zeros((2, len(sample)))
    if gathered:
        told = gathered.told[sample]
        gathered2[told] = (weight * gathered.light.variance_at(sample)).mean(1)[told]
        gathered_blur2[told] = (weight * gathered.light.blur2_at(sample)).mean(1)[told]
        photons2[told] = (weight.mean(1) * gathered.doubt2[sample])[told]
        for missing in (bias2, gap2, noise2, shrunk2):
            missing[told] = 0.0
    likely = photons2 + direct2 + gap2 + gathered2
    best = np.argpartition(likely, count - 1)[:count]
    every = (photons2, direct2, bias2, blur2, gathered2, gathered_blur2)
    parts = [float(part[best].mean(dtype=np.float64)) for part in every]
    parts[1] += max(parts[3], 0.0)
    parts[4] += max(parts[5], 0.0)
    # A bias is told only in sum, by nodes that err apart. How far apart was seen says how much of it is sure; what may be missing
    # is told by what could be expected, for few nodes may agree by chance.
    seen4 = (np.bincount(judge[best], bias2[best]) ** 2).sum() / count**2
    expected4 = (np.bincount(judge[best], noise2[best]) ** 2).sum() / count**2
    square = parts[0] + parts[1] + parts[4] + _beyond_noise(parts[2], seen4)
    doubt2 = _BIAS_DOUBT * math.sqrt(expected4) + (taken - taken_surely) * float(shrunk2[best].mean())
    chosen, by_rays, by_gathering = math.sqrt(square + doubt2), math.sqrt(parts[1]), math.sqrt(parts[4])
    texel_gathered2 = None
    if gathered:
        light, is_told = gathered.light, gathered.told
        texel_gathered2 = partial(of_texels, lambda rows: light.variance_at(rows) * is_told[rows, None])
    return StatedError(math.sqrt(square), chosen, by_rays, correction, texel_direct2, by_gathering, texel_gathered2)


def _beyond_noise(value: float, variance: float) -> float:
    """What is sure of a number that cannot be negative: below zero it is noise, which must not hide other noise, and the more so above.

    Source: James & Stein 1961, the positive part
    """
    return max(value - variance / value, 0.0) if value > 0.0 else 0.0


def list_told(tree: Quadtree, nodes: IntArray, blender: LeafBlender) -> NDArray[np.int64]:
    """(m,) int64: the nodes whose functions state_error asks for, the leaves `nodes` among them."""
    return np.concatenate([nodes, _find_judges(tree, nodes, blender)])


def _find_judges(tree: Quadtree, nodes: IntArray, blender: LeafBlender) -> NDArray[np.int32]:
    """(m,) int32: the node that judges the light at each texel of the sample: a child of its leaf of `nodes`, where that has any.

    What the fewer photons of nodes deeper down tell drowns in noise, tens of times the variance of a leaf's own.
    """
    opened = np.zeros(len(tree), bool)
    opened[nodes] = tree.has_children[nodes]
    judges = refine.open_nodes(tree, nodes, opened)
    judges = judges[np.argsort(tree.start[judges])]  # they tile the charts
    place = np.searchsorted(tree.start[judges], _choose_sample(blender.texels), side="right") - 1
    judge: NDArray[np.int32] = judges[place].astype(np.int32)
    return judge


def _parts(count: int) -> Iterator[slice]:
    return (slice(start, min(start + _CHUNK, count)) for start in range(0, count, _CHUNK))


def _find_dark(tree: Quadtree, nodes: IntArray, node_light: NDArray[np.float32], direct: ShownDirect) -> np.float32:
    """Square of the brightness below which a texel is judged as if it had that; arguments as in state_error."""
    by_photons = (np.maximum(node_light[nodes], 0.0).sum(axis=1, dtype=np.float64) * (tree.end - tree.start)[nodes]).sum()
    return np.float32(DARK_FLOOR * (float(by_photons) + direct.sum_light()) / max(direct.found.size, 1)) ** 2


def _weigh(light: NDArray[np.float32], dark2: np.float32) -> NDArray[np.float32]:
    """What makes a squared error relative: light (m, 3) W/m^2, out (m, 3)."""
    scale2 = np.maximum(light, 0.0) ** 2 + dark2
    return np.divide(np.float32(1.0), scale2, out=np.zeros_like(scale2), where=scale2 > 0.0)


def _choose_sample(texels: TexelMap) -> NDArray[np.int64]:
    """(m,) int64, ascending: shown texels with covered centres, or all if there are none; spread without a rhythm that rows could share."""
    middle = texels.shown & texels.is_central
    parts = list(_parts(len(middle)))
    count = np.array([np.count_nonzero(middle[part]) for part in parts], np.int64)
    total = int(count.sum())
    if not total:
        return np.arange(len(middle))
    if total <= _SAMPLE:
        return np.flatnonzero(middle)
    place = ((np.arange(_SAMPLE) + (np.arange(_SAMPLE) * _GOLDEN) % 1.0) * (total / _SAMPLE)).astype(np.int64)
    ends = np.searchsorted(place, np.append(0, np.cumsum(count)))
    found = [
        part.start + np.flatnonzero(middle[part])[place[first:last] - place_before]
        for part, first, last, place_before in zip(parts, ends[:-1], ends[1:], np.cumsum(count) - count, strict=True)
    ]
    return np.concatenate(found)


def _missing_from_blend(
    tree: Quadtree,
    solution: Solution,
    leaf: NDArray[np.int32],
    judge: NDArray[np.int32],
    sample: NDArray[np.int64],
    blender: LeafBlender,
    shown: PointLight,
    correction: NDArray[np.float64],
    weight: NDArray[np.float32],
    blind2: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Squared relative difference between the blend and the nodes that judge it, at the texels `sample`, (m,) float64 thrice.

    judge    (m,) int32, of _find_judges
    weight   (m, 3), as is blind2

    The first is a product of what each half says alone, whose noise is independent, and so right in sum. The second is how far that
    is from zero, noise and all: who leaves out the worst by it leaves out as much noise below zero as above. Without nodes below,
    `blind2` (m,) stands for all. The third is a standard error of the first, by which all texels of a judge
    are off together.
    """
    unbiased = blind2.copy()
    seen = np.maximum(unbiased, 0.0)
    noise = np.abs(blind2)
    told = np.flatnonzero(judge != leaf[sample])
    entry = sample[told]
    x, y = blender.texels.own_points_at(entry)
    below = evaluate_leaf(tree, solution, judge[told], x, y, halves=True)
    halves = shown.irradiance[..., told]
    gap = np.where(halves.sum(0) > 0.0, halves, 0.0) - below.irradiance  # what dips below zero is shown as dark
    unbiased[told] = (weight[told].T * gap[0] * gap[1]).mean(0)
    group, count = np.unique(judge[told], return_inverse=True, return_counts=True)[1:]
    seen[told] = np.abs(np.bincount(group, unbiased[told]) / count)[group]
    # Either half has twice the variance of both; over a node a product has as many independent parts as the node has functions.
    # A mean that weighs its parts well shares as much of each one's noise as it has itself, so that this is not seen between them.
    noise2 = np.maximum(below.variance - shown.variance[:, told], 0.0) * correction[:, None]
    of_half = 2.0 * (weight[told].T * noise2).mean(0)
    noise[told] = of_half / np.sqrt(np.maximum(tree.rank[judge[told]], 1))
    return unbiased, seen, noise


def missing_light(
    tree: Quadtree, totals: Totals, solution: Solution, comparison: refine.Comparison, nodes: IntArray
) -> NDArray[np.float64]:
    """(n,) float64, (W/m^2)^2: mean square a channel of light that `nodes` cannot hold, 0 elsewhere; noise can make it negative."""
    missing = np.zeros(len(tree))
    # Photons spread more evenly than chance would spread them: less noise than their number tells, which would hide a bias.
    common = comparison.differences[0].common / 3.0
    parents = nodes[tree.has_children[nodes] & (totals.shot[nodes] > 0)]
    missing[parents] = common[comparison.rows[0][parents]]
    blind = nodes[~tree.has_children[nodes] & (tree.side[nodes] > 1) & (tree.parent[nodes] >= 0)]
    # No previews yet: what their parents could not hold tells, and dark ones have less of it.
    parent = tree.parent[blind]
    light2, parent2 = (((solution.flux[:, ids] / np.maximum(tree.area[ids], _TINY)) ** 2).sum(0) for ids in (blind, parent))
    share = np.divide(light2, parent2, out=np.zeros(len(blind)), where=parent2 > 0.0)
    missing[blind] = BIAS_DECAY * np.minimum(share, 1.0) * np.maximum(common[comparison.rows[0][parent]], 0.0)
    return missing
