"""Closes seams, where bilinear filtering reads the same point of a surface from different texels on both sides.

A least squares problem changes the texels along seams so that points on them get equal bilinear values, with as little change as possible.
Its weights are inverse squares of each texel's uncertainty: empty texels beside a chart, which filtering reads too, change most, then
texels whose centres the chart does not cover; all others by little more than their noise.

Source: Sylvan 2015, "Fixing lightmap seams"; Iwanicki 2013, "Lighting technology of The Last of Us"; Ray, Nivoliers, Lefebvre &
Levy 2010, "Invisible seams".
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..texels.seam_points import SeamPoints

Float32: TypeAlias = NDArray[np.float32]
Float64: TypeAlias = NDArray[np.float64]
Int32: TypeAlias = NDArray[np.int32]
Int64: TypeAlias = NDArray[np.int64]

# Uncertainties relative to the local light plus _FLOOR times the mean light:
_STEP = 0.02  # of the step between both sides of a point
_CENTRE = 0.02  # of a texel whose centre a chart covers, besides its noise
_EMPTY = 0.1  # of an empty texel, which is the mean of its neighbours
_FLOOR = 0.1
# Uncertainties relative to the standard deviation of the texels around, which estimates the gradient of light:
_SPREAD_PART = 0.6  # of a texel whose sample lies half a texel from its centre
_SPREAD_EMPTY = 2.0  # of an empty texel, which lies more than a texel from those whose mean it is
_REACH = 2  # texels around
_GRAIN = 0.5  # factor on a texel's standard error, which is that before the filter
_MOST_SIGMAS = 3.0  # a step above so many times the uncertainty of both sides is an edge of light, as where something touches the seam
_AROUND = tuple(sorted(product(range(-_REACH, _REACH + 1), repeat=2), key=lambda step: max(map(abs, step))))
_FARTHEST = 2.0  # greatest change of a texel over its uncertainty
_ITERATIONS = 40  # at most
_RESIDUAL = 1e-3  # relative residual at which the iterations end
_DARKEST = 1e-30  # W/m^2


@dataclass(frozen=True)
class EmptyTexels:
    """Texels beside charts that get light of their own; the margin is filled from them.

    page     (m,) int32
    xy       (m, 2) int64, page texel
    tri      (m,) int32: triangle whose surface they show
    weight   (m, 2) float32, of its corners 1 and 2
    light    (k, m, 3) float32, W/m^2
    """

    page: Int32
    xy: Int64
    tri: Int32
    weight: Float32
    light: Float32


_NO_TEXELS = np.zeros(0, np.int32), np.zeros((0, 2), np.int64), np.zeros(0, np.int32), np.zeros((0, 2), np.float32)


@dataclass(frozen=True)
class SeamReport:
    """Number of edges, number of covered texels that may change, and RMS steps at points of seams relative to the local light."""

    edges: int
    texels: int
    step_before: float
    step_after: float


def match_seams(
    points: SeamPoints, light: Sequence[Float32], stderr: Float32, is_central: NDArray[np.bool_], entry_at: Int32
) -> tuple[list[Float32], EmptyTexels, SeamReport]:
    """The light with seams closed, light for empty texels beside them, and a report. There must be at least one point.

    light        parts of the light at the texel entries, each (n, 3) float32, W/m^2
    stderr       (n, 3) float32, W/m^2, of their sum
    is_central   (n,) bool: whether the texel's centre is covered
    entry_at     (n_page, size, size) int32: the entry that a texel shows, -1 where no chart covers it
    """
    parts = len(light)
    system, entry = _System.of(points, is_central, entry_at)
    if not len(entry):  # no chart covers a texel near the points
        none = EmptyTexels(*_NO_TEXELS, np.zeros((parts, 0, 3), np.float32))
        return [part.copy() for part in light], none, SeamReport(points.n_edge, 0, 0.0, 0.0)
    near = np.stack([part.take(entry, axis=0) for part in light])
    keep, pull = system.weigh(near.sum(axis=0).mean(axis=1), np.sqrt((stderr.take(entry, axis=0) ** 2).mean(axis=1)))
    before = system.gather(near.transpose(1, 0, 2).reshape(len(entry), -1))
    change = system.solve(before, keep, pull)
    shift = np.abs(change.reshape(-1, parts, 3).sum(axis=1).mean(axis=1))
    change *= np.minimum(_FARTHEST / np.sqrt(keep) / np.maximum(shift, _DARKEST), 1.0)[:, None]
    after = np.maximum(before + change, 0.0)
    shown = after.reshape(-1, parts, 3).transpose(1, 0, 2)
    matched = [part.copy() for part in light]
    for part, values in zip(matched, shown, strict=True):
        part[entry[system.near[system.covered, 0]]] = values[system.covered]
    report = SeamReport(points.n_edge, int(system.covered.sum()), system.step(before), system.step(after))
    return matched, system.empty(points, shown), report


@dataclass(frozen=True)
class _System:
    """The least squares problem: texels that may change, and how points on seams read them.

    size             side of a page, texels
    cell             (v,) int64: flat index of each such texel among those of all pages
    covered          (v,) bool
    central          (v,) bool: whether its centre is covered
    near             (v, 25) int32: rows of the texels around in the list of all used entries, the texel itself first, then the nearest;
                     -1 for none
    column, weight   (m, 8) int64, float64: a step is the weighted sum of these texels, the reading of one side minus that of the other
    """

    size: int
    cell: Int64
    covered: NDArray[np.bool_]
    central: NDArray[np.bool_]
    near: Int32
    column: Int64
    weight: Float64

    @classmethod
    def of(cls, points: SeamPoints, is_central: NDArray[np.bool_], entry_at: Int32) -> tuple[_System, Int64]:
        """The system, and the list (k,) of all texel entries that it uses."""
        size = entry_at.shape[1]
        read, weight = _read_bilinear(points, size)
        cell, column = np.unique(read, return_inverse=True)
        near = np.full((len(cell), len(_AROUND)), -1, np.int32)
        steps = range(-_REACH, _REACH + 1)
        inside_x, inside_y = ({step: (at + step >= 0) & (at + step < size) for step in steps} for at in (cell % size, cell // size % size))
        for k, (dy, dx) in enumerate(_AROUND):
            inside = inside_x[dx] & inside_y[dy]
            near[inside, k] = entry_at.ravel()[cell[inside] + dy * size + dx]
        covered = near[:, 0] >= 0
        central = covered.copy()
        central[covered] = is_central[near[covered, 0]]
        looked_at = np.zeros(len(is_central) + 1, bool)  # -1 is the last
        looked_at[near] = True
        entry = np.flatnonzero(looked_at[:-1])
        row_of = np.full(len(looked_at), -1, np.int32)
        row_of[entry] = np.arange(len(entry), dtype=np.int32)
        return cls(size, cell, covered, central, row_of[near], column.reshape(read.shape), weight), entry

    def gather(self, values: NDArray[Any]) -> Float64:
        """(v, c): values of the texels, from (k, c) of all used entries; empty ones get the mean of covered neighbours, as in margins."""
        out: Float64 = values[self.near[:, 0]].astype(np.float64)
        near = self.near[~self.covered, 1:9]
        known = near >= 0
        out[~self.covered] = (values[near] * known[..., None]).sum(axis=1) / np.maximum(known.sum(axis=1), 1)[:, None]
        return out

    def weigh(self, total: Float32, noise: Float32) -> tuple[Float64, Float64]:
        """Weights against changes of texels (v,) and against steps at points (m,): inverse squared uncertainties.

        total, noise   (k,) float32, W/m^2: light at all used entries, and its standard error
        """
        value, doubt = self.gather(np.stack([total, noise], axis=1)).T
        level = value + _FLOOR * value.mean() + _DARKEST
        known = self.near >= 0
        count = np.maximum(known.sum(axis=1), 1)
        around = np.where(known, total.take(self.near, mode="wrap"), 0.0)
        mean = around.sum(axis=1) / count
        spread = np.sqrt((known * (around - mean[:, None]) ** 2).sum(axis=1) / count)
        part = np.where(self.central, 0.0, _SPREAD_PART * spread)
        off = np.where(self.covered, np.hypot(_GRAIN * doubt, _CENTRE * level) + part, _EMPTY * level + _SPREAD_EMPTY * spread)
        readings = np.abs(self.weight) * off[self.column]
        # Errors of neighbours are correlated, so their standard errors add up.
        unsure = np.hypot(readings[:, :4].sum(axis=1), readings[:, 4:].sum(axis=1))
        local = 0.5 * (np.abs(self.weight) * level[self.column]).sum(axis=1)
        step = (self.weight * value[self.column]).sum(axis=1)
        return 1.0 / off**2, np.where(np.abs(step) <= _MOST_SIGMAS * unsure, 1.0 / (_STEP * local) ** 2, 0.0)

    def solve(self, before: Float64, keep: Float64, pull: Float64) -> Float64:
        """(v, c): the change that minimises sum keep * change^2 + sum pull * step^2.

        Source: Hestenes & Stiefel 1952, "Methods of conjugate gradients for solving linear systems"; preconditioned by the diagonal.
        """
        diagonal = np.bincount(self.column.ravel(), (self.weight**2 * pull[:, None]).ravel(), len(keep)) + keep
        change = np.zeros_like(before)
        residual = -self._pull(before, pull)
        scaled = residual / diagonal[:, None]
        direction, power = scaled, (residual * scaled).sum(axis=0)
        enough = _RESIDUAL**2 * power
        for _ in range(_ITERATIONS):
            if not (power > enough).any():
                break
            image = self._pull(direction, pull) + keep[:, None] * direction
            size = power / np.maximum((direction * image).sum(axis=0), np.finfo(np.float64).tiny)
            change += size * direction
            residual = residual - size * image
            scaled = residual / diagonal[:, None]
            new_power = (residual * scaled).sum(axis=0)
            direction = scaled + new_power / np.maximum(power, np.finfo(np.float64).tiny) * direction
            power = new_power
        return change

    def step(self, values: Float64) -> float:
        """Root mean square of the steps at points, relative to the local light plus a tenth of its mean."""
        if not len(self.column):
            return 0.0
        total = values.reshape(len(values), -1, 3).sum(axis=1).mean(axis=1)
        local = 0.5 * (np.abs(self.weight) * total[self.column]).sum(axis=1)
        return float(np.sqrt(((self._find_steps(total) / (local + 0.1 * local.mean() + _DARKEST)) ** 2).mean()))

    @cached_property
    def _turned(self) -> tuple[Int64, Float64]:
        """column and weight, transposed to (8, m)."""
        return np.ascontiguousarray(self.column.T), np.ascontiguousarray(self.weight.T)

    def _find_steps(self, values: Float64) -> Float64:
        """(m,): steps at points for values (v,) of texels."""
        column, weight = self._turned
        read = weight * values.take(column)
        while len(read) > 1:  # adding pairs of long rows is several times faster than summing eight numbers each
            read = read[::2] + read[1::2]
        steps: Float64 = read[0]
        return steps

    def _pull(self, values: Float64, pull: Float64) -> Float64:
        """(v, c): half the gradient of sum pull * step^2 with respect to values (v, c) of texels."""
        out, column = np.empty_like(values), self.column.ravel()
        for c, of_channel in enumerate(np.ascontiguousarray(values.T)):
            steps = pull * self._find_steps(of_channel)
            out[:, c] = np.bincount(column, (self.weight * steps[:, None]).ravel(), len(self.cell))
        return out

    def empty(self, points: SeamPoints, light: Float64) -> EmptyTexels:
        """The empty texels, each with the surface at the point that reads it with the greatest weight."""
        order = np.argsort(np.abs(self.weight).ravel(), kind="stable")  # of several assignments to one place the last stays
        place = np.zeros(len(self.cell), np.int64)
        place[self.column.ravel()[order]] = order
        place = place[~self.covered]
        point, side = place // 8, place % 8 // 4
        cell = self.cell[~self.covered]
        xy = np.stack([cell % self.size, cell // self.size % self.size], axis=1)
        page = (cell // self.size**2).astype(np.int32)
        return EmptyTexels(page, xy, points.tri[side, point], points.weight[side, point], light[:, ~self.covered].astype(np.float32))


def _read_bilinear(points: SeamPoints, size: int) -> tuple[Int64, Float64]:
    """Flat indices (m, 8) of the texels that points read, four on each side, and weights (m, 8), negative on the second side."""
    corner = np.clip(points.place - 0.5, 0.0, size - 1.0)
    low = np.minimum(np.floor(corner).astype(np.int64), size - 2)
    part = corner - low
    cells, weights = [], []
    for side, sign in ((0, 1.0), (1, -1.0)):
        for dy, dx in product((0, 1), repeat=2):
            x, y = low[side, :, 0] + dx, low[side, :, 1] + dy
            cells.append((points.page[side].astype(np.int64) * size + y) * size + x)
            across = part[side, :, 0] if dx else 1.0 - part[side, :, 0]
            weights.append(sign * across * (part[side, :, 1] if dy else 1.0 - part[side, :, 1]))
    return np.stack(cells, axis=1), np.stack(weights, axis=1)
