"""Cells of the unit cube of random numbers from which photons are emitted, each with a share of the photons."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..util.arrays import Float32, Float64, Int32, Int64

Float32 = Float32
Float64 = Float64

DIMENSIONS = 4  # random numbers per emitted photon
SLICE_BITS = 3
SLICES = 1 << SLICE_BITS  # per cell along each dimension; photons are tallied in them
BINS = SLICES**DIMENSIONS
_BELOW_ONE = np.float32(1 - 2.0**-24)  # where a sum of float32 would round to 1


@dataclass(frozen=True)
class BirthCells:
    """Boxes that tile each emitter's unit cube of random numbers, ascending by emitter; the photons of a cell share its power equally.

    emitter   (c,) int32
    low       (c, 4) float32   lower corner
    side      (c, 4) float32
    natural   (c,) float64     probability without guiding, where all photons have equal power
    share     (c,) float64     probability, > 0 where natural is
    """

    emitter: Int32
    low: Float32
    side: Float32
    natural: Float64
    share: Float64

    @classmethod
    def whole(cls, emitter_share: Float64) -> BirthCells:
        """One cell for each emitter: emitter_share (n_emitter,) float64, probability of each."""
        count = len(emitter_share)
        low, side = np.zeros((count, DIMENSIONS), np.float32), np.ones((count, DIMENSIONS), np.float32)
        return cls(np.arange(count, dtype=np.int32), low, side, emitter_share, emitter_share)

    def __len__(self) -> int:
        return len(self.emitter)

    def count_births(self, number: int, shift: float) -> Int64:
        """(c + 1,) int64: index of each cell's first photon among `number` photons in order of cells, and the end of the last.

        By systematic sampling each cell gets number * share to within one, and exactly so in the mean over shifts uniform in [0, 1).
        """
        end = np.ceil(np.cumsum(self.share) * number - shift).astype(np.int64).clip(0, number)
        end[np.flatnonzero(self.share)[-1] :] = number  # a sum of shares may round to just below 1
        return np.concatenate([[0], end])

    def place(self, cell: Int64, points: Float32) -> Float32:
        """Random numbers (n, 4) within cells (n,), from points (n, 4) uniform in [0, 1)."""
        numbers = np.empty((DIMENSIONS, len(cell)), np.float32)
        for axis, row in enumerate(numbers):
            np.multiply(self.side[:, axis].take(cell), points[:, axis], out=row)
            row += self.low[:, axis].take(cell)
        np.minimum(numbers, _BELOW_ONE, out=numbers)
        return numbers.T


def find_bins(cell: Int64, points: Float32) -> Int32:
    """(n,) int32: bins of photons from cells (n,) and points (n, 4), as for BirthCells.place; the bins of cell c start at c * BINS."""
    bins = cell.astype(np.int32)
    for axis in reversed(range(DIMENSIONS)):
        bins <<= SLICE_BITS
        bins |= (points[:, axis] * np.float32(SLICES)).astype(np.int32)
    return bins


def find_slice(bins: Int32, axis: int) -> Int32:
    """(n,) int32: slices of their cells along an axis in which bins (n,) lie."""
    return bins >> SLICE_BITS * axis & SLICES - 1
