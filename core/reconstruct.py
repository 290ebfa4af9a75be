"""Leaves' functions to light at texels, without visible edges between leaves.

Around each texel a window as large as its leaf is looked at. Every leaf that reaches into it has a say at the texel,
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

Float64: TypeAlias = NDArray[np.float64]

WINDOW = 1.0  # side of the window over the side of the leaf
_STRATA = 4  # points across the window, each way
_STEP_SIGMAS = 3.0  # a step above so many standard errors is light
_NOISIER = 4.0  # a leaf whose variance there is more than so many times the texel's own has no say
_FARTHEST = 2.0  # node coordinate up to which a function is carried on beyond its node, which ends at 1
_CELLS_LOG2 = 3  # cells side by side in a leaf: see blend_range
_VARIANCE_DEGREE = 2  # up to which a variance is told around a place: all of it where functions are linear
_TOGETHER = 1 << 12  # places blended at once: what lies between fits a core's cache
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
    found = _describe_leaf(tree, solution, node, x, y, halves, degree=0)
    return PointLight(found.irradiance[:, :, 0], found.variance[:, 0])


def _describe_leaf(
    tree: Quadtree, solution: Solution, node: NDArray[Any], x: Float64, y: Float64, halves: bool, degree: int
) -> _LocalLight:
    """The functions of nodes around points, up to a degree; arguments as for evaluate_leaf."""
    coefficient = solution.half if halves else solution.coefficient
    s, t = node_coordinates(tree, node, x, y)
    irradiance = basis.move_origin(coefficient[..., node], s, t, tree.degree, degree)
    norm = basis.square_norms(tree.project[node], s, t, tree.degree, min(2 * degree, _VARIANCE_DEGREE)) * tree.area[node]
    per_texel = 2.0 / tree.side[node]
    for terms in (irradiance, norm):
        for k in range(1, terms.shape[-2]):
            terms[..., k, :] *= per_texel ** sum(basis.EXPONENTS[k])
    return _LocalLight(irradiance, solution.variance[:, None, node] * norm)


def node_coordinates(tree: Quadtree, node: NDArray[Any], x: Float64, y: Float64) -> tuple[Float64, Float64]:
    """Coordinates s, t of points in their nodes, each (m,), [-1, 1] inside."""
    half = tree.side[node] / 2.0
    return (x - tree.origin[node, 0]) / half - 1.0, (y - tree.origin[node, 1]) / half - 1.0


@dataclass(frozen=True)
class _LocalLight:
    """Light around points, in monomials of page texels from each: 1, x, y, x^2, xy, y^2.

    irradiance   (2, 3, K, m) float64, W/m^2: see PointLight
    variance     (3, L, m) float64, (W/m^2)^2
    """

    irradiance: Float64
    variance: Float64


@dataclass(frozen=True)
class _Places:
    """Where light is blended: at texels' points or in the middle of cells.

    leaf, page   (m,) int32: its own leaf
    x, y         (m,) float64, page texels
    """

    leaf: NDArray[np.int32]
    page: NDArray[np.int32]
    x: Float64
    y: Float64

    def __getitem__(self, rows: slice | NDArray[Any]) -> _Places:
        return _Places(self.leaf[rows], self.page[rows], self.x[rows], self.y[rows])


@dataclass(frozen=True)
class LeafBlender:
    """Where texels lie and who is next to whom, for blending at any of them.

    page       (n,) int32, of each entry
    entry_at   (n_page, size, size) int32, -1 where no chart covers the texel; of several the one that is shown
    """

    texels: TexelMap
    page: NDArray[np.int32]
    entry_at: NDArray[np.int32]

    @classmethod
    def of(cls, texels: TexelMap, page: NDArray[np.int32]) -> LeafBlender:
        """page   (n,) int32, the page of each entry"""
        entry_at = np.full((texels.page_count, texels.page_size, texels.page_size), -1, np.int32)
        shown = np.flatnonzero(texels.shown)
        entry_at[page[shown], texels.texel_xy[shown, 1], texels.texel_xy[shown, 0]] = shown
        return cls(texels, page, entry_at)

    def blend(
        self, tree: Quadtree, solution: Solution, leaf: NDArray[np.int32], entry: NDArray[Any] | None = None, halves: bool = False
    ) -> PointLight:
        """Light at texel entries.

        leaf     (n,) int32, the leaf at each entry
        entry    (m,) int, all if None
        halves   what each half of the bake says, in place of the components
        """
        entry = np.arange(len(leaf)) if entry is None else entry
        found = self._blend_at(tree, solution, leaf, _Places(leaf[entry], self.page[entry], *self.texels.own_points_at(entry)), halves)
        return PointLight(found.irradiance[:, :, 0], found.variance[:, 0])

    def blend_range(self, tree: Quadtree, solution: Solution, leaf: NDArray[np.int32], start: int, stop: int) -> PointLight:
        """Light at the entries start ... stop - 1, leaf as for blend; asked once for each cell of a leaf.

        Within an eighth of a leaf's side no point of the window comes to another leaf, unless that has less than a quarter of the side:
        over such a cell the blend is one function.
        """
        part = slice(start, stop)
        own_leaf, (x, y) = leaf[part], self.texels.own_points(start, stop)
        # Leaves and cells are ranges of entries, in Morton order.
        cell_bits = 2 * np.maximum(np.log2(tree.side).astype(np.int8) - _CELLS_LOG2, 0)
        place = self.texels.texel_code[part] >> cell_bits[own_leaf]
        first = np.flatnonzero(np.append(True, (place[1:] != place[:-1]) | (own_leaf[1:] != own_leaf[:-1]))[: stop - start])
        count = np.diff(np.append(first, stop - start))
        cells = _Places(own_leaf[first], self.page[part][first], *(np.add.reduceat(values, first) / count for values in (x, y)))
        single, many = np.flatnonzero(count == 1), np.flatnonzero(count > 1)
        alone = self._blend_at(tree, solution, leaf, cells[single])
        if not len(many):
            return PointLight(alone.irradiance[:, :, 0], alone.variance[:, 0])
        joint = self._blend_at(tree, solution, leaf, cells[many], degree=tree.degree)
        cell = np.repeat(np.arange(len(first)), count)
        offset = basis.monomials(x - cells.x[cell], y - cells.y[cell], max(tree.degree, _VARIANCE_DEGREE))

        def spread(of_single: Float64, of_many: Float64) -> Float64:
            """Values at the texels; monomials around cells (..., 1, single) and (..., K, many)."""
            terms = np.zeros((*of_many.shape[:-1], len(first)))
            terms[..., :1, single], terms[..., many] = of_single, of_many
            out = np.zeros((*of_many.shape[:-2], stop - start))
            for row in np.ndindex(out.shape[:-1]):
                if terms[row].any():  # all but light straight from lights where rays tell of that
                    terms[row][0].take(cell, out=out[row], mode="clip")
                    for term, by in zip(terms[row][1:], offset[1:], strict=False):
                        at_texels = term.take(cell, mode="clip")
                        at_texels *= by
                        out[row] += at_texels
            return out

        irradiance, variance = spread(alone.irradiance, joint.irradiance), spread(alone.variance, joint.variance)
        return PointLight(irradiance, np.maximum(variance, 0.0))

    def _blend_at(
        self, tree: Quadtree, solution: Solution, leaf: NDArray[np.int32], places: _Places, halves: bool = False, degree: int = 0
    ) -> _LocalLight:
        """Light around places up to a degree; leaf, halves as for blend."""
        parts = [
            self._blend_part(tree, solution, leaf, places[start : start + _TOGETHER], halves, degree)
            for start in range(0, max(len(places.leaf), 1), _TOGETHER)
        ]
        irradiance, variance = ([getattr(part, name) for part in parts] for name in ("irradiance", "variance"))
        return _LocalLight(np.concatenate(irradiance, axis=-1), np.concatenate(variance, axis=-1))

    def _blend_part(
        self, tree: Quadtree, solution: Solution, leaf: NDArray[np.int32], places: _Places, halves: bool, degree: int
    ) -> _LocalLight:
        own = _describe_leaf(tree, solution, places.leaf, places.x, places.y, halves, degree)
        own_points, row, other, points = self._reached_leaves(tree, leaf, places)
        share = 0.5 if halves else 1.0  # components add up to the light, halves each stand for it
        x, y = places.x[row], places.y[row]
        theirs = _describe_leaf(tree, solution, other, x, y, halves, degree)
        step = share * (theirs.irradiance[:, :, 0].sum(0).mean(0) - own.irradiance[:, :, 0].sum(0).mean(0)[row])
        own_noise, noise = own.variance[:, 0].mean(0)[row], theirs.variance[:, 0].mean(0)
        # A sliver's function runs away beyond its node, and its noise would excuse any step.
        close = np.abs(node_coordinates(tree, other, x, y)).max(0) <= _FARTHEST
        joined = np.flatnonzero(close & (step**2 <= _STEP_SIGMAS**2 * (own_noise + noise)) & (noise <= _NOISIER * own_noise))
        row, points = row[joined], points[joined]
        own_count = 1.0 + own_points  # the place itself is a point too
        count = own_count + np.bincount(row, points, len(own_count))

        def join(mine: Float64, others: Float64, power: int) -> Float64:
            out: Float64 = mine * own_count**power
            weight = points**power
            for term in np.ndindex(out.shape[:-1]):
                out[term] += np.bincount(row, weight * others[term][joined], len(own_count))
            out /= count**power
            return out

        # Points on one leaf err together, leaves err apart.
        return _LocalLight(join(own.irradiance, theirs.irradiance, 1), join(own.variance, theirs.variance, 2))

    def _reached_leaves(
        self, tree: Quadtree, leaf: NDArray[np.int32], places: _Places
    ) -> tuple[NDArray[np.int32], NDArray[Any], NDArray[np.int32], NDArray[np.int64]]:
        """Points (m,) of each window on its own leaf; and rows (k,) of windows, other leaves (k,) that they reach, and points (k,) on them.

        Points beside the window's chart are left out.
        """
        size, own_leaf = self.texels.page_size, places.leaf
        chart, side = tree.chart[own_leaf], tree.side[own_leaf]
        entry_at = self.entry_at.ravel()
        steps = WINDOW * ((np.arange(_STRATA) + 0.5) / _STRATA - 0.5)
        column, row = ([np.floor(at + step * side).astype(np.int64) for step in steps] for at in (places.x, places.y))
        column_inside, row_inside = ([(line >= 0) & (line < size) for line in lines] for lines in (column, row))
        row = [(places.page.astype(np.int64) * size + line) * size for line in row]
        reached = np.empty((_STRATA**2, len(own_leaf)), np.int32)
        own_points = np.zeros(len(own_leaf), np.int32)
        for point, (a, b) in enumerate(product(range(_STRATA), repeat=2)):
            inside = column_inside[a] & row_inside[b]
            entry = entry_at.take(np.where(inside, row[b] + column[a], 0))
            inside &= entry >= 0
            other = leaf.take(np.maximum(entry, 0))
            is_own = other == own_leaf
            own_points += inside & is_own
            reached[point] = np.where(inside & ~is_own & (tree.chart.take(other) == chart), other, -1)
        met = np.flatnonzero(reached.max(axis=0) >= 0)
        ordered = np.sort(reached[:, met].T, axis=1)
        is_new = np.ones(ordered.shape, bool)
        np.not_equal(ordered[:, 1:], ordered[:, :-1], out=is_new[:, 1:])
        start = np.flatnonzero(is_new)
        points, other = np.diff(np.append(start, ordered.size)), ordered.ravel()[start]
        told = other >= 0
        return own_points, met[start[told] // _STRATA**2], other[told], points[told]
