"""The faces by which light from infinity enters a scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from .geometry import select, stack_columns
from .scene import FloatArray

Float32: TypeAlias = NDArray[np.float32]
Float64: TypeAlias = NDArray[np.float64]

_COVER_PADDING = 1e-3  # unit box; keeps rays from starting in the plane of an outermost surface


@dataclass(frozen=True)
class SceneCover:
    """A box around the scene: light from infinity enters by its faces, so none is spent beside the scene's outline.

    low, high   (3,) float32, unit box
    """

    low: Float32
    high: Float32

    @classmethod
    def around(cls, points_unit: FloatArray) -> SceneCover:
        """points_unit (n, 3), unit box; without any, the whole unit box."""
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
        out: Float64 = x * a + y * b + z * c  # many times faster than a product of matrices
        return out

    def choose_axis(self, u: Float32, weight: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
        """Face axes (n,) chosen by weights (n, 3) or (1, 3), and what is left of u (n,) float32, again in [0, 1]."""
        x, y, z = weight.T.astype(np.float32)
        total = x + y + z
        first, second = x / total, (x + y) / total
        beyond_first, beyond_second = u >= first, u >= second
        axis = beyond_first.astype(np.int64) + beyond_second
        low = np.maximum(beyond_first * first, beyond_second * second)
        high = select(beyond_first, np.maximum(second, beyond_second), first)
        return axis, np.clip((u - low) / np.maximum(high - low, 1e-12), 0, 1)

    def place(self, axis: NDArray[np.int64], at_high: NDArray[np.bool_], u: FloatArray, v: FloatArray) -> Float32:
        """(n, 3) float32: points (u, v) of the faces across `axis`, on their high or low side."""
        across = [axis == k for k in range(3)]
        side, u, v = (number.astype(np.float32, copy=False) for number in (at_high, u, v))
        share = stack_columns(*(across[k] * side + across[k - 1] * u + across[k - 2] * v for k in range(3)))
        out: Float32 = self.low + share * (self.high - self.low)
        return out
