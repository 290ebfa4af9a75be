"""Tallies of arriving photons, and the irradiance estimated from them.

A photon is added once, to the deepest node at its texel. The total that a node has received is its own sum plus what it has shot on to its
children, so p_received and p_shot need no counters of their own. During the run only sums are kept; irradiance is computed with a Solution.

Components of light: 0 direct, 1 indirect. If rays find the direct light, photons carry indirect light only and the sums have that one
component: C is 2 or 1. The two halves are the even and the odd shards.
Source: [Tobler97] 3.1 (counters), eq. 9 (coefficients), eq. 10 (nodes that were made late).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..util.arrays import BoolArray, Float64, FloatArray, Int64, IntArray
from . import basis
from .quadtree import Quadtree

COMPONENTS = 2
HALVES = 2
CHANNELS = 3
_SQUARED_W = 1e-15, 1e18  # range of a shard's greatest photon power for which float32 can hold its square and those of much fainter photons
_PART = 1 << 11  # nodes processed at once: the intermediate arrays fit a core's cache


@dataclass(frozen=True)
class ShardTally:
    """Sums of one shard at the m nodes that its photons hit.

    node      (m,) int64, ascending
    count     (m,) int64, photons
    weight2   (3, m) float64, W^2: sum of squared photon powers
    raw       (C, 3, K, m) float64, W: per component and channel, sums of power times each monomial
    """

    node: Int64
    count: Int64
    weight2: Float64
    raw: Float64

    @classmethod
    def join(cls, parts: Sequence[ShardTally]) -> ShardTally:
        """The sum of several."""
        node = np.unique(np.concatenate([part.node for part in parts]))
        shape, m = parts[0].raw.shape[:-1], len(node)
        out = cls(node, np.zeros(m, np.int64), np.zeros((CHANNELS, m)), np.zeros((*shape, m)))
        for part in parts:
            rows = np.searchsorted(node, part.node)
            out.count[rows] += part.count
            out.weight2[:, rows] += part.weight2
            out.raw[..., rows] += part.raw
        return out


def deposit(
    node: IntArray, s: FloatArray, t: FloatArray, flux: FloatArray, is_first: BoolArray | None, n_node: int, degree: int
) -> ShardTally:
    """Sums over the hits of a shard.

    node       (m,) int, the deepest node at each hit
    s, t       (m,) float, node coordinates
    flux       (3, m) float, W
    is_first   (m,) bool: direct light; None for a shard of indirect light alone
    """
    touched, slot, count = find_touched(node, n_node)  # sums are as large as the number of hit nodes, not as the tree
    m = len(touched)
    components = 1 if is_first is None else COMPONENTS
    placed = slot if is_first is None else slot + m * (~is_first)
    moments = basis.monomials(s, t, degree)
    raw = np.empty((components, CHANNELS, len(moments), m))
    weight2 = np.empty((CHANNELS, m))
    for channel in range(CHANNELS):
        weight2[channel] = np.bincount(slot, _square(flux[channel]), m)
        power = flux[channel].astype(np.float64)  # converted once; all sums are in this precision
        for k, moment in enumerate(moments):
            sums = np.bincount(placed, power * moment if k else power, components * m)
            raw[:, channel, k] = sums.reshape(components, m)
    return ShardTally(touched, count, weight2, raw)


def find_touched(node: IntArray, n_node: int) -> tuple[Int64, Int64, Int64]:
    """As np.unique with inverse and counts, but without sorting: distinct nodes (k,) int64, ascending, of node (m,) int < n_node; the index
    of each node among them (m,) int64; and their counts (k,).
    """
    count = np.bincount(node, minlength=n_node)
    touched = np.flatnonzero(count)
    slot_of = np.empty(n_node, np.int64)
    slot_of[touched] = np.arange(len(touched))
    return touched, slot_of.take(node, mode="wrap"), count[touched]


def _square(power: FloatArray) -> FloatArray:
    """(m,), W^2: squares of the powers of a shard's photons, (m,) W; in float64 if float32 cannot hold them."""
    greatest = float(power.max(initial=0.0))
    plain = greatest == 0.0 or _SQUARED_W[0] < greatest < _SQUARED_W[1]
    return np.square(power, dtype=None if plain else np.float64)


@dataclass
class Tally:
    """Sums that every node received while it was the deepest; grows in place.

    photons   (2,) float64: number emitted, per half
    count     (n,) int64
    weight2   (3, n) float64, W^2
    raw       (2, C, 3, K, n) float64, W: half, component, channel, monomial
    """

    photons: Float64
    count: Int64
    weight2: Float64
    raw: Float64

    @classmethod
    def empty(cls, n_node: int, degree: int, components: int = COMPONENTS) -> Tally:
        size = basis.count_functions(degree)
        return cls(
            np.zeros(HALVES),
            np.zeros(n_node, np.int64),
            np.zeros((CHANNELS, n_node)),
            np.zeros((HALVES, components, CHANNELS, size, n_node)),
        )

    def grow(self, n_node: int) -> None:
        """Append zeros for nodes that were added to the tree."""
        more = n_node - len(self.count)
        if more:
            self.count = np.pad(self.count, (0, more))
            self.weight2 = np.pad(self.weight2, ((0, 0), (0, more)))
            self.raw = np.pad(self.raw, ((0, 0),) * 4 + ((0, more),))

    def add(self, half: int, shard: ShardTally, photons: float) -> None:
        self.photons[half] += photons
        self.count[shard.node] += shard.count
        for sums, added in ((self.weight2, shard.weight2), (self.raw[half], shard.raw)):
            for row, of_shard in zip(_rows_of(sums), _rows_of(added), strict=True):
                row[shard.node] += of_shard


def _rows_of(sums: Float64) -> Float64:
    """(k, n): sums (..., n), reshaped."""
    return sums.reshape(math.prod(sums.shape[:-1]), sums.shape[-1])


@dataclass(frozen=True)
class Totals:
    """Sums of all nodes including everything below them; fields as in Tally.

    received   (n,) int64: p_received, number of photons that reached the node since it exists
    shot       (n,) int64: p_shot, number of those that were passed on to its children
    shot_raw   (2, C, 3, K, n) float64, W: the part of `raw` from photons that were passed on
    """

    photons: Float64
    received: Int64
    shot: Int64
    weight2: Float64
    raw: Float64
    shot_raw: Float64


def parts_of(nodes: Int64, size: int = _PART) -> Iterator[Int64]:
    """The nodes in parts of a given size."""
    return (nodes[start : start + size] for start in range(0, len(nodes), size))


def accumulate(tree: Quadtree, tally: Tally) -> Totals:
    """Sums of every node from those of the deepest, exact, level by level from the bottom."""
    transforms = basis.parent_transforms(tree.degree)
    received, weight2, raw = tally.count.copy(), tally.weight2.copy(), tally.raw.copy()
    shot, shot_raw = np.zeros_like(received), np.zeros_like(raw)
    for level in reversed(tree.levels[:-1]):
        for nodes in parts_of(level[tree.has_children[level]]):
            of_part = np.zeros((*raw.shape[:-1], len(nodes)))
            for quadrant in range(4):
                child = tree.children[nodes, quadrant]
                there = np.flatnonzero(child >= 0)
                parent, child = nodes[there], child[there]
                shot[parent] += received[child]
                weight2[:, parent] += weight2[:, child]
                of_part[..., there] += transforms[quadrant] @ raw.take(child, axis=-1)
            received[nodes] += shot[nodes]
            raw[..., nodes] += of_part
            shot_raw[..., nodes] = of_part
    return Totals(tally.photons.copy(), received, shot, weight2, raw, shot_raw)


@dataclass(frozen=True)
class Solution:
    """Irradiance of nodes; 0 for nodes that solve_tallies did not solve.

    coefficient   (2, 3, K, n) float64, W/m^2: per component and channel, of the monomials in node coordinates
    half          (2, 3, K, n) float64, W/m^2: sum of components, from each half alone
    flux_half     (2, 3, n) float64, W: sum of components, from each half alone
    flux          (3, n) float64, W: sum of components
    variance      (3, n) float64, (W/m^2)^2: variance of the node's mean irradiance; at a point of the node the variance is this times the
                  area times the sum of the squared basis functions
    scale         (3, n) float64: eq. 10, all the light of a node over the light of the photons it received itself; 0 if it received none
    """

    coefficient: Float64
    half: Float64
    flux_half: Float64
    flux: Float64
    variance: Float64
    scale: Float64


def solve_tallies(tree: Quadtree, totals: Totals, nodes: Int64 | None = None) -> Solution:
    """Irradiance of nodes; nodes that were made late are scaled up to all the light that their ancestors received.

    nodes   (m,) int64: nodes to solve, together with their ancestors; all if None
    """
    transforms = basis.parent_transforms(tree.degree).transpose(0, 2, 1)
    n_component, *rest = totals.raw.shape[1:]
    functions = np.zeros((COMPONENTS + HALVES, *rest))
    fitted = functions[COMPONENTS - n_component :]  # components and halves, in the order of _join_views
    view_scale = np.ones((*fitted.shape[:2], len(tree)))
    flux_half, (flux, scale, variance) = np.zeros((HALVES, CHANNELS, len(tree))), np.zeros((3, CHANNELS, len(tree)))
    # As float: from 3e9 on the square exceeds any integer type.
    photons = np.maximum([float(totals.photons.sum())] * n_component + totals.photons.tolist(), 1.0)[:, None, None]
    for level in _find_above(tree, nodes):
        for part in parts_of(level):
            raw, parent = _join_views(totals.raw.take(part, axis=-1)), tree.parent[part]
            own = basis.apply_matrices(tree.project[part], raw / photons[..., None])
            if tree.depth[part[0]]:
                shot = _join_views(totals.shot_raw[:, :, :, 0].take(parent, axis=-1))
                received = _join_views(totals.raw[:, :, :, 0].take(parent, axis=-1))
                seen = shot > 0.0
                view_scale[..., part] = np.where(seen, view_scale.take(parent, axis=-1) * (received / np.where(seen, shot, 1.0)), 0.0)
                own *= view_scale[:, :, None, part]
                if not seen.all():
                    # If a component reached no child since there are children, the parent's function is inherited.
                    inherited = basis.apply_transforms(transforms, tree.quadrant[part], fitted.take(parent, axis=-1))
                    own = np.where(seen[:, :, None], own, inherited)
            fitted[..., part] = own
            whole = (own * tree.moment[part, : own.shape[2]].T).sum(2)
            arrived = raw[:n_component, :, 0].sum(0) / photons[0]
            light = whole[:n_component].sum(0)
            factor = np.where(arrived > 0.0, np.abs(light) / np.where(arrived > 0.0, arrived, 1.0), 0.0)
            area2 = np.maximum(tree.area[part] ** 2, np.finfo(float).tiny)  # the square of a tiny area would underflow to 0
            flux_half[..., part], flux[:, part], scale[:, part] = whole[n_component:], light, factor
            variance[:, part] = totals.weight2[:, part] * factor**2 / photons[0] ** 2 / area2
    return Solution(functions[:COMPONENTS], functions[COMPONENTS:], flux_half, flux, variance, scale)


def _find_above(tree: Quadtree, nodes: Int64 | None) -> list[Int64]:
    """Nodes (m,) and their ancestors, by depth from the top; all nodes if None."""
    if nodes is None:
        return tree.levels
    wanted = np.zeros(len(tree), bool)
    wanted[nodes] = True
    levels = []
    for level in reversed(tree.levels):
        found = level[wanted[level]]
        above = tree.parent[found]
        wanted[above[above >= 0]] = True
        levels.append(found)
    return levels[::-1]


def _join_views(sums: Float64) -> Float64:
    """(C + 2, ...): sums (2 halves, C components, ...) added over the halves, for each component, then over components, for each half."""
    return np.concatenate([sums.sum(0), sums.sum(1)])
