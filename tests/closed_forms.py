"""Irradiance and form factors as published, written without the core's own formulas.

Positions and normals are (n, 3) float, results (n,) float64, per radiance 1, intensity 1 or facing irradiance 1.
Numbers of configurations are those of Howell, "A Catalog of Radiation Heat Transfer Configuration Factors".
"""

import math

import numpy as np


def from_point(light: np.ndarray, position: np.ndarray, normal: np.ndarray, radius: float = 0.0) -> np.ndarray:
    """Of a point of intensity 1; with a radius, Blender's soft falloff 1 / (d^2 + r^2)."""
    way = np.asarray(light) - position
    square = (way**2).sum(1)
    return np.maximum((way * normal).sum(1), 0) / np.sqrt(square) / (square + radius**2)


def from_polygon(corner: np.ndarray, position: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Of a polygon (m, 3) that lies wholly above the receivers' horizon and is seen from one side. Source: Lambert 1760."""
    way = np.asarray(corner)[None] - position[:, None]
    way /= np.linalg.norm(way, axis=2, keepdims=True)
    following = np.roll(way, -1, axis=1)
    cross = np.cross(way, following)
    sine = np.linalg.norm(cross, axis=2)
    angle = np.arctan2(sine, (way * following).sum(2))
    return np.abs((angle / np.maximum(sine, 1e-300) * (cross * normal[:, None]).sum(2)).sum(1)) / 2


def above_floor(corner: np.ndarray) -> np.ndarray:
    """The part of a plane convex polygon (m, 3) at z >= 0. Source: Sutherland & Hodgman 1974."""
    kept = []
    for a, b in zip(corner, np.roll(corner, -1, axis=0), strict=True):
        if a[2] >= 0:
            kept.append(a)
        if (a[2] >= 0) != (b[2] >= 0):
            kept.append(a + (b - a) * a[2] / (a[2] - b[2]))
    return np.array(kept)


def from_disk(radius: float, height: float, offset: np.ndarray) -> np.ndarray:
    """Of a disk parallel to the receiver, `height` above it, whose axis passes it at `offset` (n,). Source: B-13."""
    square = offset**2 + height**2
    return math.pi / 2 * (1 - (square - radius**2) / np.sqrt((square + radius**2) ** 2 - 4 * offset**2 * radius**2))


def factor_of_parallel_rectangles(a: float, b: float, distance: float) -> float:
    """Form factor of equal rectangles that face each other. Source: C-11."""
    x, y = a / distance, b / distance
    x1, y1 = math.sqrt(1 + x * x), math.sqrt(1 + y * y)
    edges = x * y1 * math.atan(x / y1) + y * x1 * math.atan(y / x1) - x * math.atan(x) - y * math.atan(y)
    return 2 / (math.pi * x * y) * (math.log(x1 * y1 / math.sqrt(1 + x * x + y * y)) + edges)


def factor_of_perpendicular_rectangles(width: float, height: float, edge: float) -> float:
    """From a rectangle edge * width to one of edge * height that stands on the common edge. Source: C-14."""
    w, h = width / edge, height / edge
    w2, h2 = w * w, h * h
    arcs = w * math.atan(1 / w) + h * math.atan(1 / h) - math.hypot(w, h) * math.atan(1 / math.hypot(w, h))
    logs = math.log((1 + w2) * (1 + h2) / (1 + w2 + h2))
    logs += w2 * math.log(w2 * (1 + w2 + h2) / ((1 + w2) * (w2 + h2))) + h2 * math.log(h2 * (1 + w2 + h2) / ((1 + h2) * (w2 + h2)))
    return (arcs + logs / 4) / (math.pi * w)


def factor_of_coaxial_disks(radius: float, other: float, distance: float) -> float:
    """From a disk to another one that faces it. Source: C-41."""
    x = 1 + (distance**2 + other**2) / radius**2
    return (x - math.sqrt(x * x - 4 * (other / radius) ** 2)) / 2
