"""Bright places as targets of gather rays.

A small bright place, such as the ceiling above a lamp or a patch of sunlight, gives texels much of their indirect light, but few rays of a
cosine distribution meet it: most of their variance comes from hits that are over ten times as bright as the mean. So as many rays again go
to points of bright places, which are chosen by importance, and all rays are weighted by the balance heuristic.

Source: Jensen 1995, "Importance driven path tracing using the photon map" (directions are chosen by the light of the photon map); Veach
and Guibas 1995, "Optimally combining sampling techniques for Monte Carlo rendering", 3.2 (balance heuristic).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..lights.direct_points import MIDDLE, ReceivingSurfaces, TexelChunk
from ..lights.emitter_clusters import RIGHT_ANGLES_APART, cut_by_spread, estimate_importance
from ..lights.stratified_choice import Clusters, choose, cumulate, sort_by_place
from ..scene.materials import SurfaceMaterials
from ..scene.surface_cells import SurfaceCells
from ..texels.texel_map import TexelMap
from ..util.ablation import uses
from ..util.arrays import Float32, Float64, Int32, Int64, IntArray
from ..util.geometry import dot_rows

# Times the mean light, above which a place is bright. On four random scenes 1 and 4 make 0.9 to 1.1 times the standard deviation; the same
# is true of 16 or 256 clusters, or 1.2 times on one of them with 16.
_BRIGHT = 2.0
_MAX_CLUSTERS, _EVEN = 64, 1e-4  # of cut_by_spread
_TOGETHER = 16  # consecutive texels that share a pdf, the mean of those at _PROBES of them
_PROBES = np.array([2, 6, 9, 13])


@dataclass(frozen=True)
class BrightPlaces:
    """Bright texels and cells, ordered so that clusters of consecutive ones are compact.

    entry      (m,) int64     texel entry of each place, -1 for a cell
    cell       (m,) int64     cell of each place, -1 for a texel
    density    (m,) float32   pdf per area, unit box, of points on a place once its cluster is chosen
    clusters   of the places; the weight is area times radiosity
    """

    entry: Int64
    cell: Int64
    density: Float32
    clusters: Clusters

    def __len__(self) -> int:
        return len(self.entry)


@dataclass(frozen=True)
class PlacedSurfaces:
    """What bright places lie on; scale is the unit box's."""

    texels: TexelMap
    cells: SurfaceCells
    surfaces: SurfaceMaterials
    receiving: ReceivingSurfaces
    scale: float


def find_bright(scene: PlacedSurfaces, light: Float32, on_cells: Float32) -> BrightPlaces:
    """The places whose light exceeds _BRIGHT times the mean of all, from light on texels (3, n) and cells (3, n_cell), W/m^2."""
    texels, cells, receiving = scene.texels, scene.cells, scene.receiving
    areas, levels = (texels.texel_area, cells.area_m2), (light.mean(axis=0), on_cells.mean(axis=0))
    area, level = np.concatenate(areas), np.concatenate(levels)
    mean = np.average(level, weights=area * (level > 0)) if (level > 0).any() else 0.0  # the outsides of walls do not count
    entry, cell = (np.flatnonzero((level > _BRIGHT * mean) & uses("bright_places")) for level in levels)
    entry = entry[~texels.borders.are_crossed(entry)]  # whose light is not that of their whole square
    weight = texels.bary_at(entry)
    of_cell, is_front, corners = cells.locate(cell)
    middle = corners.mean(axis=1)
    tri, u, v = (
        np.concatenate(both) for both in ((texels.texel_tri[entry], of_cell), (weight[:, 1], middle[:, 0]), (weight[:, 2], middle[:, 1]))
    )
    centre, normal = receiving.place(tri, u, v), receiving.normal[tri]
    normal[len(entry) :][~is_front] *= -1
    area = np.concatenate([texels.texel_area[entry], cells.area_m2[cell]]) * scene.scale**2
    sent = np.concatenate([light[:, entry], on_cells[:, cell]], axis=1).T * scene.surfaces.reflectance.at(tri, u, v)
    power = sent.sum(axis=1, dtype=np.float64) * area
    order = sort_by_place(centre, normal)
    order = order[power[order] > 0]
    entry, cell = np.append(entry, np.full(len(cell), -1))[order], np.append(np.full(len(entry), -1), cell)[order]
    centre, normal, area, power = centre[order], normal[order], area[order], power[order]
    start = np.zeros(0, np.int64)
    if len(order):
        start = cut_by_spread(power, np.concatenate([centre / RIGHT_ANGLES_APART, normal], axis=1), _MAX_CLUSTERS, _EVEN)
    clusters = Clusters.of(power, centre, normal, area / math.pi, start)
    density = power / area / np.repeat(clusters.weight, clusters.count)
    return BrightPlaces(entry, cell, density.astype(np.float32), clusters)


class Targets:
    """Bright places to aim at.

    of_texel   (n,) int32        number of the place of each texel entry, -1 for none
    of_cell    (n_cell,) int32   the same of each cell
    """

    of_texel: Int32
    of_cell: Int32

    def __init__(self, places: BrightPlaces, scene: PlacedSurfaces) -> None:
        self._places, self._receiving = places, scene.receiving
        self._cluster = np.repeat(np.arange(len(places.clusters)), places.clusters.count)
        is_texel = places.entry >= 0
        texel, cell = np.flatnonzero(is_texel), np.flatnonzero(~is_texel)
        self.of_texel, self.of_cell = np.full(len(scene.texels), -1, np.int32), np.full(len(scene.cells), -1, np.int32)
        self.of_texel[places.entry[texel]], self.of_cell[places.cell[cell]] = texel, cell
        footprints = scene.texels.footprints_at(places.entry[texel], side=1.0)
        self._texels = TexelChunk(footprints, np.zeros((len(texel), 2), np.uint32), scene.receiving, False)
        self._is_texel, self._row = is_texel, np.where(is_texel, np.cumsum(is_texel), np.cumsum(~is_texel)) - 1
        self._tri, _, self._corners = scene.cells.locate(places.cell[cell])

    def __len__(self) -> int:
        return len(self._places)

    def find_chances(self, chunk: TexelChunk) -> Float64:
        """(n_group, n_cluster): cdfs of the clusters for groups of _TOGETHER texels of a chunk, from stratified_choice.cumulate."""
        clusters = self._places.clusters
        probe = np.minimum(np.arange(0, len(chunk), _TOGETHER)[:, None] + _PROBES, len(chunk) - 1)
        at = chunk.receivers_at(probe.ravel(), MIDDLE)
        away2 = dot_rows(at.position, at.position)[:, None] + dot_rows(clusters.centre, clusters.centre)
        away2 = away2 - 2 * at.position @ clusters.centre.T
        height = at.normal @ clusters.centre.T - dot_rows(at.normal, at.position)[:, None]
        facing = at.position @ clusters.normal.T - dot_rows(clusters.centre, clusters.normal)
        no_reach, sealed = np.zeros(1, np.float32), np.ones(len(clusters), bool)
        chance = estimate_importance(away2, height, facing, no_reach, clusters.square, clusters.spread, sealed) * clusters.weight
        end = np.empty((len(probe), len(clusters)))
        cumulate(chance.reshape(*probe.shape, -1).sum(axis=1), 0, end)
        return end

    def choose(self, end: Float64, rows: IntArray, pick: Float64, rng: np.random.Generator) -> tuple[Int64, Float32]:
        """Points for rays (k, n) of texels `rows` (n,) of a chunk: their places (k * n,), and the points (k * n, 3), unit box.

        end    from find_chances
        pick   (k, n) in [0, 1)
        """
        cluster, _, rest = choose(end, np.broadcast_to(rows // _TOGETHER, pick.shape), pick)
        number, _ = self._places.clusters.choose(cluster, rest)
        u, out = rng.random((len(number), 2), np.float32), np.empty((3, len(number)), np.float32).T
        is_texel = self._is_texel[number]
        texel, cell = np.flatnonzero(is_texel), np.flatnonzero(~is_texel)
        out[texel] = self._texels.receivers_at(self._row[number[texel]], u[None, texel]).position
        u[cell] = np.where(u[cell].sum(axis=1, keepdims=True) > 1, 1 - u[cell], u[cell])
        row = self._row[number[cell]]
        first, second, third = np.moveaxis(self._corners[row], 1, 0)
        bary = first + u[cell, :1] * (second - first) + u[cell, 1:] * (third - first)
        out[cell] = self._receiving.place(self._tri[row], bary[:, 0], bary[:, 1])
        return number, out

    def find_pdf(self, end: Float64, rows: IntArray, number: IntArray, away: Float32, normal: Float32) -> Float64:
        """(n,): pdf per steradian with which rays from texels `rows` (n,) are aimed at points of places `number` (n,).

        away     (n, 3), unit box, from the texel to the point
        normal   (n, 3), of the surface there, of either sign
        """
        group, cluster = rows // _TOGETHER, self._cluster[number]
        low = np.where(cluster > 0, end[group, np.maximum(cluster - 1, 0)], group)
        square = np.maximum(dot_rows(away, away), np.float32(1e-20))
        cosine = np.abs(dot_rows(away, normal)) / np.sqrt(square)
        out: Float64 = (end[group, cluster] - low) * self._places.density[number] * square / np.maximum(cosine, np.float32(1e-6))
        return out
