"""Charts cut along creases, so that no leaf holds the light of faces that look different ways.

Across a crease light jumps, as it does between charts. A leaf over both sides could hold neither, and a texel that both share
would show their mean, where whoever filters the image reads the light of the side that holds its centre.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from .charts import ChartAtlas
from .layer_check import join_sets, signed_areas
from .scene import FloatArray, SceneSnapshot

_CREASE_COSINE = math.cos(math.radians(20.0))  # between shading normals at an edge's end; 2 and 8 degrees bake no better, with more leaves
_LEAST_AREA = 4.0  # texels^2; smaller faces side by side are a rough surface, of which a texel shows the mean


def cut_at_creases(snapshot: SceneSnapshot, atlas: ChartAtlas) -> ChartAtlas:
    """The atlas with its charts cut where shading normals differ across an edge; nothing moves on the pages."""
    used = np.flatnonzero(atlas.tri_chart >= 0)
    one, other, creased = _pair_sides(snapshot, atlas.tri_chart, used)
    smooth = ~creased
    facet = join_sets(len(used), one[smooth], other[smooth])
    small = np.bincount(facet, np.abs(signed_areas(atlas.tri_uv[used])), minlength=len(used))[facet] < _LEAST_AREA
    joined = smooth | (small[one] & small[other])
    _, first, label = np.unique(join_sets(len(used), one[joined], other[joined]), return_index=True, return_inverse=True)
    tri_chart = np.full(len(atlas.tri_chart), -1, np.int32)
    tri_chart[used] = label.ravel()
    whole = atlas.tri_chart[used[first]]
    return dataclasses.replace(atlas, tri_chart=tri_chart, chart_page=atlas.chart_page[whole], chart_object=atlas.chart_object[whole])


def _pair_sides(
    snapshot: SceneSnapshot, tri_chart: NDArray[np.int32], used: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """Places in `used` of triangles of one chart that share an edge of the mesh, (m,) twice, and whether it is a crease (m,)."""
    corner = snapshot.tri_vertex[used]
    low, high = corner, np.roll(corner, -1, axis=1)
    normal, after = snapshot.tri_normal[used], np.roll(snapshot.tri_normal[used], -1, axis=1)
    swap = (low > high)[..., None]
    low_normal, high_normal = np.where(swap, after, normal).reshape(-1, 3), np.where(swap, normal, after).reshape(-1, 3)
    keys = np.stack([np.repeat(tri_chart[used], 3), np.minimum(low, high).ravel(), np.maximum(low, high).ravel()])
    order = np.lexsort(keys[::-1])
    here, there = order[:-1], order[1:]
    same = (keys[:, here] == keys[:, there]).all(axis=0)
    here, there = here[same], there[same]
    creased = _differ(low_normal[here], low_normal[there]) | _differ(high_normal[here], high_normal[there])
    return here // 3, there // 3, creased


def _differ(one: FloatArray, other: FloatArray) -> NDArray[np.bool_]:
    """(m,) bool: whether normals (m, 3) are of a crease; a face without a normal has none."""
    told = one.any(axis=1) & other.any(axis=1)
    differ: NDArray[np.bool_] = told & ((one * other).sum(axis=1) < _CREASE_COSINE)
    return differ
