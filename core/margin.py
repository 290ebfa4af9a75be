"""Colour that runs on beyond the edges of charts, so that filtering and mip levels do not pull in the empty page."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_EMPTY, _FILLED, _QUEUED, _OUTSIDE = range(4)


def fill_margin(page: NDArray[np.float32], covered: NDArray[np.bool_], texels: int) -> NDArray[np.float32]:
    """The page with uncovered texels up to `texels` steps from a covered one set to the mean of their neighbours nearer to it.

    page      (h, w, c) float32
    covered   (h, w) bool
    texels    rings to add; a step goes to any of the eight neighbours
    out       (h, w, c) float32, covered texels and those out of reach as they were
    """
    height, width, channels = page.shape
    padded = np.zeros((height + 2, width + 2, channels), np.float32)  # a border saves every test for the page's edge
    padded[1:-1, 1:-1] = page
    state = np.full((height + 2, width + 2), _OUTSIDE, np.uint8)
    state[1:-1, 1:-1] = np.where(covered, _FILLED, _EMPTY)
    colour, texel_state = padded.reshape(-1, channels), state.ravel()
    ring = _first_ring(state)
    neighbours = [dy * (width + 2) + dx for dy in (-1, 0, 1) for dx in (-1, 0, 1) if dy or dx]
    for _ in range(texels):
        total, count = np.zeros((len(ring), channels)), np.zeros((len(ring), 1))
        next_ring = []
        texel_state[ring] = _QUEUED
        for step in neighbours:
            place = ring + step
            found = texel_state[place]
            known = np.flatnonzero(found == _FILLED)
            total[known] += colour[place[known]]
            count[known] += 1.0
            empty = place[found == _EMPTY]
            texel_state[empty] = _QUEUED  # so that no other step finds it again
            next_ring.append(empty)
        colour[ring] = total / count
        texel_state[ring] = _FILLED
        ring = np.concatenate(next_ring)
    return np.ascontiguousarray(padded[1:-1, 1:-1])


def _first_ring(state: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Flat indices of empty texels next to a filled one."""
    filled = state == _FILLED
    wide = filled.copy()
    wide[:, 1:] |= filled[:, :-1]
    wide[:, :-1] |= filled[:, 1:]
    near = wide.copy()
    near[1:] |= wide[:-1]
    near[:-1] |= wide[1:]
    return np.flatnonzero(near & (state == _EMPTY))
