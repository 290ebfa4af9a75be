"""Irradiance on sides of surfaces without a lightmap, which gather rays meet too.

Photons are tallied in the cells of scene.surface_cells: a constant basis at a fixed level. That suffices since the light is used one bounce
away only, where it is averaged over all that a texel sees.

Source: [Tobler97] eq. 9 with N_0 alone, on triangles in place of charts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..scene.surface_cells import SurfaceCells
from ..util.arrays import Float32, Float64, FloatArray, Int64


@dataclass(frozen=True)
class CellFlux:
    """Flux of one shard: cell (k,) int64, ascending, plus the number of cells for light straight from lamps; flux (3, k) float64, W."""

    cell: Int64
    flux: Float64

    @classmethod
    def of(cls, cell: Int64, flux: FloatArray, n_cell: int) -> CellFlux:
        """Sums of deposits, given their cells (m,) < n_cell and flux (3, m)."""
        touched = np.flatnonzero(np.bincount(cell, minlength=n_cell))
        return cls(touched, np.stack([np.bincount(cell, channel, n_cell)[touched] for channel in flux]))

    @classmethod
    def join(cls, parts: Sequence[CellFlux]) -> CellFlux:
        """The sum of several."""
        cell = np.concatenate([part.cell for part in parts])
        return cls.of(cell, np.concatenate([part.flux for part in parts], axis=1), int(cell.max(initial=-1)) + 1)


@dataclass
class CellTally:
    """Sums over the even and the odd shards of a bake.

    flux      (2, 3, 2 * n_cell) float64, W: indirect light of all cells, then light straight from lamps; each photon carries
              the power of the whole scene, as in tally.Tally
    photons   (2,) float64
    """

    flux: Float64
    photons: Float64

    @classmethod
    def empty(cls, n_cell: int) -> CellTally:
        return cls(np.zeros((2, 3, 2 * n_cell)), np.zeros(2))

    def add(self, half: int, found: CellFlux, photons: float) -> None:
        """Add a shard of so many emitted photons."""
        self.flux[half][:, found.cell] += found.flux
        self.photons[half] += photons

    def irradiance(self, cells: SurfaceCells) -> tuple[Float32, Float32]:
        """(2, 3, n_cell) float32, W/m^2: indirect light, and light straight from lamps; and (2, n_cell) half the difference of their two
        halves, mean of channels.
        """
        flux = np.moveaxis(self.flux.reshape(2, 3, 2, -1), 2, 0)  # by component, half and channel
        both = (flux.sum(axis=1) / max(self.photons.sum(), 1.0) / cells.area_m2).astype(np.float32)
        first, second = (flux[:, half].mean(axis=1) / max(count, 1.0) for half, count in enumerate(self.photons))
        return both, ((first - second) / cells.area_m2 / 2.0).astype(np.float32)
