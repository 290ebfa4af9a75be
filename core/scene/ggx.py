"""Rough surfaces as GGX microfacets: visible normals and masking, Fresnel's equations, and tables by the cosine with the normal.

Source: Walter et al. 2007, "Microfacet models for refraction through rough surfaces"; Heitz 2018, "Sampling the GGX distribution of
visible normals"; Heitz 2014, "Understanding the masking-shadowing function".
"""

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

from ..util.arrays import Float32, Float64, FloatArray, IntArray
from ..util.geometry import gather, orthonormal_basis

Axes: TypeAlias = tuple[FloatArray, FloatArray, FloatArray]

LEAST_ALPHA = 1e-3  # of a mirror; its lobe is a twentieth of a degree wide
LEAST_COSINE = np.float32(1e-6)
TINY = np.finfo(np.float32).tiny
ENTRIES = 65  # per table


def find_axes(normal: Float32) -> Axes:
    """(3, n) each: tangent and bitangent of unit normals (3, n), and the normals."""
    tangent, bitangent = orthonormal_basis(normal.T)
    return tangent.T, bitangent.T, normal


def view_along(direction: Float32, axes: Axes) -> FloatArray:
    """(3, n): toward the viewer, for rays in directions (3, n) that arrive from the side of the normals, in local axes."""
    local = np.stack([-dot(direction, axis) for axis in axes])
    local[2] = np.maximum(local[2], LEAST_COSINE)
    return local


def turn_back(local: FloatArray, axes: Axes) -> FloatArray:
    """(3, n): local directions (3, n) in world space."""
    return local[0] * axes[0] + local[1] * axes[1] + local[2] * axes[2]


def tabulated_views(entries: int, samples: int) -> tuple[FloatArray, FloatArray]:
    """Directions (3, entries * samples) toward the viewer for each entry of a table, and numbers (2, entries * samples) to sample with.

    Source: Rank-1 lattice by the golden ratio; Niederreiter 1992.
    """
    cosine = np.repeat(np.maximum(np.linspace(0, 1, entries) ** 2, 1e-5), samples)
    index = np.arange(samples)
    numbers = np.tile(np.stack([(index + 0.5) / samples, index * 0.6180339887498949 % 1]), entries)
    return np.stack([np.sqrt(1 - cosine**2), np.zeros_like(cosine), cosine]), numbers


def sample_visible_normals(view: FloatArray, alpha: FloatArray, numbers: FloatArray) -> FloatArray:
    """(3, n): normals of microfacets visible from view (3, n), around +Z, with density G1 max(view . h, 0) D / view_z per steradian.

    alpha     (n,) float
    numbers   (2, n) float, uniform in [0, 1)
    Source: Heitz 2018, appendix A.
    """
    stretched = np.stack([alpha * view[0], alpha * view[1], view[2]])
    stretched /= np.sqrt(dot(stretched, stretched))
    length = np.sqrt(stretched[0] ** 2 + stretched[1] ** 2)
    upright = length < 1e-7
    length = np.where(upright, 1, length)
    first = np.stack([np.where(upright, 1, -stretched[1] / length), np.where(upright, 0, stretched[0] / length), np.zeros_like(length)])
    second = np.cross(stretched, first, axis=0)
    radius, turn = np.sqrt(numbers[0]), 2 * np.pi * numbers[1]
    x, y = radius * np.cos(turn), radius * np.sin(turn)
    share = 0.5 * (1 + stretched[2])
    y = (1 - share) * np.sqrt(np.maximum(1 - x * x, 0)) + share * y
    half = x * first + y * second + np.sqrt(np.maximum(1 - x * x - y * y, 0)) * stretched
    out = np.stack([alpha * half[0], alpha * half[1], np.maximum(half[2], 1e-9)])
    return out / np.sqrt(dot(out, out))


def mask(cosine_in: FloatArray, cosine_out: FloatArray, alpha: FloatArray) -> FloatArray:
    """(n,): G2 / G1, the weight without Fresnel of a direction that was reflected at a sampled visible normal; 0 below the surface.

    Source: Heitz 2018, eq. 19, with the height-correlated G2 of Heitz 2014.
    """
    into, out = shadow_term(cosine_in, alpha), shadow_term(np.maximum(cosine_out, 1e-6), alpha)
    return np.where(cosine_out > 0, (1 + into) / (1 + into + out), 0)


def shadow_term(cosine: FloatArray, alpha: FloatArray) -> FloatArray:
    """Smith's Lambda of GGX. Source: Walter et al. 2007, eq. 34; Heitz 2014, eq. 72."""
    tangent2 = np.maximum(1 / (cosine * cosine) - 1, 0)
    return 0.5 * (np.sqrt(1 + alpha * alpha * tangent2) - 1)


def reflectance(cosine: FloatArray, eta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n,) each: share of unpolarised light at a cosine (n,) with the normal that a smooth interface reflects, 1 for total reflection; and
    the cosine of the refracted direction with the normal on the other side.

    eta   (n,) float: index of refraction of the other side, relative to the side that light comes from
    Source: Walter et al. 2007, eq. 22.
    """
    square = 1 - (1 - cosine * cosine) / (eta * eta)
    inside = square > 0
    other = np.sqrt(np.where(inside, square, 0))
    across = (cosine - eta * other) / np.maximum(cosine + eta * other, TINY)
    along = (eta * cosine - other) / np.maximum(eta * cosine + other, TINY)
    return np.where(inside, 0.5 * (across * across + along * along), 1), other


def fresnel(cosine: FloatArray, ior: FloatArray) -> FloatArray:
    """(n,): share of unpolarised light from outside, at a cosine (n,) with the normal, that a smooth dielectric reflects.

    Source: Walter et al. 2007, eq. 22.
    """
    g = np.sqrt(np.maximum(ior * ior - 1 + cosine * cosine, 0))
    ratio = (g - cosine) / np.maximum(g + cosine, 1e-9)
    other = (cosine * (g + cosine) - 1) / (cosine * (g - cosine) + 1)
    return 0.5 * ratio * ratio * (1 + other * other)


def tinted_fresnel(cosine: FloatArray, ior: FloatArray, tint: FloatArray) -> FloatArray:
    """(n,): as fresnel, with the reflection at normal incidence scaled by a tint (n,) and that at grazing incidence unchanged.

    Source: Hoffman 2019, "Fresnel equations considered harmful", with the exact equations in between; as Specular Tint of the Principled
    BSDF in Cycles.
    """
    whole = fresnel(cosine, ior)
    straight_on = ((ior - 1) / (ior + 1)) ** 2
    grazing = np.maximum(whole - straight_on, 0) / np.maximum(1 - straight_on, 1e-6)
    return tint * whole + (1 - tint) * grazing


def find_place(row: IntArray, cosine: FloatArray, entries: int = ENTRIES) -> tuple[IntArray, FloatArray]:
    """Place of cosines (n,) in the tables of rows (n,), whose entries are at even steps of the square root of the cosine, since tables vary
    fastest at grazing angles: index of the entry before, and fraction of the way to the next.
    """
    place = np.sqrt(np.minimum(np.abs(cosine), 1)) * (entries - 1)
    before = np.minimum(place, entries - 2).astype(np.intp)
    return row * entries + before, place - before


def look_up(table: Float32, before: IntArray, share: FloatArray) -> Float32:
    """(n,): values of tables (n_row, entries) at places from find_place."""
    values = table.reshape(-1)
    low = gather(values, before)
    return low + (gather(values, before + 1) - low) * share.astype(np.float32)


def stack_tables(rows: Sequence[tuple[Float64, ...]]) -> Float32:
    """(k, n_row, entries): k tables of the k tabulated functions of each row."""
    return np.ascontiguousarray(np.array(rows, np.float32).swapaxes(0, 1))


def dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """(n,): dot products of vectors (3, n)."""
    return np.einsum("kn,kn->n", a, b)
