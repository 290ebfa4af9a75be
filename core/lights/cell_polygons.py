"""The polygons of emitting cells, and the closed form of their irradiance at receivers nearby."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..util.arrays import BoolArray, Float32, Float64, Int64
from ..util.geometry import dot_rows, lay_rows, take_rows
from .direct_points import Receivers, ReceivingSurfaces
from .emitting_cells import EmittingCells
from .irradiance import polygon_irradiance

_CLOSE = np.float32(4)  # the closed form is used below this ratio of squared distance to the farthest corner's
_SQUARE = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)  # a cell's domain
_ON_HORIZON = 1e-3  # roots of a cell's area below the horizon that count as on it


@dataclass(frozen=True)
class CellPolygons:
    """Cells as polygons: two triangles of equal area, which share the corners 0 and 2. Arrays are views for take_rows.

    corners   (n, 4, 3) float32, unit box
    normal    (n, 3) float32
    area      (n,) float64, unit box squared
    sealed    (n,) bool: the cell's back is never visible
    """

    corners: Float32
    normal: Float32
    area: Float64
    sealed: BoolArray

    @classmethod
    def of(cls, cells: EmittingCells, scene: ReceivingSurfaces, scale: float, tri_sealed: BoolArray) -> CellPolygons:
        """From cells in a scene; scale is the unit box's, tri_sealed (n_tri,) that of EmittingMeshes."""
        every, corners = np.arange(len(cells.tri)), []
        for corner in _SQUARE:
            tri, barycentric = cells.place(every, np.broadcast_to(corner, (len(every), 2)))
            corners.append(scene.place(tri, barycentric[:, 0], barycentric[:, 1]))
        normal = lay_rows(scene.normal[cells.tri])
        return cls(lay_rows(np.stack(corners, axis=1)), normal, cells.area_m2 * scale**2, tri_sealed[cells.tri])

    def rows(self, order: Int64) -> CellPolygons:
        return CellPolygons(take_rows(self.corners, order), take_rows(self.normal, order), self.area[order], self.sealed[order])

    @cached_property
    def centre(self) -> Float32:
        """(n, 3) float32, unit box: centroids."""
        return lay_rows(np.average(self.corners, axis=1, weights=(2, 1, 2, 1)).astype(np.float32))

    @cached_property
    def farthest(self) -> Float32:
        """(n,) float32, unit box squared: squared distance of the farthest corner from the centroid."""
        away = self.corners - self.centre[:, None]
        return (away * away).sum(axis=2).max(axis=1)

    def are_close(self, cell: Int64, receivers: Receivers) -> BoolArray:
        """(n,) bool: whether cells (n,) are close to receivers, where their centres and area do not give their light."""
        away = take_rows(self.centre, cell) - receivers.position
        return dot_rows(away, away) < _CLOSE * self.farthest[cell]

    def irradiance(self, cell: Int64, receivers: Receivers) -> Float64:
        """(n,): of cells (n,) of unit radiance, unoccluded, above the horizon of receivers."""
        out = np.abs(polygon_irradiance(take_rows(self.corners, cell), receivers.position, receivers.normal))
        behind = dot_rows(receivers.position - take_rows(self.centre, cell), take_rows(self.normal, cell)) < 0
        out[self.sealed[cell] & behind] = 0
        return out

    def share_above(self, cell: Int64, receivers: Receivers) -> Float64:
        """(n,): share of the area of cells (n,) that is above the receivers' horizon."""
        height = ((take_rows(self.corners, cell) - receivers.position[:, None]) * receivers.normal[:, None]).sum(axis=2)
        # Corners shared with the receiver's own face lie on the horizon up to rounding.
        whole = (height > -_ON_HORIZON * np.sqrt(self.area[cell])[:, None]).all(axis=1)
        return np.where(whole, 1.0, (_triangle_above(height[:, :3]) + _triangle_above(height[:, [0, 2, 3]])) / 2)


def _triangle_above(height: Float32) -> Float64:
    """(n,) float64: share of triangles' area above the horizon, by the heights of their corners (n, 3)."""
    low, middle, high = np.sort(height.astype(np.float64), axis=1).T
    with np.errstate(divide="ignore", invalid="ignore"):
        below = np.where(middle > 0, low**2 / ((low - middle) * (low - high)), 1 - high**2 / ((high - middle) * (high - low)))
    return np.where(low >= 0, 1.0, np.where(high <= 0, 0.0, 1 - below))
