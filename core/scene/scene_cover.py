"""A box around the scene, through whose faces light from infinity enters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..util.arrays import Float32, Float64, FloatArray
from ..util.geometry import stack_columns

_TINY = float(np.finfo(np.float32).tiny)
_COVER_PADDING = 1e-3  # unit box; keeps rays from starting in the plane of an outermost surface


@dataclass(frozen=True)
class SceneCover:
    """A box around the scene. Light from infinity is emitted from its faces, so that no photon misses the box.

    low, high   (3,) float32, unit box
    """

    low: Float32
    high: Float32

    @classmethod
    def around(cls, points_unit: FloatArray) -> SceneCover:
        """The box around points_unit (n, 3), unit box; the whole unit box if there are none."""
        if not len(points_unit):
            return cls(np.full(3, -0.5, np.float32), np.full(3, 0.5, np.float32))
        low, high = points_unit.min(axis=0) - _COVER_PADDING, points_unit.max(axis=0) + _COVER_PADDING
        return cls(low.astype(np.float32), high.astype(np.float32))

    @property
    def face_area(self) -> Float64:
        """(3,) float64, unit box squared: areas of the faces across x, y and z."""
        side = (self.high - self.low).astype(np.float64)
        return np.array([side[1] * side[2], side[0] * side[2], side[0] * side[1]])

    def outline_area(self, direction: FloatArray) -> Float64:
        """(n,) float64, unit box squared: the box's area seen along directions (n, 3)."""
        x, y, z = np.abs(direction.T.astype(np.float64))
        a, b, c = self.face_area
        return x * a + y * b + z * c  # many times faster than a matrix product

    def choose_faces(self, u: Float32, weight: FloatArray) -> tuple[Float32, Float32]:
        """Choose axes by weights (n, 3) or (1, 3); returns `across` and u (n,) float32, rescaled to [0, 1] for further use.

        across   (3, n) float32: 1 for the axis to which the chosen face is perpendicular, 0 for the others
        """
        x, y, z = weight.T.astype(np.float32)
        place = u.astype(np.float32, copy=False) * (x + y + z)
        beyond_first, beyond_second = (place >= x).astype(np.float32), (place >= x + y).astype(np.float32)
        across = np.stack([1 - beyond_first, beyond_first - beyond_second, beyond_second])
        place -= beyond_first * x
        place -= beyond_second * y
        place /= np.maximum(across[0] * x + across[1] * y + across[2] * z, np.float32(_TINY))
        return across, place.clip(0, 1)

    def place(self, across: Float32, at_high: FloatArray, u: FloatArray, v: FloatArray) -> Float32:
        """(n, 3) float32: points (u, v) on the faces perpendicular to an axis; the upper face where at_high (n,) is 1, the lower for 0."""
        at_high, u, v = (number.astype(np.float32, copy=False) for number in (at_high, u, v))
        share = stack_columns(*(across[k] * at_high + across[k - 1] * u + across[k - 2] * v for k in range(3)))
        return self.low + share * (self.high - self.low)
