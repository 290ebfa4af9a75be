"""Direct light from many emitting triangles: importance sampling of clusters, with shared visibility per block of texels."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..scene.materials import SurfaceMaterials
from ..scene.shadow_rays import ShadowRays
from ..scene.slender_triangles import find_corners, whole_parts
from ..util.arrays import BoolArray, Float32, Float64, FloatArray, Int64, IntArray
from ..util.geometry import ORIGIN_OFFSET, dot_rows, take_rows
from .direct_lights import Aim
from .direct_points import GAUSS_POINTS, MIDDLE, STAGES, Receivers, ReceivingSurfaces, TexelChunk, light_points, random_shift, row_pieces
from .emitter_clusters import EmitterClusters, order_cells
from .emitting_cells import EmittingCells
from .irradiance import polygon_irradiance
from .stratified_choice import (
    BLOCK_TEXELS,
    Demand,
    Span,
    choose_by_importance,
    choose_by_strata,
    cumulate,
    find_reach,
    in_order,
    sample_adaptively,
    sum_regions,
)

_SPANS = ((0, STAGES[1][1]), STAGES[2])  # of a texel's rays: the first 4 may all miss the emitters
_TOGETHER = 16  # texels of a quarter of a tile, which share a pdf
_DIAGONAL = GAUSS_POINTS[[0, 3]]  # of a texel
_PROBES = (0, 5, 10, 15)  # the quarter's corners, at which the importances are evaluated and summed
_PILOTS = 4  # receivers of a block that first trace a ray to every cluster
_REGION_BLOCKS = 16  # blocks whose pilots' mean visibility of a cluster is a prior
_UNSEEN_LEAST, _UNSEEN_MOST = 0.05, 0.4  # bounds of the importance's factor for a pilot that did not see the cluster
_ON_HORIZON = 1e-3  # roots of a triangle's area below the horizon that count as on it
_CORNERS_WORK = 16  # cost of a triangle's closed form, relative to a cluster's importance
_NEAR = 4.0  # the closed form is used below this ratio of squared distance to the triangle's area


@dataclass(frozen=True)
class EmitterPool:
    """Emitting cells, sorted so that clusters of consecutive ones are compact and of similar normals.

    constant         (n,) bool                          the cell is a triangle, or part of one, of constant radiance
    area             (n,) float64, unit box squared
    sealed           (n,) bool                          the cell's back is never visible
    """

    cells: EmittingCells
    constant: BoolArray
    area: Float64
    sealed: BoolArray
    clusters: EmitterClusters
    scene: ReceivingSurfaces
    surfaces: SurfaceMaterials

    @cached_property
    def corners(self) -> Float32:
        """(n, 3, 3) float32, unit box: corners of the cells' triangles, or of their parts."""
        own = self.scene.corner_unit[self.cells.tri]
        return own if self.cells.part is None else find_corners(own, self.cells.part)

    @cached_property
    def middle(self) -> Float32:
        """(n, 3) float32, unit box: centroids of the cells' triangles, or of their parts."""
        return self.corners.mean(axis=1)

    @cached_property
    def _alone(self) -> Int64:
        """(m,) int64: runs of a single cell of constant radiance."""
        return np.flatnonzero((self.clusters.runs.count == 1) & self.constant[self.clusters.first[: len(self.clusters)]])

    @classmethod
    def of(
        cls, groups: list[EmittingCells], scene: ReceivingSurfaces, scale: float, surfaces: SurfaceMaterials, tri_sealed: BoolArray
    ) -> EmitterPool:
        """A pool of the cells of several materials; scale is the unit box's, tri_sealed (n_tri,) that of EmittingMeshes."""
        importance = np.concatenate([group.importance for group in groups])
        constant = np.concatenate([np.full(len(group.tri), group.constant) for group in groups])
        tri = np.concatenate([group.tri for group in groups])
        corner, side, area_m2, mean_rgb = (
            np.concatenate([getattr(group, name) for group in groups]) for name in ("corner", "side", "area_m2", "mean_rgb")
        )
        part = None
        if any(group.part is not None for group in groups):
            part = np.concatenate([whole_parts(len(group.tri)) if group.part is None else group.part for group in groups])
        every = np.arange(len(tri))
        cells = EmittingCells(tri, corner, side, area_m2, mean_rgb, False, part)
        _, barycentric = cells.place(every, np.full((len(tri), 2), 0.5))
        centre, normal = scene.place(tri, barycentric[:, 0], barycentric[:, 1]), scene.normal[tri]
        order = order_cells(centre, normal, tri_sealed[tri])
        part = None if part is None else part[order]
        cells = EmittingCells(tri[order], corner[order], side[order], area_m2[order], mean_rgb[order], False, part)
        area, weight, centre, normal = area_m2[order] * scale**2, importance[order], centre[order], normal[order]
        sealed = tri_sealed[cells.tri]
        clusters = EmitterClusters.of(weight, centre, normal, area / math.pi, sealed)
        return cls(cells, constant[order], area, sealed, clusters, scene, surfaces)

    def irradiance(
        self, rays: ShadowRays, chunk: TexelChunk, demand: Demand, base_rgb: Float64, rng: np.random.Generator
    ) -> tuple[Float64, Float64, int]:
        """Irradiance (n, 3) and its variance (n, 3) of the chunk's texels, and the number of rays.

        base_rgb   (n, 3) float64, W/m^2: other light at the texels; the tolerance is relative to the sum
        """
        end, group, n_ray = self._choose_clusters(rays, chunk, demand.flat.texels(), rng)
        shift, turn = random_shift(rng, len(chunk)), random_shift(rng, len(chunk))[:, 0]

        def gather(rows: IntArray, span: Span) -> tuple[Float64, int]:
            return self._gather(rays, chunk, rows, (end, group), (shift, turn), span, rng)

        total, variance, traced = sample_adaptively(gather, np.arange(len(chunk)), demand, base_rgb, _SPANS)
        return total, variance, n_ray + traced

    def choose(self, receivers: Receivers, rng: np.random.Generator) -> tuple[Float64, Aim]:
        """Radiance (n, 3) of a place on an emitting cell for each of n receivers, chosen by importance; and the ray there, whose weight is
        the irradiance per unit of radiance over its probability.
        """
        count = len(receivers.position)
        cell, chance = np.empty(count, np.int64), np.empty(count)
        for rows, run, of_run, rest in choose_by_importance(receivers, len(self.clusters), self._estimate, rng):
            cell[rows], within = self.clusters.choose(receivers.rows(rows), run, rest)
            chance[rows] = of_run * within
        aim, radiance = self._aim(receivers, cell, rng.random((count, 2), np.float32))
        return radiance, replace(aim, weight=(aim.weight / chance).astype(np.float32))

    def _gather(
        self,
        rays: ShadowRays,
        chunk: TexelChunk,
        rows: IntArray,
        chances: tuple[Float64, Int64],
        shifts: tuple[NDArray[np.uint32], NDArray[np.uint32]],
        span: Span,
        rng: np.random.Generator,
    ) -> tuple[Float64, int]:
        """(k, len(rows), 3) float64: estimates by one ray each, in the order of their strata of the choice."""
        (first, last), (end, group) = span, chances
        receivers = chunk.receivers(rows, first, last)
        step, cluster, chance, rest = choose_by_strata(end, group[rows], shifts[1][rows], last - first, rng)
        cell, cell_chance = self.clusters.choose(receivers, cluster, rest)
        aim, radiance = self._aim(receivers, cell, light_points(take_rows(shifts[0], rows), first, last))
        seen = receivers.see(rays, aim)
        weight = np.where(seen.share > 0, aim.weight / (chance * cell_chance), 0)
        return in_order(step, seen.times(radiance * weight[:, None])), seen.rays

    def _choose_clusters(self, rays: ShadowRays, chunk: TexelChunk, flat: Int64, rng: np.random.Generator) -> tuple[Float64, Int64, int]:
        """(n_group, n_cluster) float64: cdf of the clusters plus the row's number; (n,) int64: row of each texel; and rays traced.

        Texels of a quarter of a flat tile share a row.
        """
        visibility, n_ray = self._measure_visibility(rays, chunk, rng)
        n_cluster = len(self.clusters)
        alone = np.ones(len(chunk), bool)
        alone[flat] = False
        quarters, single = flat.reshape(-1, _TOGETHER), np.flatnonzero(alone)
        group = np.empty(len(chunk), np.int64)
        group[quarters] = np.arange(len(quarters))[:, None]
        group[single] = len(quarters) + np.arange(len(single))
        end = np.empty((len(quarters) + len(single), n_cluster))
        for probes, first in ((quarters[:, _PROBES], 0), (single[:, None], len(quarters))):
            for piece in row_pieces(np.arange(len(probes)), n_cluster * probes.shape[1]):
                ends = chunk.receivers_at(probes[piece].ravel(), _DIAGONAL)
                count = len(ends.position) // len(_DIAGONAL)
                middle = replace(ends.rows(np.arange(count)), position=ends.position.reshape(-1, count, 3).mean(axis=0))
                chance = self._estimate(middle, find_reach(ends.position, count)).reshape(len(piece), -1, n_cluster).sum(axis=1)
                chance *= visibility[probes[piece, 0] // BLOCK_TEXELS]
                at = first + piece[0]
                cumulate(chance, at, end[at : at + len(piece)])
        return end, group, n_ray

    def _estimate(self, receivers: Receivers, reach: Float32) -> Float32:
        """As EmitterClusters.estimate, but near large triangles by their closed form, as the centroid is a poor estimate there."""
        estimated = self.clusters.estimate(receivers, reach)
        run, place = self._alone, receivers.position
        cell = self.clusters.first[run]
        middle, area = take_rows(self.middle, cell), self.area[cell]
        away2 = dot_rows(place, place)[:, None] + dot_rows(middle, middle) - 2 * place @ middle.T
        row, which = np.nonzero(away2 < _NEAR * area)
        for piece in row_pieces(np.arange(len(row)), _CORNERS_WORK):
            rows, runs, cells = row[piece], run[which[piece]], cell[which[piece]]
            asking, normal = receivers.rows(rows), take_rows(self.scene.normal, self.cells.tri[cells])
            given = np.abs(polygon_irradiance(self.corners[cells], asking.position, asking.normal))
            given[self.sealed[cells] & (dot_rows(asking.position - take_rows(self.middle, cells), normal) < 0)] = 0
            estimated[rows, runs] = np.maximum(estimated[rows, runs], given / self.area[cells] * self.clusters.weight[runs])
        return estimated

    def _measure_visibility(self, rays: ShadowRays, chunk: TexelChunk, rng: np.random.Generator) -> tuple[Float32, int]:
        """(n_block, n_cluster): visibility of each cluster from the pilots of the block and of its region; and rays traced."""
        n_cluster = len(self.clusters)
        n_block = -(-len(chunk) // BLOCK_TEXELS)
        pilot = np.arange(n_block)[:, None] * BLOCK_TEXELS + np.arange(_PILOTS) * (BLOCK_TEXELS // _PILOTS) + BLOCK_TEXELS // _PILOTS // 2
        receivers = chunk.receivers_at(np.minimum(pilot, len(chunk) - 1).ravel(), MIDDLE)
        seen, n_ray = np.empty((n_block * _PILOTS, n_cluster), np.float32), 0
        for piece in row_pieces(np.arange(n_block * _PILOTS), n_cluster):
            cluster = np.tile(np.arange(n_cluster), len(piece))
            asking = receivers.rows(np.repeat(piece, n_cluster))
            cell, _ = self.clusters.choose(asking, cluster, rng.random(len(cluster)))
            aim, _ = self._aim(asking, cell, rng.random((len(cell), 2), np.float32))
            visible = asking.see(rays, aim)
            n_ray += visible.rays
            seen[piece] = visible.share.reshape(len(piece), n_cluster)
        by_block = seen.reshape(n_block, _PILOTS, n_cluster).mean(axis=1)
        by_region = sum_regions(by_block, _REGION_BLOCKS) / sum_regions(np.ones((n_block, 1)), _REGION_BLOCKS)
        unseen = np.clip(by_region, _UNSEEN_LEAST, _UNSEEN_MOST)
        return (by_block + (1 - by_block) * unseen).astype(np.float32), n_ray

    def _aim(self, receivers: Receivers, cell: Int64, u: FloatArray) -> tuple[Aim, Float64]:
        """Rays to points of cells (n,), with the irradiance per unit of radiance as their weight; and the radiance there (n, 3)."""
        tri, barycentric = self.cells.place(cell, u)
        target = self.scene.place(tri, barycentric[:, 0], barycentric[:, 1])
        normal = take_rows(self.scene.normal, tri)
        direction = target - receivers.position
        in_front = dot_rows(direction, normal) <= 0
        toward = np.where(in_front, np.float32(1), np.float32(-1))
        direction += np.float32(ORIGIN_OFFSET) * toward[:, None] * normal
        square = np.maximum(dot_rows(direction, direction), np.float32(1e-20))
        area = self.area[cell]
        cosines = np.maximum(dot_rows(direction, receivers.normal), 0) * np.abs(dot_rows(direction, normal)) / square
        # cos cos' A / r^2, with r at least the radius of a disk of the cell's area: biased there, to bound the weight of rare near points.
        weight = cosines * (area / np.maximum(square, area / math.pi))
        weight[self.sealed[cell] & ~in_front] = 0
        self._sharpen(weight, receivers, cell)
        radiance = self.cells.mean_rgb[cell]
        textured = np.flatnonzero(~self.constant[cell])
        if len(textured):
            radiance[textured] = self.surfaces.emission_at(tri[textured], barycentric[textured, 0], barycentric[textured, 1])
        short = weight.astype(np.float32)
        return Aim(direction, np.ones(len(cell), np.float32), short, short), radiance

    def _sharpen(self, weight: Float64, receivers: Receivers, cell: Int64) -> None:
        """Replaces the weight by the closed form of the irradiance near triangles of constant radiance."""
        # Chosen by the centroid, not by the ray's end: else near ends would have the mean weight, and far ones their own lower weight.
        middle = take_rows(self.middle, cell) - receivers.position
        near = np.flatnonzero(self.constant[cell] & (weight > 0) & (dot_rows(middle, middle) < _NEAR * self.area[cell]))
        asking, corners = receivers.rows(near), self.corners[cell[near]]
        height = ((corners - asking.position[:, None]) * asking.normal[:, None]).sum(axis=2)
        # Points below the horizon have weight 0, so the points above, a share p of the area, get the closed form divided by p.
        # Corners shared with the receiver's own face lie on the horizon up to rounding.
        whole = (height > -_ON_HORIZON * np.sqrt(self.area[cell[near]])[:, None]).all(axis=1)
        share = np.where(whole, 1.0, _share_above(height))
        chosen = whole | (share > 0)
        near, asking = near[chosen], asking.rows(np.flatnonzero(chosen))
        weight[near] = np.abs(polygon_irradiance(corners[chosen], asking.position, asking.normal)) / share[chosen]


def _share_above(height: FloatArray) -> Float64:
    """(n,) float64: share of triangles' area above the horizon, by the heights of their corners (n, 3)."""
    low, middle, high = np.sort(height.astype(np.float64), axis=1).T
    with np.errstate(divide="ignore", invalid="ignore"):
        below = np.where(middle > 0, low**2 / ((low - middle) * (low - high)), 1 - high**2 / ((high - middle) * (high - low)))
    return np.where(low >= 0, 1.0, np.where(high <= 0, 0.0, 1 - below))
