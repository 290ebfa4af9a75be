"""Contribution of photons' deposits to the squared error of a bake, which guides the emission of the next round.

The error is relative, so the variance that a photon adds to a texel is divided by the texel's squared brightness.

Source: Vorba & Křivánek 2016, "Adjoint-driven Russian roulette and splitting in light transport simulation".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..texels.error_metric import DARK_FLOOR, Parts
from ..transport.emission_cells import BirthCells
from ..transport.photon_log import Groups
from ..util.arrays import Float64, FloatArray, IntArray
from .quadtree import Quadtree

_GRAIN = 4  # texels: the filter averages the noise of nodes of a shorter side over this width, see denoise
_TINY = float(np.finfo(float).tiny)


@dataclass(frozen=True)
class Guiding:
    """Guide of a round's photons.

    worth    (3, n_node) float64, 1/W^2: squared error of the bake, relative to local brightness, per squared watt that a photon deposits
             in a deepest node
    cells    cells of emission
    """

    worth: Float64
    cells: BirthCells


def weigh_groups(groups: Groups, worth: Float64, node: IntArray, flux: FloatArray) -> Float64:
    """(g,) float64: contributions of groups to the squared error, the sums of worth * flux^2 over their deposits (m,).

    worth   as in Guiding
    node    (m,) int
    flux    (3, m) float, W
    """
    each = np.zeros(len(node))
    for of_channel, power in zip(worth, flux, strict=True):
        noise = of_channel.take(node, mode="wrap")
        noise *= np.square(power, dtype=np.float64)
        each += noise
    return np.bincount(groups.owner, each, len(groups.place)).astype(np.float64)


def weigh_deposits(
    tree: Quadtree, leaves: IntArray, light: FloatArray, deposits: int, weighed: tuple[Parts, Float64] | None = None
) -> Float64:
    """Guiding.worth (3, n) of the nodes at and below the leaves, up to a factor.

    leaves     (m,) int: nodes that tile the charts
    light      (3, n') float, W/m^2: total irradiance of the leaves and their ancestors, among the first n' nodes
    deposits   number so far; it limits the worth of nodes so small that less than one deposit is expected
    weighed    groups of texels with their own errors, and their weights (p,), see error_metric.Parts; None for the whole
    """
    area = tree.area
    cut = np.array(leaves)
    while len(small := np.flatnonzero((tree.side[cut] < _GRAIN) & (tree.depth[cut] > 0))):
        cut[small] = tree.parent[cut[small]]
    cut = np.unique(cut)
    count = tree.end[cut] - tree.start[cut]
    shown = np.maximum(light[:, cut], 0.0)
    dark2: FloatArray | float = (DARK_FLOOR * float((shown * count).sum()) / max(3 * int(count.sum()), 1)) ** 2
    worth_of_each: Float64 | float = 1.0
    if weighed and weighed[0].of_entry is not None:
        (parts, part_weight), first = weighed, tree.start[cut]
        dark2, worth_of_each = parts.find_dark2(first)[:, 0], parts.spread(part_weight, first, 0.0)
    least_area = float(area[cut].sum()) / max(deposits, 1)
    worth = np.zeros((3, len(tree)))
    worth[:, cut] = worth_of_each * count / (np.maximum(shown**2 + dark2, _TINY) * (area[cut] ** 2 + least_area**2))
    is_set = np.zeros(len(tree), bool)
    is_set[cut] = True
    for level in tree.levels[1:]:
        below = level[is_set[tree.parent[level]] & ~is_set[level]]
        worth[:, below] = worth[:, tree.parent[below]]
        is_set[below] = True
    return worth
