"""The stated error: an estimate of the bake's distance from the converged light, from the bake's own samples.

It has three parts: the variance of each leaf from the squared powers of its photons, corrected by the difference of the dual buffers and,
on small leaves, by the noise that the filter removes; the discretisation bias of the leaves (bias_estimate); and the variance of light by
rays. It is relative to local brightness, since the eye sees relative differences in dark corners too.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ..radiosity.spatial_shrinkage import SpatialShrinkage
from ..texels.error_metric import ErrorMetric, Parts, choose_lit
from ..texels.texel_map import TexelMap
from ..util.ablation import uses
from . import bias_estimate, variance_estimate
from .denoise import GRAIN_LEFT, SMALL_LEAF
from .error_terms import RayNoise, Terms, find_ray_error_alone
from .filtered_field import FilteredField, FilteredGather
from .neighbours import Neighbours
from .radiosity_solution import RadiositySolution
from .reconstruct import Blend
from .reference_light import ReferenceLight
from .subtexel_tally import SubtexelLight, SubtexelMix
from .variance_estimate import PhotonNoise


@dataclass(frozen=True)
class StatedError:
    """The stated error relative to local brightness; if there are several groups of texels, that of the worst.

    relative          root mean square over the best texels and over channels; nan before any photon
    chosen            the same with Sum.doubt2 added, for the stop rule: stopping at a small estimate selects one that is small by chance
    direct            its part from the variance of direct light by rays, which more photons do not reduce
    photons           its part from the photons' variance
    correction        from variance_estimate.noise_correction
    texel_direct2     returns (n,) float32: squared error of direct light by rays at each texel, 0 where no error is measured
    weigh             returns (k, 3) float32: factor that makes squared errors at texel entries (k,) relative, see ReferenceLight
    gathered, texel_gathered2   as direct and texel_direct2, for gathered light; None without
    indirect          mean share of photons in the light of a texel
    neighbours        neighbours of the nodes, for blending; None before any photon
    parts             groups of texels with one error each
    of_parts          (p,) float64: `chosen` of each group, `direct` without photons
    of_objects        returns `relative`, or `direct`, of each object by its index, relative to its own brightness; without objects of few
                      texels
    """

    relative: float
    chosen: float
    direct: float
    photons: float
    correction: NDArray[np.float64]
    texel_direct2: Callable[[], NDArray[np.float32]]
    weigh: Callable[[NDArray[np.int64]], NDArray[np.float32]]
    gathered: float = 0.0
    texel_gathered2: Callable[[], NDArray[np.float32]] | None = None
    indirect: float = 1.0
    neighbours: Neighbours | None = None
    parts: Parts = field(default_factory=lambda: Parts.whole(0, 0.0))
    of_parts: NDArray[np.float64] = field(default_factory=lambda: np.zeros(1))
    of_objects: Callable[[], dict[int, float]] = dict


def state_error(
    reading: RadiositySolution,
    shown_direct: FilteredField,
    texels: TexelMap,
    smooth_grain: bool = True,
    gathered: FilteredGather | None = None,
    metric: ErrorMetric | None = None,
    photon_w: NDArray[np.float64] | None = None,
    few: SpatialShrinkage | None = None,
) -> StatedError:
    """Error of the shown light: of leaves, of gathered light in their place, and of direct light by rays.

    smooth_grain   whether the leaves' light is shown filtered
    gathered       gathered light, if there is any
    metric         the sampled texels; None for a sample of all
    photon_w       (3,), W: power of one photon, which bounds the light that objects without photons may lack; None for 0
    few            leaves that are shrunk towards their surroundings
    """
    metric = metric or ErrorMetric.whole(texels)
    tree, solution, leaves, sample = reading.tree, reading.solution, reading.leaves, metric.entry
    correction = reading.correction
    all_light = ReferenceLight.of(tree, solution, leaves, shown_direct, metric, few)
    direct2 = all_light.relate(shown_direct.variance_at, sample)
    texel_direct2 = partial(all_light.relate_all, shown_direct.variance_at)
    rays = RayNoise(shown_direct.smoothing_at(sample), np.ones(len(sample), bool), direct2)
    if not reading.totals.photons.sum() or not len(sample):
        return _state_rays_alone(all_light, metric, rays, correction, texel_direct2)
    # The pages show blended leaves, which have less variance than single ones.
    blend = Blend.of(texels, tree, solution, all_light.leaf, halves=True)
    alone, shown = blend.compare_at(sample)
    x, y = texels.own_points_at(sample)
    asked = bias_estimate.AskedLight(all_light.leaf[sample], x, y, shown, all_light.weigh(sample))
    noise = PhotonNoise.of(solution, asked, alone.variance, correction, leaves, reading.risk)
    bias = bias_estimate.find_bias(tree, solution, reading.comparison, leaves, sample, asked, correction)
    if few:
        is_few, row = few.find(asked.leaf)
        noise.replace((asked.weight[is_few].T * few.variance[:, row]).mean(0), is_few)
        bias = bias.without(is_few)
    if smooth_grain and uses("leaf_filter"):
        noise.keep(GRAIN_LEFT, np.flatnonzero(tree.side[asked.leaf] <= SMALL_LEAF))
    if reading.squares:
        _mix_squares(noise, blend, reading.squares, texels, sample, asked.weight)
    terms = Terms(
        light=all_light.at(sample),
        dark=all_light.dark,
        weight=asked.weight,
        noise=noise,
        unseen2=variance_estimate.find_unseen(metric, asked.weight, np.zeros(3) if photon_w is None else photon_w),
        bias=bias,
        direct=rays,
        gathered=None,
        indirect=np.maximum(all_light.node_light[asked.leaf], 0.0) * np.sqrt(asked.weight),
    )
    texel_gathered2 = None
    if gathered:
        terms = terms.with_gathered(gathered, sample)
        texel_gathered2 = partial(all_light.relate_all, partial(_find_shown_variance, gathered))
    parts = all_light.parts
    sums = [terms.sum_up(rows, unseen=parts.of_entry is not None) for rows in parts.rows]
    worst = max(sums, key=lambda one: one.chosen)
    return StatedError(
        relative=worst.relative,
        chosen=worst.chosen,
        direct=math.sqrt(worst.direct2),
        photons=math.sqrt(max(worst.photons2, 0.0)),
        correction=correction,
        texel_direct2=texel_direct2,
        weigh=all_light.weigh,
        parts=parts,
        of_parts=np.array([one.chosen for one in sums]),
        of_objects=partial(metric.find_object_errors, terms.find_error_alone),
        gathered=math.sqrt(worst.gathered2),
        texel_gathered2=texel_gathered2,
        indirect=worst.indirect,
        neighbours=blend.neighbours,
    )


def _state_rays_alone(
    all_light: ReferenceLight,
    metric: ErrorMetric,
    rays: RayNoise,
    correction: NDArray[np.float64],
    texel_direct2: Callable[[], NDArray[np.float32]],
) -> StatedError:
    """As state_error without photons: only the error of direct light by rays at the sampled texels."""
    parts, light, weight = all_light.parts, all_light.at(metric.entry), all_light.weigh(metric.entry)
    of_parts = np.array([rays.find_error(weight, choose_lit(rows, light.any(axis=1))) for rows in parts.rows])
    return StatedError(
        relative=math.nan,
        chosen=math.nan,
        direct=float(of_parts.max()),
        photons=math.nan,
        correction=correction,
        texel_direct2=texel_direct2,
        weigh=all_light.weigh,
        parts=parts,
        of_parts=of_parts,
        of_objects=partial(metric.find_object_errors, partial(find_ray_error_alone, light, all_light.dark, weight, rays)),
    )


def _find_shown_variance(gathered: FilteredGather, rows: NDArray[np.int64]) -> NDArray[np.float32]:
    """(k, 3) float32, (W/m^2)^2: variance of gathered light at texel entries (k,), 0 where leaves are shown."""
    found: NDArray[np.float32] = gathered.light.variance_at(rows) * gathered.is_shown[rows, None]
    return found


def _mix_squares(
    noise: PhotonNoise, blend: Blend, squares: SubtexelLight, texels: TexelMap, sample: NDArray[np.int64], weight: NDArray[np.float32]
) -> None:
    """Change the noise at texels `sample` (m,) to that after mixing with squares, in place; weight (m, 3) from ReferenceLight.weigh."""
    if len(texels.borders.entry):  # pages move light over borders before mixing; here it is not moved, which would count as error
        squares = squares.only(np.flatnonzero(~texels.borders.crossed[squares.entry]))
    if not squares.are_reliable():
        return
    shown = dataclasses.replace(blend, halves=False).at(squares.entry).irradiance
    mix = SubtexelMix.of(np.maximum(shown, 0.0), squares, texels)
    row = np.minimum(np.searchsorted(squares.entry, sample), len(squares.entry) - 1)
    mixed = np.flatnonzero((squares.entry[row] == sample) & (mix.share[row] > 0.0))
    row = row[mixed]
    noise.keep((1.0 - mix.share[row]) ** 2, mixed)
    noise.photons2[mixed] += (weight[mixed].T * mix.find_error(row)).mean(0)
