"""Tiling of a page into strips with halos around the texels to process, so that arrays fit a core's cache."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..util.arrays import BoolArray, Int32, Int64, IntArray
from ..util.coverage import expand_ranges

_WIDTHS = (16, 32, 64, 128, 256)  # candidate widths of strips, texels: narrow ones for contacts, wide ones for whole pages
_HEIGHT = 128  # greatest height of a strip, texels
# Texels of strips processed at once. With a quarter of them the overhead of numpy's calls is a third of the time; with twice as many the
# arrays exceed the cache, and there are too few parts for two cores.
_TOGETHER = 1 << 15


@dataclass(frozen=True)
class Strips:
    """Strips of a page that hold all texels to work on, each with a halo.

    entry_at         (h, w) int32, -1 where no chart covers the texel
    halo             texels
    wanted           (h, w2) bool: texels to process; w2 >= w is a multiple of a strip's width
    left, low        (m,) int64: lower left corner of each strip, without its halo
    height           (m,) int64: height of each strip, with its halo
    width            width of all strips, with their halos
    """

    entry_at: Int32
    halo: int
    wanted: BoolArray
    left: Int64
    low: Int64
    height: Int64
    width: int

    @classmethod
    def of(cls, grainy: Int64, xy: IntArray, entry_at: Int32, radius: int, halo: int) -> Strips:
        """Strips around all texels within the windows of grainy ones. Those may have a small variance by chance, but the filter must be
        symmetric to preserve energy: a texel that contributes to a grainy one must receive its share of it.

        grainy   (m,) int64: entries of the page
        xy       (m, 2) int: their columns and rows in entry_at
        radius   of a window, texels
        halo     width of the border around a strip that its filter reads, texels
        """
        (x, y), (height, width) = xy.T, entry_at.shape
        shown = entry_at[y, x] == grainy
        wanted = np.zeros((height, -(-width // max(_WIDTHS)) * max(_WIDTHS)), bool)
        wanted[y[shown], x[shown]] = True
        _widen(wanted, radius)
        wanted[:, width:] = False
        near = wanted[:, :width]
        near &= entry_at >= 0
        cuts = (cls(entry_at, halo, wanted, *_find_strips(wanted, width, halo), width + 2 * halo) for width in _WIDTHS)
        return min(cuts, key=lambda strips: strips.width * int(strips.height.sum()))

    def groups(self) -> list[Int64]:
        """Groups of strips to process at once."""
        together = np.cumsum(self.height) * self.width // _TOGETHER
        return np.split(np.arange(len(self.height)), np.flatnonzero(np.diff(together)) + 1) if len(together) else []

    def stack(self, some: Int64) -> tuple[Int32, BoolArray]:
        """Entries of some strips stacked in one image, and which of them are wanted; the latter without the stack's own halo."""
        (rows, columns), halo = self.entry_at.shape, self.halo
        height = self.height[some]
        owner, step = expand_ranges(np.zeros_like(height), height)
        left = self.left[some][owner][:, None]
        row, column = (self.low[some][owner] + step - halo)[:, None], left + np.arange(-halo, self.width - halo)
        on_page = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        row = np.clip(row, 0, rows - 1)
        entry = np.where(on_page, self.entry_at[row, np.clip(column, 0, columns - 1)], np.int32(-1))
        inner = (step >= halo) & (step < height[owner] - halo)
        wanted = self.wanted[row, left + np.arange(self.width - 2 * halo)] & inner[:, None]
        return entry, wanted[halo:-halo]


def _find_strips(wanted: BoolArray, width: int, halo: int) -> tuple[Int64, Int64, Int64]:
    """Strips that contain all wanted (h, w) texels: their left and low corners, and their heights with halos."""
    eight = wanted.view(np.uint64) != 0  # eight texels at once
    strip, row = np.nonzero(eight.reshape(len(wanted), -1, width // 8).any(axis=2).T)
    # Rows less than two halos apart are cheaper in one strip.
    apart = (np.diff(strip) > 0) | (np.diff(row) > 2 * halo) | (np.diff(row // _HEIGHT) > 0)
    first = np.flatnonzero(np.append(True, apart)[: len(row)])
    last = np.append(first[1:], len(row))[: len(first)] - 1
    return strip[first] * width, row[first], row[last] - row[first] + 1 + 2 * halo


def _widen(image: BoolArray, radius: int) -> None:
    """Dilate the image by a square of side 2 * radius + 1, in place."""
    for axis in (0, 1):
        narrow = image.copy()  # shifting whole slices in memory order is twenty times as fast along columns
        for step in range(1, radius + 1):
            ahead, behind = ((slice(None),) * axis + (part,) for part in (slice(step, None), slice(None, -step)))
            image[ahead] |= narrow[behind]
            image[behind] |= narrow[ahead]
