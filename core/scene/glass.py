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
from ..util.geometry import gather
from . import ggx
from .ggx import LEAST_ALPHA, TINY
from .gloss import RoughnessRows
from .materials import SurfaceMaterials
from .scene import SceneSnapshot

_ENTRIES = 33  # per table, at even steps of the square root of the cosine
_SAMPLES = 1024  # per entry
_LEAST_IOR = 1e-2


@dataclass(frozen=True)
class Glass:
    """The glass of a scene's materials.

    tri_material   (n_tri,) int32
    tri_glass      (n_tri,) bool
    tri_rough      (n_tri,) bool: triangles of glass that is rough anywhere
    rows           rows of the tables
    alpha          (n_row,) float32: roughness squared; 0 for smooth glass
    ior            (n_row,) float32
    mirror         (3, n_row) float32: tint of the reflection, times the share of the surface that is glass
    fresnel        (n_row,) bool: whether Fresnel's equations apply; else all light is refracted, and light that would be totally
                   reflected is lost
    kept           (2 * n_row, _ENTRIES) float32: the lobe's albedo by single scattering, from the front and the back, by the cosine;
                   1 without compensation
    """

    surfaces: SurfaceMaterials
    tri_material: Int32
    tri_glass: BoolArray
    tri_rough: BoolArray
    rows: RoughnessRows
    alpha: Float32
    ior: Float32
    mirror: Float32
    fresnel: BoolArray
    kept: Float32

    @classmethod
    def of(cls, scene: SceneSnapshot, surfaces: SurfaceMaterials) -> Glass | None:
        """None if no surface is glass."""
        tri_glass = surfaces.tri_glass
        if not tri_glass.any():
            return None
        rows = RoughnessRows.of(scene)
        materials = rows.materials
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
        roughest = alpha[rows.first + rows.most - rows.least]
        return cls(
            surfaces,
            scene.tri_material,
            tri_glass,
            (roughest > 0)[scene.tri_material],
            rows,
            alpha,
            ior,
            mirror,
            fresnel,
            np.array(kept, np.float32),
        )

    def bend(
        self, tri: IntArray, u: FloatArray, v: FloatArray, direction: Float32, normal: Float32, is_front: BoolArray, numbers: Float32
    ) -> Bent:
        """Sample reflection or refraction of rays.

        direction   (3, n) float32, unit: directions in which rays arrive, from the side of their normals (3, n)
        is_front    (n,) bool: whether that side is the front of the triangle
        numbers     (3, n) float32, uniform in [0, 1)
        """
        material = gather(self.tri_material, tri)
        lobes = self.surfaces.lobes
        row = self.rows.find(material, lobes.at(tri, u, v)[:, 0]) if lobes.has_images else gather(self.rows.first, material)
        alpha, ior = gather(self.alpha, row), gather(self.ior, row)
        eta = np.where(is_front, ior, 1 / ior)
        axes = ggx.find_axes(normal)
        local = ggx.view_along(direction, axes)
        local /= np.sqrt(ggx.dot(local, local))
        half = np.zeros_like(local)
        half[2] = 1
        facets = (alpha > 0).nonzero()[0]
        if len(facets):
            half[:, facets] = ggx.sample_visible_normals(gather(local, facets), gather(alpha, facets), gather(numbers[:2], facets))
        cosine = np.clip(ggx.dot(local, half), 0, 1)
        share, cosine_out = ggx.reflectance(cosine, eta)
        fresnel = gather(self.fresnel, row)
        # Without Fresnel's equations, light that would be totally reflected is lost.
        mirrored = np.where(fresnel, share, 0) * gather(self.mirror, row)
        passed = np.where(fresnel, 1 - share, share < 1) * self.surfaces.glass.at(tri, u, v).T
        chance_m, chance_p = mirrored.max(axis=0), passed.max(axis=0)
        over = np.maximum(chance_m + chance_p, 1)
        chance_m, chance_p = chance_m / over, chance_p / over
        is_mirrored = numbers[2] < chance_m
        crossed = ~is_mirrored & (numbers[2] < chance_m + chance_p)
        weight = np.where(is_mirrored, mirrored / np.maximum(chance_m, TINY), np.where(crossed, passed / np.maximum(chance_p, TINY), 0))
        out = np.where(is_mirrored, 2 * cosine * half - local, (cosine / eta - cosine_out) * half - local / eta)
        if len(facets):
            goes = np.where(is_mirrored, out[2], -out[2])
            kept = ggx.look_up(self.kept, *ggx.find_place(2 * row.astype(np.intp) + ~is_front, local[2], _ENTRIES))
            factor = ggx.mask(local[2], goes, alpha) / np.maximum(kept, 1e-3)
            weight = np.where(alpha > 0, weight * factor, weight)
        turned = ggx.turn_back(out, axes)
        turned /= np.sqrt(np.maximum(ggx.dot(turned, turned), TINY))
        return Bent(turned.astype(np.float32), weight.astype(np.float32), crossed, eta.astype(np.float32))


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


@lru_cache(maxsize=1024)
def tabulate_glass(alpha: float, eta: float, fresnel: bool) -> Float64:
    """(_ENTRIES,): share of light that single scattering reflects and refracts together, by the cosine with the normal."""
    if alpha == 0:
        return np.ones(_ENTRIES)
    view, numbers = ggx.tabulated_views(_ENTRIES, _SAMPLES)
    cosine = view[2]
    rough = np.full_like(cosine, alpha)
    half = ggx.sample_visible_normals(view, rough, numbers)
    facing = np.clip(ggx.dot(view, half), 0, 1)
    share, other = ggx.reflectance(facing, np.full_like(cosine, eta))
    back = ggx.mask(cosine, 2 * facing * half[2] - cosine, rough)
    through = ggx.mask(cosine, cosine / eta - (facing / eta - other) * half[2], rough)
    kept: FloatArray = share * back + (1 - share) * through if fresnel else np.where(share < 1, through, 1)
    return kept.reshape(_ENTRIES, _SAMPLES).mean(axis=1)
