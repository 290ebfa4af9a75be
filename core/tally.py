"""Counters of arriving photons, and the irradiance they stand for.

A photon is added once, to the deepest node at its texel. What a node has received in all is its own sum plus what it has
shot on to its children, so p_received and p_shot need no counters of their own. Only sums are kept during the run;
watts per square metre appear when a Solution is made.

Components of light: 0 direct, 1 indirect. Halves: even and odd shards.
Source: [Tobler97] 3.1 (counters), eq. 9 (coefficients), eq. 10 (nodes that were made late).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from . import basis
from .quadtree import Quadtree
from .scene import FloatArray, IntArray

COMPONENTS = 2
HALVES = 2
CHANNELS = 3


@dataclass(frozen=True)
class ShardTally:
    """Sums of one shard over the m nodes that it touched.

    node      (m,) int64, ascending
    count     (m,) int64, photons
    weight2   (3, m) float64, W^2: sum of squared photon powers
    raw       (2, 3, K, m) float64, W: per component and channel, sums of power times each monomial
    """

    node: NDArray[np.int64]
    count: NDArray[np.int64]
    weight2: NDArray[np.float64]
    raw: NDArray[np.float64]


def deposit(
    node: IntArray,
    s: FloatArray,
    t: FloatArray,
    flux: FloatArray,
    is_first: NDArray[np.bool_],
    n_node: int,
    degree: int,
) -> ShardTally:
    """Sums over the hits of a shard.

    node       (m,) int, the deepest node at each hit
    s, t       (m,) float, node coordinates
    flux       (3, m) float, W
    is_first   (m,) bool: straight from a light
    """
    if len(node) < n_node:  # few hits in many nodes: sums as large as the hits, not as the tree
        touched, node = np.unique(node, return_inverse=True)
    else:
        touched = np.arange(n_node)
    m = len(touched)
    slot = node + m * (~is_first)
    moments = basis.monomials(s, t, degree)
    raw = np.empty((COMPONENTS, CHANNELS, len(moments), m))
    weight2 = np.empty((CHANNELS, m))
    for channel in range(CHANNELS):
        weight2[channel] = np.bincount(node, flux[channel] * flux[channel], m)
        for k, moment in enumerate(moments):
            sums = np.bincount(slot, flux[channel] * moment if k else flux[channel], COMPONENTS * m)
            raw[:, channel, k] = sums.reshape(COMPONENTS, m)
    return ShardTally(touched.astype(np.int64), np.bincount(node, minlength=m), weight2, raw)


@dataclass
class Tally:
    """What every node received while it was the deepest; grows in place.

    photons   (2,) int64: emitted, per half
    count     (n,) int64
    weight2   (3, n) float64, W^2
    raw       (2, 2, 3, K, n) float64, W: half, component, channel, monomial
    """

    photons: NDArray[np.int64]
    count: NDArray[np.int64]
    weight2: NDArray[np.float64]
    raw: NDArray[np.float64]

    @classmethod
    def empty(cls, n_node: int, degree: int) -> Tally:
        size = basis.count_functions(degree)
        return cls(
            np.zeros(HALVES, np.int64),
            np.zeros(n_node, np.int64),
            np.zeros((CHANNELS, n_node)),
            np.zeros((HALVES, COMPONENTS, CHANNELS, size, n_node)),
        )

    def grow(self, n_node: int) -> None:
        """Make room for nodes that were added to the tree."""
        more = n_node - len(self.count)
        if more:
            self.count = np.pad(self.count, (0, more))
            self.weight2 = np.pad(self.weight2, ((0, 0), (0, more)))
            self.raw = np.pad(self.raw, ((0, 0),) * 4 + ((0, more),))

    def add(self, half: int, shard: ShardTally, photons: int) -> None:
        self.photons[half] += photons
        if len(shard.node) == len(self.count):  # all of them, in order: no gathering
            self.count += shard.count
            self.weight2 += shard.weight2
            self.raw[half] += shard.raw
        else:
            self.count[shard.node] += shard.count
            self.weight2[:, shard.node] += shard.weight2
            self.raw[half, ..., shard.node] += np.moveaxis(shard.raw, -1, 0)


@dataclass(frozen=True)
class Totals:
    """Own sums plus everything below, for all nodes; fields as in Tally.

    received   (n,) int64: p_received, photons that reached the node since it exists
    shot       (n,) int64: p_shot, those passed on to its children
    shot_raw   as raw: sums over the photons shot only, in the node's own coordinates
    shot_weight2   as weight2, over the photons shot only
    """

    photons: NDArray[np.int64]
    received: NDArray[np.int64]
    shot: NDArray[np.int64]
    weight2: NDArray[np.float64]
    shot_weight2: NDArray[np.float64]
    raw: NDArray[np.float64]
    shot_raw: NDArray[np.float64]


def accumulate(tree: Quadtree, tally: Tally) -> Totals:
    """Sums of every node from those of the deepest, exactly, level by level from the bottom."""
    transforms = basis.parent_transforms(tree.degree)
    received, weight2, raw = tally.count.copy(), tally.weight2.copy(), tally.raw.copy()
    shot, shot_weight2, shot_raw = np.zeros_like(received), np.zeros_like(weight2), np.zeros_like(raw)
    for level in reversed(tree.levels[:-1]):
        for quadrant in range(4):
            child = tree.children[level, quadrant]
            parent, child = level[child >= 0], child[child >= 0]
            shot[parent] += received[child]
            shot_weight2[:, parent] += weight2[:, child]
            shot_raw[..., parent] += transforms[quadrant] @ raw[..., child]
        received[level] += shot[level]
        weight2[:, level] += shot_weight2[:, level]
        raw[..., level] += shot_raw[..., level]
    return Totals(tally.photons.copy(), received, shot, weight2, shot_weight2, raw, shot_raw)


@dataclass(frozen=True)
class Solution:
    """Irradiance of every node.

    coefficient   (2, 3, K, n) float64, W/m^2: per component and channel, of the monomials in node coordinates
    half          (2, 3, K, n) float64, W/m^2: both components, from each half alone
    flux_half     (2, 3, n) float64, W: both components, from each half alone
    flux          (3, n) float64, W: both components
    variance      (3, n) float64, (W/m^2)^2: of the node's mean irradiance; at a point of the node the variance is this
                  times the area times the sum of the squared basis functions there
    scale         (3, n) float64: eq. 10, all the light of a node over the light it saw itself; 0 where it saw none
    """

    coefficient: NDArray[np.float64]
    half: NDArray[np.float64]
    flux_half: NDArray[np.float64]
    flux: NDArray[np.float64]
    variance: NDArray[np.float64]
    scale: NDArray[np.float64]


def solve_tallies(tree: Quadtree, totals: Totals) -> Solution:
    """Irradiance of every node, late nodes scaled up to all the light their ancestors received."""
    photons = max(float(totals.photons.sum()), 1.0)  # its square is beyond any integer type from 3e9 on
    raw, shot_raw = totals.raw.sum(0), totals.shot_raw.sum(0)
    coefficient = _scale_coefficients(tree, raw, shot_raw)
    moment = tree.moment[:, : raw.shape[2]].T
    flux = (coefficient * moment).sum((0, 2))
    seen = raw[:, :, 0].sum(0)
    scale = np.where(seen > 0.0, np.abs(flux) / np.where(seen > 0.0, seen, 1.0), 0.0)
    area = np.maximum(tree.area, np.finfo(float).tiny)
    variance = totals.weight2 * scale**2 / photons**2 / area**2
    emitted = np.maximum(totals.photons, 1)[:, None, None, None]
    half = _scale_coefficients(tree, totals.raw.sum(1), totals.shot_raw.sum(1)) / emitted
    halves = [
        _scale_flux(tree, totals.raw[half, :, :, 0].sum(0), totals.shot_raw[half, :, :, 0].sum(0)) / max(int(totals.photons[half]), 1)
        for half in range(HALVES)
    ]
    return Solution(coefficient / photons, half, np.array(halves), flux / photons, variance, scale)


def _scale_coefficients(tree: Quadtree, raw: NDArray[np.float64], shot_raw: NDArray[np.float64]) -> NDArray[np.float64]:
    """Polynomial coefficients (2, 3, K, n) per photon, of two components or of two halves."""
    transforms = basis.parent_transforms(tree.degree)
    fitted = basis.apply_matrices(tree.project, raw)
    received, shot = raw[:, :, 0], shot_raw[:, :, 0]
    scale = np.ones(received.shape)
    for level in tree.levels[1:]:
        parent = tree.parent[level]
        seen = shot[:, :, parent] > 0.0
        ratio = received[:, :, parent] / np.where(seen, shot[:, :, parent], 1.0)
        scale[:, :, level] = np.where(seen, scale[:, :, parent] * ratio, 0.0)
        fitted[..., level] *= scale[:, :, None, level]
        if not seen.all():
            # A component that reached no child since there are children: the parent's own function holds on.
            inherited = basis.apply_matrices(transforms[tree.quadrant[level]].transpose(0, 2, 1), fitted[..., parent])
            fitted[..., level] = np.where(seen[:, :, None], fitted[..., level], inherited)
    return fitted


def _scale_flux(tree: Quadtree, received: NDArray[np.float64], shot: NDArray[np.float64]) -> NDArray[np.float64]:
    """Flux (3, n) per photon of every node, from sums (3, n) over the photons it received and shot."""
    flux = received.copy()
    area = np.maximum(tree.area, np.finfo(float).tiny)
    for level in tree.levels[1:]:
        parent = tree.parent[level]
        seen = shot[:, parent] > 0.0
        share = np.where(seen, received[:, level] / np.where(seen, shot[:, parent], 1.0), area[level] / area[parent])
        flux[:, level] = flux[:, parent] * share
    return flux
