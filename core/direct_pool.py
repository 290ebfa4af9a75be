"""Direct light from more emitting triangles than can be looked at one by one: clusters chosen for each block of texels."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from .direct_lights import Aim
from .direct_points import MIDDLE, STAGES, Receivers, ReceivingSurfaces, TexelChunk, light_points, random_shift, row_pieces, take_rows
from .emitters import EmittingCells, weigh_channels
from .geometry import ORIGIN_OFFSET
from .irradiance import polygon_irradiance
from .lights import Float32, Float64
from .materials import SurfaceMaterials
from .rays import RayScene
from .scene import FloatArray, IntArray

Int64: TypeAlias = NDArray[np.int64]

BLOCK_TEXELS = 64  # neighbours in Morton order, 8 x 8 within a chart, share their pilots
_PILOTS = 4  # receivers of a block that look at every cluster first
_REGION_BLOCKS = 16  # blocks whose pilots tell together whether a cluster is seen from there at all
_UNSEEN_LEAST, _UNSEEN_MOST = 0.05, 0.4  # share of a cluster that is kept for each pilot that did not see it
_MAX_CLUSTERS = 256
_GRAZING = np.float32(0.1)  # least cosine a cluster is judged by
_ON_HORIZON = 1e-3  # roots of a triangle's area below the horizon that count as on it
_NEAR = 4.0  # distance squared in areas of a triangle, below which its closed form is taken


@dataclass(frozen=True)
class EmitterPool:
    """Emitting cells, sorted so that clusters of consecutive ones are close and look the same way.

    constant         (n,) bool                          the cell is a whole triangle of one radiance
    area             (n,) float64, unit box squared
    power_end        (n + 1,) float64                   cumulative importance
    cluster_start    (n_cluster + 1,) int64
    cluster_centre   (n_cluster, 3) float32, unit box
    cluster_normal   (n_cluster, 3) float32             mean; short where its cells look in many directions
    cluster_square   (n_cluster,) float32               mean squared distance of its cells from the centre, and their own size
    """

    cells: EmittingCells
    constant: NDArray[np.bool_]
    area: Float64
    power_end: Float64
    cluster_start: Int64
    cluster_centre: Float32
    cluster_normal: Float32
    cluster_square: Float32
    scene: ReceivingSurfaces
    surfaces: SurfaceMaterials

    @cached_property
    def middle(self) -> Float32:
        """(n, 3) float32, unit box: of the cells' triangles."""
        out: Float32 = self.scene.corner_unit[self.cells.tri].mean(axis=1)
        return out

    @classmethod
    def of(cls, groups: list[EmittingCells], scene: ReceivingSurfaces, scale: float, surfaces: SurfaceMaterials) -> EmitterPool:
        """A pool of the cells of several materials; scale is the unit box's."""
        importance = np.concatenate([group.importance for group in groups])
        constant = np.concatenate([np.full(len(group.tri), group.constant) for group in groups])
        tri = np.concatenate([group.tri for group in groups])
        corner, side, area_m2, mean_rgb = (
            np.concatenate([getattr(group, name) for group in groups]) for name in ("corner", "side", "area_m2", "mean_rgb")
        )
        every = np.arange(len(tri))
        cells = EmittingCells(tri, corner, side, area_m2, mean_rgb, constant=False)
        _, barycentric = cells.place(every, np.full((len(tri), 2), 0.5))
        centre, normal = scene.place(tri, barycentric[:, 0], barycentric[:, 1]), scene.normal[tri]
        order = _sort_by_place(centre, normal)
        cells = EmittingCells(tri[order], corner[order], side[order], area_m2[order], mean_rgb[order], constant=False)
        area, weight, centre, normal = area_m2[order] * scale**2, importance[order], centre[order], normal[order]
        power_end = np.concatenate([[0.0], np.cumsum(weight)])
        start = every
        if len(every) > _MAX_CLUSTERS:
            start = np.searchsorted(power_end, power_end[-1] * np.arange(_MAX_CLUSTERS) / _MAX_CLUSTERS, side="right") - 1
        start = np.unique(np.clip(start, 0, len(every) - 1))
        total = np.maximum(np.add.reduceat(weight, start), 1e-300)
        mean_centre = np.add.reduceat(centre * weight[:, None], start, axis=0) / total[:, None]
        mean_normal = np.add.reduceat(normal * weight[:, None], start, axis=0) / total[:, None]
        cluster = np.repeat(np.arange(len(start)), np.diff(np.append(start, len(every))))
        square = ((centre - mean_centre[cluster]) ** 2).sum(axis=1) + area / math.pi
        mean_square = np.add.reduceat(square * weight, start) / total
        cluster_start = np.append(start, len(every)).astype(np.int64)
        return cls(
            cells=cells,
            constant=constant[order],
            area=area,
            power_end=power_end,
            cluster_start=cluster_start,
            cluster_centre=mean_centre.astype(np.float32),
            cluster_normal=mean_normal.astype(np.float32),
            cluster_square=mean_square.astype(np.float32),
            scene=scene,
            surfaces=surfaces,
        )

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
        # Row r of the choice rises from r to r + 1, so that one search serves all texels.
        texel = np.broadcast_to(rows, pick.shape).ravel()
        target = pick.ravel() + texel
        cluster = np.minimum(np.searchsorted(choice.ravel(), target, side="right") - texel * n_cluster, n_cluster - 1)
        low = np.where(cluster > 0, choice[texel, np.maximum(cluster - 1, 0)], texel)
        chance = np.maximum(choice[texel, cluster] - low, 1e-12)
        cell, cell_chance = self._choose_cell(cluster, np.clip((target - low) / chance, 0, 1))
        aim, radiance = self._aim(receivers, cell, light_points(shifts[0][rows], first, last))
        seen, traced = receivers.see(rays, aim)
        value = radiance * np.where(seen, aim.weight / (chance * cell_chance), 0)[:, None]
        ordered = np.empty((strata, len(rows), 3))
        ordered[step, np.arange(len(rows))] = value.reshape(strata, len(rows), 3)
        return ordered, traced

    def _choose_clusters(self, rays: RayScene, chunk: TexelChunk, rng: np.random.Generator) -> tuple[Float64, int]:
        """(n, n_cluster) float64: cumulative chances of the clusters at each texel, row r from r to r + 1; and rays spent."""
        visibility, n_ray = self._look_around(rays, chunk, rng)
        count = len(chunk.texel)
        power = np.diff(self.power_end[self.cluster_start]).astype(np.float32)
        end = np.empty((count, len(power)))
        for rows in row_pieces(np.arange(count), len(power)):
            looking = chunk.receivers_at(rows, MIDDLE)
            chance = self._judge(looking) * power
            chance *= visibility[rows // BLOCK_TEXELS]
            np.cumsum(chance, axis=1, out=end[rows[0] : rows[-1] + 1])
        end /= end[:, -1:]
        end += np.arange(count)[:, None]
        return end, n_ray

    def _judge(self, receivers: Receivers) -> Float32:
        """(n, n_cluster): what the clusters would give per area and radiance, unoccluded and never 0."""
        centre, normal = self.cluster_centre, self.cluster_normal
        square = (receivers.position**2).sum(axis=1)[:, None] + (centre**2).sum(axis=1) - 2 * receivers.position @ centre.T
        np.maximum(square, np.float32(1e-9), out=square)
        distance = np.sqrt(square)
        least = _GRAZING * distance
        out: Float32 = receivers.normal @ centre.T - (receivers.normal * receivers.position).sum(axis=1)[:, None]
        np.maximum(out, least, out=out)
        from_light = receivers.position @ normal.T - (centre * normal).sum(axis=1)
        np.abs(from_light, out=from_light)
        # A mean normal is short where its cells look in many directions.
        distance *= np.maximum(np.sqrt(np.maximum(1 - (normal**2).sum(axis=1), 0)), _GRAZING)
        out *= np.maximum(from_light, distance, out=from_light)
        out /= square * (square + self.cluster_square)
        return out

    def _look_around(self, rays: RayScene, chunk: TexelChunk, rng: np.random.Generator) -> tuple[Float32, int]:
        """(n_block, n_cluster): share of each cluster that pilots of the block, and of the blocks around it, saw; and rays spent."""
        n_cluster = len(self.cluster_start) - 1
        n_block = -(-len(chunk.texel) // BLOCK_TEXELS)
        pilot = np.arange(n_block)[:, None] * BLOCK_TEXELS + np.arange(_PILOTS) * (BLOCK_TEXELS // _PILOTS) + BLOCK_TEXELS // _PILOTS // 2
        receivers = chunk.receivers_at(np.minimum(pilot, len(chunk.texel) - 1).ravel(), MIDDLE)
        seen, n_ray = np.empty((n_block * _PILOTS, n_cluster), np.float32), 0
        for piece in row_pieces(np.arange(n_block * _PILOTS), n_cluster):
            cluster = np.tile(np.arange(n_cluster), len(piece))
            cell, _ = self._choose_cell(cluster, rng.random(len(cluster)))
            looking = receivers.rows(np.repeat(piece, n_cluster))
            aim, _ = self._aim(looking, cell, rng.random((len(cell), 2), np.float32))
            visible, traced = looking.see(rays, aim)
            n_ray += traced
            seen[piece] = visible.reshape(len(piece), n_cluster)
        by_block = seen.reshape(n_block, _PILOTS, n_cluster).mean(axis=1)
        region = np.arange(0, n_block, _REGION_BLOCKS)
        size = np.diff(np.append(region, n_block))
        by_region = np.repeat(np.add.reduceat(by_block, region, axis=0) / size[:, None], size, axis=0)
        unseen = np.clip(by_region, _UNSEEN_LEAST, _UNSEEN_MOST)
        return (by_block + (1 - by_block) * unseen).astype(np.float32), n_ray

    def _choose_cell(self, cluster: Int64, u: FloatArray) -> tuple[Int64, Float64]:
        """Cells of clusters (n,) by importance, and their chances within the cluster."""
        start, end = self.cluster_start[cluster], self.cluster_start[cluster + 1]
        low, width = self.power_end[start], self.power_end[end] - self.power_end[start]
        cell = np.clip(np.searchsorted(self.power_end, low + u * width, side="right") - 1, start, end - 1)
        return cell, np.maximum(self.power_end[cell + 1] - self.power_end[cell], 1e-300) / width

    def _aim(self, receivers: Receivers, cell: Int64, u: FloatArray) -> tuple[Aim, Float64]:
        """Rays to points of cells (n,), weighted by the cells' irradiance at radiance 1; and the radiance there (n, 3)."""
        tri, barycentric = self.cells.place(cell, u)
        target = self.scene.place(tri, barycentric[:, 0], barycentric[:, 1])
        normal = take_rows(self.scene.normal, tri)
        direction = target - receivers.position
        toward = np.where((direction * normal).sum(axis=1) <= 0, np.float32(1), np.float32(-1))
        direction += np.float32(ORIGIN_OFFSET) * toward[:, None] * normal
        square = np.maximum((direction * direction).sum(axis=1), np.float32(1e-20))
        area = self.area[cell]
        cosines = np.maximum((direction * receivers.normal).sum(axis=1), 0) * np.abs((direction * normal).sum(axis=1)) / square
        # Exact, but for points nearer than the radius of a disk of the cell's area: few of them would be far too bright.
        weight = cosines * (area / np.maximum(square, area / math.pi))
        self._sharpen(weight, receivers, cell)
        radiance = self.cells.mean_rgb[cell]
        textured = np.flatnonzero(~self.constant[cell])
        if len(textured):
            radiance[textured] = self.surfaces.emission_at(tri[textured], barycentric[textured, 0], barycentric[textured, 1])
        short = weight.astype(np.float32)
        return Aim(direction, np.ones(len(cell), np.float32), short, short), radiance

    def _sharpen(self, weight: Float64, receivers: Receivers, cell: Int64) -> None:
        """Takes the closed form near triangles of constant radiance."""
        # By the middle of the triangle: were it by the ray's end, near ends would bring the mean of all, and far ones their own less.
        middle = take_rows(self.middle, cell) - receivers.position
        near = np.flatnonzero(self.constant[cell] & ((middle * middle).sum(axis=1) < _NEAR * self.area[cell]))
        looking, corners = receivers.rows(near), self.scene.corner_unit[self.cells.tri[cell[near]]]
        height = ((corners - looking.position[:, None]) * looking.normal[:, None]).sum(axis=2)
        # A triangle that the horizon cuts keeps the weight of its point: the closed form leaves out what points below it would carry.
        # Corners that it shares with the receiver's own face lie on the horizon, to rounding.
        whole = (height > -_ON_HORIZON * np.sqrt(self.area[cell[near]])[:, None]).all(axis=1)
        near, looking = near[whole], looking.rows(np.flatnonzero(whole))
        weight[near] = np.abs(polygon_irradiance(corners[whole], looking.position, looking.normal))


def _sort_by_place(centre: FloatArray, normal: FloatArray) -> Int64:
    """Order of cells: by the axis their normals are nearest to, then along a Morton curve."""
    place = (np.clip(centre + 0.5, 0, 1) * 1023).astype(np.int64)
    code = np.zeros(len(place), np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= ((place[:, axis] >> bit) & 1) << (3 * bit + axis)
    nearest = np.abs(normal).argmax(axis=1)
    facing = 2 * nearest + (normal[np.arange(len(normal)), nearest] < 0)
    order: Int64 = np.lexsort((code, facing))
    return order
