"""The stated error: how far the bake is likely to be from the converged light, told from the bake itself.

Three parts: noise of each leaf from the squared powers of its photons, corrected by how the two halves of the bake differ;
light that the leaves cannot hold, from the previews below them; and the noise of direct light by shadow rays.
The error of a bake is relative to local brightness, so that dark corners count as the eye counts them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import refine
from .quadtree import Quadtree
from .scene import IntArray
from .tally import Solution, Totals

# Brightness below this share of the mean is judged against that share: else one black texel would decide the whole.
DARK_FLOOR = 0.1
# The worst texels are left out: on a hard edge of light, whether a texel is its centre or its mean decides its error.
BEST_TEXELS = 0.99
# Squared light that a node cannot hold, over what its parent could not: 1/2 along edges, 1/16 where light is smooth.
BIAS_DECAY = 0.25
# The halves of few leaves say little about noise; the prior says "as independent photons" with this many values' weight.
_PRIOR_VALUES = 64.0


def noise_correction(tree: Quadtree, solution: Solution, nodes: IntArray) -> float:
    """Variance seen between the halves of the bake over the variance that independent photons would have.

    nodes   (m,) int, nodes that tile the charts
    """
    area = np.maximum(tree.area[nodes], np.finfo(float).tiny)
    seen = ((solution.flux_half[0] - solution.flux_half[1])[:, nodes] / (2.0 * area)) ** 2
    predicted = solution.variance[:, nodes]
    told = predicted > 0.0
    ratio = seen[told] / predicted[told]
    # Photons of a leaf are few and their powers differ, so single ratios have long tails: weigh leaves by their light.
    weight = np.sqrt(np.maximum(solution.flux[:, nodes], 0.0))[told]
    if not weight.sum() > 0.0:
        return 1.0
    effective = weight.sum() ** 2 / (weight**2).sum()
    return float(((ratio * weight).sum() / weight.sum() * effective + _PRIOR_VALUES) / (effective + _PRIOR_VALUES))


@dataclass(frozen=True)
class StatedError:
    """What the bake says of itself.

    relative     error of the whole: root mean square over the best texels and channels, relative to local brightness
    correction   of noise_correction
    bias2        (n,) float64, (W/m^2)^2: mean square of light the nodes cannot hold, a channel; noise can
                 make one negative, their sum tells; 0 elsewhere
    """

    relative: float
    correction: float
    bias2: NDArray[np.float64]


def state_error(
    tree: Quadtree,
    totals: Totals,
    solution: Solution,
    comparison: refine.Comparison,
    nodes: IntArray,
    background: NDArray[np.float64],
    background_variance: NDArray[np.float64],
) -> StatedError:
    """Error of the light on the `nodes`, which tile the charts.

    background            (3, n) float64, W/m^2: mean direct light on each node by rays, 0 without
    background_variance   (3, n) float64, (W/m^2)^2: mean over the node of the variance of each texel's direct light
    """
    correction = noise_correction(tree, solution, nodes)
    bias2 = np.zeros(len(tree))
    parents = nodes[tree.has_children[nodes] & (totals.shot[nodes] > 0)]
    bias2[parents] = comparison.differences[0].excess[comparison.row[parents]] / 3.0
    blind = nodes[~tree.has_children[nodes] & (tree.side[nodes] > 1) & (tree.parent[nodes] >= 0)]
    above = np.maximum(comparison.differences[0].excess[comparison.row[tree.parent[blind]]], 0.0) / 3.0
    bias2[blind] = BIAS_DECAY * above  # no previews yet: what their parents could not hold tells
    area = np.maximum(tree.area[nodes], np.finfo(float).tiny)
    brightness = np.maximum(solution.flux[:, nodes] / area + background[:, nodes], 0.0)
    texels = (tree.end - tree.start)[nodes]
    mean = (brightness * texels).sum() / max(3.0 * texels.sum(), 1.0)
    noise2 = solution.variance[:, nodes] * tree.rank[nodes] * correction + background_variance[:, nodes]
    scale2 = brightness**2 + (DARK_FLOOR * mean) ** 2
    weight = np.divide(1.0, scale2, out=np.zeros_like(scale2), where=scale2 > 0.0)
    noise, bias = (noise2 * weight).mean(0), (bias2[nodes] * weight).mean(0)
    best = _best_share(np.maximum(noise + bias, 0.0), texels)
    # A bias is told only in sum, and a sum below zero is noise: it must not hide the noise that is there.
    square = (noise * best).sum() + max(float((bias * best).sum()), 0.0)
    relative = float(np.sqrt(square / max(best.sum(), 1.0)))
    return StatedError(relative if totals.photons.sum() else float("nan"), correction, bias2)


def _best_share(error: NDArray[np.float64], texels: NDArray[np.integer[Any]]) -> NDArray[np.float64]:
    """(m,) float64: how many texels of each node are among the BEST_TEXELS of all, by their error."""
    order = np.argsort(error, kind="stable")
    end = np.cumsum(texels[order])
    kept = np.empty(len(texels))
    kept[order] = np.clip(BEST_TEXELS * texels.sum() - (end - texels[order]), 0.0, texels[order])
    return kept
