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
from .layer_check import join_sets, pair_sides, signed_areas
from .scene import FloatArray, SceneSnapshot

_CREASE_COSINE = math.cos(math.radians(20.0))  # between shading normals at an edge's end; 2 and 8 degrees bake no better, with more leaves
_LEAST_AREA = 4.0  # texels^2; smaller faces side by side are a rough surface, of which a texel shows the mean


def cut_at_creases(snapshot: SceneSnapshot, atlas: ChartAtlas) -> ChartAtlas:
    """The atlas with its charts cut where shading normals differ across an edge; nothing moves on the pages."""
    used = np.flatnonzero(atlas.tri_chart >= 0)
    ends, one, other = pair_sides(snapshot.tri_vertex[used], atlas.tri_chart[used])
    normal = snapshot.tri_normal[used].reshape(-1, 3)[ends]
    smooth = ~_differ(normal[:, one], normal[:, other]).any(axis=0)
    one, other = one // 3, other // 3
    facet = join_sets(len(used), one[smooth], other[smooth])
    small = np.bincount(facet, np.abs(signed_areas(atlas.tri_uv[used])), minlength=len(used))[facet] < _LEAST_AREA
    joined = smooth | (small[one] & small[other])
    _, first, label = np.unique(join_sets(len(used), one[joined], other[joined]), return_index=True, return_inverse=True)
    tri_chart = np.full(len(atlas.tri_chart), -1, np.int32)
    tri_chart[used] = label.ravel()
    whole = atlas.tri_chart[used[first]]
    return dataclasses.replace(atlas, tri_chart=tri_chart, chart_page=atlas.chart_page[whole], chart_object=atlas.chart_object[whole])


def _differ(one: FloatArray, other: FloatArray) -> NDArray[np.bool_]:
    """(2, m) bool: whether normals (2, m, 3) are of a crease; a face without a normal has none."""
    told = one.any(axis=-1) & other.any(axis=-1)
    differ: NDArray[np.bool_] = told & ((one * other).sum(axis=-1) < _CREASE_COSINE)
    return differ
