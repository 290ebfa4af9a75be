"""Slender triangles cut across into parts that are not: of a long one the middle tells little of where its light is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..util.ablation import uses
from ..util.arrays import Float32, Float64

_LONG = 8.0  # longest edge, in heights above it, from which on a triangle is cut
# Length of its parts, in that height, at most: of 8 light by strips 5 mm from a wall takes twice the time, of 2 no less.
_PART = 4.0
# Of the area of all, that parts have at least on the mean: there are never many more than its inverse, however slender triangles are.
_LEAST = 2.0**-17
_NO_FOOT = 1e-6  # share of the longest edge that is no part of its own
_WHOLE = np.array([[0, 0], [1, 0], [0, 1]], np.float32)


def cut_slender(corner: Float64, area: Float64) -> tuple[NDArray[np.int64], Float32, Float64]:
    """Parts (n,) of triangles: whose each is, ascending; (n, 3, 2) the weights of corners 1 and 2 at its corners; and its area.

    corner   (m, 3, 3) float64, of any unit; area (m,) float64, that squared, > 0
    A slender triangle is cut where its height stands, and both halves, right-angled, across from there to their tips.
    """
    along = np.roll(corner, -1, axis=1) - corner
    square = (along * along).sum(axis=2)
    slender = np.flatnonzero(square.max(axis=1) > 2 * _LONG * area)
    if not len(slender) or not uses("slender_cutting"):
        return np.arange(len(area)), whole_parts(len(area)), area
    first = square[slender].argmax(axis=1)
    start, end, apex = (_WHOLE[(first + i) % 3].astype(np.float64) for i in range(3))
    longest, to_apex = along[slender, first], -along[slender, (first + 2) % 3]
    foot = (longest * to_apex).sum(axis=1) / square[slender, first]
    foot = np.where(foot < _NO_FOOT, 0.0, np.where(foot > 1 - _NO_FOOT, 1.0, foot))
    base = start + foot[:, None] * (end - start)
    owner, tip, share = np.tile(slender, 2), np.concatenate([start, end]), np.concatenate([foot, 1 - foot])
    base, apex = np.tile(base, (2, 1)), np.tile(apex, (2, 1))
    length, own_area = share * np.tile(square[slender, first] / (2 * area[slender]), 2), share * area[owner]
    wanted = np.minimum(length / _PART, own_area / (_LEAST * area.sum()))
    count = np.where(share > 0, np.maximum(np.ceil(wanted), 1), 0).astype(np.int64)
    piece = np.repeat(np.arange(len(owner)), count)
    step = np.arange(len(piece)) - (np.cumsum(count) - count)[piece]
    near, far = step / count[piece], (step + 1) / count[piece]
    low, low_far = (base[piece] + at[:, None] * (tip - base)[piece] for at in (near, far))
    high, high_far = (apex[piece] + at[:, None] * (tip - apex)[piece] for at in (near, far))
    toward = far < 1  # at the tip there is one triangle alone
    part = np.concatenate([np.stack([low, low_far, high], axis=1), np.stack([high, low_far, high_far], axis=1)[toward]])
    in_strip = own_area[piece] / count[piece]
    whole = np.setdiff1d(np.arange(len(area)), slender)
    all_owners = np.concatenate([whole, owner[piece], owner[piece][toward]])
    all_parts = np.concatenate([whole_parts(len(whole)), part.astype(np.float32)])
    all_areas = np.concatenate([area[whole], in_strip * (1 - near), (in_strip * (1 - far))[toward]])
    order = np.argsort(all_owners, kind="stable")
    return all_owners[order], all_parts[order], all_areas[order]


def whole_parts(count: int) -> Float32:
    """(n, 3, 2): of triangles that are not cut."""
    return np.tile(_WHOLE, (count, 1, 1))


def find_between(corner: Float32, weight: Float32) -> Float32:
    """(n, k): what triangles (n, 3, k) have at points of which the weights of corners 1 and 2 are given (n, 2)."""
    first, second, third = corner.transpose(1, 0, 2)
    out: Float32 = first + weight[:, :1] * (second - first) + weight[:, 1:] * (third - first)
    return out


def find_corners(corner: Float32, part: Float32) -> Float32:
    """(n, 3, k): the same at the corners of parts (n, 3, 2) of them, of cut_slender."""
    return np.stack([find_between(corner, part[:, i]) for i in range(3)], axis=1)
