"""Lamps that do not treat all surfaces or rays alike: which objects they light, which cast their shadows, and which rays see them.

Source: Blender's light linking and shadow linking, and a lamp's ray visibility. A ray is of the kind by which it left the last surface, as
a light path runs from the receiver to the lamp.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..scene.scene import Light, SceneSnapshot
from ..util.arrays import Float32, IntArray
from ..util.geometry import gather

Bools = NDArray[np.bool_]
DIFFUSE, GLOSSY, TRANSMISSION = range(3)  # of Light.seen_by


@dataclass(frozen=True)
class LightLinks:
    """A row for each group of lamps with the same choices.

    of_light   (n_light,) int16     row of each of the snapshot's lights, -1 where it treats all alike
    lit        (n_row, n_tri) bool  triangles that it lights
    blocks     (n_row, n_tri) bool  triangles that cast its shadows
    seen_by    (3, n_row) bool      whether diffuse, glossy and transmission rays see it
    """

    of_light: NDArray[np.int16]
    lit: Bools
    blocks: Bools
    seen_by: Bools

    @classmethod
    def of(cls, snapshot: SceneSnapshot) -> LightLinks:
        rows: dict[tuple[object, ...], int] = {}
        of_light = np.full(len(snapshot.lights), -1, np.int16)
        for number, light in enumerate(snapshot.lights):
            choice = (light.lights, light.blocked_by, light.seen_by)
            if choice != _LIKE_ALL:
                of_light[number] = rows.setdefault(choice, len(rows))
        first = [snapshot.lights[int((of_light == row).argmax())] for row in range(len(rows))]
        lit, blocks = (
            np.array([_find_chosen(chosen, len(snapshot.objects)) for chosen in lists], bool).reshape(-1, len(snapshot.objects))
            for lists in ([one.lights for one in first], [one.blocked_by for one in first])
        )
        seen_by = np.array([one.seen_by for one in first], bool).reshape(-1, 3).T
        return cls(of_light, lit[:, snapshot.tri_object], blocks[:, snapshot.tri_object], seen_by)

    def __len__(self) -> int:
        return len(self.lit)

    def look_up(self, row: NDArray[np.int16], tri: IntArray) -> Linked:
        """How lamps of rows (n,), -1 plain ones, treat triangles (n,) that their photons have met."""
        linked = row >= 0
        own = np.maximum(row, 0).astype(np.intp)
        lit = np.where(linked, self.lit[own, tri], True)
        seen = np.where(linked, gather(self.seen_by, own), True) & lit
        return Linked(seen.astype(np.float32), linked & ~self.blocks[own, tri])


@dataclass(frozen=True)
class Linked:
    """What becomes of photons where they meet a surface straight from their lamp.

    seen   (3, n) float32: 1 where diffuse, glossy and transmission rays that leave there see the lamp, else 0
    open   (n,) bool: they go on as if nothing were there, whether they light it or not
    """

    seen: Float32
    open: Bools


_LIKE_ALL = (Light.lights, Light.blocked_by, Light.seen_by)


def _find_chosen(chosen: tuple[int, ...] | None, count: int) -> Bools:
    """(count,) bool: objects by their numbers; None is all."""
    out = np.full(count, chosen is None)
    out[list(chosen or ())] = True
    return out
