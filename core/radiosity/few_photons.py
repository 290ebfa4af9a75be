"""Leaves that few photons fell on, held against the light around them.

A chart of less than a texel, as the facets of a leaf or a screw have, waits for a photon that hardly ever comes; and the one that does
would light it hundreds of times too much, so that it shines out of the dark. Where few photons were to be expected, what fell says less
than what fell around: in cells of space from the whole scene down to about the thing itself, each held against the next larger one.

Source: Marshall 1991, "Mapping disease and mortality rates using empirical Bayes estimators", local estimates; a Poisson count whose mean
has a gamma prior of one photon, with the prior's mean from the next larger cell. What is shown errs by the variance of its posterior.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..util.arrays import IntArray
from ..util.coverage import Float64
from .quadtree import Quadtree
from .tally import Solution

_FEW = 16  # photons; more of them say more than any surroundings
# Photons that what is around counts for: for a leaf, and for a cell, whose own ones the leaf's are among and must not count each time.
_OF_LEAF, _OF_CELL = 1.0, 4.0
# Of what is darker than around: it may be turned away from what lights that, and to shine out of the dark is worse. Measured on a room of
# furniture and on people with faces inside: with all of it up to half more squared relative error, with none 1.7 times as many dark specks.
_LIFTED = 0.5
_BLACK = 1e-3  # of the mean: what would be lifted to less stays black, as the inside of what is closed is
CELL_BITS = 7
_LEVELS = (0, 3, 5, CELL_BITS)  # halvings of the scene's box; in all of them what faces different ways is told apart
_TINY = float(np.finfo(float).tiny)


@dataclass(frozen=True)
class FewPhotons:
    """Leaves that few photons fell on, k of them, and what they are shown with: light of photons that came by way of a surface.

    row_of     (n_node,) int32: of each node of the tree, -1 of all others
    around     (3, k) float64, W/m^2: that of what is around them
    share      (k,) float64: how far they lean on it
    mean       (3, k) float64, W/m^2: what they have, brought towards it
    variance   (3, k) float64, (W/m^2)^2: of that
    """

    row_of: NDArray[np.int32]
    around: Float64
    share: Float64
    mean: Float64
    variance: Float64

    @classmethod
    def of(
        cls,
        tree: Quadtree,
        solution: Solution,
        leaves: NDArray[np.int64],
        received: NDArray[np.int64],
        correction: Float64,
        cell: IntArray,
    ) -> FewPhotons:
        """Of the leaves (m,), which tile the charts, of a tree.

        received     (n_node,): photons that came to each node
        correction   (3,), of photon_noise.noise_correction
        cell         (m,) int, of space_cells.code_cells with CELL_BITS: where each of the leaves begins
        """
        row_of = np.full(len(tree), -1, np.int32)
        is_few = received[leaves] < _FEW
        flux, area = np.maximum(solution.flux[:, leaves], 0.0), tree.area[leaves]
        if not is_few.any() or not flux.any():
            return cls(row_of, np.zeros((3, 0)), np.zeros(0), *np.zeros((2, 3, 0)))
        power2 = (solution.variance[:, leaves] * correction[:, None]).sum(axis=0) * area**2
        around = _look_around(cell, np.stack([*flux, area, power2]))
        share = around.find_share(area, _OF_LEAF)
        is_few |= share > 0.5  # where not one was to be expected, many that came may have parted from one
        few, least = np.flatnonzero(is_few), _BLACK * flux.sum(axis=1, keepdims=True) / max(float(area.sum()), _TINY)
        row_of[leaves[few]] = np.arange(len(few))
        around, share, area = around.take(few), share[few], area[few]
        own = flux[:, few] / np.maximum(area, _TINY)
        mean = _lean(own, around.mean, share)
        black = (own == 0.0) & (mean < least)
        mean[black] = 0.0
        # Where none fell the light was found to be about as likely above what is shown as below, down to none.
        count = own.mean(axis=0) * area / np.maximum(around.photon, _TINY)
        told = count + np.where(count > 0.0, _OF_LEAF, _LIFTED**2 * _OF_LEAF)
        variance = np.where(black, 0.0, told * (share / _OF_LEAF * around.mean) ** 2)
        return cls(row_of, np.where(black, 0.0, around.mean), share, mean, variance)

    def find(self, leaf: IntArray) -> tuple[NDArray[np.bool_], NDArray[np.int32]]:
        """Which of some texels are on such a leaf, (m,), and the rows of those, (j,); leaf (m,), the node of each."""
        row = self.row_of[leaf]
        chosen = row >= 0
        return chosen, row[chosen]

    def show(self, light: NDArray[np.float32], variance: NDArray[np.float32] | None, leaf: IntArray) -> None:
        """Brings the light of such leaves towards that of what is around, and states its variance where that is asked for; in place.

        light, variance   (n, 3) float32, W/m^2 and its square, of some texels
        leaf              (n,) int: which each is on
        """
        chosen, row = self.find(leaf)
        texel = np.flatnonzero(chosen)
        for channel in range(3):
            light[texel, channel] = _lean(light[texel, channel], self.around[channel, row], self.share[row])
            if variance is not None:
                variance[texel, channel] = self.variance[channel, row]


@dataclass(frozen=True)
class _Around:
    """What is known of each of c cells.

    mean     (3, c) float64, W/m^2
    photon   (c,) float64, W: the power of one photon there, of a channel
    """

    mean: Float64
    photon: Float64

    def within(self, total: Float64) -> _Around:
        """In as many smaller cells, held against these; total (5, c) of each, as of _look_around."""
        flux, area, power2 = total[:3], total[3], total[4]
        own = flux / np.maximum(area, _TINY)
        mean = own + self.find_share(area, _OF_CELL) * (self.mean - own)
        one = len(flux) * self.photon  # as if one more had come, lest a single one tells what all of them carry
        return _Around(mean, (power2 + one * self.photon) / np.maximum(flux.sum(axis=0) + one, _TINY))

    def take(self, rows: IntArray) -> _Around:
        return _Around(self.mean[:, rows], self.photon[rows])

    def find_share(self, area: Float64, prior: float) -> Float64:
        """(c,): how far surfaces of area (c,), m^2, lean on the mean: the more, the fewer photons were to be expected; at a prior, half."""
        expected = self.mean.mean(axis=0) * area / np.maximum(self.photon, _TINY)
        share: Float64 = prior / (expected + prior)
        return share


def _lean(light: NDArray[Any], around: Float64, share: Float64) -> Float64:
    """Light brought so far towards that of what is around."""
    leaning: Float64 = light + share * np.where(light < around, _LIFTED, 1.0) * (around - light)
    return leaning


def _look_around(cell: IntArray, parts: Float64) -> _Around:
    """What is around each of m leaves, by the `cell` (m,) of FewPhotons.of.

    parts   (5, m) float64: the leaves' flux, W, of each channel, their area, m^2, and the sum of their photons' squared powers, W^2
    """
    order = np.argsort(cell, kind="stable")
    parts, cell = parts[:, order], cell[order]
    total = parts.sum(axis=1)[:, None]
    flux = total[:3].sum()
    around = _Around(total[:3] / np.maximum(total[3], _TINY), total[4] / np.maximum(flux, _TINY))
    larger = np.zeros(len(cell), np.int64)  # the cell of each leaf
    for level in _LEVELS:
        code = cell >> 3 * (CELL_BITS - level)
        begins = np.append(True, code[1:] != code[:-1])
        first = np.flatnonzero(begins)
        around = around.take(larger[first]).within(np.add.reduceat(parts, first, axis=1))
        larger = np.cumsum(begins) - 1
    back = np.empty(len(order), np.int64)
    back[order] = larger
    return around.take(back)
