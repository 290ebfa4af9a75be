"""Texels where other geometry touches or nearly touches the surface: the foot of a table's leg, a shelf on a wall.

The preview of a large node averages over such small shadows and so misses them, which is the shadow leak that [Tobler97]
describes in section 4; its remedy, forced subdivision where geometry tells (3.7), needs to know where.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .rays import RayScene
from .scene import FloatArray

_LIFT_TEXELS = 0.25  # height of the feelers above the surface
_REACH_TEXELS = 1.5  # and their length
_FEELERS = 4
_CHUNK = 1 << 18


def find_contacts(rays: RayScene, position: NDArray[np.float32], normal: NDArray[np.float32], texel_size: FloatArray) -> NDArray[np.bool_]:
    """Whether something stands within a texel or so of each point, found by short rays along the surface.

    position     (n, 3) float32, unit box
    normal       (n, 3) float32, unit
    texel_size   (n,) float, unit box: side of a texel on the surface
    """
    found = np.zeros(len(position), bool)
    for start in range(0, len(position), _CHUNK):
        part = slice(start, start + _CHUNK)
        size = texel_size[part, None].astype(np.float32)
        along = _any_tangent(normal[part])
        across = np.cross(normal[part], along)
        origin = position[part] + normal[part] * (_LIFT_TEXELS * size)
        reach = _REACH_TEXELS * size[:, 0]
        for feeler in range(_FEELERS):
            angle = 2.0 * np.pi * feeler / _FEELERS
            direction = (np.cos(angle) * along + np.sin(angle) * across).astype(np.float32)
            found[part] |= rays.occluded(origin, direction, reach)
    return found


def _any_tangent(normal: NDArray[np.float32]) -> NDArray[np.float32]:
    least = np.abs(normal).argmin(1)
    axis = np.zeros_like(normal)
    axis[np.arange(len(normal)), least] = 1.0
    tangent = np.cross(normal, axis)
    length = np.linalg.norm(tangent, axis=1, keepdims=True)
    unit: NDArray[np.float32] = (tangent / np.where(length > 0.0, length, 1.0)).astype(np.float32)
    return unit
