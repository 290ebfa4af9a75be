"""Cuts slender triangles across into compact parts, since the centroid of a long triangle is a poor proxy for its light."""

import numpy as np

from ..util.ablation import uses
from ..util.arrays import Float32, Float64, Int64
from ..util.coverage import expand_ranges

_LONG = 8.0  # triangles are cut if the ratio of the longest edge to the height above it exceeds this
# Greatest ratio of a part's length to that height: with 8, light by strips 5 mm from a wall takes twice the time; with 2, no less.
_PART = 4.0
# Least mean area of parts as a share of the total area, which bounds their number to about its inverse, however slender the triangles are.
_LEAST = 2.0**-17
_NO_FOOT = 1e-6  # least share of the longest edge on either side of the height's foot; a smaller side gets no parts
_WHOLE = np.array([[0, 0], [1, 0], [0, 1]], np.float32)


def cut_slender(corner: Float64, area: Float64) -> tuple[Int64, Float32, Float64]:
    """Parts of triangles: (n,) the triangle of each, ascending; (n, 3, 2) weights of corners 1 and 2 at its corners; and (n,) its area.

    corner   (m, 3, 3) float64, any unit; area (m,) float64, that unit squared, > 0
    A slender triangle is cut along its height, and both right-angled halves are cut into strips from there to their tips.
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
    piece, step = expand_ranges(np.zeros_like(count), count)
    near, far = step / count[piece], (step + 1) / count[piece]
    low, low_far = (base[piece] + at[:, None] * (tip - base)[piece] for at in (near, far))
    high, high_far = (apex[piece] + at[:, None] * (tip - apex)[piece] for at in (near, far))
    toward = far < 1  # the strip at the tip is a single triangle
    part = np.concatenate([np.stack([low, low_far, high], axis=1), np.stack([high, low_far, high_far], axis=1)[toward]])
    in_strip = own_area[piece] / count[piece]
    whole = np.setdiff1d(np.arange(len(area)), slender)
    all_owners = np.concatenate([whole, owner[piece], owner[piece][toward]])
    all_parts = np.concatenate([whole_parts(len(whole)), part.astype(np.float32)])
    all_areas = np.concatenate([area[whole], in_strip * (1 - near), (in_strip * (1 - far))[toward]])
    order = np.argsort(all_owners, kind="stable")
    return all_owners[order], all_parts[order], all_areas[order]


def whole_parts(count: int) -> Float32:
    """(n, 3, 2): weights of parts that are whole triangles."""
    return np.tile(_WHOLE, (count, 1, 1))


def find_between(corner: Float32, weight: Float32) -> Float32:
    """(n, k): linear interpolation of the corners' values (n, 3, k) at points with weights (n, 2) of corners 1 and 2."""
    first, second, third = corner.transpose(1, 0, 2)
    return first + weight[:, :1] * (second - first) + weight[:, 1:] * (third - first)


def find_corners(corner: Float32, part: Float32) -> Float32:
    """(n, 3, k): find_between at the corners of parts (n, 3, 2) from cut_slender."""
    return np.stack([find_between(corner, part[:, i]) for i in range(3)], axis=1)
