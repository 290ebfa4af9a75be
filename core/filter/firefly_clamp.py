"""Clamping of fireflies: bright specks from few photons on small leaves, in the shown light.

Photons that split near a corner fall close together on the wall beside it. They are correlated, but the variance counts them as
independent.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from ..texels.texel_map import TexelMap
from ..util.ablation import uses
from ..util.arrays import IntArray

_SIDE = 4  # texels: side of the largest leaf that may be a firefly, and radius of the window around it
# A firefly is so many times as bright as all texels around. Measured on bent_quads, furnished_room and instances at 1 and 4 M photons: it
# increases no error. Without the factor, and with leaves darker than all around lifted as well, bent_quads' error grew by a tenth.
_BRIGHTER = 1.5
_NOISY = 0.15  # relative standard error, that of some 40 photons
# With more photons, _BRIGHTER is multiplied by the cube of the ratio of standard errors, since split photons understate these: a leaf with
# 60 photons (0.13) must be 2.3 times as bright as all around, with 100 photons 5 times. Leaves with a smaller standard error stay.
_SURE = 0.09
_ENOUGH = 16  # texels around a firefly
_AROUND = ((_SIDE, 0), (-_SIDE, 0), (0, _SIDE), (0, -_SIDE))  # texels of a first, quick test


def clip_flecks(
    light: NDArray[np.float32],
    variance: NDArray[np.float32],
    leaf: IntArray,
    side: NDArray[np.int32],
    texels: TexelMap,
) -> None:
    """Clamp texels of leaves with few photons that are far brighter than all texels around to the brightest of these, in place.

    light, variance   (n, 3) float32, at the texel entries
    leaf, side        (n,) int: leaf of each entry, and (n,) int32: its side, texels

    Only less noisy texels around count, if there are enough of them. Leaves with more photons are not clamped, so the clamp is consistent.
    """
    if not uses("firefly_clamp"):
        return
    small = np.flatnonzero(side <= _SIDE)
    own = light[small].sum(axis=1)
    doubt = np.sqrt(3.0 * variance[small].sum(axis=1))
    is_noisy = np.zeros(len(side), bool)
    is_noisy[small[(doubt > _NOISY * own) & (own > 0.0)]] = True
    unsure = np.flatnonzero((doubt > _SURE * own) & (own > 0.0))
    brighter = _BRIGHTER * np.maximum(_NOISY * own[unsure] / doubt[unsure], 1.0) ** 3
    small, own = small[unsure], own[unsure]
    seen = np.zeros(len(small), np.float32)
    for step in _AROUND:
        near, other = _find_beside(small, step, leaf, texels)
        seen[near] = np.maximum(seen[near], light[other].sum(axis=1) * ~is_noisy[other])
    likely = np.flatnonzero(own > brighter * seen)  # only these few need the full test
    small, own, brighter = small[likely], own[likely], brighter[likely]
    brightest, count = np.zeros((2, len(small)), np.float32), np.zeros((2, len(small)), np.int64)  # of all around; of those not noisy
    steps = range(-_SIDE, _SIDE + 1)
    for dy, dx in product(steps, steps):
        near, other = _find_beside(small, (dy, dx), leaf, texels)
        value, known = light[other].sum(axis=1), ~is_noisy[other]
        for kind, (some, seen) in enumerate(((near, value), (near[known], value[known]))):
            brightest[kind, some] = np.maximum(brightest[kind, some], seen)
            count[kind, some] += 1
    is_known = count[1] >= _ENOUGH
    most = np.where(is_known, brightest[1], brightest[0])
    fleck = np.flatnonzero((own > brighter * most) & (most > 0.0) & (count[0] >= _ENOUGH))  # light among dark texels stays
    light[small[fleck]] *= (most[fleck] / own[fleck])[:, None]


def _find_beside(
    entry: NDArray[np.intp], step: tuple[int, int], leaf: IntArray, texels: TexelMap
) -> tuple[NDArray[np.intp], NDArray[np.int32]]:
    """Rows (k,) of entries (m,) that have another leaf of their chart at an offset of (rows, columns), and the entries (k,) there."""
    chart = texels.texel_chart[entry]
    column, row = (texels.texel_xy[entry] + np.array(step[::-1], np.int32)).T
    near = np.flatnonzero((np.minimum(row, column) >= 0) & (np.maximum(row, column) < texels.page_size))
    other = texels.entry_at[texels.chart_page[chart[near]], row[near], column[near]]
    found = (other >= 0) & (texels.texel_chart.take(other, mode="wrap") == chart[near])
    found &= leaf.take(other, mode="wrap") != leaf[entry[near]]
    return near[found], other[found]
