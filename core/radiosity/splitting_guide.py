"""Adjoint-driven splitting: the number of photons into which a photon splits at its first hit.

The photons split at one place contribute variance downstream and cost rays. At equal cost the total variance is least if the number at a
place goes as sqrt(variance / cost). Most light of a sunlit house falls on its outside, and hardly any of it comes in; a lamp close to a
wall sends a room's light through a few texels of it.

A place is a deepest node of the trees, or an object whose surface has no lightmap. The estimates at a place are shrunk towards those of its
parent node, of the object, and of the scene.

Source: Neyman 1934, "On the two different aspects of the representative method" (optimal allocation); Vorba & Křivánek 2016,
"Adjoint-driven Russian roulette and splitting in light transport simulation".
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..texels.error_metric import DARK_FLOOR, Parts
from ..transport.emission_cells import BirthCells
from ..transport.photon_log import Groups
from ..util.arrays import FloatArray, IntArray
from .quadtree import Quadtree
from .tally import find_touched

Float64 = NDArray[np.float64]

# Bounds, relative to photons.SPLIT: at least one photon, so that unexpected light is still found; and few enough that the estimate does not
# depend on few points of emission.
LEAST_FACTOR, MOST_FACTOR = 1 / 8, 8.0
_PRIOR_GROUPS = 16.0  # weight of the parent's rates as a prior, in groups
_GRAIN = 4  # texels: the filter averages the noise of nodes of a shorter side over this width, see denoise
_STEPS = 8  # of a search whose result need not be exact
_LEAST_WORK = 0.05  # rays of a group
_TINY = float(np.finfo(float).tiny)


@dataclass(frozen=True)
class Splitting:
    """Splitting factors and guiding of a round.

    factor   (n_object + n_node,) float32: splitting factor relative to photons.SPLIT, on objects without a lightmap and in deepest nodes
    worth    (3, n_node) float64, 1/W^2: squared error of the bake, relative to local brightness, per squared watt that a photon deposits
             in a deepest node
    cells    emission cells of photons that start alone
    """

    factor: NDArray[np.float32]
    worth: Float64
    cells: BirthCells

    def find_places(self, node: IntArray, is_mapped: NDArray[np.bool_], thing: IntArray) -> NDArray[np.int32]:
        """(m,) int32, indices of `factor` for hits: the node (m,) where the surface has a lightmap, else the object (m,)."""
        n_object = len(self.factor) - self.worth.shape[1]
        return np.where(is_mapped, node + n_object, thing).astype(np.int32)


@dataclass(frozen=True)
class SplitTally:
    """Sums over the groups of a shard by place, normalized to a splitting into SPLIT photons everywhere.

    place    (k,) int64, ascending
    groups   (k,) float64
    rays     (k,) float64
    noise    (k,) float64: their contribution to the squared error
    """

    place: NDArray[np.int64]
    groups: Float64
    rays: Float64
    noise: Float64

    @classmethod
    def of(cls, groups: Groups, noise: Float64) -> SplitTally:
        """From groups and the contribution of each to the squared error, noise (g,)."""
        place, slot, _ = find_touched(groups.place, int(groups.place.max(initial=-1)) + 1)
        sums = np.empty((3, len(place)))
        for row, values in zip(sums, (None, groups.rays / groups.split, noise * groups.split), strict=True):
            row[:] = np.bincount(slot, values, len(place))
        return cls(place, *sums)


@dataclass
class SplitGuide:
    """Sums over all groups of a bake, each (n_object + n_node,) float64; places as in Splitting.factor.

    groups   number of groups
    rays     number of their rays
    noise    their squared error, relative to the mean per group of its round, since rounds differ in their leaves
    """

    groups: Float64
    rays: Float64
    noise: Float64

    @classmethod
    def empty(cls, n_place: int) -> SplitGuide:
        return cls(*np.zeros((3, n_place)))

    def grow(self, n_place: int) -> None:
        """Appends zeros for new nodes."""
        for name in ("groups", "rays", "noise"):
            sums = getattr(self, name)
            setattr(self, name, np.concatenate([sums, np.zeros(n_place - len(sums))]))

    def add_round(self, shards: Sequence[SplitTally]) -> None:
        """Adds the shards of one round."""
        groups, noise = (math.fsum(getattr(shard, name).sum() for shard in shards) for name in ("groups", "noise"))
        for shard in shards:
            self.groups[shard.place] += shard.groups
            self.rays[shard.place] += shard.rays
            self.noise[shard.place] += shard.noise * (groups / noise if noise > 0.0 else 0.0)

    def plan(self, tree: Quadtree, root_object: IntArray) -> tuple[NDArray[np.float32], float]:
        """Factors (n_object + n_node,) as in Splitting, and the weight of the round's photons: variance without over variance with them.

        root_object   (r,) int: the object of each root
        """
        if not self.noise.any():
            return np.ones(len(self.groups), np.float32), 1.0
        work, noise = self._know_rates(tree, root_object)
        wanted = np.sqrt(noise / np.maximum(work, _LEAST_WORK))
        met = np.flatnonzero(self.groups)
        number, work, noise = self.groups[met], work[met], noise[met]
        scale = 1.0 / max(float(wanted[met].max()), _TINY)
        all_work = float((number * work).sum())
        for _ in range(_STEPS):  # equal cost to SPLIT photons everywhere
            factor = np.clip(scale * wanted[met], LEAST_FACTOR, MOST_FACTOR)
            scale *= all_work / max(float((number * factor * work).sum()), _TINY)
        # If MOST_FACTOR bounded only the main sources of variance, the freed cost would go to places that hardly matter.
        scale = min(scale, MOST_FACTOR * float((number * noise).sum()) / max(float((number * noise * wanted[met]).sum()), _TINY))
        factor = np.clip(scale * wanted, LEAST_FACTOR, MOST_FACTOR)
        weight = float((number * noise).sum() / max(float((number * noise / factor[met]).sum()), _TINY))
        return factor.astype(np.float32), max(weight, 1.0)

    def _know_rates(self, tree: Quadtree, root_object: IntArray) -> tuple[Float64, Float64]:
        """Shrunk estimates of a group's rays and noise at each place, (n_object + n_node,) each."""
        n_object = len(self.groups) - len(tree)
        sums = np.stack([self.groups, self.rays, self.noise])
        for level in reversed(tree.levels[1:]):
            for row in sums:
                row += np.bincount(tree.parent[level] + n_object, row[level + n_object], len(row))
        roots = tree.levels[0] + n_object
        for row in sums:
            row[:n_object] += np.bincount(root_object, row[roots], n_object)
        mean = sums[1:, :n_object].sum(1)[:, None] / max(float(sums[0, :n_object].sum()), 1.0)
        known = np.empty((2, len(self.groups)))
        known[:, :n_object] = _mix(sums[:, :n_object], mean)
        for level in tree.levels:
            above = tree.parent[level] + n_object if tree.depth[level[0]] else root_object
            known[:, level + n_object] = _mix(sums[:, level + n_object], known[:, above])
        return known[0], known[1]


def _mix(sums: Float64, expected: Float64) -> Float64:
    """Posterior rates (2, m) per group: sums (3, m) as in SplitGuide, expected (2, m) rates of the parents."""
    mixed: Float64 = (sums[1:] + _PRIOR_GROUPS * expected) / (sums[0] + _PRIOR_GROUPS)
    return mixed


def weigh_groups(groups: Groups, worth: Float64, node: IntArray, flux: FloatArray) -> Float64:
    """(g,) float64: contribution of groups to the squared error, the sum of worth * flux^2 over their deposits (m,).

    worth as in Splitting, node (m,) int, flux (3, m) float, W
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
    """Splitting.worth (3, n) of the nodes at and below the leaves, up to a factor.

    leaves     (m,) int: nodes that tile the charts
    light      (3, n') float, W/m^2: total irradiance of the leaves and their ancestors, among the first n' nodes
    deposits   number so far; it limits the worth of nodes so small that less than one deposit is expected
    weighed    error groups and their weights (p,), see error_metric.Parts; None means the whole
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
