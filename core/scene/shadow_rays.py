"""Shadow rays with coloured transmittance.

Opaque triangles are in a bvh of their own, which decides most rays at once. The remaining rays are followed from one transparent triangle
to the next; a scene without these has no second bvh.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..util.arrays import BoolArray, Float32, Float64
from ..util.geometry import gather, locate_hits, offset_origin, triangle_frames
from .materials import SurfaceMaterials
from .rays import RayScene
from .scene import DIFFUSE, SHADOW

MOST_LAYERS = 1024  # transparent triangles along one ray; rounding may keep a ray between two that coincide


@dataclass(frozen=True)
class Sight:
    """Transmittance along rays.

    share   (n,) bool, or float32 in [0, 1] in a scene with transparent surfaces: mean of the channels
    rgb     (n, 3) float32 in [0, 1], a view of rows; None in a scene without transparent surfaces
    rays    number of rays that were traced
    """

    share: BoolArray | Float32
    rgb: Float32 | None
    rays: int

    def times(self, values: Float64) -> Float64:
        """(n, 3): transmitted part of light (n, 3)."""
        return values * (self.share[:, None] if self.rgb is None else self.rgb)

    def dim(self, factor: Float32) -> Sight:
        """The transmittance times factors (n,) in [0, 1]."""
        rgb = np.repeat(self.share[None].astype(np.float32), 3, axis=0).T if self.rgb is None else self.rgb
        return Sight(self.share * factor, (rgb.T * factor).T, self.rays)

    def place(self, index: NDArray[np.intp], count: int) -> Sight:
        """The transmittance of `count` rays, where these are the ones at `index` and all others are blocked."""
        share: BoolArray | Float32 = np.zeros(count, bool if self.rgb is None else np.float32)
        share[index] = self.share
        if self.rgb is None:
            return Sight(share, None, self.rays)
        rgb = np.zeros((3, count), np.float32)
        rgb[:, index] = self.rgb.T
        return Sight(share, rgb.T, self.rays)


class ShadowRays:
    """Traces shadow rays.

    between_surfaces   the same for diffuse rays between surfaces, whose transmittance may differ; often the same object

    opaque      triangles that let no light pass
    passing     triangles that let some light pass, None if there are none
    tri_frame   (3, 3, n_tri) float32, from triangle_frames, unit box
    tri_normal  (3, n_tri) float32, unit
    """

    def __init__(
        self, opaque: RayScene, passing: RayScene | None, surfaces: SurfaceMaterials, tri_frame: Float32, tri_normal: Float32, kind: int
    ) -> None:
        self._opaque, self._passing, self._surfaces, self._kind = opaque, passing, surfaces, kind
        self._tri_frame, self._tri_normal = tri_frame, tri_normal
        self.between_surfaces = self

    @classmethod
    def of(cls, rays: RayScene, surfaces: SurfaceMaterials, corners: Float32, tri_normal: Float32) -> ShadowRays:
        """For triangles corners (n_tri, 3, 3), unit box, with normals (3, n_tri); `rays` contains all of them."""
        frame = triangle_frames(corners)

        def make(kind: int) -> ShadowRays:
            passes, whole = surfaces.find_passing(kind)
            some = passes & ~whole
            opaque = RayScene(collapse(corners, ~passes)) if passes.any() else rays
            return cls(opaque, RayScene(collapse(corners, some)) if some.any() else None, surfaces, frame, tri_normal, kind)

        made = make(SHADOW)
        if surfaces.has_two_passings:
            made.between_surfaces = make(DIFFUSE)
        return made

    def see(self, origin: Float32, direction: Float32, distance: Float32) -> Sight:
        """Transmittance along rays.

        origin, direction   (n, 3) float32, unit box; any strides
        distance            (n,) float32, in lengths of the direction
        """
        clear = ~self._opaque.occluded(origin, direction, distance) if len(distance) else np.zeros(0, bool)
        if self._passing is None:
            return Sight(clear, None, len(clear))
        left = clear.nonzero()[0]
        rgb = np.zeros((3, len(clear)), np.float32)
        rgb[:, left], traced = self._follow(self._passing, gather(origin.T, left), gather(direction.T, left), gather(distance, left))
        return Sight(rgb.sum(axis=0) / np.float32(3), rgb.T, len(clear) + traced)

    def _follow(self, passing: RayScene, origin: Float32, direction: Float32, distance: Float32) -> tuple[Float32, int]:
        """(3, n): transmittance of rays (3, n) through the transparent triangles; and the number of rays traced for it."""
        left, rgb, traced = np.arange(len(distance)), np.ones((3, len(distance)), np.float32), 0
        for _ in range(MOST_LAYERS):
            found = passing.closest(origin.T, direction.T, distance)
            traced += len(left)
            met = ((found.tri >= 0) & (found.distance < distance)).nonzero()[0]
            if not len(met):
                break
            tri, u, v = gather(found.tri, met).astype(np.intp), gather(found.u, met), gather(found.v, met)
            left, distance = gather(left, met), gather(distance, met) - gather(found.distance, met)
            share = gather(rgb, left) * self._surfaces.passing_at(tri, u, v, self._kind, -gather(direction, met)).T
            rgb[:, left] = share
            on = share.any(axis=0).nonzero()[0]
            left, distance, direction = gather(left, on), gather(distance, on), gather(direction, gather(met, on))
            tri, u, v = gather(tri, on), gather(u, on), gather(v, on)
            origin = leave_through(locate_hits(self._tri_frame, tri, u, v), direction, gather(self._tri_normal, tri))
        return rgb, traced


def leave_through(position: Float32, direction: Float32, normal: Float32) -> Float32:
    """(3, n): origins of rays that go on through triangles, just beyond their far sides; position, direction, normal (3, n) float32."""
    side = np.copysign(np.float32(1), np.einsum("kn,kn->n", direction, normal))
    return offset_origin(position, side * normal)


def collapse(corners: Float32, kept: BoolArray) -> Float32:
    """Triangles (n, 3, 3), of which those not kept (n,) lose their area: rays never meet these, and the others keep their numbers."""
    return np.where(kept[:, None, None], corners, corners[:, :1])
