"""Shading normals from images: bump and normal maps of materials."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..util.arrays import BoolArray, Float32, FloatArray, Int32, Int64, IntArray
from ..util.geometry import dot_rows, gather, locate_hits, triangle_frames
from .scene import SceneSnapshot
from .textures import Textures

_SHORTEST_NORMAL = 1e-3  # length of an interpolated normal below which it has no direction


@dataclass(frozen=True)
class NormalMaps:
    """The images of normals of a scene's triangles.

    tri_image   (n_tri,) int32, -1 for none
    tri_uv      (3, 2, n_tri) float32   from triangle_frames
    tri_row     (n_tri,) int32          column below of a triangle whose map is in tangent space, -1 for others
    strength    (n,) float32
    tangents    (3, 9, n) float32       from triangle_frames: tangent, bitangent and normal
    """

    tri_image: Int32
    tri_uv: Float32
    textures: Textures
    tri_row: Int32
    strength: Float32
    tangents: Float32

    @classmethod
    def of(cls, snapshot: SceneSnapshot) -> NormalMaps | None:
        """None if no triangle has a map."""
        image = np.array([material.normal_image for material in snapshot.materials], np.int32)[snapshot.tri_material]
        if not (image >= 0).any():
            return None
        strength = np.array([np.nan if one.normal_strength is None else one.normal_strength for one in snapshot.materials], np.float32)
        strength = strength[snapshot.tri_material]
        own = np.flatnonzero(np.isfinite(strength) & (image >= 0))
        row = np.full(len(image), -1, np.int32)
        row[own] = np.arange(len(own))
        tangents = triangle_frames(snapshot.tri_tangents[own].reshape(-1, 3, 9) if len(own) else np.zeros((0, 3, 9), np.float32))
        return cls(image, triangle_frames(snapshot.tri_normal_uv), Textures(snapshot.images), row, strength[own], tangents)

    def has(self, tri: IntArray) -> BoolArray:
        """(n,) bool: whether triangles (n,) have a map."""
        return gather(self.tri_image, tri) >= 0

    def look_up(self, tri: IntArray, u: FloatArray, v: FloatArray, side: Float32) -> tuple[Int64, Float32]:
        """Rows (m,) int64 of those of n points that have a normal from a map, and the normals, (3, m) float32, unit.

        tri, u, v   (n,) triangles, and weights of their corners 1 and 2
        side        (3, n) float32, unit: normals without maps; those of the maps are turned to their side
        """
        rows = self.has(tri).nonzero()[0]
        own = gather(tri, rows)
        u, v = gather(u, rows), gather(v, rows)
        uv = locate_hits(self.tri_uv, own, u, v)
        normal = self.textures.at(gather(self.tri_image, own), uv.T).T.astype(np.float32)
        row = gather(self.tri_row, own)
        mapped = (row >= 0).nonzero()[0]
        if len(mapped) == len(row):
            normal = self._turn(normal, row, u, v)
        elif len(mapped):
            normal[:, mapped] = self._turn(normal[:, mapped], row[mapped], u[mapped], v[mapped])
        length = np.sqrt((normal * normal).sum(axis=0))
        is_known = length > _SHORTEST_NORMAL
        rows, normal, length = rows[is_known], normal[:, is_known], length[is_known]
        # A surface that is seen from its back, or was turned, has the same bumps with opposite normals.
        ahead = (normal * gather(side, rows)).sum(axis=0)
        return rows, normal * (np.where(ahead < 0, -1.0, 1.0).astype(np.float32) / length)

    def _turn(self, rgb: Float32, row: IntArray, u: FloatArray, v: FloatArray) -> Float32:
        """(3, n) float32, unit or 0: normals in world space from colours (3, n) of normal maps, at weights u, v (n,) of corners 1 and 2.

        Source: Blender, intern/cycles/kernel/svm/tex_coord.h, svm_node_normal_map.
        """
        tangent, bitangent, normal = locate_hits(self.tangents, row, u, v).reshape(3, 3, -1)
        strength = gather(self.strength, row)
        x, y, z = 2 * rgb - 1
        tangent *= x * strength
        bitangent *= y * strength
        normal *= 1 + (z - 1) * np.minimum(strength, 1)
        tangent += bitangent
        tangent += normal
        tangent /= np.maximum(np.sqrt((tangent * tangent).sum(axis=0)), np.float32(1e-30))
        return tangent.astype(np.float32, copy=False)

    def weigh(
        self, tri: IntArray, u: FloatArray, v: FloatArray, side: Float32, smooth: Float32, direction: Float32
    ) -> tuple[Int64, Float32]:
        """Rows (m,) int64 of those of n photons that meet a normal map, and factors (m,) float32 on their light.

        The factor is the cosine with the map's normal over that with the surface, times the shadowing of bumps. It scales all light that
        leaves the surface diffusely, in any direction.

        side        (3, n) float32, unit: normal of the surface on the side that they meet
        smooth      (3, n) float32, unit: normal between the corners', on the same side
        direction   (3, n) float32, unit: direction of the photons
        Source: Veach 1997, "Robust Monte Carlo methods for light transport simulation", section 5.3.
        """
        rows, normal = self.look_up(tri, u, v, smooth)
        side, smooth, toward = gather(side, rows), gather(smooth, rows), -gather(direction, rows)
        height = np.maximum((side * toward).sum(axis=0), np.float32(1e-4))
        facing = np.maximum((normal * toward).sum(axis=0), 0)
        worth: Float32 = facing / height * shade_bumps(smooth.T, normal.T, toward.T)
        return rows, worth


def shade_bumps(side: Float32, normal: Float32, direction: Float32) -> Float32:
    """(n,) float32 in [0, 1]: unshadowed share of bumps, nearly 1 unless light is grazing and bumps are steep.

    side        (n, 3) float32, unit     normal of the surface without bumps
    normal      (n, 3) float32, unit     normal with bumps
    direction   (n, 3) float32, unit     towards the light
    Source: Conty Estevez, Lecocq & Stein 2019, "A Microfacet-Based Shadowing Function to Solve the Bump Terminator Problem"; Cycles does
    the same.
    """
    steep = np.clip(dot_rows(side, normal), np.float32(1e-4), np.float32(1))  # rounding may exceed 1, which would make a root negative
    height = np.maximum(dot_rows(side, direction), np.float32(1e-4))
    roughness = np.minimum((1 / (steep * steep) - 1) / 8, 1)
    shade: Float32 = 2 / (1 + np.sqrt(1 + roughness * (1 / (height * height) - 1)))
    return shade.astype(np.float32, copy=False)
