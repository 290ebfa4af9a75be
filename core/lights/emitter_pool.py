"""Direct light from many emitting triangles: importance sampling of clusters, with shared visibility per block of texels."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..scene.materials import SurfaceMaterials
from ..scene.shadow_rays import ShadowRays
from ..scene.slender_triangles import whole_parts
from ..util.arrays import BoolArray, Float32, Float64, FloatArray, Int64, IntArray
from ..util.geometry import ORIGIN_OFFSET, dot_rows, take_rows
from .cell_polygons import CellPolygons
from .direct_lights import Aim
from .direct_points import GAUSS_POINTS, MIDDLE, STAGES, Receivers, ReceivingSurfaces, TexelChunk, light_points, random_shift, row_pieces
from .emitter_clusters import EmitterClusters, order_cells
from .emitting_cells import EmittingCells
from .stratified_choice import (
    BLOCK_TEXELS,
    Demand,
    Span,
    choose,
    choose_by_importance,
    cumulate,
    draw_strata,
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
# A cluster is near a texel if its distance and size together are below this many half diagonals of the texel.
_WIDE = np.float32(4)


@dataclass(frozen=True)
class _Chances:
    """Pdfs of the clusters at the texels of a chunk.

    end       (n_group, n_cluster) float64   from stratified_choice.cumulate
    group     (n,) int64                     row of each texel
    is_near   (n,) bool                      texels beside a small cluster, which have a pdf for each ray: that of one place in the texel is
                                             a poor one elsewhere
    """

    end: Float64
    group: Int64
    is_near: BoolArray


@dataclass(frozen=True)
class EmitterPool:
    """Emitting cells, sorted so that clusters of consecutive ones are compact and of similar normals.

    constant         (n,) bool                          the cell is a triangle, or part of one, of constant radiance; else textured
    """

    cells: EmittingCells
    constant: BoolArray
    clusters: EmitterClusters
    scene: ReceivingSurfaces
    surfaces: SurfaceMaterials

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
        cells = EmittingCells(tri, corner, side, area_m2, mean_rgb, False, part)
        polygons = CellPolygons.of(cells, scene, scale, tri_sealed)
        order = order_cells(polygons)
        part = None if part is None else part[order]
        cells = EmittingCells(tri[order], corner[order], side[order], area_m2[order], mean_rgb[order], False, part)
        clusters = EmitterClusters.of(importance[order], polygons.rows(order))
        return cls(cells, constant[order], clusters, scene, surfaces)

    def irradiance(
        self, rays: ShadowRays, chunk: TexelChunk, demand: Demand, base_rgb: Float64, rng: np.random.Generator
    ) -> tuple[Float64, Float64, int]:
        """Irradiance (n, 3) and its variance (n, 3) of the chunk's texels, and the number of rays.

        base_rgb   (n, 3) float64, W/m^2: other light at the texels; the tolerance is relative to the sum
        """
        chances, n_ray = self._choose_clusters(rays, chunk, demand.flat.texels(), rng)
        shift, turn = random_shift(rng, len(chunk)), random_shift(rng, len(chunk))[:, 0]

        def gather(rows: IntArray, span: Span) -> tuple[Float64, int]:
            return self._gather(rays, chunk, rows, chances, (shift, turn), span, rng)

        total, variance, traced = sample_adaptively(gather, np.arange(len(chunk)), demand, base_rgb, _SPANS)
        return total, variance, n_ray + traced

    def choose(self, receivers: Receivers, rng: np.random.Generator) -> tuple[Float64, Aim]:
        """Radiance (n, 3) of a place on an emitting cell for each of n receivers, chosen by importance; and the ray there, whose weight is
        the irradiance per unit of radiance over its probability.
        """
        count = len(receivers.position)
        cell, chance = np.empty(count, np.int64), np.empty(count)
        for rows, run, of_run, rest in choose_by_importance(receivers, len(self.clusters), self.clusters.estimate, rng.random(count)):
            cell[rows], within = self.clusters.choose(receivers.rows(rows), run, rest)
            chance[rows] = of_run * within
        aim, radiance = self._aim(receivers, cell, rng.random((count, 2), np.float32))
        return radiance, replace(aim, weight=(aim.weight / chance).astype(np.float32))

    def _gather(
        self,
        rays: ShadowRays,
        chunk: TexelChunk,
        rows: IntArray,
        chances: _Chances,
        shifts: tuple[NDArray[np.uint32], NDArray[np.uint32]],
        span: Span,
        rng: np.random.Generator,
    ) -> tuple[Float64, int]:
        """(k, len(rows), 3) float64: estimates by one ray each, in the order of their strata of the choice."""
        first, last = span
        receivers = chunk.receivers(rows, first, last)
        step, pick = draw_strata(shifts[1][rows], last - first, rng)
        cluster, chance, rest = choose(chances.end, np.broadcast_to(chances.group[rows], pick.shape), pick)
        near = np.flatnonzero(np.broadcast_to(chances.is_near[rows], pick.shape).ravel())
        for piece, *own in choose_by_importance(receivers.rows(near), len(self.clusters), self.clusters.estimate, pick.ravel()[near]):
            cluster[near[piece]], chance[near[piece]], rest[near[piece]] = own
        cell, cell_chance = self.clusters.choose(receivers, cluster, rest)
        aim, radiance = self._aim(receivers, cell, light_points(take_rows(shifts[0], rows), first, last))
        seen = receivers.see(rays, aim)
        weight = np.where(seen.share > 0, aim.weight / (chance * cell_chance), 0)
        return in_order(step, seen.times(radiance * weight[:, None])), seen.rays

    def _choose_clusters(self, rays: ShadowRays, chunk: TexelChunk, flat: Int64, rng: np.random.Generator) -> tuple[_Chances, int]:
        """The pdfs of the chunk's texels, and rays traced. Texels of a quarter of a flat tile share one."""
        visibility, n_ray = self._measure_visibility(rays, chunk, rng)
        n_cluster = len(self.clusters)
        alone = np.ones(len(chunk), bool)
        alone[flat] = False
        quarters, single = flat.reshape(-1, _TOGETHER), np.flatnonzero(alone)
        group = np.empty(len(chunk), np.int64)
        group[quarters] = np.arange(len(quarters))[:, None]
        group[single] = len(quarters) + np.arange(len(single))
        end = np.empty((len(quarters) + len(single), n_cluster))
        is_near = np.zeros(len(end), bool)
        for probes, first in ((quarters[:, _PROBES], 0), (single[:, None], len(quarters))):
            for piece in row_pieces(np.arange(len(probes)), n_cluster * probes.shape[1]):
                ends = chunk.receivers_at(probes[piece].ravel(), _DIAGONAL)
                count = len(ends.position) // len(_DIAGONAL)
                middle = replace(ends.rows(np.arange(count)), position=ends.position.reshape(-1, count, 3).mean(axis=0))
                reach = find_reach(ends.position, count)
                chance = self.clusters.estimate(middle, reach).reshape(len(piece), -1, n_cluster).sum(axis=1)
                is_near[first + piece] = self.clusters.find_near(middle.position, _WIDE * reach).reshape(len(piece), -1).any(axis=1)
                chance *= visibility[probes[piece, 0] // BLOCK_TEXELS]
                at = first + piece[0]
                cumulate(chance, at, end[at : at + len(piece)])
        return _Chances(end, group, is_near[group]), n_ray

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
        polygons = self.clusters.polygons
        area = polygons.area[cell]
        cosines = np.maximum(dot_rows(direction, receivers.normal), 0) * np.abs(dot_rows(direction, normal)) / square
        # cos cos' A / r^2, with r at least the radius of a disk of the cell's area: biased there, to bound the weight of rare near points.
        weight = cosines * (area / np.maximum(square, area / math.pi))
        weight[polygons.sealed[cell] & ~in_front] = 0
        # Near cells have the closed form, as their radiance is constant or almost. Chosen by the centroid, not by the ray's end: else near
        # ends would have the mean weight, and far ones their own lower weight.
        near = np.flatnonzero((weight > 0) & polygons.are_close(cell, receivers))
        beside, cells = receivers.rows(near), cell[near]
        # Points below the horizon have weight 0, so the points above, a share p of the area, get the closed form divided by p.
        share = polygons.share_above(cells, beside)
        weight[near] = np.where(share > 0, polygons.irradiance(cells, beside) / np.where(share > 0, share, 1), weight[near])
        radiance = self.cells.mean_rgb[cell]
        textured = np.flatnonzero(~self.constant[cell])
        if len(textured):
            radiance[textured] = self.surfaces.emission.at(tri[textured], barycentric[textured, 0], barycentric[textured, 1])
        short = weight.astype(np.float32)
        return Aim(direction, np.ones(len(cell), np.float32), short, short, by_chance=True), radiance
