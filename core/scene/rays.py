"""Closest hits and shadow rays; the only module that imports embreex."""

from __future__ import annotations

import contextlib
import mmap
import sys
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..util.arrays import BoolArray, Float32, Int32
from ..util.geometry import triangle_normals_areas
from ..util.threads import count_usable

# Address space that embree 4.4 needs: for its libraries, and for a scene. The latter is the least limit that it survived with one triangle,
# one million and three million, on one processor and on two: 132 MB, 340 bytes per triangle, 8 MB per processor that this process may use.
_LIBRARY_BYTES = 64 << 20
_SCENE_BYTES, _TRIANGLE_BYTES, _PROCESSOR_BYTES = 144 << 20, 352, 8 << 20


@dataclass(frozen=True)
class Hits:
    """Closest hits of rays.

    tri        (n,) int32     -1 for a miss; u and v are then 0
    u, v       (n,) float32   barycentric weights of corners 1 and 2; by rounding, up to 2e-7 outside of the triangle
    distance   (n,) float32   in lengths of the ray's direction; huge for a miss
    """

    tri: Int32
    u: Float32
    v: Float32
    distance: Float32


class RayScene:
    """The triangles in a bvh. Rays have no least distance: callers offset their origins (geometry.offset_origin).

    tri_position_unit   (n_tri, 3, 3) float32, unit box; triangles without area are never hit
    Raises ValueError if embreex cannot be loaded, MemoryError if there is no room for the bvh.
    """

    def __init__(self, tri_position_unit: Float32) -> None:
        solid = triangle_normals_areas(tri_position_unit)[1] > 0
        # By rounding, a triangle without area could still be hit, and its normal is arbitrary.
        self._tri_of_primitive: Int32 | None = None
        if not solid.all():
            self._tri_of_primitive = np.append(np.flatnonzero(solid), -1).astype(np.int32)  # primitive -1, a miss, takes the last
        embree_scene, triangle_mesh = _load_embree()
        _ask_for(_SCENE_BYTES + _TRIANGLE_BYTES * len(tri_position_unit) + _PROCESSOR_BYTES * count_usable())
        self._embree = embree_scene(robust=True)  # otherwise 1 of 15 rays aimed at an edge slips through; it costs nothing measurable
        if solid.any():
            triangle_mesh(self._embree, np.ascontiguousarray(tri_position_unit[solid], np.float32))
        # The first run commits the scene, which is not thread-safe.
        self._embree.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))

    def closest(self, origin: Float32, direction: Float32, distance: Float32 | None = None) -> Hits:
        """The first triangle along each ray, from either side.

        origin, direction   (n, 3) float32, unit box; any strides
        distance            (n,) float32, length of the ray in lengths of the direction; None for no limit
        """
        limit = None if distance is None else np.array(distance, np.float32)  # embreex writes to it
        found = self._embree.run(origin, direction, limit, output=1)
        tri = found["primID"] if self._tri_of_primitive is None else self._tri_of_primitive[found["primID"]]
        return Hits(tri, found["u"], found["v"], found["tfar"])

    def occluded(self, origin: Float32, direction: Float32, distance: Float32) -> BoolArray:
        """Whether a triangle lies nearer than the distance along each ray.

        origin, direction   (n, 3) float32, unit box; any strides
        distance            (n,) float32, in lengths of the direction
        out                 (n,) bool
        """
        limit = np.array(distance, np.float32)  # a copy: embreex needs a writable array
        return self._embree.run(origin, direction, limit, query="OCCLUDED") >= 0


def load_ahead() -> None:
    """Load embreex before the first scene; errors are raised when a scene is made."""
    with contextlib.suppress(ValueError, MemoryError):
        _load_embree()


def _load_embree() -> tuple[Any, Any]:
    if "embreex" not in sys.modules:
        _ask_for(_LIBRARY_BYTES)  # otherwise a lack of memory would be reported as a failure to load embreex
    try:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene
    except (ImportError, OSError) as reason:
        raise ValueError(
            f"The ray tracer embreex cannot be loaded ({reason}); reinstall Leaflight with the package for this platform and Python "
            "(Linux x64, Windows x64, or macOS 13 and later)."
        ) from reason
    return EmbreeScene, TriangleMesh


def _ask_for(n_bytes: int) -> None:
    """Raise MemoryError if this process cannot get so much more memory: embree would end the process without a message."""
    try:
        mmap.mmap(-1, n_bytes).close()  # untouched, it takes no memory and only microseconds
    except OSError as reason:
        raise MemoryError(f"{n_bytes >> 20} MB for the ray tracer") from reason
