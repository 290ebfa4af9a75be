"""Sampling of many lights: clusters, stratified sampling of these, and rays until the standard error is within the tolerance."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..scene.morton import code_places, find_facing
from ..texels.tiles import Tiles
from ..util.arrays import BoolArray, Float32, Float64, FloatArray, Int64, IntArray
from ..util.brightness import weigh_channels
from .direct_points import STAGES, Receivers, row_pieces

BLOCK_TEXELS = 64  # neighbours in Morton order, 8 x 8 within a chart, that share visibility and the stopping rule

Span: TypeAlias = tuple[int, int]  # rays first ... last - 1 of a texel


@dataclass(frozen=True)
class Demand:
    """Required standard error of the light of a chunk's texels, and which of them may share samples.

    tolerance   standard error, relative to a texel's light, at which a light gets no more rays
    flat        tiles that lie on one triangle, whose texels share their first samples and pdfs
    alone       (n,) bool: texels that share no samples with their neighbours; None for none
    """

    tolerance: float
    flat: Tiles = field(default_factory=Tiles.none)
    alone: BoolArray | None = None

    def are_alone(self, rows: Int64) -> BoolArray | None:
        """(m,) bool: `alone` of the texels `rows` (m,); None if no texel is."""
        return None if self.alone is None else self.alone[rows]


@dataclass(frozen=True)
class Clusters:
    """Sorted emitters in runs, the clusters; within a cluster an emitter is chosen by importance.

    weight_end   (n + 1,) float64           cumulative importance
    start        (n_cluster + 1,) int64
    centre       (n_cluster, 3) float32, unit box
    normal       (n_cluster, 3) float32     mean normal; short if the emitters face many directions
    square       (n_cluster,) float32       mean squared distance of its emitters from the centre, plus their squared size
    """

    weight_end: Float64
    start: Int64
    centre: Float32
    normal: Float32
    square: Float32

    @classmethod
    def of(cls, weight: Float64, centre: FloatArray, normal: FloatArray, own_square: FloatArray, start: Int64) -> Clusters:
        """Clusters of consecutive emitters, which begin at `start`; own_square (n,) is the emitters' squared size."""
        every = np.arange(len(weight))
        weight_end = np.concatenate([[0.0], np.cumsum(weight)])
        total = np.maximum(np.add.reduceat(weight, start), 1e-300)
        mean_centre = np.add.reduceat(centre * weight[:, None], start, axis=0) / total[:, None]
        mean_normal = np.add.reduceat(normal * weight[:, None], start, axis=0) / total[:, None]
        cluster = np.repeat(np.arange(len(start)), np.diff(np.append(start, len(every))))
        square = ((centre - mean_centre[cluster]) ** 2).sum(axis=1) + own_square
        mean_square = np.add.reduceat(square * weight, start) / total
        return cls(
            weight_end,
            np.append(start, len(every)).astype(np.int64),
            mean_centre.astype(np.float32),
            mean_normal.astype(np.float32),
            mean_square.astype(np.float32),
        )

    def __len__(self) -> int:
        return len(self.start) - 1

    @cached_property
    def weight(self) -> Float64:
        """(n_cluster,) float64."""
        return np.diff(self.weight_end[self.start])

    @cached_property
    def count(self) -> Int64:
        """(n_cluster,) int64: number of emitters."""
        return np.diff(self.start)

    @cached_property
    def spread(self) -> Float32:
        """(n_cluster,) float32: sqrt(1 - |normal|^2), 0 if all emitters face the same way, at most 1."""
        return np.sqrt(np.maximum(1 - (self.normal**2).sum(axis=1), 0))

    def choose(self, cluster: Int64, u: FloatArray) -> tuple[Int64, Float64]:
        """Emitters of clusters (n,) by importance, and their probabilities within the cluster."""
        if len(self) == len(self.weight_end) - 1:  # each is its own cluster
            return cluster, np.ones(len(cluster))
        return self.choose_among(self.start[cluster], self.start[cluster + 1], u)

    def choose_among(self, first: Int64, last: Int64, u: FloatArray) -> tuple[Int64, Float64]:
        """As choose, among emitters first ... last - 1, (n,)."""
        low, width = self.weight_end[first], self.weight_end[last] - self.weight_end[first]
        chosen = np.clip(np.searchsorted(self.weight_end, low + u * width, side="right") - 1, first, last - 1)
        return chosen, np.maximum(self.weight_end[chosen + 1] - self.weight_end[chosen], 1e-300) / width


def cut_evenly(weight: Float64, most: int) -> Int64:
    """First entries of at most `most` runs of about equal weight; weight (n,)."""
    if len(weight) <= most:
        return np.arange(len(weight))
    end = np.append(0.0, np.cumsum(weight))
    start = np.searchsorted(end, end[-1] * np.arange(most) / most, side="right") - 1
    return np.unique(np.clip(start, 0, len(weight) - 1))


def find_reach(starts: FloatArray, count: int) -> Float32:
    """(count,) float32: about half the diagonal of each texel; starts (k * count, 3) are k points per texel."""
    place = starts.reshape(-1, count, 3)
    return np.sqrt(((place - place.mean(axis=0)) ** 2).sum(axis=2).max(axis=0)) * np.float32(math.sqrt(3))


def cumulate(chances: FloatArray, first: int, out: Float64) -> None:
    """Write to out (n, n_cluster) float64 the cdf of each row r, plus first + r, so that one binary search finds entries of all rows."""
    np.cumsum(chances, axis=1, out=out)
    out /= np.maximum(out[:, -1:], 1e-300)
    out += np.arange(first, first + len(out))[:, None]


def choose(end: Float64, row: Int64, u: FloatArray) -> tuple[Int64, Float64, Float64]:
    """Choose a cluster from the cdf of each row (n,) or (k, n) of `end`, from `cumulate`, by u in [0, 1), of the same shape.

    out   (n,) or (k * n,): cluster int64, its probability, and u rescaled to be uniform in [0, 1] again
    """
    n_cluster = end.shape[1]
    target = u + row
    # Searched row by row, for locality of memory.
    found = np.searchsorted(end.ravel(), np.ravel(target, order="F"), side="right").reshape(target.shape, order="F")
    target, row = target.ravel(), row.ravel()
    cluster = np.clip(found.ravel() - row * n_cluster, 0, n_cluster - 1)
    low = np.where(cluster > 0, end[row, np.maximum(cluster - 1, 0)], row)
    chance = np.maximum(end[row, cluster] - low, 1e-12)
    return cluster, chance, np.clip((target - low) / chance, 0, 1)


def draw_strata(turn: NDArray[np.uint32], count: int, rng: np.random.Generator) -> tuple[Int64, Float64]:
    """A number in each of `count` strata of [0, 1) for n rows: the strata (count, n) int64 and the numbers (count, n) float64.

    turn   (n,) uint32   rotates the order of each row's strata, to decorrelate them from places in the texel
    """
    step = (np.arange(count)[:, None] + turn % count) % count
    return step, (step + rng.random((count, len(turn)))) / count


def choose_by_importance(
    receivers: Receivers, n_cluster: int, estimate: Callable[[Receivers, Float32], Float32], u: FloatArray
) -> Iterator[tuple[Int64, Int64, Float64, Float64]]:
    """Choose a cluster for each of n receivers by its importance and u (n,) in [0, 1).

    estimate   returns importances (k, n_cluster) at k receivers, for radii (k,) around them
    Yields pieces of the receivers: their rows (k,), and clusters, probabilities and random numbers (k,) as `choose` returns them.
    """
    for rows in row_pieces(np.arange(len(receivers.position)), n_cluster):
        end = np.empty((len(rows), n_cluster))
        cumulate(estimate(receivers.rows(rows), np.zeros(len(rows), np.float32)), 0, end)
        yield rows, *choose(end, np.arange(len(rows)), u[rows])


def in_order(step: Int64, values: FloatArray) -> Float64:
    """(k, n, 3) float64: values (k * n, 3) of n rows in the order of their strata, step (k, n)."""
    ordered = np.empty((*step.shape, 3))
    ordered[step, np.arange(step.shape[1])] = values.reshape(*step.shape, 3)
    return ordered


def sample_adaptively(
    gather: Callable[[IntArray, Span], tuple[Float64, int]],
    rows: IntArray,
    demand: Demand,
    base_rgb: Float64,
    stages: Sequence[Span] = STAGES,
    learn: Callable[[IntArray], None] = lambda rows: None,
    foreseen: tuple[Float64, Float64] | None = None,
    gain: Callable[[Int64], Float64] | None = None,
) -> tuple[Float64, Float64, int]:
    """Sample until the standard error is within the tolerance. Returns irradiance (n, 3), its variance (n, 3), both 0 outside of the rows,
    and the number of rays.

    gather     for some rows and a span of rays, returns estimates (k, len(rows), 3) in the order of their strata, and the number of rays
    base_rgb   (n, 3) float64, W/m^2: other light; the tolerance is relative to the sum
    learn      called after the first span, with the rows that continue
    foreseen   two (n,) float64: predicted mean and variance of a ray, from independent pilot rays. With it the stopping rule uses the
               predicted variance and the block's sample variance, not the texel's, which is 0 if all of its rays miss
    gain       takes the number of rays so far (n,) and returns the factor by which successive differences overestimate the variance, for
               rays stratified in two dimensions; default 1
    """
    count, n_ray = len(base_rgb), 0
    total, squares = np.zeros((count, 3)), np.zeros((count, 3))
    if not len(rows):
        return total, squares, n_ray
    taken, asked = np.ones(count, np.int64), np.zeros(count, bool)
    taken[rows], asked[rows] = 0, True
    for first, last in stages:
        for piece in row_pieces(rows, last - first):
            value, traced = gather(piece, (first, last))
            n_ray += traced
            total[piece] += value.sum(axis=0)
            # Variance by successive differences of neighbouring strata. Source: Wolter 1984.
            squares[piece] += ((value[0::2] - value[1::2]) ** 2).sum(axis=0)
            taken[piece] += last - first
        if last == stages[-1][1]:
            break
        error, mean = weigh_channels(squares) / taken**2, total / taken[:, None]
        if gain is not None:
            error /= gain(taken)
        allowed = (demand.tolerance * weigh_channels(base_rgb + mean)) ** 2
        # Stopping by a texel's own sample variance alone is biased, so a block also shares the rule.
        worse = np.add.reduceat((error - allowed) * asked, np.arange(0, count, BLOCK_TEXELS)) > 0
        doubt = np.repeat(worse, BLOCK_TEXELS)[:count]
        if foreseen is None:
            doubt |= error > allowed
        else:
            doubt |= foreseen[1] / taken > (demand.tolerance * (weigh_channels(base_rgb) + foreseen[0])) ** 2
        rows = rows[doubt[rows]]
        if first == 0:
            learn(rows)
    variance = squares / taken[:, None] ** 2
    if gain is not None:
        variance /= gain(taken)[:, None]
    return total / taken[:, None], variance, n_ray


def sort_by_place(centre: FloatArray, normal: FloatArray) -> Int64:
    """Order of emitters by the signed axis nearest to the normal, then along a Morton curve."""
    place = (np.clip(centre + 0.5, 0, 1) * 1023).astype(np.int64)
    return np.lexsort((code_places(place), find_facing(normal)))


def sum_regions(counts: FloatArray, n_block: int) -> Float64:
    """(n, ...): for each of n blocks, the sum of counts (n, ...) over its region of n_block consecutive blocks."""
    first = np.arange(0, len(counts), n_block)
    return np.repeat(np.add.reduceat(counts, first, axis=0), np.diff(first, append=len(counts)), axis=0)
