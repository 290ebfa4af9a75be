"""Clamping of bright specks from few photons on small leaves, in the shown light.

Photons split near a corner fall close together on the wall beside it. They are correlated, but the variance counts them as independent.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from ..texels.texel_map import TexelMap
from ..util.ablation import uses
from ..util.arrays import IntArray

_SIDE = 4  # texels, of the largest leaf that may be a fleck, and how far is looked around it
# Measured on bent_quads, furnished_room and instances at 1 and 4 M photons: none errs more for it. Without the factor, and with leaves
# that are darker than all around lifted too, bent_quads' error grew by a tenth.
_BRIGHTER = 1.5
_NOISY = 0.15  # standard error over light: of some 40 photons
# With more photons a leaf is a fleck only if it is brighter yet, by the cube of the ratio of standard errors, for split photons understate
# it: with 60 photons (0.13) 2.3 times as bright as all around, with 100 5 times. Leaves with a smaller standard error are kept.
_SURE = 0.09
_ENOUGH = 16  # texels around
_AROUND = ((_SIDE, 0), (-_SIDE, 0), (0, _SIDE), (0, -_SIDE))  # where it is looked first


def clip_flecks(
    light: NDArray[np.float32],
    variance: NDArray[np.float32],
    leaf: IntArray,
    side: NDArray[np.int32],
    texels: TexelMap,
) -> None:
    """Takes texels of leaves of few photons that are far brighter than all around down to the brightest there, in place.

    light      (n, 3) float32, of the texel entries, as is variance
    leaf       (n,) int: which each is on, and side (n,) int32 that leaf's side, texels

    Around counts what is better known, where there is enough of it. With more photons a leaf is believed: in the end this changes nothing.
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
    likely = np.flatnonzero(own > brighter * seen)  # few are: all others are left before they are looked at closely
    small, own, brighter = small[likely], own[likely], brighter[likely]
    brightest, count = np.zeros((2, len(small)), np.float32), np.zeros((2, len(small)), np.int64)  # of all, and of what is not noisy
    steps = range(-_SIDE, _SIDE + 1)
    for dy, dx in product(steps, steps):
        near, other = _find_beside(small, (dy, dx), leaf, texels)
        value, known = light[other].sum(axis=1), ~is_noisy[other]
        for kind, (some, seen) in enumerate(((near, value), (near[known], value[known]))):
            brightest[kind, some] = np.maximum(brightest[kind, some], seen)
            count[kind, some] += 1
    is_known = count[1] >= _ENOUGH
    most = np.where(is_known, brightest[1], brightest[0])
    fleck = np.flatnonzero((own > brighter * most) & (most > 0.0) & (count[0] >= _ENOUGH))  # in the dark, light is light
    light[small[fleck]] *= (most[fleck] / own[fleck])[:, None]


def _find_beside(
    entry: NDArray[np.intp], step: tuple[int, int], leaf: IntArray, texels: TexelMap
) -> tuple[NDArray[np.intp], NDArray[np.int32]]:
    """Which of the entries (m,) have another leaf of their chart so many rows and columns away, (k,), and the entry there (k,)."""
    chart = texels.texel_chart[entry]
    column, row = (texels.texel_xy[entry] + np.array(step[::-1], np.int32)).T
    near = np.flatnonzero((np.minimum(row, column) >= 0) & (np.maximum(row, column) < texels.page_size))
    other = texels.entry_at[texels.chart_page[chart[near]], row[near], column[near]]
    found = (other >= 0) & (texels.texel_chart.take(other, mode="wrap") == chart[near])
    found &= leaf.take(other, mode="wrap") != leaf[entry[near]]
    return near[found], other[found]
