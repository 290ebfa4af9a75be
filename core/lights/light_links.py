"""Light linking: the objects that a lamp or glowing mesh lights, the objects that block it, and the kinds of rays that see it.

Source: Blender's light linking and shadow linking, and a lamp's ray visibility. Paths run from the receiver to the lamp, so a ray has the
kind by which it left the last surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..scene.materials import find_ray_kinds
from ..scene.scene import SEEN_BY_ALL, Rgb, SceneSnapshot
from ..util.arrays import BoolArray, Float32, IntArray
from ..util.geometry import gather


@dataclass(frozen=True)
class LightLinks:
    """The links of a scene; lights with the same links share a row.

    of_light   (n_light,) int16     row of each of the snapshot's lights, -1 without links
    of_tri     (n_tri,) int16       row for the emission of each triangle, -1 without links
    lit        (n_row, n_tri) bool  triangles that the light lights
    blocks     (n_row, n_tri) bool  triangles that block it
    seen_rgb   (3, 3, n_row) float32   share of it that diffuse, glossy and transmission rays see, by channel
    """

    of_light: NDArray[np.int16]
    of_tri: NDArray[np.int16]
    lit: BoolArray
    blocks: BoolArray
    seen_rgb: Float32

    @classmethod
    def of(cls, snapshot: SceneSnapshot) -> LightLinks:
        rows: dict[_Choice, int] = {}
        of_light = np.full(len(snapshot.lights), -1, np.int16)
        for number, light in enumerate(snapshot.lights):
            of_light[number] = _find_row(rows, (light.lights, light.blocked_by, _see(SEEN_BY_ALL, light.seen_by)))
        of_tri = np.full(snapshot.n_tri, -1, np.int16)
        glows = np.array([any(one.emission_rgb) for one in snapshot.materials], bool)[snapshot.tri_material]
        kinds, shining = find_ray_kinds(snapshot.materials), np.flatnonzero(glows)
        pairs = np.stack([snapshot.tri_material[shining], snapshot.tri_object[shining]])
        for material, thing in np.unique(pairs, axis=1).T.tolist():
            glow, owner = snapshot.materials[material].glow_rgb, snapshot.objects[thing]
            seen_rgb = _see([glow[kind] for kind in kinds], [owner.seen_by[kind] for kind in kinds])
            row = _find_row(rows, (owner.lights, owner.blocked_by, seen_rgb))
            of_tri[shining[(pairs == [[material], [thing]]).all(axis=0)]] = row
        count = len(snapshot.objects)
        lit = np.array([_find_chosen(chosen, count) for chosen, _, _ in rows], bool).reshape(-1, count)
        blocks = np.array([_find_chosen(chosen, count) for _, chosen, _ in rows], bool).reshape(-1, count)
        seen = np.array([seen for _, _, seen in rows], np.float32).reshape(-1, 3, 3).transpose(1, 2, 0)
        return cls(of_light, of_tri, lit[:, snapshot.tri_object], blocks[:, snapshot.tri_object], seen)

    def __len__(self) -> int:
        return len(self.lit)

    def look_up(self, row: NDArray[np.int16], tri: IntArray) -> Linked:
        """Links of photons from lamps with rows (n,), -1 for none, at triangles (n,) that they have met."""
        linked = row >= 0
        own = np.maximum(row, 0).astype(np.intp)
        lit = np.where(linked, self.lit[own, tri], True)
        seen = np.where(linked, gather(self.seen_rgb, own) * lit, np.float32(1))
        return Linked(seen, linked & ~self.blocks[own, tri])


@dataclass(frozen=True)
class Linked:
    """Links of photons at the first surface that they meet.

    seen   (3, 3, n) float32: share of their light that diffuse, glossy and transmission rays from the surface see, by channel
    open   (n,) bool: whether they also go on as if the surface were not there
    """

    seen: Float32
    open: BoolArray


_Choice: TypeAlias = tuple[tuple[int, ...] | None, tuple[int, ...] | None, tuple[Rgb, ...]]
_LIKE_ALL: _Choice = (None, None, SEEN_BY_ALL)


def _find_row(rows: dict[_Choice, int], choice: _Choice) -> int:
    """Row of a choice, which is added if it is new; -1 for no links."""
    return -1 if choice == _LIKE_ALL else rows.setdefault(choice, len(rows))


def _see(rgb: Sequence[Rgb], seen_by: Sequence[bool]) -> tuple[Rgb, ...]:
    return tuple(own if is_seen else (0.0, 0.0, 0.0) for own, is_seen in zip(rgb, seen_by, strict=True))


def _find_chosen(chosen: tuple[int, ...] | None, count: int) -> BoolArray:
    """(count,) bool: objects by their indices; None for all."""
    out = np.full(count, chosen is None)
    out[list(chosen or ())] = True
    return out
