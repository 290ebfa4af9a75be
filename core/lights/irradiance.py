"""Irradiance from unoccluded lights of unit radiance or intensity, in closed form.

All lengths have the same unit. Receivers are points with a unit normal; only light from that side counts.
"""

import math
from collections.abc import Sequence

import numpy as np

from ..util.arrays import Float64, FloatArray

# Corners that stand for an ellipse from a distance, in radii, on. From 3 radii on the error is at most 3e-4 of what a receiver gets that
# faces the ellipse.
_CORNERS = (0.0, 32), (3.0, 8), (6.0, 6)


def cap_irradiance(cosine: FloatArray, sine_squared: FloatArray) -> Float64:
    """From a cone of directions of radiance 1, cut by the receiver's horizon; if wholly above it, pi sin^2 cos.

    cosine         (n,) float    between the receiver's normal and the cone's axis
    sine_squared   (n,) float    of the cone's half angle, at most a right angle
    out            (n,) float64
    Source: Snyder 1996, "Area Light Sources for Real-Time Graphics"; as in Lagarde & de Rousiers 2014, listing 7.
    """
    cosine, share = np.broadcast_arrays(np.asarray(cosine, np.float64), np.asarray(sine_squared, np.float64))
    out = math.pi * share * np.maximum(cosine, 0)
    cut = np.flatnonzero(cosine * cosine < share)
    out[cosine * cosine < share] = 0
    if len(cut):
        c, s = cosine[cut], np.minimum(share[cut], 1)
        sine = np.sqrt(1 - c * c)
        cotangent = np.sqrt((1 - s) / s)
        y = np.clip(-cotangent * c / np.maximum(sine, 1e-300), -1, 1)
        rim = sine * np.sqrt(1 - y * y)
        out[cut] = s * (c * np.arccos(y) - cotangent * rim) + np.arctan2(rim, cotangent)
    return np.maximum(out, 0)


def point_irradiance(to_light: FloatArray, normal: FloatArray, radius: FloatArray | float, soft: bool) -> Float64:
    """From a point light of intensity 1: a disk that faces the receiver (soft), or a sphere.

    to_light   (n, 3) float   from the receivers to the light's centre
    radius     a number, (1,) or (n,) float; all 0, or none
    out        (n,) float64   facing a disk 1 / (d^2 + r^2); inside a sphere that of its radiance from all sides, as in Cycles
    """
    vector = np.asarray(to_light, np.float64)
    distance_squared = np.maximum((vector * vector).sum(axis=1), 1e-300)
    cosine = (vector * normal).sum(axis=1) / np.sqrt(distance_squared)
    if not np.any(radius):
        return np.maximum(cosine, 0) / distance_squared
    radius_squared = np.square(radius, dtype=np.float64)
    radiance = 1 / (math.pi * radius_squared)
    if soft:
        out = cap_irradiance(cosine, radius_squared / (distance_squared + radius_squared))
    else:
        out = cap_irradiance(cosine, np.minimum(radius_squared / distance_squared, 1))
        out = np.where(distance_squared > radius_squared, out, math.pi)
    return out * radiance


def sun_irradiance(cosine: FloatArray, half_angle_rad: FloatArray | float) -> Float64:
    """From a sun whose irradiance facing it is 1; cosine (n,) between the normals and the direction to it.

    half_angle_rad   a number, (1,) or (n,) float; all 0, or none
    """
    if not np.any(half_angle_rad):
        return np.maximum(np.asarray(cosine, np.float64), 0)
    share = np.sin(half_angle_rad, dtype=np.float64) ** 2
    return cap_irradiance(cosine, np.asarray(share)) / (math.pi * share)


def polygon_irradiance(corners: FloatArray, position: FloatArray, normal: FloatArray) -> Float64:
    """From a convex planar polygon of radiance 1, cut by the receiver's horizon; negative if the receiver sees it clockwise.

    corners            (m, 3) or (n, m, 3) float    one polygon, or one per receiver
    position, normal   (n, 3) float
    out                (n,) float64
    Source: Lambert 1760; Arvo 1995, "Applications of Irradiance Tensors", 2.1. Edges are cut independently; an arc along the horizon closes
    the gap between the two cuts.
    """
    points = np.reshape(corners, (-1, *np.shape(corners)[-2:]))
    place, up = (np.ascontiguousarray(rows.T, np.float64) for rows in (position, normal))
    vector = [points[:, i].T - place for i in range(points.shape[1])]
    height = [_dot(v, up) for v in vector]
    total, is_cut = np.zeros(len(position)), False
    leaving, entering = np.zeros((3, len(position))), np.zeros((3, len(position)))
    for i in range(len(vector)):
        j = (i + 1) % len(vector)
        a, b = vector[i], vector[j]
        crossing = (height[i] > 0) != (height[j] > 0)
        if crossing.any():
            is_cut = True
            a, b = a.copy(), b.copy()
            rows = np.flatnonzero(crossing)
            share = height[i][rows] / (height[i][rows] - height[j][rows])
            cut = vector[i][:, rows] + share * (vector[j][:, rows] - vector[i][:, rows])
            falls = height[i][rows] > 0
            b[:, rows[falls]] = leaving[:, rows[falls]] = cut[:, falls]
            a[:, rows[~falls]] = entering[:, rows[~falls]] = cut[:, ~falls]
        part = _edge(a, b, up)
        part[(height[i] <= 0) & (height[j] <= 0)] = 0
        total += part
    if is_cut:
        total += np.arctan2(_dot(_cross(leaving, entering), up), _dot(leaving, entering))
    return total / -2  # a polygon counter-clockwise as seen from its front has reversed edges in Lambert's formula


def ellipse_irradiance(centre: FloatArray, semi_axes: FloatArray, position: FloatArray, normal: FloatArray) -> Float64:
    """From an ellipse of radiance 1, as a polygon of its area with more corners the nearer it is; signed as polygon_irradiance.

    centre      (3,) or (m, 3) float         one ellipse, m = 1, or one per receiver, m = n
    semi_axes   (2, 3) or (m, 2, 3) float    counter-clockwise on the shining side
    """
    centres, axes = np.reshape(centre, (-1, 3)), np.reshape(semi_axes, (-1, 2, 3))
    radius_squared = (axes**2).sum(axis=2).max(axis=1)
    distance_squared = ((np.asarray(position, np.float64) - centres) ** 2).sum(axis=1)
    tier = sum((distance_squared >= begin**2 * radius_squared).astype(np.int8) for begin, _ in _CORNERS[1:])
    out = np.empty(len(position))
    for k, (_, count) in enumerate(_CORNERS):
        rows = np.flatnonzero(tier == k)
        phi = 2 * math.pi * np.arange(count) / count
        growth = math.sqrt(2 * math.pi / count / math.sin(2 * math.pi / count))  # makes the areas equal
        own = rows if len(centres) > 1 else slice(None)
        corners = centres[own, None] + growth * np.stack([np.cos(phi), np.sin(phi)], axis=1) @ axes[own]
        out[rows] = polygon_irradiance(corners, position[rows], normal[rows])
    return out


def _edge(a: FloatArray, b: FloatArray, up: FloatArray) -> FloatArray:
    """Angle between a and b times the height of the unit normal of their plane; arrays (3, n)."""
    cross = _cross(a, b)
    length = np.sqrt(_dot(cross, cross))
    return np.arctan2(length, _dot(a, b)) * _dot(cross, up) / np.maximum(length, 1e-300)


def _dot(a: Sequence[FloatArray] | FloatArray, b: Sequence[FloatArray] | FloatArray) -> FloatArray:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
