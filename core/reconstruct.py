"""Leaves' functions to light at texels, without visible edges between leaves.

Around each texel a window as large as half its leaf is looked at. Every leaf that reaches into it has a say at the texel,
by the share of the window it fills and with its own function, carried on a little beyond its edge: linear light stays
linear, and a step between two leaves that is no larger than their noise becomes a ramp. A step that is larger is light,
and stays. Windows end at a chart's border.

Source: the weights are those of a partition of unity (Babuska & Melenk 1997); the test of a step is a z-test of the
two leaves' values.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from . import basis
from .quadtree import Quadtree
from .tally import Solution
from .texel_map import TexelMap
from .tiles import NODE_WEIGHTS, TILE_NODES, TILE_SIDE, TILE_TEXELS, Tiles

Float64: TypeAlias = NDArray[np.float64]

WINDOW = 1.0  # side of the window over the side of the leaf
_STRATA = 4  # points across the window, each way
_STEP_SIGMAS = 3.0  # a step above so many standard errors is light
_NOISIER = 4.0  # a leaf whose variance there is more than so many times the texel's own has no say
_FARTHEST = 2.0  # node coordinate up to which a function is carried on beyond its node, which ends at 1
_FINE = 16  # tiles side by side in a leaf, from which on nine texels tell of a tile: off by 0.1 of the standard error; measured
CHUNK = 1 << 16


@dataclass(frozen=True)
class PointLight:
    """Light at points.

    irradiance   (2, 3, m) float64, W/m^2: per component (or half) and channel; may dip below zero at the edge of a shadow
    variance     (3, m) float64, (W/m^2)^2, of both components together
    """

    irradiance: Float64
    variance: Float64


def evaluate_leaf(tree: Quadtree, solution: Solution, node: NDArray[Any], x: Float64, y: Float64, halves: bool = False) -> PointLight:
    """The functions of nodes at points, which may lie beyond them.

    node     (m,) int;  x, y   (m,) float64, page texels
    halves   what each half of the bake says, in place of the components
    """
    coefficient = solution.half if halves else solution.coefficient
    monomials = np.array(basis.monomials(*node_coordinates(tree, node, x, y), tree.degree))
    irradiance = np.zeros((*coefficient.shape[:2], len(node)))
    for k, monomial in enumerate(monomials):
        irradiance += coefficient[:, :, k, node] * monomial
    squares = (monomials * basis.apply_matrices(tree.project[node], monomials)).sum(0) * tree.area[node]
    return PointLight(irradiance, solution.variance[:, node] * squares)


def node_coordinates(tree: Quadtree, node: NDArray[Any], x: Float64, y: Float64) -> tuple[Float64, Float64]:
    """Coordinates s, t of points in their nodes, each (m,), [-1, 1] inside."""
    half = tree.side[node] / 2.0
    return (x - tree.origin[node, 0]) / half - 1.0, (y - tree.origin[node, 1]) / half - 1.0


@dataclass(frozen=True)
class LeafBlender:
    """Where texels lie and who is next to whom, for blending at any of them.

    x, y       (n,) float64, page texels: each entry's own point
    page       (n,) int32, of each entry
    entry_at   (n_page, size, size) int32, -1 where no chart covers the texel; of several the one that is shown
    """

    texels: TexelMap
    x: Float64
    y: Float64
    page: NDArray[np.int32]
    entry_at: NDArray[np.int32]

    @classmethod
    def of(cls, texels: TexelMap, page: NDArray[np.int32]) -> LeafBlender:
        """page   (n,) int32, the page of each entry"""
        x, y = np.empty((2, len(page)))
        for start in range(0, len(page), CHUNK):
            part = slice(start, min(start + CHUNK, len(page)))
            _, u, v = texels.bary_of(part.start, part.stop).T
            x[part], y[part] = texels.hit_texel_xy(texels.texel_tri[part], u, v)
        entry_at = np.full((texels.page_count, texels.page_size, texels.page_size), -1, np.int32)
        shown = np.flatnonzero(texels.shown)
        entry_at[page[shown], texels.texel_xy[shown, 1], texels.texel_xy[shown, 0]] = shown
        return cls(texels, x, y, page, entry_at)

    def blend(
        self, tree: Quadtree, solution: Solution, leaf: NDArray[np.int32], entry: NDArray[Any] | None = None, halves: bool = False
    ) -> PointLight:
        """Light at texel entries.

        leaf     (n,) int32, the leaf at each entry
        entry    (m,) int, all if None
        halves   what each half of the bake says, in place of the components
        """
        entry = np.arange(len(leaf)) if entry is None else entry
        parts = [
            self._blend_part(tree, solution, leaf, entry[start : start + CHUNK], halves) for start in range(0, max(len(entry), 1), CHUNK)
        ]
        return PointLight(
            np.concatenate([part.irradiance for part in parts], axis=-1), np.concatenate([part.variance for part in parts], axis=-1)
        )

    def blend_range(self, tree: Quadtree, solution: Solution, leaf: NDArray[np.int32], start: int, stop: int) -> PointLight:
        """Light at the entries start ... stop - 1, over tiles of large leaves by few of their texels; leaf as for blend."""
        part = slice(start, stop)
        tiles = Tiles.of(self.texels.texel_chart[part], self.texels.texel_code[part])
        own = leaf[start + tiles.start]
        smooth = (leaf[start + tiles.start + TILE_TEXELS - 1] == own) & (tree.side[own] >= _FINE * TILE_SIDE)
        nodes = start + (tiles.start[smooth] + TILE_NODES[:, None])
        rows = tiles.texels()[smooth]
        alone = np.ones(stop - start, bool)
        alone[rows] = False
        asked = np.concatenate([nodes.ravel(), start + np.flatnonzero(alone)])
        found = self.blend(tree, solution, leaf, asked)
        irradiance, variance = (np.empty((*values.shape[:-1], stop - start)) for values in (found.irradiance, found.variance))
        for out, values in ((irradiance, found.irradiance), (variance, found.variance)):
            out[..., alone] = values[..., nodes.size :]
            told = NODE_WEIGHTS @ values[..., : nodes.size].reshape(*values.shape[:-1], *nodes.shape)
            out[..., rows.T] = told
        return PointLight(irradiance, np.maximum(variance, 0.0))

    def _blend_part(self, tree: Quadtree, solution: Solution, leaf: NDArray[np.int32], part: NDArray[Any], halves: bool) -> PointLight:
        x, y, own_leaf = self.x[part], self.y[part], leaf[part]
        own = evaluate_leaf(tree, solution, own_leaf, x, y, halves)
        reached = self._reached_leaves(tree, leaf, part)
        own_count = 1.0 + (reached == own_leaf).sum(0)  # the texel itself is a point too
        reached[reached == own_leaf] = -1
        irradiance, variance, count = own.irradiance * own_count, own.variance * own_count**2, own_count
        share = 0.5 if halves else 1.0  # components add up to the light, halves each stand for it
        rows = np.arange(len(part))
        while True:  # one more leaf for every texel whose window reaches one
            other = reached.max(0)
            rows, reached, other = rows[other >= 0], reached[:, other >= 0], other[other >= 0]
            if not len(rows):
                break
            points = (reached == other).sum(0)
            reached[reached == other] = -1
            theirs = evaluate_leaf(tree, solution, other, x[rows], y[rows], halves)
            step = share * (theirs.irradiance - own.irradiance[..., rows]).sum(0).mean(0)
            own_noise, noise = own.variance[:, rows].mean(0), theirs.variance.mean(0)
            # A sliver's function runs away beyond its node, and its noise would excuse any step.
            close = np.abs(node_coordinates(tree, other, x[rows], y[rows])).max(0) <= _FARTHEST
            joined = close & (step**2 <= _STEP_SIGMAS**2 * (own_noise + noise)) & (noise <= _NOISIER * own_noise)
            points = np.where(joined, points, 0)
            irradiance[..., rows] += points * theirs.irradiance
            variance[:, rows] += points**2 * theirs.variance  # points on one leaf err together, leaves err apart
            count[rows] += points
        return PointLight(irradiance / count, variance / count**2)

    def _reached_leaves(self, tree: Quadtree, leaf: NDArray[np.int32], part: NDArray[Any]) -> NDArray[np.int32]:
        """(points of a window, m) int32: leaf under each point of each texel's window, -1 where its chart is not."""
        size, own_leaf, page = self.texels.page_size, leaf[part], self.page[part]
        x, y, chart = self.x[part], self.y[part], tree.chart[own_leaf]
        reached = np.empty((_STRATA**2, len(part)), np.int32)
        for point, (across, up) in enumerate(product((np.arange(_STRATA) + 0.5) / _STRATA - 0.5, repeat=2)):
            column = np.floor(x + across * WINDOW * tree.side[own_leaf]).astype(np.int64)
            row = np.floor(y + up * WINDOW * tree.side[own_leaf]).astype(np.int64)
            inside = (column >= 0) & (column < size) & (row >= 0) & (row < size)
            entry = np.where(inside, self.entry_at[page, np.clip(row, 0, size - 1), np.clip(column, 0, size - 1)], -1)
            other = leaf[entry]
            reached[point] = np.where((entry >= 0) & (tree.chart[other] == chart), other, -1)
        return reached
