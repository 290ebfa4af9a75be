"""Extends colours beyond the edges of charts, so that filtering and mip levels do not mix in the empty page."""

import numpy as np
from numpy.typing import NDArray

from ..util.arrays import BoolArray, Float32, Int64

_EMPTY, _FILLED, _QUEUED, _OUTSIDE = range(4)  # the first two equal the values of the covered mask
_BAND = 128  # rows processed at once: the intermediate arrays fit the cache


def add_margin(page: Float32, covered: BoolArray, texels: int) -> None:
    """Sets uncovered texels up to `texels` steps from a covered one to the mean of their neighbours nearer to it; others stay.

    page      (h, w, c) float32, one row right after the other
    covered   (h, w) bool
    texels    rings to add; a step goes to any of the eight neighbours
    Raises ValueError for a page of another order.
    """
    height, width, channels = page.shape
    line = width + 2
    state = np.full((height + 2, line), _OUTSIDE, np.uint8)  # a border saves every test for the page's edge
    state[1:-1, 1:-1] = covered
    texel_state, texel = state.ravel(), page.reshape(height * width, channels)
    if not np.may_share_memory(texel, page):
        raise ValueError("a page whose rows do not follow each other in memory cannot be filled in place.")
    ring = _first_ring(state)
    at = ring - 2 * (ring // line) + (1 - line)  # on the page, which has no border
    neighbours = [(dy * line + dx, dy * width + dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if dy or dx]
    for _ in range(texels):
        row, beside, next_ring, next_at = [], [], [], []
        texel_state[ring] = _QUEUED
        for step, step_at in neighbours:
            place = ring + step
            found = texel_state[place]
            known = np.flatnonzero(found == _FILLED)
            row.append(known)
            beside.append(at[known] + step_at)
            empty = np.flatnonzero(found == _EMPTY)
            next_ring.append(place[empty])
            next_at.append(at[empty] + step_at)
            texel_state[next_ring[-1]] = _QUEUED  # so that no other step finds it again
        rows, places = np.concatenate(row), np.concatenate(beside)
        count = np.bincount(rows, minlength=len(ring))
        for channel in range(channels):
            texel[at, channel] = np.bincount(rows, texel[places, channel], len(ring)) / count
        texel_state[ring] = _FILLED
        ring, at = np.concatenate(next_ring), np.concatenate(next_at)


def _first_ring(state: NDArray[np.uint8]) -> Int64:
    """Flat indices of empty texels next to a filled one."""
    found = []
    for row in range(1, len(state) - 1, _BAND):
        band = state[row - 1 : row + _BAND + 1]
        filled = band == _FILLED
        wide = filled.copy()
        wide[:, 1:] |= filled[:, :-1]
        wide[:, :-1] |= filled[:, 1:]
        near = wide[:-2] | wide[1:-1] | wide[2:]
        found.append(np.flatnonzero(near & (band[1:-1] == _EMPTY)) + row * state.shape[1])
    return np.concatenate(found)
