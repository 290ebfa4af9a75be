"""Guiding of emission: more photons start where they reduce the bake's error most for the rays they take.

A sun shines on the whole house, and one photon in many enters by a window; earlier rounds estimate which. The unit cube of random numbers
from which photons are emitted is cut into cells, each with a share of the photons, and a photon's power is divided by the cell's density.
Cells of random numbers, unlike cells of positions and directions, work for all kinds of light.

Only photons that carry all light are guided (--direct photons). Where they carry indirect light alone, guided emission saved no more error
on the samples than its rays cost, and neither did a guided number of splits on random scenes.

Source: Peter & Pietrek 1998, "Importance driven construction of photon maps"; Lepage 1978 (VEGAS) and Jadach 2000 (Foam) for cells of the
unit cube that are cut where it helps; Neyman's allocation for their shares; Hesterberg 1995 for photons that go evenly among them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..util.arrays import Float64
from .emission_cells import BINS, DIMENSIONS, SLICES, BirthCells, find_slice
from .photon_log import Groups

Float64 = Float64

# Share of photons emitted without guiding: they sample what earlier rounds missed, and bound the variance at twice the unguided one. All
# rounds have equal weight; the bound would not hold if better guided rounds had more.
EVEN_SHARE = 1 / 2
MOST_CELLS = 4096
_CUTS = 6  # successive cuts of a cell after one round
# The next two avoid cuts by chance. A quarter of each is as good on a page with many photons, but not better.
_LEAST_GAIN = 1 / 256  # of a cut, as a share of the bake's noise times work
_LEAST_BIRTHS = 1024  # photons in a cell that is cut
_PRIOR_BIRTHS = 64.0  # prior weight of the mean of all cells, in photons
_TINY = float(np.finfo(float).tiny)


@dataclass(frozen=True)
class BirthTally:
    """Tallies of a shard's photons: sums (c, 4, SLICES) float64 over the slices of each cell along each axis.

    births   number of photons
    rays     number of their rays
    noise    their contribution to the squared error
    """

    births: Float64
    rays: Float64
    noise: Float64

    @classmethod
    def of(cls, groups: Groups, noise: Float64, n_cell: int) -> BirthTally:
        """Tally groups, one for each emitted photon, by the bin of emission; noise (g,) is their contribution to the squared error."""
        sums = np.empty((3, n_cell, DIMENSIONS, SLICES))
        for axis in range(DIMENSIONS):
            slices = groups.place // BINS * SLICES + find_slice(groups.place, axis)
            for row, values in zip(sums, (None, groups.rays, noise), strict=True):
                row[:, axis] = np.bincount(slices, values, n_cell * SLICES).reshape(n_cell, SLICES)
        return cls(*sums)


@dataclass
class EmissionGuide:
    """Tallies of all photons of a bake; sums (c, 4, SLICES) float64 as in BirthTally.

    cells    the last plan
    births   number of photons
    rays     number of their rays
    noise    their contribution to the squared error, scaled to the power of unguided photons and divided by the mean of its round
    """

    cells: BirthCells
    births: Float64
    rays: Float64
    noise: Float64

    @classmethod
    def of(cls, emitter_share: Float64) -> EmissionGuide:
        """emitter_share   (n_emitter,) float64, unguided probability of each"""
        return cls(BirthCells.whole(emitter_share), *np.zeros((3, len(emitter_share), DIMENSIONS, SLICES)))

    def add_round(self, shards: Sequence[BirthTally]) -> None:
        """Add the shards of one round, whose photons were emitted from the current cells."""
        noise = np.zeros_like(self.noise)
        births = np.zeros(len(self.cells))
        for shard in shards:
            self.births += shard.births
            self.rays += shard.rays
            noise += shard.noise
            births += _add_up(shard.births)
        carried = np.divide(self.cells.natural, self.cells.share, out=np.ones(len(self.cells)), where=self.cells.share > 0.0)
        noise /= carried[:, None, None] ** 2
        mean = self._find_mean(_add_up(noise), births)
        if mean > 0.0:
            self.noise += noise / mean

    def plan(self) -> BirthCells:
        """The cells of the next round."""
        if not self.noise.any():
            return self.cells
        for _ in range(_CUTS):
            before = len(self.cells)
            self._cut()
            if len(self.cells) == before:
                break
        natural = self.cells.natural
        work, noise = self._find_rates()
        wanted = natural * np.sqrt(noise / work)
        share = (1.0 - EVEN_SHARE) * wanted / wanted.sum() + EVEN_SHARE * natural
        self.cells = replace(self.cells, share=share)
        return self.cells

    def _find_mean(self, sums: Float64, births: Float64) -> float:
        """Mean per emitted photon without guiding, from sums (c,) over the births (c,) of each cell."""
        seen = births > 0.0
        natural = self.cells.natural[seen]
        return float((natural * sums[seen] / births[seen]).sum()) / max(float(natural.sum()), _TINY)

    def _find_rates(self) -> tuple[Float64, Float64]:
        """Rays and noise of a photon emitted from each cell, (c,) each, above 0."""
        births, rays, noise = (_add_up(sums) for sums in (self.births, self.rays, self.noise))
        known = births + _PRIOR_BIRTHS
        work: Float64 = (rays + _PRIOR_BIRTHS * self._find_mean(rays, births)) / known
        added: Float64 = (noise + _PRIOR_BIRTHS * self._find_mean(noise, births)) / known
        return work, added

    def _cut(self) -> None:
        """Cut cells in two between slices, each where the cut reduces noise times work most."""
        cells, births = self.cells, _add_up(self.births)
        work, noise = (_add_up(sums) / np.maximum(births, 1.0) for sums in (self.rays, self.noise))
        cost = cells.natural * np.sqrt(work * noise)  # with the best shares, noise * work = (sum of these)^2
        gain = (cost[:, None, None] - cells.natural[:, None, None] * self._price_cuts(work, noise)).reshape(len(cells), -1)
        cut = (gain.max(1) > _LEAST_GAIN * cost.sum()) & (births >= _LEAST_BIRTHS)
        cut[np.flatnonzero(cut)[max(MOST_CELLS - len(cells), 0) :]] = False
        origin = np.repeat(np.arange(len(cells)), 1 + cut)
        axis, slices = np.divmod(gain.argmax(1)[origin], SLICES - 1)
        upper = np.zeros(len(origin), bool)
        upper[1:] = origin[1:] == origin[:-1]
        halved = cut[origin]
        first, count = np.where(upper, slices + 1, 0), np.where(upper, SLICES - 1 - slices, slices + 1)
        low, side = cells.low[origin], cells.side[origin]
        part = np.where(halved, count / SLICES, 1.0)
        row = np.arange(len(origin))
        low[row, axis] += (side[row, axis] * np.where(halved, first / SLICES, 0.0)).astype(np.float32)
        side[row, axis] = (side[row, axis] * part).astype(np.float32)
        self.cells = BirthCells(cells.emitter[origin], low, side, cells.natural[origin] * part, cells.share[origin] * part)
        for name in ("births", "rays", "noise"):
            sums = getattr(self, name)[origin]
            along = sums[row, axis]
            own = np.einsum("cs,cst->ct", along, _STRETCH[first, count])
            total = along.sum(1)
            # The sums along the other axes are known for the whole cell only and are split in proportion.
            kept = np.divide(own.sum(1), total, out=np.zeros(len(row)), where=total > 0.0)
            stretched = sums * kept[:, None, None]
            stretched[row, axis] = own
            setattr(self, name, np.where(halved[:, None, None], stretched, sums))

    def _price_cuts(self, work: Float64, noise: Float64) -> Float64:
        """(c, 4, SLICES - 1) float64: sqrt(rays * noise) per photon after each cut; work and noise (c,) are those of the whole cells."""
        price = np.zeros((len(self.cells), DIMENSIONS, SLICES - 1))
        for flip in (slice(None), slice(None, None, -1)):  # the part below each cut, and the part above it
            births, *others = (np.cumsum(sums[..., flip], axis=2)[..., :-1][..., flip] for sums in (self.births, self.rays, self.noise))
            product = np.ones_like(price)
            for sums, rate in zip(others, (work, noise), strict=True):
                product *= (sums + _PRIOR_BIRTHS * rate[:, None, None]) / (births + _PRIOR_BIRTHS)
            price += np.sqrt(product) * (np.arange(1, SLICES) / SLICES)[flip]
        return price


def _add_up(sums: Float64) -> Float64:
    """(c,) float64: totals of cells from sums (c, 4, SLICES), which add up to the same along every axis."""
    return sums[:, 0].sum(1)


def _stretch_slices() -> Float64:
    """(SLICES + 1, SLICES + 1, SLICES, SLICES) float64: for a part of `count` slices from `first`, by [first, count], the share of each
    old slice that falls into each of the part's own slices.
    """
    out = np.zeros((SLICES + 1, SLICES + 1, SLICES, SLICES))
    edge = np.arange(SLICES + 1)
    for first in range(SLICES):
        for count in range(1, SLICES - first + 1):
            new = first + edge * count / SLICES
            shared = np.minimum(edge[1:, None], new[None, 1:]) - np.maximum(edge[:-1, None], new[None, :-1])
            out[first, count] = np.maximum(shared, 0.0)
    return out


_STRETCH = _stretch_slices()
