"""Specular reflection of surfaces: metals, the layer above dielectric ones, and a clear coat above both.

A material's lobe is GGX with Smith's height-correlated masking. A metal reflects its colour by Schlick's formula, a dielectric layer by the
exact Fresnel equations for its index of refraction. What single scattering loses on rough surfaces is given back, tinted: weights are
times 1 + F (1 / E - 1), with the lobe's albedo without Fresnel, E, and the share F that the surface reflects of light scattered several
times: of a layer its mean Fresnel reflectance over the hemisphere, of a metal less, see _give_back. The layer takes its albedo off the
diffuse light below it, in the direction that leaves. A coat is a second dielectric layer with a lobe of its own, which takes its albedo
off all below it.

Source: Walter et al. 2007, "Microfacet models for refraction through rough surfaces"; Heitz 2018, "Sampling the GGX distribution of
visible normals"; Heitz 2014, "Understanding the masking-shadowing function", eq. 99; Turquin 2019, "Practical multiple scattering
compensation for microfacet models"; Schlick 1994.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..util.arrays import Float32, Float64, FloatArray, IntArray
from ..util.geometry import gather, orthonormal_basis
from .materials import SurfaceMaterials
from .scene import MAX_ALBEDO, Material, SceneSnapshot

LEAST_ALPHA = 1e-3  # of a mirror; its lobe is a twentieth of a degree wide
_ENTRIES = 65  # of a material's tables, evenly by the root of the cosine: at grazing angles they change soonest
_SAMPLES = 2048  # for each entry
_HAIR = np.float32(1e-6)
_LEAST_SHARE = 1e-6  # of a surface


@dataclass(frozen=True)
class Coat:
    """The coats of a scene's materials.

    alpha, ior, share   (n_material,) float32: as of a layer
    mean                (n_material,) float32: mean Fresnel reflectance
    lost                (n_material * _ENTRIES,) float32: as of Gloss
    albedo              the same: what the coat reflects, its share included
    """

    alpha: Float32
    ior: Float32
    share: Float32
    mean: Float32
    lost: Float32
    albedo: Float32

    @classmethod
    def of(cls, materials: Sequence[Material]) -> Coat | None:
        """None where no material has one."""
        share = np.array([one.coat for one in materials], np.float32)
        if not share.any():
            return None
        alpha = np.array([max(one.coat_roughness**2, LEAST_ALPHA) for one in materials], np.float32)
        ior = np.array([max(one.coat_ior, 1.0) for one in materials], np.float32)
        tables = [tabulate_lobe(float(a), float(n)) for a, n in zip(alpha, ior, strict=True)]
        lost, _, albedo = (np.concatenate([table[k] for table in tables]).astype(np.float32) for k in range(3))
        mean = np.array([average_fresnel(float(n)) for n in ior], np.float32)
        albedo *= np.repeat(share, _ENTRIES) * (1 + np.repeat(mean, _ENTRIES) * lost)
        return cls(alpha, ior, share, mean, lost, albedo)


@dataclass(frozen=True)
class Gloss:
    """The specular lobes of a scene's materials.

    tri_material   (n_tri,) int32
    tri_glossy     (n_tri,) bool
    alpha          (n_material,) float32: roughness squared
    ior            (n_material,) float32: of the dielectric layer
    layer          (n_material,) float32: share of the surface that has one
    tint           (n_material,) float32: of what the layer reflects straight on
    metal          (n_material,) float32: share of the surface that is metal
    layer_mean     (n_material,) float32: mean Fresnel reflectance of the layer
    kept_mean      (n_material,) float32: mean of E over the hemisphere
    lost           (n_material * _ENTRIES,) float32: 1 / E - 1 by the cosine with the normal
    edge           the same: what of a black metal's light Schlick's formula reflects at the edges by single scattering
    dielectric     the same: what the layer and the coat reflect, their shares included
    below          the same: what they leave of the diffuse light that they cover, and all of the rest
    coat           None where no material has one
    """

    surfaces: SurfaceMaterials
    tri_material: NDArray[np.int32]
    tri_glossy: NDArray[np.bool_]
    alpha: Float32
    ior: Float32
    layer: Float32
    tint: Float32
    metal: Float32
    layer_mean: Float32
    kept_mean: Float32
    lost: Float32
    edge: Float32
    dielectric: Float32
    below: Float32
    coat: Coat | None

    @classmethod
    def of(cls, scene: SceneSnapshot, surfaces: SurfaceMaterials) -> Gloss | None:
        """None where no surface has any."""
        materials = scene.materials
        layer = np.array([one.layer for one in materials], np.float32)
        metal = np.array([one.metal if any(one.metal_rgb) else 0.0 for one in materials], np.float32)
        reflects = np.array([one.reflects for one in scene.objects], bool)[scene.tri_object]
        coat = Coat.of(materials)
        glossy = ((layer > 0) | (metal > 0) | (coat.share > 0 if coat else False))[scene.tri_material] & reflects
        if not glossy.any():
            return None
        alpha = np.array([max(one.roughness**2, LEAST_ALPHA) for one in materials], np.float32)
        ior = np.array([max(one.ior, 1.0) for one in materials], np.float32)
        tint = np.array([one.layer_tint for one in materials], np.float32)
        lobes = [tabulate_lobe(*map(float, numbers)) for numbers in zip(alpha, ior, tint, strict=True)]
        lost, edge, dielectric = (np.concatenate([lobe[k] for lobe in lobes]).astype(np.float32) for k in range(3))
        layer_mean = np.array([average_fresnel(float(n), float(t)) for n, t in zip(ior, tint, strict=True)], np.float32)
        kept_mean = average_kept(lost.reshape(-1, _ENTRIES)).astype(np.float32)
        dielectric *= 1 + np.repeat(layer_mean, _ENTRIES) * lost
        diffuse = np.array([max(one.diffuse, _LEAST_SHARE) for one in materials], np.float32)
        below = 1 - np.repeat(np.minimum(layer / diffuse, 1), _ENTRIES) * dielectric
        dielectric *= np.repeat(layer, _ENTRIES)
        if coat:
            below *= 1 - coat.albedo * np.repeat(np.minimum(coat.share / diffuse, 1) / np.maximum(coat.share, _LEAST_SHARE), _ENTRIES)
            dielectric = coat.albedo + (1 - coat.albedo) * dielectric
        tables = lost, edge, dielectric, below
        return cls(surfaces, scene.tri_material, glossy, alpha, ior, layer, tint, metal, layer_mean, kept_mean, *tables, coat)

    def albedo_at(self, tri: IntArray, u: FloatArray, v: FloatArray, cosine: Float32) -> Float32:
        """(3, n): share of light from directions at a cosine (n,) with the normal that is reflected specularly."""
        material = gather(self.tri_material, tri)
        place = _find_place(material, cosine)
        edge, lost = _look_up(self.edge, *place), _look_up(self.lost, *place)
        color, share = self.surfaces.metal_at(tri, u, v).T, gather(self.metal, material)
        single: Float32 = color * (1 / (1 + lost) - edge) + share * edge
        if self.coat:
            single *= 1 - _look_up(self.coat.albedo, *place)
        return single * _give_back(color, share, lost, gather(self.kept_mean, material)) + _look_up(self.dielectric, *place)

    def below_layer(self, tri: IntArray, cosine: Float32) -> Float32:
        """(n,): share of diffuse light that leaves at a cosine (n,) with the normal, for what the layer reflects there is not below it."""
        return _look_up(self.below, *_find_place(gather(self.tri_material, tri), cosine))

    def reflect(
        self, tri: IntArray, u: FloatArray, v: FloatArray, direction: Float32, normal: Float32, numbers: Float32, of_light: bool = False
    ) -> tuple[Float32, Float32]:
        """Directions (3, n) of reflected rays and their weights (3, n), whose mean is albedo_at; 0 below the surface.

        direction   (3, n) float32, unit: along which rays arrive, from the side of their normals (3, n)
        numbers     (2, n) float32, uniform in [0, 1)
        of_light    the rays carry light rather than look for it. What is given back, and what a coat leaves, goes by the direction that is
                    looked from, as in Cycles, so the weights are those of the adjoint (Veach 1997, 3.7.6)
        """
        material = gather(self.tri_material, tri)
        alpha = gather(self.alpha, material)
        tangent, bitangent = (axis.T for axis in orthonormal_basis(normal.T))
        local = np.stack([-_dot(direction, axis) for axis in (tangent, bitangent, normal)])
        local[2] = np.maximum(local[2], _HAIR)
        if self.coat:
            place = _find_place(material, local[2])
            covered, above = _look_up(self.coat.albedo, *place), gather(self.coat.share, material)
            below = self.albedo_at(tri, u, v, local[2]).max(axis=0) - covered
            chance = covered / np.maximum(covered + np.maximum(below, 0), _HAIR)
            coats = numbers[0] < chance
            numbers = np.stack(
                [np.where(coats, numbers[0] / np.maximum(chance, _HAIR), (numbers[0] - chance) / np.maximum(1 - chance, _HAIR)), numbers[1]]
            )
            numbers[0] = np.clip(numbers[0], 0, 1 - _HAIR)
            alpha = np.where(coats, gather(self.coat.alpha, material), alpha)
        half = sample_visible_normals(local, alpha, numbers)
        cosine = np.clip(_dot(local, half), 0, 1)
        out = 2 * cosine * half - local
        edge: FloatArray = (1 - cosine) ** 5
        place = _find_place(material, np.maximum(out[2], 0) if of_light else local[2])
        lost = _look_up(self.lost, *place)
        color, share = self.surfaces.metal_at(tri, u, v).T, gather(self.metal, material)
        rgb: FloatArray = (color * (1 - edge) + share * edge) * _give_back(color, share, lost, gather(self.kept_mean, material))
        layer = gather(self.layer, material) * tinted_fresnel(cosine, gather(self.ior, material), gather(self.tint, material))
        rgb = rgb + layer * (1 + gather(self.layer_mean, material) * lost)
        if self.coat:
            own = (
                above
                * fresnel(cosine, gather(self.coat.ior, material))
                * (1 + gather(self.coat.mean, material) * _look_up(self.coat.lost, *place))
            )
            left = 1 - _look_up(self.coat.albedo, *place)
            rgb = np.where(coats, own / np.maximum(chance, _HAIR), rgb * left / np.where(coats, 1, 1 - chance))
        rgb = rgb * mask(local[2], out[2], alpha)
        turned = out[0] * tangent + out[1] * bitangent + out[2] * normal
        return turned.astype(np.float32), rgb.astype(np.float32)


def sample_visible_normals(view: FloatArray, alpha: FloatArray, numbers: FloatArray) -> FloatArray:
    """(3, n): normals of microfacets as seen from view (3, n), around +Z, with density G1 max(view . h, 0) D / view_z per steradian.

    alpha     (n,) float
    numbers   (2, n) float, uniform in [0, 1)
    Source: Heitz 2018, appendix A.
    """
    stretched = np.stack([alpha * view[0], alpha * view[1], view[2]])
    stretched /= np.sqrt(_dot(stretched, stretched))
    length = np.sqrt(stretched[0] ** 2 + stretched[1] ** 2)
    upright = length < 1e-7
    length = np.where(upright, 1, length)
    first = np.stack([np.where(upright, 1, -stretched[1] / length), np.where(upright, 0, stretched[0] / length), np.zeros_like(length)])
    second = np.cross(stretched, first, axis=0)
    radius, turn = np.sqrt(numbers[0]), 2 * np.pi * numbers[1]
    x, y = radius * np.cos(turn), radius * np.sin(turn)
    share = 0.5 * (1 + stretched[2])
    y = (1 - share) * np.sqrt(np.maximum(1 - x * x, 0)) + share * y
    half = x * first + y * second + np.sqrt(np.maximum(1 - x * x - y * y, 0)) * stretched
    out = np.stack([alpha * half[0], alpha * half[1], np.maximum(half[2], 1e-9)])
    unit: FloatArray = out / np.sqrt(_dot(out, out))
    return unit


def mask(cosine_in: FloatArray, cosine_out: FloatArray, alpha: FloatArray) -> FloatArray:
    """(n,): G2 / G1, the weight of a direction that reflection at a visible normal gives, without Fresnel; 0 below the surface.

    Source: Heitz 2018, eq. 19, with the height-correlated G2 of Heitz 2014.
    """
    into, out = shadow_term(cosine_in, alpha), shadow_term(np.maximum(cosine_out, 1e-6), alpha)
    return np.where(cosine_out > 0, (1 + into) / (1 + into + out), 0)


def fresnel(cosine: FloatArray, ior: FloatArray) -> FloatArray:
    """(n,): share of unpolarised light that a smooth dielectric reflects, met from outside at a cosine (n,).

    Source: Walter et al. 2007, eq. 22.
    """
    g = np.sqrt(np.maximum(ior * ior - 1 + cosine * cosine, 0))
    ratio = (g - cosine) / np.maximum(g + cosine, 1e-9)
    other = (cosine * (g + cosine) - 1) / (cosine * (g - cosine) + 1)
    out: FloatArray = 0.5 * ratio * ratio * (1 + other * other)
    return out


def tinted_fresnel(cosine: FloatArray, ior: FloatArray, tint: FloatArray) -> FloatArray:
    """(n,): the same of a layer whose reflection straight on is scaled by a tint (n,), and is whole at grazing angles nevertheless.

    Source: Hoffman 2019, "Fresnel equations considered harmful", with the exact equations for the way from straight on to grazing; as
    Cycles has the Principled BSDF's Specular Tint.
    """
    whole = fresnel(cosine, ior)
    straight_on = ((ior - 1) / (ior + 1)) ** 2
    grazing = np.maximum(whole - straight_on, 0) / np.maximum(1 - straight_on, 1e-6)
    out: FloatArray = tint * whole + (1 - tint) * grazing
    return out


@lru_cache(maxsize=1024)
def average_fresnel(ior: float, tint: float = 1.0) -> float:
    """Mean of tinted_fresnel over the hemisphere, for even light."""
    cosine = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    return float((2 * cosine * tinted_fresnel(cosine, np.full(_SAMPLES, ior), np.full(_SAMPLES, tint))).mean())


@lru_cache(maxsize=1024)
def tabulate_lobe(alpha: float, ior: float, tint: float = 1.0) -> tuple[Float64, Float64, Float64]:
    """(_ENTRIES,) each, by the cosine with the normal: 1 / E - 1; the mean of Schlick's (1 - cos)^5; and that of
    tinted_fresnel; both over the lobe, by single scattering.
    """
    cosine = np.repeat(np.maximum(np.linspace(0, 1, _ENTRIES) ** 2, 1e-5), _SAMPLES)
    index = np.arange(_SAMPLES)
    # Source: Rank-1 lattice by the golden ratio; Niederreiter 1992.
    numbers = np.stack([(index + 0.5) / _SAMPLES, index * 0.6180339887498949 % 1])
    numbers = np.tile(numbers, _ENTRIES)
    view = np.stack([np.sqrt(1 - cosine**2), np.zeros_like(cosine), cosine])
    half = sample_visible_normals(view, np.full_like(cosine, alpha), numbers)
    facing = np.clip(_dot(view, half), 0, 1)
    weight = mask(cosine, 2 * facing * half[2] - cosine, np.full_like(cosine, alpha))

    def mean(values: FloatArray) -> Float64:
        out: Float64 = values.reshape(_ENTRIES, _SAMPLES).mean(axis=1)
        return out

    albedo = mean(weight)
    reflected = tinted_fresnel(facing, np.full_like(cosine, ior), np.full_like(cosine, tint))
    return 1 / albedo - 1, mean(weight * (1 - facing) ** 5), mean(weight * reflected)


def average_kept(lost: FloatArray) -> FloatArray:
    """(n,): the mean over the hemisphere of E, of tables (n, _ENTRIES) of 1 / E - 1 by the root of the cosine."""
    root = np.linspace(0, 1, _ENTRIES)
    kept = 1 / (1 + lost) * (4 * root**3)  # 2 cos d cos
    out: FloatArray = ((kept[:, 1:] + kept[:, :-1]) * 0.5).sum(axis=1) / (_ENTRIES - 1)
    return np.minimum(out, 1)


def _give_back(color: FloatArray, share: FloatArray, lost: FloatArray, kept_mean: FloatArray) -> FloatArray:
    """(3, n): what multiple scattering adds to a metal's light, as a factor; color (3, n) is the share (n,) that is metal times its own.

    Each further scattering is tinted again: of F E' + F (1 - E') F E' + ... is left F E' / (1 - F (1 - E')), with the means F of Schlick's
    formula, F0 + (1 - F0) / 21, and E' of E.
    Source: Kulla & Conty 2017, "Revisiting physically based shading at Imageworks", as the factor of Turquin 2019, eq. 16.
    """
    own = np.divide(color, share, out=np.zeros_like(color), where=share > 0)
    own = np.minimum(own / np.float32(MAX_ALBEDO), 1)  # what the clamp takes of white is lost once, not at each scattering
    mean = own + (1 - own) / np.float32(21)
    out: FloatArray = 1 + mean * kept_mean / (1 - mean * (1 - kept_mean)) * lost
    return out


def shadow_term(cosine: FloatArray, alpha: FloatArray) -> FloatArray:
    """Smith's Lambda of GGX. Source: Walter et al. 2007, eq. 34; Heitz 2014, eq. 72."""
    tangent2 = np.maximum(1 / (cosine * cosine) - 1, 0)
    out: FloatArray = 0.5 * (np.sqrt(1 + alpha * alpha * tangent2) - 1)
    return out


def _find_place(material: IntArray, cosine: FloatArray) -> tuple[IntArray, FloatArray]:
    """Where materials' tables have a cosine (n,): the entry before it, and how far it is on the way to the next."""
    place = np.sqrt(np.minimum(np.abs(cosine), 1)) * (_ENTRIES - 1)
    before = np.minimum(place, _ENTRIES - 2).astype(np.intp)
    return material * _ENTRIES + before, place - before


def _look_up(table: Float32, before: IntArray, share: FloatArray) -> Float32:
    low = gather(table, before)
    out: Float32 = low + (gather(table, before + 1) - low) * share.astype(np.float32)
    return out


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    out: FloatArray = np.einsum("kn,kn->n", a, b)
    return out
