"""The stated error: how far the bake is likely to be from the converged light, told from the bake itself.

Three parts: noise of each leaf from the squared powers of its photons, corrected by how the two halves of the bake differ, and on
small leaves by what smoothing takes off; light that the leaves cannot hold (missing_light); and the noise of direct light by shadow rays.
The error of a bake is relative to local brightness, so that dark corners count as the eye counts them.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from . import missing_light, photon_noise, refine
from .all_light import AllLight
from .denoise import GRAIN_LEFT, SMALL_LEAF
from .direct_shown import ShownDirect, ShownGathered
from .error_terms import RayNoise, Terms, find_root, judge_rays_alone
from .judged import Judged, Parts
from .neighbours import Neighbours
from .photon_noise import PhotonNoise
from .quadtree import Quadtree
from .reconstruct import Blend
from .scene import IntArray
from .squares import SquareLight, ToldBySquares
from .tally import Solution, Totals
from .texel_map import TexelMap


@dataclass(frozen=True)
class StatedError:
    """What the bake says of itself, relative to local brightness; of several parts that are judged, what it says of the worst.

    relative      error of the whole: root mean square over the best texels and over channels; nan before any photon
    chosen        the same for whoever stops at this round because it is small, and so picks one that came out small by chance: a standard
                  error of what leaves miss is held against it
    direct        the part of it that is noise of direct light by rays, which no photon makes less
    photons       the part of it that is photons' noise
    correction    of photon_noise.noise_correction
    texel_direct2 gives (n,) float32: the squared part of direct light by rays at each texel, 0 of those that are not judged
    gathered, texel_gathered2   as direct and texel_direct2, of gathered light; None where there is none
    indirect      mean share of a texel's light that photons bring
    neighbours    of the nodes, for who shows them; None before any photon
    parts         what was judged as one
    of_parts      (p,) float64: `chosen` of each, `direct` where there is no photon
    of_objects    gives `relative`, or `direct`, of each object by its index, beside its own brightness; without those with few texels
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
    parts: Parts = field(default_factory=lambda: Parts.whole(0, 0.0))
    of_parts: NDArray[np.float64] = field(default_factory=lambda: np.zeros(1))
    of_objects: Callable[[], dict[int, float]] = dict


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
    judged: Judged | None = None,
    photon_w: NDArray[np.float64] | None = None,
) -> StatedError:
    """Error of the light on the `nodes`, which tile the charts, as it is shown, and of direct light by rays, 0 without.

    smooth_grain   whether it is shown with its grain smoothed
    gathered       light that is shown in place of the nodes'
    risk           (m,) float64 of each of `nodes`, of shrinkage.shrink_leaves; None where they are not shrunk
    squares        that the nodes' light is shown mixed with; None for none
    judged         what is asked; None is the whole
    photon_w       (3,), W, that a photon carries: where none fell it is told by that of objects what may be missing; None is nothing
    """
    judged = judged or Judged.whole(texels)
    correction = photon_noise.noise_correction(tree, solution, nodes)
    all_light = AllLight.of(tree, solution, nodes, shown_direct, judged)
    parts, sample, light = all_light.parts, judged.entry, all_light.at(judged.entry)
    texel_direct2 = partial(all_light.relate_all, shown_direct.variance_at)
    direct2 = all_light.relate(shown_direct.variance_at, sample)
    if not totals.photons.sum() or not len(sample):
        of_parts = np.array([find_root(direct2[rows]) for rows in parts.rows])
        of_objects = partial(judged.judge_objects, partial(judge_rays_alone, light, all_light, direct2, sample))
        return StatedError(
            math.nan,
            math.nan,
            float(of_parts.max()),
            math.nan,
            correction,
            texel_direct2,
            parts=parts,
            of_parts=of_parts,
            of_objects=of_objects,
        )
    # What is shown are blended leaves, which err less than leaves do: asked of so many texels that the mean is sure.
    blend = Blend.of(texels, tree, solution, all_light.leaf, halves=True)
    alone, shown = blend.compare_at(sample)
    weight = all_light.weigh(sample)
    x, y = texels.own_points_at(sample)
    asked = missing_light.AskedLight(all_light.leaf[sample], x, y, shown, weight)
    noise = PhotonNoise.of(solution, asked, alone.variance, correction, nodes, risk)
    unseen2 = photon_noise.find_unseen(judged, weight, np.zeros(3) if photon_w is None else photon_w)
    if smooth_grain:
        noise.keep(GRAIN_LEFT, np.flatnonzero(tree.side[asked.leaf] <= SMALL_LEAF))
    if squares and len(texels.borders.entry):  # over which light is brought before it is mixed: here it is not, and would seem to be wrong
        squares = squares.only(np.flatnonzero(~texels.borders.crossed[squares.entry]))
    if squares and squares.tell_much():
        mixed, kept2, added = _mix_squares(blend, squares, texels, sample)
        noise.keep(kept2, mixed)
        noise.photons2[mixed] += (weight[mixed].T * added).mean(0)
    bias = missing_light.find_bias(tree, solution, comparison, nodes, sample, asked, correction)
    direct = RayNoise(shown_direct.tell_smoothing(sample), np.ones(len(sample), bool), direct2)
    by_gathering, texel_gathered2 = None, None
    if gathered:
        shown_gathered, is_told, told = gathered.light, gathered.told, gathered.told[sample]
        noise2 = (weight * shown_gathered.variance_at(sample)).mean(1)
        by_gathering = RayNoise(shown_gathered.tell_smoothing(sample), told, np.where(told, noise2, np.float64(0.0)))
        noise.replace((weight.mean(1) * gathered.doubt2[sample])[told] + gathered.carried2, told)
        bias, unseen2[told] = bias.without(told), 0.0
        texel_gathered2 = partial(all_light.relate_all, lambda rows: shown_gathered.variance_at(rows) * is_told[rows, None])
    indirect = np.maximum(all_light.node_light[asked.leaf], 0.0) * np.sqrt(weight)
    terms = Terms(light, all_light.dark, weight, noise, unseen2, bias, direct, by_gathering, indirect)
    sums = [terms.sum_up(rows, unseen=parts.of_entry is not None) for rows in parts.rows]
    worst = max(sums, key=lambda one: one.chosen)
    return StatedError(
        relative=worst.relative,
        chosen=worst.chosen,
        direct=math.sqrt(worst.direct2),
        photons=math.sqrt(max(worst.photons2, 0.0)),
        correction=correction,
        texel_direct2=texel_direct2,
        parts=parts,
        of_parts=np.array([one.chosen for one in sums]),
        of_objects=partial(judged.judge_objects, terms.judge_alone),
        gathered=math.sqrt(worst.gathered2),
        texel_gathered2=texel_gathered2,
        indirect=worst.indirect,
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


def list_told(tree: Quadtree, nodes: IntArray, judged: Judged) -> NDArray[np.int64]:
    """(m,) int64: the nodes whose functions state_error asks for, the leaves `nodes` among them."""
    return np.concatenate([nodes, missing_light.find_judges(tree, nodes, judged.entry)])
