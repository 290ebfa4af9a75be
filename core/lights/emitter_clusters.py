"""Light tree over emitting cells: the importance of a node to a receiver, and descent to a cell.

Source: Conty Estevez and Kulla 2018, "Importance Sampling of Many Lights with Adaptive Tree Splitting": the importance depends on distance,
facing and horizon; a node that is near for its size takes the sum over its children instead.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..util.arrays import BoolArray, Float32, Float64, FloatArray, Int64, IntArray
from ..util.coverage import expand_ranges
from ..util.geometry import dot_rows, take_rows
from .cell_polygons import CellPolygons
from .direct_points import Receivers, row_pieces
from .stratified_choice import Clusters, sort_by_place

_MAX_CLUSTERS = 256
_NEAR = np.float32(16)  # squared distance, in units of a node's `square`, below which its children are evaluated
_AMONG = np.float32(4)  # the same for these children; measured: light by strips 5 mm from a wall takes as long with 2 and with 9
# A receiver is near, too, if its squared distance is below this times that of the farthest corner. Measured on a street by night with 500
# small windows: without it direct light has four times the variance.
_OUTSIDE = np.float32(1.2)
# The same for the closed form of a cell's light as its importance. Measured 1.2 mm below cells of 7 mm: with 4 the standard deviation is
# 0.9 times, with 1 twice that with 2.
_BESIDE = np.float32(2)
_CORNERS_WORK = 16  # cost of a closed form, relative to that of an importance by the centre
_GRAZING = np.float32(0.02)  # least cosine, since importances are evaluated at a normal and position that differ from the receiver's
_BEHIND = np.float32(0.002)  # replaces the cosine of nodes that are certainly below the horizon or face away
RIGHT_ANGLES_APART = 0.25  # unit box: in cut_by_spread, this distance from the mean counts as much as a normal perpendicular to the mean
# Mean squared distance of positions and normals at which cutting ends. Measured: fewer runs are faster to choose from; but with ten times
# this value the additional rays take the time that is saved.
_EVEN = 0.001
_TRIED = 256  # candidate places of a cut
_PARTS, _FEW = 8, 32  # children of a node; a node of at most _FEW cells has the cells as children


@dataclass(frozen=True)
class EmitterClusters:
    """A forest over emitting cells: the first nodes are its roots, the runs; its leaves are single cells.

    runs            the roots as Clusters
    polygons        of the cells
    first, last     (n_node,) int64     the node has the cells first ... last - 1
    below, count    (n_node,) int64     its children are nodes below ... below + count - 1; count is 0 for a single cell
    sealed          (n_node,) bool      whether all of its cells are faces of closed solids whose inside is never seen
    weight          (n_node,) float32   this and the following are as in Clusters
    centre, normal  (n_node, 3) float32
    square, spread  (n_node,) float32
    extent          (n_node,) float32   squared distance of its farthest corner from the centre, unit box squared
    """

    runs: Clusters
    polygons: CellPolygons
    first: Int64
    last: Int64
    below: Int64
    count: Int64
    sealed: BoolArray
    weight: Float32
    centre: Float32
    normal: Float32
    square: Float32
    spread: Float32
    extent: Float32

    @classmethod
    def of(cls, weight: Float64, polygons: CellPolygons) -> EmitterClusters:
        """The forest over cells (n,) in the order of `order_cells`, of importances `weight` (n,)."""
        centre, normal, square = polygons.centre, polygons.normal, polygons.area / math.pi
        weight = weight / max(float(weight.max()), 1e-300)
        starts = [cut_by_spread(weight, np.concatenate([centre / RIGHT_ANGLES_APART, normal], axis=1), _MAX_CLUSTERS, _EVEN)]
        while len(starts[-1]) < len(weight):
            starts.append(_cut_all(starts[-1], len(weight)))
        levels = [Clusters.of(weight, centre, normal, square, start) for start in starts]
        bounds, n_before = [], 0
        for level, after in zip(levels, [*levels[1:], None], strict=True):
            n_before += len(level)
            at = n_before + np.searchsorted(after.start, level.start) if after else np.full(len(level) + 1, n_before)
            bounds.append(np.stack([level.start[:-1], level.start[1:], at[:-1], np.diff(at)]))
        first, last, below, count = np.concatenate(bounds, axis=1)
        hidden = np.concatenate([np.logical_and.reduceat(polygons.sealed, start) for start in starts])
        each = [np.concatenate([getattr(level, name) for level in levels]) for name in ("weight", "centre", "normal", "square", "spread")]
        short = [np.ascontiguousarray(values.T, np.float32).T for values in each]
        short[0] = np.maximum(short[0], np.float32(1e-9))  # a weight of 0 would make a pdf of 0
        short.append(np.concatenate([_find_extent(polygons.corners, level) for level in levels]).astype(np.float32))
        return cls(levels[0], polygons, first, last, below, np.where(last - first > 1, count, 0), hidden, *short)

    @cached_property
    def close(self) -> Float32:
        """(n_node,) float32, unit box squared: squared distance below which single cells have the closed form as importance; else 0."""
        return np.where(self.count == 0, _BESIDE * self.polygons.farthest[self.first], np.float32(0))

    def __len__(self) -> int:
        return len(self.runs)

    def estimate(self, receivers: Receivers, reach: Float32) -> Float32:
        """(n, n_run): importances > 0 of the runs, which approximate their unoccluded irradiance; reach (n,), unit box: receiver radius."""
        centre, normal, square, spread, weight, sealed = (
            getattr(self, name)[: len(self)] for name in ("centre", "normal", "square", "spread", "weight", "sealed")
        )
        place = receivers.position
        away2 = dot_rows(place, place)[:, None] + dot_rows(centre, centre) - 2 * place @ centre.T
        height = receivers.normal @ centre.T - dot_rows(receivers.normal, place)[:, None]
        facing = place @ normal.T - dot_rows(centre, normal)
        out: Float32 = estimate_importance(away2, height, facing, reach[:, None], square, spread, sealed) * weight
        row, run = np.nonzero((away2 < self._reach_of(np.arange(len(self)), _NEAR)) & (self.count[: len(self)] > 0))
        for piece in row_pieces(np.arange(len(row)), _FEW):
            rows, runs = row[piece], run[piece]
            estimated, start, _ = self._estimate_parts(receivers.rows(rows), reach[rows], runs)
            out[rows, runs] = np.add.reduceat(estimated, start)
        row, run = np.nonzero(away2 < self.close[: len(self)])
        out[row, run] = self._estimate_close(out[row, run], receivers, row, run)
        return out

    def find_near(self, place: Float32, distance: Float32) -> BoolArray:
        """(n,) bool: whether a run whose distance and size together are below `distance` (n,) is at a place (n, 3), unit box."""
        centre = self.centre[: len(self)]
        away2 = dot_rows(place, place)[:, None] + dot_rows(centre, centre) - 2 * place @ centre.T
        return (away2 + self.square[: len(self)] < (distance * distance)[:, None]).any(axis=1)

    def choose(self, receivers: Receivers, run: Int64, u: FloatArray) -> tuple[Int64, Float64]:
        """Choose cells of runs (n,), with probabilities (n,): near nodes choose a child by importance, others a cell by weight."""
        node, chance, left = run.copy(), np.ones(len(run)), u.astype(np.float64)
        several = np.flatnonzero(self.count[node])
        nobody = np.zeros(len(run), np.float32)
        while len(several):
            away = take_rows(receivers.position, several) - take_rows(self.centre, node[several])
            near = several[dot_rows(away, away) < self._reach_of(node[several], _NEAR)]
            for rows in row_pieces(near, _FEW):
                estimated, start, parts = self._estimate_parts(receivers.rows(rows), nobody[rows], node[rows])
                picked, chosen, left[rows] = _pick(estimated, start, left[rows])
                node[rows] = parts[picked]
                chance[rows] *= chosen
            several = near[self.count[node[near]] > 0]
        cell = self.first[node]
        far = np.flatnonzero(self.count[node])
        cell[far], within = self.runs.choose_among(self.first[node[far]], self.last[node[far]], left[far])
        chance[far] *= within
        return cell, chance

    def _reach_of(self, node: Int64, squares: np.float32) -> Float32:
        """(n,) float32, unit box squared: squared distance below which a receiver is near to nodes (n,).

        It includes their farthest corners: a receiver at a cell that is far from hundreds of others would otherwise hardly sample it.
        """
        return np.maximum(squares * self.square[node], _OUTSIDE * self.extent[node])

    def _estimate_parts(self, receivers: Receivers, reach: Float32, node: Int64) -> tuple[Float32, Int64, Int64]:
        """Importances (m,) of all children of nodes (n,), in order; the index (n,) of each node's first child among them; and the child
        nodes (m,).

        A child close to the receiver has the sum over its own children, recursively: the centre of several strips is a poor proxy if the
        receiver nearly touches one of them.
        """
        count = self.count[node]
        start = np.cumsum(count) - count
        owner, part = expand_ranges(self.below[node], self.below[node] + count)
        looking, normal = receivers.rows(owner), take_rows(self.normal, part)
        away = take_rows(self.centre, part) - looking.position
        square, height, facing = dot_rows(away, away), dot_rows(away, looking.normal), -dot_rows(away, normal)
        estimated = estimate_importance(square, height, facing, reach[owner], self.square[part], self.spread[part], self.sealed[part])
        estimated *= self.weight[part]
        rows = np.flatnonzero((square < self._reach_of(part, _AMONG)) & (self.count[part] > 0))
        for piece in row_pieces(rows, _FEW):
            whose = owner[piece]
            below, begin, _ = self._estimate_parts(receivers.rows(whose), reach[whose], part[piece])
            estimated[piece] = np.add.reduceat(below, begin)
        rows = np.flatnonzero(square < self.close[part])
        estimated[rows] = self._estimate_close(estimated[rows], receivers, owner[rows], part[rows])
        return estimated, start, part

    def _estimate_close(self, estimated: Float32, receivers: Receivers, row: Int64, node: Int64) -> Float32:
        """(n,): the greater of an importance (n,) and that by the closed form, of single cells, nodes (n,), at receivers `row` (n,)."""
        out = estimated.copy()
        for piece in row_pieces(np.arange(len(row)), _CORNERS_WORK):
            of, own = node[piece], receivers.rows(row[piece])
            given = self.polygons.irradiance(self.first[of], own) / self.polygons.area[self.first[of]]
            out[piece] = np.maximum(estimated[piece], given * self.weight[of])
        return out


def _find_extent(corners: Float32, level: Clusters) -> Float32:
    """(n_cluster,) float32: EmitterClusters.extent; corners (n, 4, 3) of all cells."""
    away = corners - np.repeat(level.centre, level.count, axis=0)[:, None]
    return np.maximum.reduceat((away * away).sum(axis=2).max(axis=1), level.start[:-1])


def _pick(estimated: Float32, start: Int64, u: Float64) -> tuple[Int64, Float64, Float64]:
    """Choose one entry (m,) of each group by importance: its index, its probability, and u rescaled to be uniform in [0, 1] again.

    start   (n,): first entries of the groups
    """
    count = np.diff(start, append=len(estimated))
    chances = estimated / np.repeat(np.add.reduceat(estimated, start, dtype=np.float64), count)
    end = np.cumsum(chances)
    before = np.append(0.0, end)[start]
    target = before + u
    picked = np.clip(np.searchsorted(end, target, side="right"), start, start + count - 1)
    chance: Float64 = chances[picked]
    return picked, chance, np.clip((target - end[picked] + chance) / chance, 0, 1)


def _cut_all(start: Int64, end: int) -> Int64:
    """First cells of the children of all nodes: single cells of short nodes, else _PARTS children of about equal length."""
    count = np.diff(start, append=end)
    n_part = np.where(count > _FEW, _PARTS, count)
    run, part = expand_ranges(np.zeros_like(n_part), n_part)
    return start[run] + count[run] * part // n_part[run]


def estimate_importance(
    square: Float32, height: Float32, facing: Float32, reach: Float32, own_square: Float32, spread: Float32, sealed: BoolArray
) -> Float32:
    """Importance for unit weight: height * facing / (square * (square + own_square)), that is cos * cos' / (r^2 + own_square).

    square       squared distance of receiver and emitter; reach, radius around the receiver, adds its square
    height       of the emitter above the receiver's horizon, r cos; facing, of the receiver above the emitter's, r cos'; both with floors
    own_square   squared size of the emitter; spread, of its normals
    """
    square = np.maximum(square, np.float32(1e-9)) + reach * reach
    distance = np.sqrt(square)
    height, facing = height + reach, np.where(sealed, facing, np.abs(facing)) + reach
    least = np.where(height > -np.sqrt(own_square), _GRAZING, _BEHIND) * distance
    out: Float32 = np.maximum(height, least)
    uneven = np.maximum(spread, _GRAZING)
    least = np.where(facing > -uneven * distance, uneven, _BEHIND) * distance
    out *= np.maximum(facing, least)
    out /= square * (square + own_square)
    return out


def order_cells(polygons: CellPolygons) -> Int64:
    """Order of cells (n,): unsealed cells first, then by normal and along a Morton curve, so that runs are compact."""
    by_place = sort_by_place(polygons.centre, polygons.normal)
    return by_place[np.argsort(polygons.sealed[by_place], kind="stable")]


def cut_by_spread(weight: Float64, place: FloatArray, most: int, even: float) -> Int64:
    """First entries of at most `most` runs of entries (n,) whose positions (n, k) are close to each other.

    Greedy top-down clustering: the run with the greatest weighted sum of squared distances from its mean is cut where the sum over both
    parts is least, until the mean over all entries is at most `even`.
    """
    weight = weight + 1e-9 * max(float(weight.max()), 1e-300)  # entries of weight 0 count a little
    mass = np.append(0.0, np.cumsum(weight))
    moment = np.concatenate([np.zeros((1, place.shape[1])), np.cumsum(place * weight[:, None], axis=0)])
    second = np.append(0.0, np.cumsum((place * place).sum(axis=1) * weight))

    def unevenness(first: IntArray | int, last: IntArray | int) -> Float64:
        centre = moment[last] - moment[first]
        return second[last] - second[first] - (centre * centre).sum(axis=-1) / (mass[last] - mass[first])

    runs = [(-float(unevenness(0, len(weight))), 0, len(weight))]
    left = -runs[0][0]
    while len(runs) < most and left > even * mass[-1]:
        uneven, first, last = heapq.heappop(runs)
        tried = np.unique(np.linspace(first + 1, last - 1, min(_TRIED, last - first - 1)).astype(np.int64))
        both = unevenness(first, tried) + unevenness(tried, last)
        cut = int(tried[both.argmin()])
        left += uneven
        for part in ((first, cut), (cut, last)):
            of_part = float(unevenness(*part)) if part[1] - part[0] > 1 else 0.0
            left += of_part
            heapq.heappush(runs, (-of_part, *part))
    return np.sort(np.array([first for _, first, _ in runs], np.int64))
