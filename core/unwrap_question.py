"""What xatlas is asked of one object, and how its answer is read.

Packing, which only tells UVs, takes most of its time with meshes of few triangles. UVs of flat charts come from their planes; so an object
that seems to fall into such is packed roughly, and anew only where a chart is not flat after all. xatlas finds the same charts either way.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from .geometry import orthonormal_basis
from .layer_check import signed_areas
from .mesh_pieces import split_part
from .scene import IntArray
from .topology import join_sets, pair_sides
from .unfolding import give_up, unfold_meshes, wait_for
from .xatlas_process import Mesh

Float64: TypeAlias = NDArray[np.float64]
Int64: TypeAlias = NDArray[np.int64]
Bool: TypeAlias = NDArray[np.bool_]

_LARGEST_COORDINATE = 1e5  # float32 then still tells 1 % of a triangle of median size
_FLATNESS = 1e-5  # of a chart's extent: nearer to its plane it is projected, in float64
# Cosines between triangles that share a side: above the one they lie in one plane, below the other xatlas cuts between them.
_COPLANAR, _CUT = 1.0 - 1e-7, 0.25


class Question:
    """A question to xatlas, put when it is made."""

    def __init__(self, position: Float64, normal: Float64, area: Float64, tri_vertex: IntArray, tri_polygon: IntArray) -> None:
        """position      (n, 3, 3) float64, m
        normal        (n, 3) float64
        area          (n,) float64, m^2, above 0
        tri_vertex    (n, 3) int
        tri_polygon   (n,) int
        """
        self._position, self._normal, self._area = position, normal, area
        _, first, vertex = np.unique(tri_vertex, return_index=True, return_inverse=True)
        vertex = vertex.reshape(-1, 3)
        label = join_sets(len(first), vertex.ravel(), np.roll(vertex, -1, axis=1).ravel())[vertex[:, 0]]
        order = np.argsort(label, kind="stable")
        _, one, other = pair_sides(vertex, np.zeros(len(vertex), np.int64))
        one, other = one // 3, other // 3
        cosine = _dot(normal[one], normal[other])
        facet = join_sets(len(vertex), one[cosine > _COPLANAR], other[cosine > _COPLANAR])
        # Loose parts go in apart, each centred and scaled: a teaspoon in a hall would drown in float32.
        loose = np.split(order, np.flatnonzero(np.diff(label[order])) + 1)
        self._parts = [part[rows] for part in loose for rows in split_part(facet[part], tri_polygon[part], position[part].mean(axis=1))]
        self._meshes: list[Mesh] = []
        self._scaled_area = 0.0
        for part in self._parts:
            points = position[part]
            points = points - 0.5 * (points.min(axis=(0, 1)) + points.max(axis=(0, 1)))
            # xatlas leaves out triangles by an absolute area, so the usual one has area 1.
            scale = min(float(np.median(area[part])) ** -0.5, _LARGEST_COORDINATE / float(np.abs(points).max()))
            self._scaled_area += float(area[part].sum()) * scale**2
            _, first, index = np.unique(vertex[part], return_index=True, return_inverse=True)
            points = points.reshape(-1, 3)[first] * scale
            self._meshes.append((np.ascontiguousarray(points, np.float32), np.ascontiguousarray(index.reshape(-1, 3), np.uint32)))
        self._roughly = _seems_flat(cosine)
        self._answer = unfold_meshes(self._meshes, self._scaled_area, self._roughly)

    def cancel(self) -> None:
        """Nobody will read the answer."""
        give_up(self._answer)

    def read(self, watch: Callable[[], None] = lambda: None) -> tuple[Int64, Float64]:
        """(n,) int64 chart, -1 where xatlas leaves a triangle out; (n, 3, 2) float64 UV, m, each chart of its area in space.

        watch   called now and then while xatlas is at work; it may raise
        Raises ValueError when xatlas cannot be loaded, UnfolderDied when it crashes.
        """
        while True:
            group, uv = np.full(len(self._area), -1, np.int64), np.zeros((len(self._area), 3, 2))
            for part, unfolded in zip(self._parts, wait_for(self._answer, watch), strict=True):
                group[part], uv[part] = unfolded
            placed = group >= 0
            position, area, chart = self._position[placed], self._area[placed], group[placed]
            is_flat, projected = _project_flat_charts(position, self._normal[placed], area, chart)
            if is_flat.all() or not self._roughly:
                break
            self._roughly = False
            self._answer = unfold_meshes(self._meshes, self._scaled_area)
        if not is_flat.all():
            projected = np.where(is_flat[:, None, None], projected, _restore_proportions(position, uv[placed], area, chart))
        uv[placed] = projected
        return group, uv


def _seems_flat(cosine: Float64) -> bool:
    """Whether no two triangles that share a side, with normals at that cosine (m,), are bent as little as xatlas allows within a chart."""
    return bool(((cosine > _COPLANAR) | (cosine < _CUT)).all())


def _restore_proportions(position: Float64, uv: Float64, area: Float64, group: Int64) -> Float64:
    """Charts as they were before xatlas stretched them to whole texels: as conformal as a scale along u and v can make them, not
    mirrored, and of their area in space."""
    edge, uv_edge = position[:, 1:] - position[:, :1], uv[:, 1:] - uv[:, :1]
    uv_area = signed_areas(uv)
    steep = np.abs(uv_area) > 1e-9 * (uv_edge**2).sum(axis=(1, 2))  # others have no derivative
    weight = np.where(steep, area / np.where(steep, uv_area**2, 1.0), 0.0)
    along_u = ((edge[:, 0] * uv_edge[:, 1, 1:] - edge[:, 1] * uv_edge[:, 0, 1:]) ** 2).sum(axis=1)
    along_v = ((edge[:, 1] * uv_edge[:, 0, :1] - edge[:, 0] * uv_edge[:, 1, :1]) ** 2).sum(axis=1)
    n_chart = group.max(initial=-1) + 1
    sums = [np.bincount(group, values, n_chart) for values in (weight * along_u, weight * along_v, area, uv_area)]
    known = (sums[0] > 0) & (sums[1] > 0)
    ratio = np.sqrt(np.where(known, sums[0], 1.0) / np.where(known, sums[1], 1.0)) ** 0.5
    size = np.sqrt(sums[2] / np.where(sums[3] != 0, np.abs(sums[3]), 1.0))
    scale = np.stack([np.where(sums[3] < 0, -1.0, 1.0) * size * ratio, size / ratio], axis=1)
    restored: Float64 = uv * scale[group][:, None]
    return restored


def _project_flat_charts(position: Float64, normal: Float64, area: Float64, group: Int64) -> tuple[Bool, Float64]:
    """Whether triangles are of flat charts, (n,), and all of them projected onto their charts' planes, which for those is exact."""
    n_chart = group.max(initial=-1) + 1
    axis = sum_by(group, normal * area[:, None], n_chart)
    length = np.linalg.norm(axis, axis=1)
    axis = axis / np.where(length > 0, length, 1.0)[:, None]
    centre = sum_by(group, position.mean(axis=1), n_chart) / np.maximum(np.bincount(group, minlength=n_chart), 1)[:, None]
    offset = position - centre[group][:, None]
    height, extent = np.zeros(n_chart), np.zeros(n_chart)
    np.maximum.at(height, group, np.abs(_dot(offset, axis[group][:, None])).max(axis=1))
    np.maximum.at(extent, group, np.abs(offset).max(axis=(1, 2)))
    facing = (normal * axis[group]).sum(axis=1) > 0
    is_flat: Bool = (height <= _FLATNESS * extent)[group] & (np.bincount(group, ~facing, n_chart) == 0)[group]
    return is_flat, project(offset, axis[group])


def project(position: Float64, axis: Float64) -> Float64:
    """(n, 3, 2) float64: corners (n, 3, 3) on the planes across the unit vectors (n, 3)."""
    tangent, bitangent = orthonormal_basis(axis)
    return np.stack([_dot(position, tangent[:, None]), _dot(position, bitangent[:, None])], axis=2)


def _dot(one: Float64, other: Float64) -> Float64:
    """Products summed term by term: the same for the same vectors wherever they stand, which einsum does not promise."""
    x, y, z = (one[..., k] * other[..., k] for k in range(3))
    return np.asarray(x + y + z)


def sum_by(group: Int64, values: Float64, count: int) -> Float64:
    """(count, 3) float64: sums of vectors (n, 3) over the members of each group."""
    return np.stack([np.bincount(group, values[:, k], count) for k in range(3)], axis=1)
