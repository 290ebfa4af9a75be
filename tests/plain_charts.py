"""Charts of triangles and of rectangles, with their outlines."""

import numpy as np
from leaflight.core.atlas.outlines import measure_outlines


def triangles(count, seed=1, box=(1.0, 1.0)):
    """Charts of one triangle each, at 0, of any shape."""
    uv = np.random.default_rng(seed).uniform(0.0, 1.0, (count, 3, 2)) * box
    uv -= uv.min(axis=1, keepdims=True)
    chart = np.arange(count)
    return uv, chart, measure_outlines(uv, chart, np.zeros((count, 3), bool), count)


def rectangles(sizes):
    """Charts of two triangles each."""
    corner = np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1.0]]])
    uv = (corner[None] * np.asarray(sizes, float)[:, None, None]).reshape(-1, 3, 2)
    chart = np.repeat(np.arange(len(sizes)), 2)
    shared = np.tile([[False, False, True], [True, False, False]], (len(sizes), 1))
    return uv, chart, measure_outlines(uv, chart, shared, len(sizes))
