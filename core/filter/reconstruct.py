"""Light at texels from the functions of leaves, blended across their edges.

Weights are a partition of unity: each leaf's share of a window about as wide as the smaller of two touching leaves. Linear light stays
linear, and a step within noise becomes a ramp. A significant step is an edge of light and stays. Indirect light has few edges, so its
steps also become ramps within a chart unless they are large. Nothing is blended over the border of a chart, except over cuts of a piece.

Source: Babuska & Melenk 1997 for partitions of unity; a step is tested by a z-test of the two leaves' values.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..radiosity import basis
from ..radiosity.quadtree import Quadtree
from ..radiosity.tally import Solution, with_direct
from ..texels.texel_grid import part_bits
from ..texels.texel_map import TexelMap
from ..texels.tiles import NODE_WEIGHTS, TILE_NODES, TILE_SIDE, TILE_TEXELS, find_tiles
from ..util.ablation import uses
from .blend_weights import find_shares
from .neighbours import Neighbours

Float64: TypeAlias = NDArray[np.float64]

# A step below the first number of standard errors is noise, above the second it is an edge; between them the weight is linear.
_NOISE_SIGMAS, _LIGHT_SIGMAS = 3.0, 5.0
# Relative steps of indirect light, over the mean of both leaves: below the first, a step is curvature that neither leaf represents; above
# the second it is an edge, as at a wall along which no chart was cut.
_SMOOTH_STEP, _SHARP_STEP = 0.4, 0.8
_CELLS = 8  # lattice cells per side of a large leaf: see Blend.range
_LARGE_SIDE, _LARGE_TEXELS = 16, 128
_BELOW_END = np.nextafter(float(_CELLS), 0.0)
_TILES_TOGETHER = 1 << 8  # with more, BLAS would start threads
_TOGETHER = 1 << 12  # points blended at once, for a core's cache


@dataclass(frozen=True)
class PointLight:
    """Light at points.

    irradiance   (2, 3, m) float64, W/m^2: per component (or half) and channel; may be negative at the edge of a shadow. During blending
                 (1, 3, m) if there is no direct component
    variance     (3, m) float64, (W/m^2)^2, of both components together
    """

    irradiance: Float64
    variance: Float64


def evaluate_leaf(tree: Quadtree, solution: Solution, node: NDArray[Any], x: Float64, y: Float64, halves: bool = False) -> PointLight:
    """Evaluate the functions of nodes at points, also outside of them.

    node     (m,) int;  x, y   (m,) float64, page texels
    halves   evaluates the dual buffers in place of the components
    """
    return _evaluate(tree, solution, solution.half if halves else solution.coefficient, node, x, y)


def _evaluate(tree: Quadtree, solution: Solution, coefficient: Float64, node: NDArray[Any], x: Float64, y: Float64) -> PointLight:
    s, t = node_coordinates(tree, node, x, y)
    irradiance = basis.evaluate(coefficient.take(node, axis=-1, mode="wrap"), s, t, tree.degree)
    norm = basis.square_norm(tree.project[node], s, t, tree.degree) * tree.area[node]
    return PointLight(irradiance, solution.variance[:, node] * norm)


def node_coordinates(tree: Quadtree, node: NDArray[Any], x: Float64, y: Float64) -> tuple[Float64, Float64]:
    """Coordinates s, t of points in their nodes, each (m,), [-1, 1] inside."""
    half = tree.side[node] / 2.0
    return (x - tree.origin[node, 0]) / half - 1.0, (y - tree.origin[node, 1]) / half - 1.0


@dataclass(frozen=True)
class Blend:
    """Leaves (n,) int32 at all texel entries, with the neighbours that they are blended with.

    halves   whether the dual buffers are blended instead of the components
    """

    texels: TexelMap
    tree: Quadtree
    solution: Solution
    leaf: NDArray[np.int32]
    neighbours: Neighbours
    halves: bool

    @classmethod
    def of(cls, texels: TexelMap, tree: Quadtree, solution: Solution, leaf: NDArray[np.int32], halves: bool = False) -> Blend:
        """Arguments are as the fields."""
        return cls(texels, tree, solution, leaf, Neighbours.of(tree, leaf, texels), halves)

    def at(self, entry: NDArray[Any]) -> PointLight:
        """Light at texel entries (m,)."""
        return self.compare_at(entry)[1]

    def compare_at(self, entry: NDArray[Any]) -> tuple[PointLight, PointLight]:
        """Light at texel entries (m,): of the leaf alone, and blended."""
        alone, blended = self._blend(self.leaf[entry], *self.texels.own_points_at(entry))
        return PointLight(with_direct(alone.irradiance), alone.variance), PointLight(with_direct(blended.irradiance), blended.variance)

    def range(self, start: int, stop: int) -> PointLight:
        """Light at the entries start ... stop - 1. In large leaves the change by blending is interpolated on a lattice.

        Over a tile of texels within a lattice cell light is then quadratic, and is interpolated from a few texels.
        """
        count, first = stop - start, self._find_smooth_tiles(start, stop)
        out = PointLight(np.zeros((2, 3, count)), np.zeros((3, count)))
        alone = np.ones(count, bool)
        self._fill_tiles(first - start, self.leaf[first], self.texels.texel_xy[first], out, alone)
        rows = np.flatnonzero(alone)
        leaf, (x, y) = self.leaf[start + rows], self.texels.own_points(start, stop)[:, rows]
        is_large = self._is_large[leaf]
        small, large = np.flatnonzero(~is_large), np.flatnonzero(is_large)
        for some, part in (
            (small, self._blend(leaf[small], x[small], y[small])[1]),
            (large, self._on_lattice(leaf[large], x[large], y[large])),
        ):
            place = rows[some]
            for values, of_part in ((out.irradiance[-len(part.irradiance) :], part.irradiance), (out.variance, part.variance)):
                for term in np.ndindex(of_part.shape[:-1]):  # several times faster than all at once
                    values[term][place] = of_part[term]
        return out

    def _find_smooth_tiles(self, start: int, stop: int) -> NDArray[np.int64]:
        """(m,) int64: first entries of all tiles that have texels in the range and lie in one cell of a leaf's lattice."""
        texels = self.texels
        if self.tree.degree > 1:  # the variance would be of degree 4
            return np.zeros(0, np.int64)
        low, high = max(start - TILE_TEXELS + 1, 0), min(stop + TILE_TEXELS - 1, len(self.leaf))
        first = low + find_tiles(texels.texel_chart[low:high], texels.texel_code[low:high])
        first = first[self._is_large[self.leaf[first]] & (self.tree.side[self.leaf[first]] >= _CELLS * TILE_SIDE)]
        begin, end = np.searchsorted(texels.off_centre, first), np.searchsorted(texels.off_centre, first + TILE_TEXELS)
        whole: NDArray[np.int64] = first[begin == end]
        return whole

    def _fill_tiles(
        self, row: NDArray[np.int64], leaf: NDArray[np.int32], xy: NDArray[np.int32], out: PointLight, alone: NDArray[np.bool_]
    ) -> None:
        """Fill in the light of tiles, given the rows (m,) in `out`, leaves (m,) and page texels (m, 2) of their first texels.

        alone   (n,) bool: rows of `out` that no tile has filled; updated
        """
        x, y = ((xy[:, axis, None] + (part_bits(TILE_NODES)[axis] + 0.5)).ravel() for axis in (0, 1))
        nodes = self._on_lattice(np.repeat(leaf, len(TILE_NODES)), x, y)
        ends = np.flatnonzero(np.diff(row) != TILE_TEXELS) + 1
        runs = [(part[0], part[-1] + 1) for part in np.split(np.arange(len(row)), ends) if len(part)]
        for values, of_nodes in ((out.irradiance[-len(nodes.irradiance) :], nodes.irradiance), (out.variance, nodes.variance)):
            for term in np.ndindex(values.shape[:-1]):
                light = _at_texels(of_nodes[term]).ravel()
                for begin, end in runs:
                    before = max(-row[begin], 0)  # texels of the first tile before the range
                    place = values[term][row[begin] + before : row[begin] + (end - begin) * TILE_TEXELS]
                    place[:] = light[begin * TILE_TEXELS + before :][: len(place)]
        for begin, end in runs:
            alone[max(row[begin], 0) : row[begin] + (end - begin) * TILE_TEXELS] = False

    @cached_property
    def _has_edges(self) -> bool:
        """Whether photons carry direct light anywhere. The components decide, even if halves are blended."""
        return bool(self.solution.coefficient[0].any())

    @cached_property
    def _coefficients(self) -> Float64:
        """(C, 3, K, n_node) float64: coefficients of the components or halves, without an empty direct component."""
        if self.halves:
            return self.solution.half
        return self.solution.coefficient[0 if self._has_edges else 1 :]

    @cached_property
    def _is_large(self) -> NDArray[np.bool_]:
        """(n_node,) bool: nodes with many more texels than lattice points."""
        return (self.tree.side >= _LARGE_SIDE) & (self.tree.end - self.tree.start >= _LARGE_TEXELS)

    def _on_lattice(self, leaf: NDArray[np.int32], x: Float64, y: Float64) -> PointLight:
        tree, points = self.tree, _CELLS + 1
        is_met = np.zeros(len(tree), bool)
        is_met[leaf] = True
        met = np.flatnonzero(is_met)
        slot = np.empty(len(tree), np.int64)
        slot[met] = np.arange(len(met))
        (right, column), (up, row) = (
            np.modf(np.clip((at + 1.0) * _CELLS / 2.0, 0.0, _BELOW_END)) for at in node_coordinates(tree, leaf, x, y)
        )
        corner = (slot[leaf] * points + row.astype(np.int64)) * points + column.astype(np.int64)
        corners = [(corner + (j * points + i), (right if i else 1.0 - right) * (up if j else 1.0 - up)) for j in (0, 1) for i in (0, 1)]
        is_asked = np.zeros(len(met) * points * points, bool)
        for place, _ in corners:
            is_asked[place] = True
        asked = np.flatnonzero(is_asked)
        of, at = np.divmod(asked, points * points)
        node, (j, i) = met[of], np.divmod(at, points)
        cell = tree.side[node] / _CELLS
        alone, blended = self._blend(node, tree.origin[node, 0] + i * cell, tree.origin[node, 1] + j * cell)
        number = np.empty(len(is_asked), np.int64)
        number[asked] = np.arange(len(asked))
        corners = [(number[place], weight) for place, weight in corners]

        def interpolate(values: Float64) -> Float64:
            out = np.zeros(len(leaf))
            for place, weight in corners:
                out += values.take(place, mode="wrap") * weight
            return out

        change = blended.irradiance - alone.irradiance
        left = np.divide(blended.variance, alone.variance, out=np.ones_like(alone.variance), where=alone.variance > 0.0)
        light = self._evaluate_leaf(leaf, x, y)
        for term in np.ndindex(change.shape[:-1]):
            light.irradiance[term] += interpolate(change[term])
        for channel, values in enumerate(left):
            light.variance[channel] *= interpolate(values)
        return light

    def _blend(self, leaf: NDArray[np.int32], x: Float64, y: Float64) -> tuple[PointLight, PointLight]:
        """Light at points (m,) on leaves (m,): of the leaf alone, and blended."""
        parts = [
            self._blend_part(leaf[start : start + _TOGETHER], x[start : start + _TOGETHER], y[start : start + _TOGETHER])
            for start in range(0, max(len(leaf), 1), _TOGETHER)
        ]
        alone, blended = (
            PointLight(*(np.concatenate([getattr(one, name) for one in of], axis=-1) for name in ("irradiance", "variance")))
            for of in zip(*parts, strict=True)
        )
        return alone, blended

    def _evaluate_leaf(self, leaf: NDArray[np.int32], x: Float64, y: Float64) -> PointLight:
        return _evaluate(self.tree, self.solution, self._coefficients, leaf, x, y)

    def _blend_part(self, leaf: NDArray[np.int32], x: Float64, y: Float64) -> tuple[PointLight, PointLight]:
        own = self._evaluate_leaf(leaf, x, y)
        if not uses("leaf_blending"):
            return own, own
        own_reach, row, other, reach = find_shares(self.tree, self.neighbours, leaf, x, y)
        theirs = self._evaluate_leaf(other, x[row], y[row])
        own_variance, variance = own.variance.mean(0)[row], theirs.variance.mean(0)
        mean = 0.5 if self.halves else 1.0  # components add up to the light, while each half estimates all of it
        mine, others = (mean * of.irradiance.sum(0).mean(0) for of in (own, theirs))
        step, noise = np.abs(others - mine[row]), np.sqrt(own_variance + variance)
        sigmas = np.divide(step, noise, out=np.where(step == 0.0, 0.0, np.inf), where=noise > 0.0)
        goes_over = np.clip((_LIGHT_SIGMAS - sigmas) / (_LIGHT_SIGMAS - _NOISE_SIGMAS), 0.0, 1.0)
        if not self._has_edges:
            level = 0.5 * (np.abs(mine[row]) + np.abs(others))
            relative = np.divide(step, level, out=np.zeros_like(step), where=level > 0.0)
            smooth = np.clip((_SHARP_STEP - relative) / (_SHARP_STEP - _SMOOTH_STEP), 0.0, 1.0)
            smooth[self.tree.chart[leaf[row]] != self.tree.chart[other]] = 0.0  # such charts may touch along a wall, not only at its door
            goes_over = np.maximum(goes_over, smooth)
        reach *= goes_over
        # Weights are proportional to 1 / sqrt(variance). Inverse variance would favour leaves with dim photons, whose variance is lowest.
        reach *= np.sqrt(np.divide(own_variance, variance, out=np.ones(len(row)), where=(own_variance > 0.0) & (variance > 0.0)))
        whole = own_reach + np.bincount(row, reach, len(leaf))

        def join(mine: Float64, others: Float64, power: int) -> Float64:
            out: Float64 = mine * own_reach**power
            weight = reach**power
            for term in np.ndindex(out.shape[:-1]):
                out[term] += np.bincount(row, weight * others[term], len(leaf))
            out /= whole**power
            return out

        # Errors of leaves are independent.
        return own, PointLight(join(own.irradiance, theirs.irradiance, 1), join(own.variance, theirs.variance, 2))


def _at_texels(nodes: Float64) -> Float64:
    """(m, 64): values at the texels of tiles from those at their nodes (m * 9,)."""
    nodes = nodes.reshape(-1, len(TILE_NODES))
    out = np.empty((len(nodes), TILE_TEXELS))
    for start in range(0, len(nodes), _TILES_TOGETHER):
        part = slice(start, start + _TILES_TOGETHER)
        np.matmul(nodes[part], NODE_WEIGHTS.T, out=out[part])
    return out
