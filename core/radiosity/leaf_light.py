"""Light on the leaves of quadtrees: the functions of nodes at points.

A linear or quadratic function that is fitted to a small spot of light dips below zero beside it. Clipping it at zero alone would add
energy, so the rest of the leaf is scaled down to the flux that it had.
"""

from __future__ import annotations

import numpy as np

from ..util.arrays import Float32, Float64, FloatArray, IntArray
from . import basis
from .quadtree import Quadtree
from .tally import Solution


def evaluate_nodes(tree: Quadtree, coefficient: Float64, node: IntArray, x: FloatArray, y: FloatArray) -> Float64:
    """(..., m) float64: the functions of nodes (m,) at points x, y (m,), page texels; they may be negative.

    coefficient   (..., K, n_node) float64, as of tally.Solution
    """
    return basis.evaluate(coefficient.take(node, axis=-1), *_find_places(tree, node, x, y), tree.degree)


def find_variance(tree: Quadtree, solution: Solution, node: IntArray, x: FloatArray, y: FloatArray) -> Float64:
    """(3, m) float64, (W/m^2)^2: variance of the functions of nodes (m,) at points x, y (m,), page texels."""
    norm = basis.square_norm(tree.project[node], *_find_places(tree, node, x, y), tree.degree)
    return solution.variance[:, node] * (norm * tree.area[node])


def _find_places(tree: Quadtree, node: IntArray, x: FloatArray, y: FloatArray) -> tuple[Float64, Float64]:
    """Coordinates s, t of points in their nodes, each (m,), [-1, 1] inside."""
    half = tree.side[node] / 2.0
    return (x - tree.origin[node, 0]) / half - 1.0, (y - tree.origin[node, 1]) / half - 1.0


def clip_light(light: Float32 | Float64, area: FloatArray, node: IntArray) -> None:
    """Clip negative light to zero, in place, and scale the rest of each node down to the flux it had.

    light   (n,) float, W/m^2, at texels in any order
    area    (n,) float, m^2, of the texels
    node    (n,) int: the node of each texel
    """
    if light.min(initial=0.0) >= 0.0:
        return
    before = np.bincount(node, light * area)
    np.maximum(light, 0.0, out=light)
    after = np.bincount(node, light * area)
    factor = np.divide(np.maximum(before, 0.0), after, out=np.ones(len(after)), where=after > 0.0)
    light *= factor[node].astype(light.dtype)
