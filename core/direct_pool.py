"""Direct light from more emitting triangles than can be looked at one by one: clusters chosen for each block of texels."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from .direct_lights import Aim
from .direct_points import STAGES, Receivers, TexelChunk, light_points, random_shift, row_pieces
from .emitters import EmittingCells, weigh_channels
from .geometry import ORIGIN_OFFSET, interpolate_corners
from .irradiance import polygon_irradiance
from .lights import Float32, Float64
from .materials import SurfaceMaterials
from .rays import RayScene
from .scene import FloatArray, IntArray

Int64: TypeAlias = NDArray[np.int64]

BLOCK_TEXELS = 64  # neighbours in Morton order, 8 x 8 within a chart, choose alike
_PILOTS = 4  # receivers of a block that look at every cluster first
_MAX_CLUSTERS = 256
_UNSEEN_LEAST, _UNSEEN_MOST = 0.02, 0.25  # share that a cluster keeps where a pilot did not see it
_REGION_BLOCKS = 16  # blocks whose pilots tell together whether a cluster is seen from there at all
_GRAZING = np.float32(0.05)  # least cosine a cluster is judged by
_NEAR = 4.0  # distance squared in areas of a triangle, below which its closed form is taken


@dataclass(frozen=True)
class EmitterPool:
    """Emitting cells, sorted so that clusters of consecutive ones are close and look the same way.

    power_end        (n + 1,) float64    cumulative importance
    cluster_start    (n_cluster + 1,) int64
    area             (n,) float64, unit box squared
    corner_unit      (n_tri, 3, 3) float32, unit box;  normal  (n_tri, 3) float32, unit
    """

    cells: EmittingCells
    constant: NDArray[np.bool_]
    power_end: Float64
    cluster_start: Int64
    area: Float64
    corner_unit: Float32
    normal: Float32
    surfaces: SurfaceMaterials

    @classmethod
    def of(
        cls, groups: list[EmittingCells], corner_unit: Float32, normal: Float32, scale: float, surfaces: SurfaceMaterials
    ) -> EmitterPool:
        """A pool of the cells of several materials; scale is the unit box's."""
        importance = np.concatenate([group.importance for group in groups])
        constant = np.concatenate([np.full(len(group.tri), group.constant) for group in groups])
        tri = np.concatenate([group.tri for group in groups])
        order = _sort_by_place(corner_unit[tri].mean(axis=1), normal[tri])
        corner, side, area_m2, mean_rgb = (
            np.concatenate([getattr(group, name) for group in groups])[order] for name in ("corner", "side", "area_m2", "mean_rgb")
        )
        cells = EmittingCells(tri[order], corner, side, area_m2, mean_rgb, constant=False)
        power_end = np.concatenate([[0.0], np.cumsum(importance[order])])
        start = np.searchsorted(power_end, power_end[-1] * np.arange(_MAX_CLUSTERS) / _MAX_CLUSTERS)
        if len(order) <= _MAX_CLUSTERS:
            start = np.arange(len(order))
        cluster_start = np.unique(np.append(np.minimum(start, len(order) - 1), len(order))).astype(np.int64)
        cluster_start[0] = 0
        return cls(cells, constant[order], power_end, cluster_start, cells.area_m2 * scale**2, corner_unit, normal, surfaces)

    def irradiance(
        self, rays: RayScene, chunk: TexelChunk, base_rgb: Float64, tolerance: float, max_rays: int, rng: np.random.Generator
    ) -> tuple[Float64, Float64, int]:
        """Irradiance (n, 3) and its variance (n, 3) of the chunk's texels, and the number of rays.

        base_rgb   (n, 3) float64: other light at the texels; more rays go where the error shows beside the sum
        """
        choice, n_ray = self._choose_clusters(rays, chunk, rng)
        count = len(chunk.texel)
        shift, turn = random_shift(rng, count), random_shift(rng, count)
        total, squares = np.zeros((count, 3)), np.zeros((count, 3))
        taken = np.zeros(count, np.int64)
        rows = np.arange(count)
        for first, last in ((0, STAGES[1][1]), STAGES[2]):
            if first >= max_rays:
                break
            for piece in row_pieces(rows, last - first):
                value, traced = self._gather(rays, chunk, piece, choice, (shift, turn), (first, last), rng)
                n_ray += traced
                total[piece] += value.sum(axis=0)
                # Neighbouring strata differ by what is random inside them. Source: Wolter 1984, successive differences.
                squares[piece] += ((value[0::2] - value[1::2]) ** 2).sum(axis=0)
                taken[piece] += last - first
            error = np.sqrt(weigh_channels(squares)) / taken
            level = weigh_channels(base_rgb + total / taken[:, None])
            rows = np.flatnonzero(error > tolerance * level)
        return total / taken[:, None], squares / taken[:, None] ** 2, n_ray

    def _gather(
        self,
        rays: RayScene,
        chunk: TexelChunk,
        rows: IntArray,
        choice: Float64,
        shifts: tuple[NDArray[np.uint32], NDArray[np.uint32]],
        span: tuple[int, int],
        rng: np.random.Generator,
    ) -> tuple[Float64, int]:
        """(k, len(rows), 3) float64: estimates by one ray each, in the order of their strata of the choice."""
        first, last = span
        receivers = chunk.receivers(rows, first, last)
        n_cluster = len(self.cluster_start) - 1
        strata = last - first
        # Each texel's strata of the choice are met in an order of their own, so that they are not tied to places in the texel.
        step = (np.arange(strata)[:, None] + shifts[1][rows, 0] % strata) % strata
        pick = (step + rng.random((strata, len(rows)))) / strata
        block = np.broadcast_to(rows // BLOCK_TEXELS, pick.shape).ravel()
        target = pick.ravel() + block
        ends = choice.ravel()
        cluster = np.minimum(np.searchsorted(ends, target, side="right") - block * n_cluster, n_cluster - 1)
        low = np.where(cluster > 0, choice[block, np.maximum(cluster - 1, 0)], block)
        chance = np.maximum(choice[block, cluster] - low, 1e-12)
        cell, cell_chance = self._choose_cell(cluster, np.clip((target - low) / chance, 0, 1))
        aim, radiance = self._aim(receivers, cell, light_points(shifts[0][rows], first, last), exact=True)
        seen, traced = receivers.see(rays, aim)
        value = radiance * np.where(seen, aim.weight / (chance * cell_chance), 0)[:, None]
        ordered = np.empty((strata, len(rows), 3))
        ordered[step, np.arange(len(rows))] = value.reshape(strata, len(rows), 3)
        return ordered, traced

    def _choose_clusters(self, rays: RayScene, chunk: TexelChunk, rng: np.random.Generator) -> tuple[Float64, int]:
        """(n_block, n_cluster) float64: cumulative chances of the clusters, block b's from b to b + 1; and rays spent."""
        n_cluster = len(self.cluster_start) - 1
        n_block = -(-len(chunk.texel) // BLOCK_TEXELS)
        pilot = np.arange(n_block)[:, None] * BLOCK_TEXELS + np.arange(_PILOTS) * (BLOCK_TEXELS // _PILOTS) + BLOCK_TEXELS // _PILOTS // 2
        receivers = chunk.receivers(np.minimum(pilot, len(chunk.texel) - 1).ravel(), 0, 1)
        score, n_ray = np.empty((n_block * _PILOTS, n_cluster)), 0
        seen = np.empty((n_block * _PILOTS, n_cluster), bool)
        power = np.diff(self.power_end[self.cluster_start])
        for piece in row_pieces(np.arange(n_block * _PILOTS), n_cluster):
            looking = receivers.rows(np.repeat(piece, n_cluster))
            cluster = np.tile(np.arange(n_cluster), len(piece))
            cell, _ = self._choose_cell(cluster, rng.random(len(cluster)))
            aim, _ = self._aim(looking, cell, rng.random((len(cell), 2), np.float32), exact=False)
            visible, traced = looking.see(rays, aim)
            n_ray += traced
            seen[piece] = visible.reshape(len(piece), n_cluster)
            score[piece] = (aim.share * power[cluster]).reshape(len(piece), n_cluster)
        region = np.arange(0, len(seen), _REGION_BLOCKS * _PILOTS)
        size = np.diff(np.append(region, len(seen)))
        often = np.add.reduceat(seen, region, axis=0, dtype=np.float64) / size[:, None]
        unseen = np.repeat(np.clip(often, _UNSEEN_LEAST, _UNSEEN_MOST), size, axis=0)
        chance = (score * np.where(seen, 1, unseen)).reshape(n_block, _PILOTS, n_cluster).sum(axis=1)
        end = np.cumsum(chance, axis=1)
        return end / end[:, -1:] + np.arange(n_block)[:, None], n_ray

    def _choose_cell(self, cluster: Int64, u: FloatArray) -> tuple[Int64, Float64]:
        """Cells of clusters (n,) by importance, and their chances within the cluster."""
        start, end = self.cluster_start[cluster], self.cluster_start[cluster + 1]
        low, width = self.power_end[start], self.power_end[end] - self.power_end[start]
        cell = np.clip(np.searchsorted(self.power_end, low + u * width, side="right") - 1, start, end - 1)
        return cell, np.maximum(self.power_end[cell + 1] - self.power_end[cell], 1e-300) / width

    def _aim(self, receivers: Receivers, cell: Int64, u: FloatArray, exact: bool) -> tuple[Aim, Float64]:
        """Rays to points of cells (n,), and the radiance there (n, 3).

        The weight is the irradiance of the cell at radiance 1; the share, for choosing, is softer, and per area.
        """
        tri, barycentric = self.cells.place(cell, u)
        toward = np.where(((receivers.position - self.corner_unit[tri, 0]) * self.normal[tri]).sum(axis=1) >= 0, 1, -1)
        side = self.normal[tri] * toward[:, None].astype(np.float32)
        target = interpolate_corners(self.corner_unit[tri], barycentric[:, 0], barycentric[:, 1]) + np.float32(ORIGIN_OFFSET) * side
        direction = (target - receivers.position).astype(np.float32)
        square = np.maximum((direction * direction).sum(axis=1), np.float32(1e-20))
        length = np.sqrt(square)
        cos_receiver = (direction * receivers.normal).sum(axis=1) / length
        cos_light = -(direction * side).sum(axis=1) / length
        area = self.area[cell]
        # A small disk's irradiance does not grow beyond bounds as it comes near.
        per_area = math.pi / (math.pi * square + area)
        weight = np.maximum(cos_receiver, 0) * np.maximum(cos_light, 0) * per_area * area
        share = np.maximum(cos_receiver, _GRAZING) * np.maximum(cos_light, _GRAZING) * per_area
        radiance = self.cells.mean_rgb[cell]
        if exact:
            self._sharpen(weight, receivers, cell, square)
            textured = np.flatnonzero(~self.constant[cell])
            if len(textured):
                radiance[textured] = self.surfaces.emission_at(tri[textured], barycentric[textured, 0], barycentric[textured, 1])
        one = np.ones(len(cell), np.float32)
        return Aim(direction, one, share.astype(np.float32), weight.astype(np.float32)), radiance

    def _sharpen(self, weight: Float64, receivers: Receivers, cell: Int64, square: FloatArray) -> None:
        """Makes the weights of triangles of constant radiance exact: in closed form near them, per point further away."""
        area = self.area[cell]
        far = np.flatnonzero(self.constant[cell] & (square >= _NEAR * area))
        weight[far] *= 1 + area[far] / (math.pi * square[far])
        near = np.flatnonzero(self.constant[cell] & (square < _NEAR * area))
        looking, corners = receivers.rows(near), self.corner_unit[self.cells.tri[cell[near]]]
        # A triangle that the horizon cuts keeps the softened weight: the closed form leaves out what points below it would carry.
        whole = (((corners - looking.position[:, None]) * looking.normal[:, None]).sum(axis=2) > 0).all(axis=1)
        near, looking = near[whole], looking.rows(np.flatnonzero(whole))
        weight[near] = np.abs(polygon_irradiance(corners[whole], looking.position, looking.normal))


def _sort_by_place(centre: FloatArray, normal: FloatArray) -> Int64:
    """Order of cells: by the axis their normals are nearest to, then along a Morton curve."""
    place = (np.clip(centre + 0.5, 0, 1) * 1023).astype(np.int64)
    code = np.zeros(len(place), np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= ((place[:, axis] >> bit) & 1) << (3 * bit + axis)
    axis = np.abs(normal).argmax(axis=1)
    facing = 2 * axis + (normal[np.arange(len(normal)), axis] < 0)
    order: Int64 = np.lexsort((code, facing))
    return order
