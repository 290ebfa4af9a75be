"""The stated error: how far the bake is likely to be from the converged light, told from the bake itself.

Three parts: noise of each leaf from the squared powers of its photons, corrected by how the two halves of the bake differ, and on
small leaves by what smoothing takes off; light that the leaves cannot hold (missing_light); and the noise of direct light by shadow rays.
The error of a bake is relative to local brightness, so that dark corners count as the eye counts them.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from . import missing_light, refine, shrinkage
from .denoise import GRAIN_LEFT, SMALL_LEAF
from .direct_shown import ShownDirect, ShownGathered
from .neighbours import Neighbours
from .quadtree import Quadtree, node_of_texel
from .reconstruct import Blend
from .scene import IntArray
from .squares import SquareLight, ToldBySquares
from .tally import Solution, Totals
from .texel_map import TexelMap

# Brightness below this share of the mean is judged against that share: else one black texel would decide the whole.
DARK_FLOOR = 0.1
# Texels whose centre lies outside of the chart are left out too: little of them is seen, and no other baker has light there.
# The worst texels are left out: on a hard edge of light, whether a texel is its centre or its mean decides its error.
BEST_TEXELS = 0.99
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
    chosen        the same for whoever stops at this round because it is small, and so picks one that came out small by chance: a standard
                  error of what leaves miss is held against it
    direct        the part of it that is noise of direct light by rays, which no photon makes less
    photons       the part of it that is photons' noise
    correction    of noise_correction
    texel_direct2 gives (n,) float32: the squared part of direct light by rays at each texel
    gathered, texel_gathered2   as direct and texel_direct2, of gathered light; None where there is none
    indirect      mean share of a texel's light that photons bring
    neighbours    of the nodes, for who shows them; None before any photon
    """

    relative: float
    chosen: float
    direct: float
    photons: float
    correction: NDArray[np.float64]
    texel_direct2: Callable[[], NDArray[np.float32]]
    gathered: float = 0.0
    texel_gathered2: Callable[[], NDArray[np.float32]] | None = None
    indirect: float = 1.0
    neighbours: Neighbours | None = None


def state_error(
    tree: Quadtree,
    totals: Totals,
    solution: Solution,
    comparison: refine.Comparison,
    nodes: IntArray,
    shown_direct: ShownDirect,
    texels: TexelMap,
    smooth_grain: bool = True,
    gathered: ShownGathered | None = None,
    risk: NDArray[np.float64] | None = None,
    squares: SquareLight | None = None,
) -> StatedError:
    """Error of the light on the `nodes`, which tile the charts, as it is shown, and of direct light by rays, 0 without.

    smooth_grain   whether it is shown with its grain smoothed
    gathered       light that is shown in place of the nodes'
    risk           (m,) float64 of each of `nodes`, of shrinkage.shrink_leaves; None where they are not shrunk
    squares        that the nodes' light is shown mixed with; None for none
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

    sample = _choose_sample(texels)
    count = int(np.ceil(BEST_TEXELS * len(sample)))
    direct2 = relative2_at(shown_direct.variance_at, sample)
    texel_direct2 = partial(of_texels, shown_direct.variance_at)
    if not totals.photons.sum() or not count:
        by_rays = math.sqrt(np.sort(direct2)[:count].sum() / max(count, 1))
        return StatedError(math.nan, math.nan, by_rays, math.nan, correction, texel_direct2)
    # What is shown are blended leaves, which err less than leaves do: asked of so many texels that the mean is sure.
    blend = Blend.of(texels, tree, solution, leaf, halves=True)
    alone, shown = blend.compare_at(sample)
    weight = _weigh(node_light[leaf[sample]] + shown_direct.irradiance_at(sample), dark2)
    x, y = texels.own_points_at(sample)
    asked = missing_light.AskedLight(leaf[sample], x, y, shown, weight)
    photons2 = (weight.T * shown.variance * correction[:, None]).mean(0)
    shrunk2, taken, taken_surely = np.zeros(len(sample)), 0.0, 0.0
    if risk is not None:
        shrunk2 = shrinkage.find_shrunk_noise(solution, asked.leaf, alone.variance, photons2)
        taken, taken_surely = shrinkage.find_share_taken(asked.leaf, shrunk2, nodes, risk)
    photons2 -= taken * shrunk2
    if smooth_grain:
        left = np.where(tree.side[asked.leaf] <= SMALL_LEAF, GRAIN_LEFT, 1.0)
        photons2, shrunk2 = photons2 * left, shrunk2 * left
    if squares and len(texels.borders.entry):  # over which light is brought before it is mixed: here it is not, and would seem to be wrong
        squares = squares.only(np.flatnonzero(~texels.borders.crossed[squares.entry]))
    if squares and squares.tell_much():
        mixed, kept2, added = _mix_squares(blend, squares, texels, sample)
        photons2[mixed] = kept2 * photons2[mixed] + (weight[mixed].T * added).mean(0)
        shrunk2[mixed] *= kept2
    bias = missing_light.find_bias(tree, solution, comparison, nodes, sample, asked, correction)
    blur2 = (weight * shown_direct.blur2_at(sample)).mean(1)
    gathered2, gathered_blur2 = np.zeros((2, len(sample)))
    if gathered:
        told = gathered.told[sample]
        gathered2[told] = (weight * gathered.light.variance_at(sample)).mean(1)[told]
        gathered_blur2[told] = (weight * gathered.light.blur2_at(sample)).mean(1)[told]
        photons2[told] = (weight.mean(1) * gathered.doubt2[sample])[told] + gathered.carried2
        shrunk2[told] = 0.0
        bias = bias.without(told)
    likely = photons2 + direct2 + bias.gap + gathered2
    best = np.argpartition(likely, count - 1)[:count]
    _leave_noise(shown_direct, sample, best, weight, direct2)
    if gathered:
        _leave_noise(gathered.light, sample, best[told[best]], weight, gathered2)
    every = (photons2, direct2, blur2, gathered2, gathered_blur2)
    by_photons2, by_rays2, blurred2, by_gathering2, gather_blurred2 = (float(part[best].mean(dtype=np.float64)) for part in every)
    by_rays2 += max(blurred2, 0.0)
    by_gathering2 += max(gather_blurred2, 0.0)
    missing2, doubt2 = bias.sum_up(best)
    square = by_photons2 + by_rays2 + by_gathering2 + missing2
    doubt2 += (taken - taken_surely) * float(shrunk2[best].mean())
    relative, chosen = math.sqrt(square), math.sqrt(square + doubt2)
    by_rays, by_photons, by_gathering = math.sqrt(by_rays2), math.sqrt(max(by_photons2, 0.0)), math.sqrt(by_gathering2)
    texel_gathered2 = None
    if gathered:
        light, is_told = gathered.light, gathered.told
        texel_gathered2 = partial(of_texels, lambda rows: light.variance_at(rows) * is_told[rows, None])
    return StatedError(
        relative=relative,
        chosen=chosen,
        direct=by_rays,
        photons=by_photons,
        correction=correction,
        texel_direct2=texel_direct2,
        gathered=by_gathering,
        texel_gathered2=texel_gathered2,
        indirect=float((np.maximum(node_light[leaf[sample]], 0.0) * np.sqrt(weight)).mean(dtype=np.float64)),
        neighbours=blend.neighbours,
    )


def _mix_squares(
    blend: Blend, squares: SquareLight, texels: TexelMap, sample: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Which of the texels `sample` are shown mixed with squares, (k,); the share of their squared noise that is left, (k,), and what is
    added, (3, k), (W/m^2)^2.
    """
    shown = dataclasses.replace(blend, halves=False).at(squares.entry).irradiance
    told = ToldBySquares.of(np.maximum(shown, 0.0), squares, texels)
    row = np.minimum(np.searchsorted(squares.entry, sample), len(squares.entry) - 1)
    mixed = np.flatnonzero((squares.entry[row] == sample) & (told.share[row] > 0.0))
    row = row[mixed]
    return mixed, (1.0 - told.share[row]) ** 2, told.find_error(row)


def _leave_noise(
    shown: ShownDirect, sample: NDArray[np.int64], best: NDArray[np.int64], weight: NDArray[np.float32], noise2: NDArray[Any]
) -> None:
    """Takes off the relative noise (m,) of texels `sample` (m,) what smoothing found not to be there, in place.

    best     (k,): which of the sample are asked
    weight   (m, 3) of _weigh
    """
    noise2[shown.is_smoothed(sample)] *= shown.find_noise_share(sample[best], weight[best])


def list_told(tree: Quadtree, nodes: IntArray, texels: TexelMap) -> NDArray[np.int64]:
    """(m,) int64: the nodes whose functions state_error asks for, the leaves `nodes` among them."""
    return np.concatenate([nodes, missing_light.find_judges(tree, nodes, _choose_sample(texels))])


def _parts(count: int) -> Iterator[slice]:
    return (slice(start, min(start + _CHUNK, count)) for start in range(0, count, _CHUNK))


def _find_dark(tree: Quadtree, nodes: IntArray, node_light: NDArray[np.float32], direct: ShownDirect) -> np.float32:
    """Square of the brightness below which a texel is judged as if it had that; arguments as in state_error."""
    by_photons = (np.maximum(node_light[nodes], 0.0).sum(axis=1, dtype=np.float64) * (tree.end - tree.start)[nodes]).sum()
    return np.float32(DARK_FLOOR * (float(by_photons) + direct.total_light) / max(direct.found.size, 1)) ** 2


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
