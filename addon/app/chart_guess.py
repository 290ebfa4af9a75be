"""A fast guess of the number of charts of meshes, for the estimate that is shown before a bake."""

from __future__ import annotations

import numpy as np

from ...core.scene.morton import find_facing
from ...core.scene.topology import hash_points, join_sets, pair_sides
from ...core.util.arrays import Float64, Int64, IntArray
from ...core.util.geometry import triangle_normals_areas

_SMOOTH = 0.7  # least cosine between neighbours of one chart: 45 degrees


def guess_charts(corner: Float64, tri_object: IntArray, count: int) -> tuple[Int64, Float64]:
    """(count,) int64: approximate number of charts of each object; and (count,) float64, m: the sum of the roots of their areas.

    A chart is taken to be a connected part that faces one of six directions and has no edge sharper than 45 degrees. So a ball has six
    charts, like a box; xatlas makes about as many.

    corner       (n, 3, 3) float64, m
    tri_object   (n,) int   from 0 to count - 1
    """
    normal, area = triangle_normals_areas(corner)
    solid = np.isfinite(area) & (area > 0.0)
    normal, area, tri_object = normal[solid], area[solid], tri_object[solid]
    # Corners are identified by position: files often have a vertex once for each of its normals.
    number = np.unique(hash_points(corner[solid]), return_inverse=True)[1].reshape(-1, 3)
    _, one, other = pair_sides(number, 6 * tri_object.astype(np.int64) + find_facing(normal))
    one, other = one // 3, other // 3
    smooth = np.einsum("ij,ij->i", normal[one], normal[other]) >= _SMOOTH
    first, chart = np.unique(join_sets(len(normal), one[smooth], other[smooth]), return_inverse=True)
    owner = tri_object[first]
    side_m = np.sqrt(np.bincount(chart, area, len(first)))
    total_m: Float64 = np.bincount(owner, side_m, count).astype(np.float64, copy=False)  # of no charts bincount makes integers
    return np.bincount(owner, minlength=count), total_m
