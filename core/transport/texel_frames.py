"""Positions and axes of texels in the scene; what all texels of a triangle share is computed once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..texels.contact import texel_axes
from ..texels.texel_map import TexelMap
from ..util.arrays import Float32, Float64, Int32, IntArray
from ..util.geometry import UnitBox, gather
from .traced_scene import TracedScene


@dataclass(frozen=True)
class TexelFrames:
    """Frames of the k triangles that have texels.

    row       (n_tri,) int32              column of each triangle in the fields below; arbitrary for one without texels
    corner    (9, k) float64, m           x, y, z of corner 0, of corner 1 and of corner 2
    normal    (3, k) float32              geometric, unit
    side      (k,) float64, unit box      side of a texel on the surface
    axes      (2, 3, k) float32, unit     directions of increasing columns and rows, see contact.texel_axes
    """

    texels: TexelMap
    unit_box: UnitBox
    row: Int32
    corner: Float64
    normal: Float32
    side: Float64
    axes: Float32

    @classmethod
    def of(cls, opened: TracedScene, texels: TexelMap) -> TexelFrames:
        has_texels = np.zeros(opened.snapshot.n_tri, bool)
        has_texels[texels.texel_tri] = True
        tri = np.flatnonzero(has_texels)
        corner, normal = opened.snapshot.tri_position[tri], opened.scene.tri_normal[:, tri]
        return cls(
            texels,
            opened.unit_box,
            (np.cumsum(has_texels) - 1).astype(np.int32),
            np.ascontiguousarray(corner.reshape(-1, 9).T),
            normal,
            np.sqrt(texels.tri_density[tri]) * opened.unit_box.scale,
            np.ascontiguousarray(texel_axes(corner, texels.tri_uv[tri], normal.T).transpose(0, 2, 1)),
        )

    def find_places(self, entry: IntArray) -> tuple[Float32, Float32, Float64]:
        """Positions (m, 3) and sides (m,), unit box, and normals (m, 3) between them, at texel entries (m,)."""
        row = self._rows(entry)
        weight = self.texels.bary_at(entry).T
        corner = gather(self.corner, row).reshape(3, 3, -1)
        position_m = weight[0] * corner[0]
        position_m += weight[1] * corner[1]
        position_m += weight[2] * corner[2]
        return self.unit_box.to_unit(position_m.T), gather(self.normal, row).T, gather(self.side, row)

    def find_axes(self, entry: IntArray) -> Float32:
        """(2, m, 3) float32, unit: axes of texel entries (m,)."""
        return gather(self.axes, self._rows(entry)).transpose(0, 2, 1)

    def _rows(self, entry: IntArray) -> Int32:
        return gather(self.row, gather(self.texels.texel_tri, entry))
