"""Specks that few photons leave where leaves are small, taken out of what is shown.

Photons that part near a corner fall together on the wall beside it. To whoever counts them they are many, and so look like light. Two
kinds of texels show that, and both take from those around them what they cannot tell themselves.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np
from numpy.typing import NDArray

from .denoise import SMALL_LEAF
from .scene import IntArray
from .texel_map import TexelMap

_Image = NDArray[np.float32]

_FLECK_SIDE = 4  # texels, of the largest leaf that may be a fleck, and how far is looked around it
# Measured on the samples at 1 and 4 M photons: none errs more for it. Without the first, that is with all that is brighter or darker than
# what is around, noisy surfaces of small leaves lost a tenth of their light's detail.
_BRIGHTER = 1.5
_NOISY = 0.15  # standard error over light: of some 40 photons
_ENOUGH = 16  # texels around


def fill_rims(light: _Image, variance: _Image, side: NDArray[np.int32], texels: TexelMap, entry_at: NDArray[np.int32]) -> None:
    """Gives texels of small leaves whose centre is not on their chart the mean of those beside them whose is, in place.

    Such slivers catch little, and a small leaf's polynomial runs away there. Of the page each is a whole texel nevertheless, and the
    margin carries it on.

    light      (k, n, 3) float32, of the texel entries, and variance (n, 3) float32
    side       (n,) int32, texels, of the leaf at each entry
    entry_at   (n_page, size, size) int32: the entry that a page shows at each texel, -1 for none
    """
    rim = texels.off_centre[side[texels.off_centre] <= SMALL_LEAF]
    total, doubt = np.zeros((len(light), len(rim), 3), np.float32), np.zeros((len(rim), 3), np.float32)
    count = np.zeros(len(rim), np.float32)
    for row, other in _look_around(rim, 1, texels, entry_at):
        central = np.flatnonzero(texels.is_central[other])
        row, other = row[central], other[central]
        total[:, row] += light[:, other]
        doubt[row] += variance[other]
        count[row] += 1.0
    told = np.flatnonzero(count)
    light[:, rim[told]] = total[:, told] / count[told, None]
    variance[rim[told]] = doubt[told] / count[told, None]


def clip_flecks(
    light: _Image, variance: _Image, leaf: IntArray, side: NDArray[np.int32], texels: TexelMap, entry_at: NDArray[np.int32]
) -> None:
    """Takes texels of leaves of few photons that are far brighter than all around down to the brightest there, in place.

    light   (n, 3) float32, of the texel entries, as is variance
    leaf    (n,) int: which each is on; the other arguments as for fill_rims

    With more photons a leaf is believed, so that this changes nothing in the end.
    """
    small = np.flatnonzero(side <= _FLECK_SIDE)
    small = small[(variance[small].sum(axis=1) > (_NOISY * light[small].sum(axis=1)) ** 2 / 3) & light[small].any(axis=1)]
    brightest, count = np.zeros(len(small), np.float32), np.zeros(len(small), np.int64)
    for row, other in _look_around(small, _FLECK_SIDE, texels, entry_at):
        apart = np.flatnonzero(leaf[other] != leaf[small[row]])
        row, other = row[apart], other[apart]
        brightest[row] = np.maximum(brightest[row], light[other].sum(axis=1))
        count[row] += 1
    own = light[small].sum(axis=1)
    fleck = np.flatnonzero((own > _BRIGHTER * brightest) & (count >= _ENOUGH) & (brightest > 0.0))  # in the dark, light is light
    light[small[fleck]] *= (brightest[fleck] / own[fleck])[:, None]


def _look_around(
    entry: IntArray, reach: int, texels: TexelMap, entry_at: NDArray[np.int32]
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int32]]]:
    """For each way to a texel so near: which of the entries (m,) have one of their chart there (k,), and the entry (k,) that is shown."""
    chart, (x, y) = texels.texel_chart[entry], texels.texel_xy[entry].T
    page, size = texels.chart_page[chart], texels.page_size
    steps = range(-reach, reach + 1)
    for dy, dx in product(steps, steps):
        row, column = y + dy, x + dx
        inside = np.flatnonzero((np.minimum(row, column) >= 0) & (np.maximum(row, column) < size))
        other = entry_at[page[inside], row[inside], column[inside]]
        found = (other >= 0) & (texels.texel_chart.take(other, mode="wrap") == chart[inside])
        yield inside[found], other[found]
