"""A place of its own in a picture for each polygon of a mesh, as wide and high as it is: for colours that only Blender knows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...core.util.arrays import FloatArray, IntArray
from .mesh_arrays import LocalMesh

MOST_POLYGONS = 150_000
MOST_TEXELS = 1 << 22
_BORDER = 2  # texels around each polygon, for interpolation


@dataclass(frozen=True)
class BakedLayer:
    """Where on its mesh an evaluated colour lies: texture coordinates of the mesh's corners, found by key in a SocketBaker."""

    key: tuple[int, ...]


@dataclass(frozen=True)
class PolygonAtlas:
    """Texture coordinates (n_corner, 2) float64, and the picture's size in texels."""

    uv: NDArray[np.float64]
    width: int
    height: int


def lay_polygons(local: LocalMesh, linear: FloatArray, texels_per_m: float, most_texels: int) -> PolygonAtlas | None:
    """The polygons of a mesh side by side, each seen along its normal; None where there are too many.

    linear         (3, 3) float, of the object's matrix: sizes are those in the world
    texels_per_m   wanted, of which there are fewer where more than most_texels would be needed
    """
    if not 0 < local.n_polygon <= MOST_POLYGONS:
        return None
    flat = _flatten(local.position @ np.asarray(linear, np.float64).T, local)
    low = np.minimum.reduceat(flat, local.polygon_start)
    extent = np.maximum.reduceat(flat, local.polygon_start) - low
    if not np.isfinite(extent).all():
        return None
    density = min(texels_per_m, np.sqrt(most_texels / max(float(extent.prod(axis=1).sum()), 1e-12)))
    density = min(density, MOST_TEXELS / max(float(extent.max()), 1e-12))  # a polygon without area may be endlessly long
    while True:
        size = np.ceil(extent * density).astype(np.int64) + 1 + 2 * _BORDER
        if int(size.prod(axis=1).sum()) <= MOST_TEXELS or int(size.max()) <= 2 + 2 * _BORDER:
            break
        density /= 2.0
    place, width, height = _pack(size)
    polygon = np.repeat(np.arange(local.n_polygon), np.diff(np.append(local.polygon_start, local.n_corner)))
    texel = place[polygon] + _BORDER + 0.5 + (flat - low[polygon]) * density
    return PolygonAtlas(texel / (width, height), width, height)


def _flatten(position: NDArray[np.float64], local: LocalMesh) -> NDArray[np.float64]:
    """(n_corner, 2): corners in the plane of their polygon, the first side along x."""
    start = local.polygon_start
    count = np.diff(np.append(start, local.n_corner))
    polygon = np.repeat(np.arange(local.n_polygon), count)
    corner = position[local.corner_vertex]
    after = np.arange(local.n_corner) + 1
    after[start + count - 1] = start
    normal = np.add.reduceat(np.cross(corner - corner[start][polygon], corner[after] - corner[start][polygon]), start)
    along = corner[after[start]] - corner[start]
    along, normal = (one / np.maximum(np.linalg.norm(one, axis=1, keepdims=True), 1e-300) for one in (along, normal))
    aside = np.cross(normal, along)
    way = corner - corner[start][polygon]
    return np.stack([(way * along[polygon]).sum(axis=1), (way * aside[polygon]).sum(axis=1)], axis=1)


def _pack(size: IntArray) -> tuple[NDArray[np.int64], int, int]:
    """Low corners (n, 2) of rectangles (n, 2) in rows of falling height, and the width and height of all."""
    width = max(int(np.sqrt(size.prod(axis=1).sum()) * 1.05), int(size[:, 0].max()))
    order = np.lexsort((size[:, 0], -size[:, 1]))
    end = np.cumsum(size[order, 0])
    place = np.zeros_like(size)
    first, top = 0, 0
    while first < len(order):
        begin = end[first] - size[order[first], 0]
        last = int(np.searchsorted(end, begin + width, side="right"))
        row = order[first:last]
        place[row, 0] = end[first:last] - begin - size[row, 0]
        place[row, 1] = top
        top += int(size[order[first], 1])
        first = last
    return place, width, top
