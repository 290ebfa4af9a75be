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

from . import missing_light, photon_noise, refine
from .denoise import GRAIN_LEFT, SMALL_LEAF
from .direct_shown import ShownDirect, ShownGathered
from .neighbours import Neighbours
from .photon_noise import PhotonNoise
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
_TINY = float(np.finfo(float).tiny)
# Variances (k, 3) float32, (W/m^2)^2, of some texel entries (k,).
_VarianceAt: TypeAlias = Callable[[NDArray[np.int64]], NDArray[np.float32]]


@dataclass(frozen=True)
class StatedError:
    """What the bake says of itself, relative to local brightness.

    relative      error of the whole: root mean square over the best texels and over channels; nan before any photon
    chosen        the same for whoever stops at this round because it is small, and so picks one that came out small by chance: a standard
                  error of what leaves miss is held against it
    direct        the part of it that is noise of direct light by rays, which no photon makes less
    photons       the part of it that is photons' noise
    correction    of photon_noise.noise_correction
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
    correction = photon_noise.noise_correction(tree, solution, nodes)
    all_light = _AllLight.of(tree, solution, nodes, shown_direct)
    sample = _choose_sample(texels)
    count = int(np.ceil(BEST_TEXELS * len(sample)))
    texel_direct2 = partial(all_light.relate_all, shown_direct.variance_at)
    direct2 = all_light.relate(shown_direct.variance_at, sample)
    if not totals.photons.sum() or not count:
        by_rays = math.sqrt(np.sort(direct2)[:count].sum() / max(count, 1))
        return StatedError(math.nan, math.nan, by_rays, math.nan, correction, texel_direct2)
    # What is shown are blended leaves, which err less than leaves do: asked of so many texels that the mean is sure.
    blend = Blend.of(texels, tree, solution, all_light.leaf, halves=True)
    alone, shown = blend.compare_at(sample)
    weight = all_light.weigh(sample)
    x, y = texels.own_points_at(sample)
    asked = missing_light.AskedLight(all_light.leaf[sample], x, y, shown, weight)
    noise = PhotonNoise.of(solution, asked, alone.variance, correction, nodes, risk)
    if smooth_grain:
        noise.keep(GRAIN_LEFT, np.flatnonzero(tree.side[asked.leaf] <= SMALL_LEAF))
    if squares and len(texels.borders.entry):  # over which light is brought before it is mixed: here it is not, and would seem to be wrong
        squares = squares.only(np.flatnonzero(~texels.borders.crossed[squares.entry]))
    if squares and squares.tell_much():
        mixed, kept2, added = _mix_squares(blend, squares, texels, sample)
        noise.keep(kept2, mixed)
        noise.photons2[mixed] += (weight[mixed].T * added).mean(0)
    bias = missing_light.find_bias(tree, solution, comparison, nodes, sample, asked, correction)
    gathered2, told = np.zeros(len(sample)), np.zeros(len(sample), bool)
    if gathered:
        told = gathered.told[sample]
        gathered2[told] = (weight * gathered.light.variance_at(sample)).mean(1)[told]
        noise.replace((weight.mean(1) * gathered.doubt2[sample])[told] + gathered.carried2, told)
        bias = bias.without(told)
    likely = noise.photons2 + direct2 + bias.gap + gathered2
    best = np.argpartition(likely, count - 1)[:count]
    by_rays2 = _sum_up_rays(shown_direct, sample, best, np.ones(len(sample), bool), weight, direct2)
    by_gathering2 = _sum_up_rays(gathered.light, sample, best, told, weight, gathered2) if gathered else 0.0
    by_photons2, missing2, missing_doubt2 = _mean(noise.photons2[best]), *bias.sum_up(best)
    square = by_photons2 + by_rays2 + by_gathering2 + missing2
    texel_gathered2 = None
    if gathered:
        light, is_told = gathered.light, gathered.told
        texel_gathered2 = partial(all_light.relate_all, lambda rows: light.variance_at(rows) * is_told[rows, None])
    return StatedError(
        relative=math.sqrt(square),
        chosen=math.sqrt(square + missing_doubt2 + noise.find_doubt2(best)),
        direct=math.sqrt(by_rays2),
        photons=math.sqrt(max(by_photons2, 0.0)),
        correction=correction,
        texel_direct2=texel_direct2,
        gathered=math.sqrt(by_gathering2),
        texel_gathered2=texel_gathered2,
        indirect=_mean(np.maximum(all_light.node_light[asked.leaf], 0.0) * np.sqrt(weight)),
        neighbours=blend.neighbours,
    )


@dataclass(frozen=True)
class _AllLight:
    """All light that texels are shown with, by which errors are made relative.

    leaf         (n,) int32: the node of each texel entry
    node_light   (n_node, 3) float32, W/m^2
    direct       by rays
    dark2        square of the brightness below which a texel is judged as if it had that
    """

    leaf: NDArray[np.int32]
    node_light: NDArray[np.float32]
    direct: ShownDirect
    dark2: np.float32

    @classmethod
    def of(cls, tree: Quadtree, solution: Solution, nodes: IntArray, direct: ShownDirect) -> _AllLight:
        node_light = np.ascontiguousarray((solution.flux / np.maximum(tree.area, _TINY)).astype(np.float32).T)
        by_photons = (np.maximum(node_light[nodes], 0.0).sum(axis=1, dtype=np.float64) * (tree.end - tree.start)[nodes]).sum()
        dark2 = np.float32(DARK_FLOOR * (float(by_photons) + direct.total_light) / max(direct.found.size, 1)) ** 2
        return cls(node_of_texel(tree, nodes, len(direct)), node_light, direct, dark2)

    def weigh(self, rows: NDArray[np.int64]) -> NDArray[np.float32]:
        """(k, 3) float32: what makes squared errors at texel entries (k,) relative."""
        light = self.node_light[self.leaf[rows]] + self.direct.irradiance_at(rows)
        scale2 = np.maximum(light, 0.0) ** 2 + self.dark2
        weight: NDArray[np.float32] = np.divide(np.float32(1.0), scale2, out=np.zeros_like(scale2), where=scale2 > 0.0)
        return weight

    def relate(self, variance_at: _VarianceAt, rows: NDArray[np.int64]) -> NDArray[np.float32]:
        """(k,) float32: variances at texel entries (k,), relative to the light there; mean of channels."""
        found: NDArray[np.float32] = (self.weigh(rows) * variance_at(rows)).mean(1)
        return found

    def relate_all(self, variance_at: _VarianceAt) -> NDArray[np.float32]:
        """The same at all texel entries."""
        parts = (np.arange(part.start, part.stop) for part in _parts(len(self.leaf)))
        return np.concatenate([np.zeros(0, np.float32), *(self.relate(variance_at, part) for part in parts)])


def _sum_up_rays(
    shown: ShownDirect,
    sample: NDArray[np.int64],
    best: NDArray[np.int64],
    told: NDArray[np.bool_],
    weight: NDArray[np.float32],
    noise2: NDArray[np.floating[Any]],
) -> float:
    """Mean, over the texels `best` of `sample` (m,), of what rays err by, relative and squared: their noise, and what smoothing blurs.

    told     (m,) bool: where the light is theirs
    weight   (m, 3) of _AllLight.weigh
    noise2   (m,): as rays tell it; what smoothing found not to be there is taken off, in place
    """
    asked = best[told[best]]
    noise2[shown.is_smoothed(sample)] *= shown.find_noise_share(sample[asked], weight[asked])
    blur2 = np.where(told, (weight * shown.blur2_at(sample)).mean(1), 0.0)
    return _mean(noise2[best]) + max(_mean(blur2[best]), 0.0)


def _mean(values: NDArray[np.floating[Any]]) -> float:
    return float(values.mean(dtype=np.float64))


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


def list_told(tree: Quadtree, nodes: IntArray, texels: TexelMap) -> NDArray[np.int64]:
    """(m,) int64: the nodes whose functions state_error asks for, the leaves `nodes` among them."""
    return np.concatenate([nodes, missing_light.find_judges(tree, nodes, _choose_sample(texels))])


def _parts(count: int) -> Iterator[slice]:
    return (slice(start, min(start + _CHUNK, count)) for start in range(0, count, _CHUNK))


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
