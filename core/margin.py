"""Colour that runs on beyond the edges of charts, so that filtering and mip levels do not pull in the empty page."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_EMPTY, _FILLED, _QUEUED, _OUTSIDE = range(4)


def fill_margin(page: NDArray[np.float32], covered: NDArray[np.bool_], texels: int) -> NDArray[np.float32]:
    """A copy of the page with its margin; arguments as for add_margin."""
    out = page.copy()
    add_margin(out, covered, texels)
    return out


def add_margin(page: NDArray[np.float32], covered: NDArray[np.bool_], texels: int) -> None:
    """Sets uncovered texels up to `texels` steps from a covered one to the mean of their neighbours nearer to it; others stay.

    page      (h, w, c) float32
    covered   (h, w) bool
    texels    rings to add; a step goes to any of the eight neighbours
    """
    height, width, channels = page.shape
    line = width + 2
    state = np.full((height + 2, line), _OUTSIDE, np.uint8)  # a border saves every test for the page's edge
    state[1:-1, 1:-1] = np.where(covered, np.uint8(_FILLED), np.uint8(_EMPTY))
    texel_state = state.ravel()
    ring = _first_ring(state)
    neighbours = [dy * line + dx for dy in (-1, 0, 1) for dx in (-1, 0, 1) if dy or dx]
    for _ in range(texels):
        total, count = np.zeros((len(ring), channels)), np.zeros((len(ring), 1))
        next_ring = []
        texel_state[ring] = _QUEUED
        for step in neighbours:
            place = ring + step
            found = texel_state[place]
            known = np.flatnonzero(found == _FILLED)
            total[known] += page[_on_page(place[known], line)]
            count[known] += 1.0
            empty = place[found == _EMPTY]
            texel_state[empty] = _QUEUED  # so that no other step finds it again
            next_ring.append(empty)
        page[_on_page(ring, line)] = total / count
        texel_state[ring] = _FILLED
        ring = np.concatenate(next_ring)


def _on_page(place: NDArray[np.int64], line: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of places among states, which have a border."""
    row, column = np.divmod(place, line)
    return row - 1, column - 1


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
