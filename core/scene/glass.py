"""Dielectric glass: sampling of reflection and refraction.

The lobe is GGX with Smith's height-correlated masking on both sides and the exact Fresnel equations at the microfacet; smooth glass bends
light at the shading normal. Where the material compensates for the energy that single scattering loses on rough surfaces, weights are
divided by the lobe's albedo.
Front faces look out of the glass, so a closed solid refracts light twice. A single face refracts it once, as in Cycles.

Source: Walter et al. 2007, "Microfacet models for refraction through rough surfaces", eq. 16, 22 and 40; Heitz 2018, "Sampling the GGX
distribution of visible normals"; Turquin 2019, "Practical multiple scattering compensation for microfacet models".
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..util.arrays import BoolArray, Float32, Float64, FloatArray, Int32, IntArray
from ..util.geometry import gather, orthonormal_basis
from .gloss import LEAST_ALPHA, sample_visible_normals, shadow_term
from .materials import SurfaceMaterials
from .scene import SceneSnapshot

_ENTRIES = 33  # per table, at even steps of the square root of the cosine
_SAMPLES = 1024  # per entry
_HAIR = np.float32(1e-6)
_TINY = np.finfo(np.float32).tiny
_LEAST_IOR = 1e-2


@dataclass(frozen=True)
class Glass:
    """The glass of a scene's materials.

    tri_material   (n_tri,) int32
    tri_glass      (n_tri,) bool
    alpha          (n_material,) float32: roughness squared; 0 for smooth glass
    ior            (n_material,) float32
    mirror         (3, n_material) float32: tint of the reflection, times the share of the surface that is glass
    fresnel        (n_material,) bool: whether Fresnel's equations apply; else all light is refracted, and light that would be totally
                   reflected is lost
    kept           (2 * n_material * _ENTRIES,) float32: the lobe's albedo by single scattering, from the front and the back, by the cosine;
                   1 without compensation
    """

    surfaces: SurfaceMaterials
    tri_material: Int32
    tri_glass: BoolArray
    alpha: Float32
    ior: Float32
    mirror: Float32
    fresnel: BoolArray
    kept: Float32

    @classmethod
    def of(cls, scene: SceneSnapshot, surfaces: SurfaceMaterials) -> Glass | None:
        """None if no surface is glass."""
        tri_glass = surfaces.find_glass()
        if not tri_glass.any():
            return None
        materials = scene.materials
        alpha = np.array([one.glass_roughness**2 for one in materials], np.float32)
        alpha[alpha <= LEAST_ALPHA] = 0
        ior = np.array([max(one.glass_ior, _LEAST_IOR) for one in materials], np.float32)
        mirror = np.ascontiguousarray(np.clip(np.array([one.glass_mirror_rgb for one in materials], np.float32), 0, 1).T)
        fresnel = np.array([one.glass_fresnel for one in materials], bool)
        kept = [
            tabulate_glass(float(a), float(n if front else 1 / n), bool(f)) if one.glass_multiscatter else np.ones(_ENTRIES)
            for one, a, n, f in zip(materials, alpha, ior, fresnel, strict=True)
            for front in (True, False)
        ]
        return cls(surfaces, scene.tri_material, tri_glass, alpha, ior, mirror, fresnel, np.concatenate(kept).astype(np.float32))

    def is_rough(self, tri: IntArray) -> BoolArray:
        """(n,): triangles of rough glass."""
        return gather(self.alpha, gather(self.tri_material, tri)) > 0

    def bend(
        self, tri: IntArray, u: FloatArray, v: FloatArray, direction: Float32, normal: Float32, is_front: BoolArray, numbers: Float32
    ) -> Bent:
        """Sample reflection or refraction of rays.

        direction   (3, n) float32, unit: directions in which rays arrive, from the side of their normals (3, n)
        is_front    (n,) bool: whether that side is the front of the triangle
        numbers     (3, n) float32, uniform in [0, 1)
        """
        material = gather(self.tri_material, tri)
        alpha, ior = gather(self.alpha, material), gather(self.ior, material)
        eta = np.where(is_front, ior, 1 / ior)
        tangent, bitangent = (axis.T for axis in orthonormal_basis(normal.T))
        local = np.stack([-_dot(direction, axis) for axis in (tangent, bitangent, normal)])
        local[2] = np.maximum(local[2], _HAIR)
        local /= np.sqrt(_dot(local, local))
        half = np.zeros_like(local)
        half[2] = 1
        rough = (alpha > 0).nonzero()[0]
        if len(rough):
            half[:, rough] = sample_visible_normals(gather(local, rough), gather(alpha, rough), gather(numbers[:2], rough))
        cosine = np.clip(_dot(local, half), 0, 1)
        share, cosine_out = reflectance(cosine, eta)
        fresnel = gather(self.fresnel, material)
        # Without Fresnel's equations, light that would be totally reflected is lost.
        mirrored = np.where(fresnel, share, 0) * gather(self.mirror, material)
        passed = np.where(fresnel, 1 - share, share < 1) * self.surfaces.glass_at(tri, u, v).T
        chance_m, chance_p = mirrored.max(axis=0), passed.max(axis=0)
        over = np.maximum(chance_m + chance_p, 1)
        chance_m, chance_p = chance_m / over, chance_p / over
        is_mirrored = numbers[2] < chance_m
        crossed = ~is_mirrored & (numbers[2] < chance_m + chance_p)
        weight = np.where(is_mirrored, mirrored / np.maximum(chance_m, _TINY), np.where(crossed, passed / np.maximum(chance_p, _TINY), 0))
        out = np.where(is_mirrored, 2 * cosine * half - local, (cosine / eta - cosine_out) * half - local / eta)
        if len(rough):
            goes = np.where(is_mirrored, out[2], -out[2])
            factor = mask_both(local[2], goes, alpha) / self._find_kept(material, is_front, local[2])
            weight = np.where(alpha > 0, weight * factor, weight)
        turned = out[0] * tangent + out[1] * bitangent + out[2] * normal
        turned /= np.sqrt(np.maximum(_dot(turned, turned), _TINY))
        return Bent(turned.astype(np.float32), weight.astype(np.float32), crossed, eta.astype(np.float32))

    def _find_kept(self, material: IntArray, is_front: BoolArray, cosine: FloatArray) -> FloatArray:
        place = np.sqrt(np.minimum(cosine, 1)) * (_ENTRIES - 1)
        before = np.minimum(place, _ENTRIES - 2).astype(np.intp)
        low = (2 * material.astype(np.intp) + ~is_front) * _ENTRIES + before
        first = gather(self.kept, low)
        return np.maximum(first + (gather(self.kept, low + 1) - first) * (place - before), 1e-3)


@dataclass(frozen=True)
class Bent:
    """Rays that met glass.

    direction   (3, n) float32, unit
    weight      (3, n) float32: factor on their throughput; 0 for rays that end
    crossed     (n,) bool: whether they were refracted to the other side
    eta         (n,) float32: index of refraction of the other side, relative to the side they come from
    """

    direction: Float32
    weight: Float32
    crossed: BoolArray
    eta: Float32

    def put(self, rows: IntArray, other: Bent) -> None:
        """Replace the rays in rows (k,) by others."""
        self.direction[:, rows], self.weight[:, rows], self.crossed[rows] = other.direction, other.weight, other.crossed


def reflectance(cosine: FloatArray, eta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n,) each: share of unpolarised light at a cosine (n,) with the normal that a smooth interface reflects, 1 for total reflection; and
    the cosine of the refracted direction with the normal on the other side.

    eta   (n,) float: index of refraction of the other side, relative to the side that light comes from
    Source: Walter et al. 2007, eq. 22.
    """
    square = 1 - (1 - cosine * cosine) / (eta * eta)
    inside = square > 0
    other = np.sqrt(np.where(inside, square, 0))
    across = (cosine - eta * other) / np.maximum(cosine + eta * other, _TINY)
    along = (eta * cosine - other) / np.maximum(eta * cosine + other, _TINY)
    return np.where(inside, 0.5 * (across * across + along * along), 1), other


def mask_both(cosine_in: FloatArray, cosine_out: FloatArray, alpha: FloatArray) -> FloatArray:
    """(n,): G2 / G1 for an outgoing direction on either side; 0 for cosine_out <= 0, which is on the wrong side."""
    into, out = shadow_term(cosine_in, alpha), shadow_term(np.maximum(cosine_out, 1e-6), alpha)
    return np.where(cosine_out > 0, (1 + into) / (1 + into + out), 0)


@lru_cache(maxsize=1024)
def tabulate_glass(alpha: float, eta: float, fresnel: bool) -> Float64:
    """(_ENTRIES,): share of light that single scattering reflects and refracts together, by the cosine with the normal."""
    if alpha == 0:
        return np.ones(_ENTRIES)
    cosine = np.repeat(np.maximum(np.linspace(0, 1, _ENTRIES) ** 2, 1e-5), _SAMPLES)
    index = np.arange(_SAMPLES)
    # Source: Rank-1 lattice by the golden ratio; Niederreiter 1992.
    numbers = np.tile(np.stack([(index + 0.5) / _SAMPLES, index * 0.6180339887498949 % 1]), _ENTRIES)
    view = np.stack([np.sqrt(1 - cosine**2), np.zeros_like(cosine), cosine])
    rough = np.full_like(cosine, alpha)
    half = sample_visible_normals(view, rough, numbers)
    facing = np.clip(_dot(view, half), 0, 1)
    share, other = reflectance(facing, np.full_like(cosine, eta))
    back = mask_both(cosine, 2 * facing * half[2] - cosine, rough)
    through = mask_both(cosine, cosine / eta - (facing / eta - other) * half[2], rough)
    kept: FloatArray = share * back + (1 - share) * through if fresnel else np.where(share < 1, through, 1)
    return kept.reshape(_ENTRIES, _SAMPLES).mean(axis=1)


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.einsum("kn,kn->n", a, b)
