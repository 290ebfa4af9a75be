"""Results of a shard of photons: deposits and the energy audit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from ..util.arrays import BoolArray, Float32, Float64, Int32

_Rows = Float32
_Ints = Int32


ENERGY_NAMES = ("emitted", "absorbed", "escaped", "remainder", "passed", "mirrored", "refracted")


@dataclass(frozen=True)
class EnergyAudit:
    """Power by its fate, each (3,) float64, W: emitted == absorbed + escaped + remainder.

    `passed` counts light each time it goes straight through a transparent surface, `mirrored` each time a metal, a layer or glass
    reflects it, and `refracted` each time glass refracts it; that light is counted again where it ends. `absorbed` is what roulette took
    less what it gave to survivors; `remainder` was still under way at max_depth. The light of a lamp without shadow counts as emitted once
    for each surface that it lights.
    """

    emitted: Float64
    absorbed: Float64
    escaped: Float64
    remainder: Float64
    passed: Float64
    mirrored: Float64
    refracted: Float64

    @classmethod
    def join(cls, parts: Sequence[EnergyAudit]) -> EnergyAudit:
        """The sums of all."""
        return cls(*(np.sum([getattr(part, name) for part in parts], axis=0) for name in ENERGY_NAMES))


@dataclass(frozen=True)
class Counters:
    photons: int
    rays: int
    deposits: int

    @classmethod
    def join(cls, parts: Sequence[Counters]) -> Counters:
        """The sums of all."""
        return cls(*(sum(getattr(part, name) for part in parts) for name in ("photons", "rays", "deposits")))


@dataclass(frozen=True)
class SideHits:
    """Photons that met a side of a triangle without a lightmap, first hits included.

    tri        (k,) int32
    u, v       (k,) float32
    is_front   (k,) bool
    straight   (k,) bool        they come straight from a lamp
    flux_rgb   (3, k) float32, W
    """

    tri: _Ints
    u: _Rows
    v: _Rows
    is_front: BoolArray
    straight: BoolArray
    flux_rgb: _Rows


@dataclass(frozen=True)
class ShardHits:
    """The deposits of one shard, in a fixed order.

    tri        (m,) int32
    u, v       (m,) float32     barycentric weights of corners 1 and 2
    flux_rgb   (3, m) float32, W
    is_first   (m,) bool        direct light; where shadow rays find that, light from specular surfaces alone (caustics)
    elsewhere  hits on sides without a lightmap
    """

    tri: _Ints
    u: _Rows
    v: _Rows
    flux_rgb: _Rows
    is_first: BoolArray
    audit: EnergyAudit
    counters: Counters
    elsewhere: SideHits

    def only(self, rows: NDArray[np.intp]) -> ShardHits:
        """Only the deposits in rows (k,); audit and counters stay."""
        return replace(
            self,
            tri=self.tri.take(rows),
            u=self.u.take(rows),
            v=self.v.take(rows),
            flux_rgb=self.flux_rgb.take(rows, axis=1),
            is_first=self.is_first.take(rows),
        )


class PhotonLog:
    """Collects the results of a shard. Tracing adds to its sums directly.

    n_hit   number of deposits since the last `take`
    """

    def __init__(self) -> None:
        self._forget()

    def _forget(self) -> None:
        self.emitted, self.absorbed, self.escaped, self.remainder, self.passed, self.mirrored, self.refracted = np.zeros(
            (len(ENERGY_NAMES), 3)
        )
        self.photons = self.rays = self.n_hit = 0
        self._pieces: list[tuple[_Ints, _Rows, _Rows, _Rows, BoolArray]] = []  # tri, u, v, flux, is_first
        none, nobody = np.zeros(0, np.float32), np.zeros(0, bool)
        self._elsewhere = [SideHits(np.zeros(0, np.int32), none, none, nobody, nobody, np.zeros((3, 0), np.float32))]

    def deposit(self, tri: _Ints, u: _Rows, v: _Rows, flux: _Rows, is_first: BoolArray) -> None:
        """Arguments are as in ShardHits."""
        self._pieces.append((tri, u, v, flux, is_first))
        self.n_hit += len(tri)

    def light_elsewhere(self, hits: SideHits) -> None:
        """Add photons that met sides without a lightmap."""
        self._elsewhere.append(hits)

    def take(self) -> ShardHits:
        """All results since the last call."""
        nothing = np.zeros(0, np.float32)
        self._pieces.append((np.zeros(0, np.int32), nothing, nothing, np.zeros((3, 0), np.float32), np.zeros(0, bool)))
        tri, u, v, flux, is_first = zip(*self._pieces, strict=True)
        hits = ShardHits(
            np.concatenate(tri),
            np.concatenate(u),
            np.concatenate(v),
            np.concatenate(flux, axis=1),
            np.concatenate(is_first),
            EnergyAudit(*(getattr(self, name) for name in ENERGY_NAMES)),
            Counters(self.photons, self.rays, self.n_hit),
            SideHits(*(np.concatenate([getattr(hits, one.name) for hits in self._elsewhere], axis=-1) for one in fields(SideHits))),
        )
        self._forget()
        return hits
