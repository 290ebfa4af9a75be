"""The emitters of a scene, with lights of a kind joined: their photons are emitted together, since numpy is slow on short arrays.

The last axis of a joinable light's arrays is that of lights: 1 for a single one, k for joined ones, n for the values of n photons. With the
same random numbers, each photon is bitwise equal to that of its light alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..util.arrays import BoolArray, Float32, Float64, Int64, IntArray
from ..util.geometry import gather, take_rows
from .emitters import WorldEmitter
from .lights import AreaEmitter, EmittedPhotons, Emitter, PointEmitter

_OWN = ("name", "power_rgb", "casts_shadow", "link")  # fields that do not affect positions and directions of emitted photons


@dataclass(frozen=True)
class _Kind:
    """Joined lights, which differ only in arrays; or a single emitter."""

    first: Any  # Emitter
    arrays: dict[str, NDArray[Any]]  # (..., k), by field; empty for a single emitter

    @classmethod
    def of(cls, emitters: Sequence[Emitter]) -> _Kind:
        if len(emitters) == 1:
            return cls(emitters[0], {})
        of_each = [_arrays(emitter) for emitter in emitters]
        return cls(emitters[0], {name: np.concatenate([arrays[name] for arrays in of_each], axis=-1) for name in of_each[0]})

    def emit(self, light: IntArray, u: Float32) -> EmittedPhotons:
        """Photons of lights (n,) of this kind, ascending, for numbers (n, 4)."""
        own = light[:1] if light[0] == light[-1] else light
        joined: Emitter = replace(self.first, **{name: gather(values, own) for name, values in self.arrays.items()})
        return joined.emit(u)


@dataclass(frozen=True)
class JoinedEmitters:
    """All emitters of a scene.

    power_rgb      (n_emitter, 3) float64, W
    casts_shadow   (n_emitter,) bool
    is_even_sky    (n_emitter,) bool    whether it is an even sky, whose light passes surfaces as diffuse rays do
    crowded        (n_emitter,) bool    see PointEmitter
    kind           (n_emitter,) int64   index into kinds
    light          (n_emitter,) int64   index within the kind
    link           (n_emitter,) int16   row of LightLinks, -1 for none
    """

    power_rgb: Float64
    casts_shadow: BoolArray
    is_even_sky: BoolArray
    crowded: BoolArray
    kinds: tuple[_Kind, ...]
    kind: Int64
    light: Int64
    link: NDArray[np.int16]

    @classmethod
    def of(cls, emitters: Sequence[Emitter]) -> JoinedEmitters:
        groups: dict[tuple[object, ...], list[int]] = {}
        for number, emitter in enumerate(emitters):
            groups.setdefault(_name_kind(emitter) or (number,), []).append(number)
        kind, light = np.empty((2, len(emitters)), np.int64)
        for k, numbers in enumerate(groups.values()):
            kind[numbers], light[numbers] = k, np.arange(len(numbers))
        power = np.array([emitter.power_rgb for emitter in emitters], np.float64).reshape(-1, 3)
        casts_shadow = np.array([emitter.casts_shadow for emitter in emitters], bool)
        sky = np.array([isinstance(emitter, WorldEmitter) for emitter in emitters], bool)
        crowded = np.array([isinstance(emitter, PointEmitter) and emitter.crowded for emitter in emitters], bool)
        kinds = tuple(_Kind.of([emitters[i] for i in numbers]) for numbers in groups.values())
        link = np.array([getattr(emitter, "link", -1) for emitter in emitters], np.int16)
        return cls(power, casts_shadow, sky, crowded, kinds, kind, light, link)

    def __len__(self) -> int:
        return len(self.kind)

    def emit(self, emitter: IntArray, u: Float32) -> EmittedPhotons:
        """Photons of emitters (n,), n > 0, ascending, for numbers u (n, 4) float32, see Emitter.emit."""
        kind, light = self.kind.take(emitter), self.light.take(emitter)
        found: list[int] = np.flatnonzero(np.bincount(kind)).tolist()
        if len(found) == 1:
            return self.kinds[found[0]].emit(light, u)
        origin, direction, relative = np.empty((3, 3, len(emitter)), np.float32)
        soft_radius, soft_offset = np.empty((2, len(emitter)), np.float32)
        cuts = np.flatnonzero(kind[1:] != kind[:-1]) + 1
        own: slice | IntArray
        for k in found:
            own = np.flatnonzero(kind == k)
            if len(cuts) < len(found):  # those of a kind follow each other: a range is sooner read and written than rows
                own = slice(int(own[0]), int(own[-1]) + 1)
            photons = self.kinds[k].emit(light[own], u[own] if isinstance(own, slice) else take_rows(u, own))
            origin[:, own], direction[:, own], relative[:, own] = photons.origin.T, photons.direction.T, photons.relative_rgb.T
            soft_radius[own], soft_offset[own] = photons.soft_radius, photons.soft_offset
        return EmittedPhotons(origin.T, direction.T, relative.T, soft_radius, soft_offset)


def _name_kind(emitter: Emitter) -> tuple[object, ...]:
    """Key that is equal for lights that can be joined; () for other emitters."""
    if type(emitter) not in (PointEmitter, AreaEmitter):
        return ()
    return type(emitter), *(value for name, value in vars(emitter).items() if name not in _OWN and not isinstance(value, np.ndarray))


def _arrays(emitter: Emitter) -> dict[str, NDArray[Any]]:
    """The fields of an emitter that have an axis of lights."""
    return {name: value for name, value in vars(emitter).items() if name not in _OWN and isinstance(value, np.ndarray)}
