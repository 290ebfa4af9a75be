"""How many photons part at the first surface that they meet: more where what they bring from there takes more off the bake's error.

All that parts at one place is noise at the surfaces it comes to, and work: rays. At equal work noise is least where the number of photons
goes as the root of noise over work. Most light of a sunlit house falls on its outside, from where hardly any comes in; and a
lamp close to a wall sends a room's light through a few texels of it.

A place is a deepest node of the trees, or an object where the surface has no lightmap. What few photons tell of it is mixed with what is
known of the nodes above, of the object, and of all.

Source: Neyman 1934, "On the two different aspects of the representative method" (optimal allocation); Vorba & Křivánek 2016,
"Adjoint-driven Russian roulette and splitting in light transport simulation".
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..texels.judged import DARK_FLOOR, Parts
from ..transport.birth_cells import BirthCells
from ..transport.photon_log import Groups
from ..util.arrays import FloatArray, IntArray
from .quadtree import Quadtree
from .tally import find_touched

Float64 = NDArray[np.float64]

# Of photons.SPLIT: one photon at least, so that what was not foreseen is still seen; and not so many that few places of birth tell all.
LEAST_FACTOR, MOST_FACTOR = 1 / 8, 8.0
_PRIOR_GROUPS = 16.0  # that what is known of the surroundings counts for
_GRAIN = 4  # texels: noise of smaller nodes is averaged over so many a side, see denoise
_STEPS = 8  # of a search whose result need not be exact
_LEAST_WORK = 0.05  # rays of a group
_TINY = float(np.finfo(float).tiny)


@dataclass(frozen=True)
class Splitting:
    """What the photons of a round are told.

    factor   (n_object + n_node,) float32: of photons.SPLIT, how many times as many part on objects without a lightmap, and in deepest nodes
    worth    (3, n_node) float64, 1/W^2: squared error of the bake, relative to local brightness, for each squared watt
             that a photon brings to a deepest node
    cells    where photons are born that go alone
    """

    factor: NDArray[np.float32]
    worth: Float64
    cells: BirthCells

    def find_places(self, node: IntArray, is_mapped: NDArray[np.bool_], thing: IntArray) -> NDArray[np.int32]:
        """(m,) int32, indices of `factor`: of hits in nodes (m,) where the surface is mapped, else on objects (m,)."""
        n_object = len(self.factor) - self.worth.shape[1]
        return np.where(is_mapped, node + n_object, thing).astype(np.int32)


@dataclass(frozen=True)
class SplitTally:
    """What became of the groups of a shard, by place, as if SPLIT photons had parted everywhere.

    place    (k,) int64, ascending
    groups   (k,) float64
    rays     (k,) float64
    noise    (k,) float64: what they add to the squared error
    """

    place: NDArray[np.int64]
    groups: Float64
    rays: Float64
    noise: Float64

    @classmethod
    def of(cls, groups: Groups, noise: Float64) -> SplitTally:
        """Of groups, and what each adds to the squared error, noise (g,)."""
        place, slot, _ = find_touched(groups.place, int(groups.place.max(initial=-1)) + 1)
        sums = np.empty((3, len(place)))
        for row, values in zip(sums, (None, groups.rays / groups.split, noise * groups.split), strict=True):
            row[:] = np.bincount(slot, values, len(place))
        return cls(place, *sums)


@dataclass
class SplitGuide:
    """What all groups of a bake told, each (n_object + n_node,) float64; the places as in Splitting.

    groups   number
    rays     that came of them
    noise    that came of them, over the mean of its round: other rounds had other leaves
    """

    groups: Float64
    rays: Float64
    noise: Float64

    @classmethod
    def empty(cls, n_place: int) -> SplitGuide:
        return cls(*np.zeros((3, n_place)))

    def grow(self, n_place: int) -> None:
        """Make room for nodes that were added since."""
        for name in ("groups", "rays", "noise"):
            sums = getattr(self, name)
            setattr(self, name, np.concatenate([sums, np.zeros(n_place - len(sums))]))

    def add_round(self, shards: Sequence[SplitTally]) -> None:
        """What the shards of one round told."""
        groups, noise = (math.fsum(getattr(shard, name).sum() for shard in shards) for name in ("groups", "noise"))
        for shard in shards:
            self.groups[shard.place] += shard.groups
            self.rays[shard.place] += shard.rays
            self.noise[shard.place] += shard.noise * (groups / noise if noise > 0.0 else 0.0)

    def plan(self, tree: Quadtree, root_object: IntArray) -> tuple[NDArray[np.float32], float]:
        """Factors (n_object + n_node,) of a round, as in Splitting, and its weight: how much a photon tells, over one of a first round.

        root_object   (r,) int: the object of each of the nodes that the tree started with
        """
        if not self.noise.any():
            return np.ones(len(self.groups), np.float32), 1.0
        work, noise = self._know_rates(tree, root_object)
        wanted = np.sqrt(noise / np.maximum(work, _LEAST_WORK))
        met = np.flatnonzero(self.groups)
        number, work, noise = self.groups[met], work[met], noise[met]
        scale = 1.0 / max(float(wanted[met].max()), _TINY)
        all_work = float((number * work).sum())
        for _ in range(_STEPS):  # as much work as if SPLIT parted everywhere
            factor = np.clip(scale * wanted[met], LEAST_FACTOR, MOST_FACTOR)
            scale *= all_work / max(float((number * factor * work).sum()), _TINY)
        # Where most of the noise is from must not be bounded alone: the work would go to where it is of no use.
        scale = min(scale, MOST_FACTOR * float((number * noise).sum()) / max(float((number * noise * wanted[met]).sum()), _TINY))
        factor = np.clip(scale * wanted, LEAST_FACTOR, MOST_FACTOR)
        weight = float((number * noise).sum() / max(float((number * noise / factor[met]).sum()), _TINY))
        return factor.astype(np.float32), max(weight, 1.0)

    def _know_rates(self, tree: Quadtree, root_object: IntArray) -> tuple[Float64, Float64]:
        """Rays and noise of a group at each place, (n_object + n_node,) each."""
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
    """Rates (2, m) at places: sums (3, m) as in SplitGuide, expected (2, m) of what lies above."""
    mixed: Float64 = (sums[1:] + _PRIOR_GROUPS * expected) / (sums[0] + _PRIOR_GROUPS)
    return mixed


def weigh_groups(groups: Groups, worth: Float64, node: IntArray, flux: FloatArray) -> Float64:
    """(g,) float64: what groups add to the squared error by their deposits (m,).

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
    """Worth (3, n) of light that photons bring to the nodes at and below the leaves, as in Splitting but for a factor.

    leaves     (m,) int: nodes that tile the charts
    light      (3, n') float, W/m^2: all light at the leaves and at what is above them, of the first n' nodes
    deposits   so far: where not one is to be expected, more photons would not do either
    weighed    what is judged as one, and (p,) what each part counts for; None is the whole
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
