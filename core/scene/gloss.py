"""Specular reflection: metals, a dielectric layer above diffuse surfaces, a clear coat above both, and sheen above all.

A material's lobe is GGX with Smith's height-correlated masking. A metal reflects its colour by Schlick's formula, a dielectric layer by the
exact Fresnel equations for its index of refraction. Energy that single scattering loses on rough surfaces is compensated: weights are
multiplied by 1 + F (1 / E - 1), where E is the lobe's albedo without Fresnel and F the reflectance for multiply scattered light. F is the
mean Fresnel reflectance over the hemisphere for a layer, and less for a metal, see _give_back. Materials that scatter only once (Blender's
distribution GGX, which files from before Blender 4.0 have) are not compensated. A layer reduces the diffuse light below it by its albedo in
the outgoing direction; with single scattering it also takes the energy that the lobe loses, as in Cycles. A coat is a second dielectric
layer with a lobe of its own, which reduces everything below it by its albedo.

Lobes are tabulated in rows: one for each material, or one for each level of roughness if an image sets the roughness.

Source: Walter et al. 2007, "Microfacet models for refraction through rough surfaces"; Heitz 2018, "Sampling the GGX distribution of
visible normals"; Heitz 2014, "Understanding the masking-shadowing function", eq. 99; Turquin 2019, "Practical multiple scattering
compensation for microfacet models"; Schlick 1994; Kutz, Hasan & Edmondson 2021, "Novel aspects of the Adobe Standard Material" (a metal's
tint at the edge).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from ..util.arrays import BoolArray, Float32, Float64, FloatArray, Int32, IntArray
from ..util.geometry import gather
from . import ggx
from .ggx import ENTRIES, LEAST_COSINE
from .materials import SurfaceMaterials
from .scene import MAX_ALBEDO, Material, SceneSnapshot
from .sheen import average_sheen, evaluate_sheen, sample_sheen, tabulate_sheen

_SAMPLES = 2048  # per entry
_LEAST_SHARE = 1e-6  # of a surface
_LEVELS = 16  # steps of roughness from 0 to 1 in images
_LEVEL_SAMPLES = 512
EDGE_COSINE = 1 / 7  # where a metal's edge tint applies in full: cos (1 - cos)^6 is greatest there
_EDGE = (1 - EDGE_COSINE) ** 5


@dataclass(frozen=True)
class Coat:
    """The coats of all rows of tables.

    alpha, ior, share   (n_row,) float32: as in Gloss for the layer
    mean                (n_row,) float32: mean Fresnel reflectance
    lost                (n_row, ENTRIES) float32: as in Gloss
    albedo              likewise: albedo of the coat times its share of the surface
    tint                (3, n_row) float32: as in Material; None if all are white
    """

    alpha: Float32
    ior: Float32
    share: Float32
    mean: Float32
    lost: Float32
    albedo: Float32
    tint: Float32 | None

    @classmethod
    def of(cls, rows: Sequence[Material]) -> Coat | None:
        """None if no row has a coat."""
        share = np.array([one.coat for one in rows], np.float32)
        if not share.any():
            return None
        alpha = np.array([max(one.coat_roughness**2, ggx.LEAST_ALPHA) for one in rows], np.float32)
        ior = np.array([max(one.coat_ior, 1.0) for one in rows], np.float32)
        lost, _, _, albedo = ggx.stack_tables([tabulate_lobe(float(a), float(n)) for a, n in zip(alpha, ior, strict=True)])
        mean = np.array([average_fresnel(float(n)) for n in ior], np.float32)
        albedo *= share[:, None] * (1 + mean[:, None] * lost)
        tint = np.clip(np.array([one.coat_tint_rgb for one in rows], np.float32).T, 0, 1)
        return cls(alpha, ior, share, mean, lost, albedo, None if (tint == 1).all() else tint)


@dataclass(frozen=True)
class Sheen:
    """The sheen of all rows of tables.

    rgb        (3, n_row) float32: share of the surface that has sheen, times its tint
    mean_rgb   (3, n_row) float32: its reflectance for even light, which the material's albedo contains
    a, b       (n_row, ENTRIES) float32: parameters of the lobe, by the cosine of the view direction; see sheen
    albedo     likewise: albedo of white sheen
    under      likewise: transmittance to what is below, relative to that for even light, which the material's colours contain
    """

    rgb: Float32
    mean_rgb: Float32
    a: Float32
    b: Float32
    albedo: Float32
    under: Float32

    @classmethod
    def of(cls, rows: Sequence[Material]) -> Sheen | None:
        """None if no row has sheen."""
        rgb = np.clip(np.array([one.sheen_rgb for one in rows], np.float32), 0, 1).T
        if not rgb.any():
            return None
        mean = np.array([average_sheen(one.sheen_roughness) for one in rows], np.float32)
        a, b, albedo = ggx.stack_tables([tabulate_sheen(one.sheen_roughness, ENTRIES) for one in rows])
        most = rgb.max(axis=0)
        other = np.array([one.diffuse + (one.metal if any(one.metal_rgb) else 0.0) for one in rows], np.float32)
        covered = np.minimum(most / np.maximum(other + most * mean, _LEAST_SHARE), 1)
        under = (1 - covered[:, None] * albedo) / (1 - covered * mean)[:, None]
        return cls(rgb, rgb * mean, a, b, albedo, under)


@dataclass(frozen=True)
class RoughnessRows:
    """Rows of the tables by material.

    materials      the material of each row, with the row's roughness
    first          (n_material,) int32: row of the least level of roughness
    least, most    (n_material,) int32: levels of roughness; 0 for a material of uniform roughness
    """

    materials: tuple[Material, ...]
    first: Int32
    least: Int32
    most: Int32

    @classmethod
    def of(cls, scene: SceneSnapshot) -> RoughnessRows:
        rows: list[Material] = []
        first, levels = [], []
        for material in scene.materials:
            first.append(len(rows))
            if material.lobe_image < 0:
                levels.append((0, 0))
                rows.append(material)
                continue
            image = scene.images[material.lobe_image]
            rough = image.pixels[..., 0] if image.pixels.size else np.zeros(1, np.float32)
            ends = np.nan_to_num(np.array([rough.min(), rough.max()]))
            least, most = np.rint(np.clip(ends, 0, 1) * _LEVELS).astype(int).tolist()
            levels.append((least, most))
            steps = [level / _LEVELS for level in range(least, most + 1)]
            rows += [replace(material, roughness=step, glass_roughness=step) for step in steps]
        least, most = np.array(levels, np.int32).reshape(-1, 2).T
        return cls(tuple(rows), np.array(first, np.int32), least, most)

    def find(self, material: Int32, rough: Float32) -> Int32:
        """(n,): rows of materials (n,) where images have a roughness (n,)."""
        least = gather(self.least, material)
        level = np.clip(np.rint(rough * np.float32(_LEVELS)).astype(np.int32), least, gather(self.most, material))
        return gather(self.first, material) + level - least


@dataclass(frozen=True)
class Gloss:
    """The specular lobes of a scene's materials.

    tri_material   (n_tri,) int32
    tri_glossy     (n_tri,) bool
    rows           rows of the tables
    alpha          (n_row,) float32: roughness squared
    ior            (n_row,) float32: of the dielectric layer
    layer          (n_row,) float32: share of the surface that has a layer
    tint           (n_row,) float32: tint of the layer's reflection at normal incidence
    metal          (n_row,) float32: share of the surface that is metal
    layer_mean     (n_row,) float32: mean Fresnel reflectance of the layer
    kept_mean      (n_row,) float32: mean of E over the hemisphere
    rising         (n_row,) float32: 1 if a metal's reflectance rises to the edge by Schlick's formula, 0 if it is constant
    lost           (n_row, ENTRIES) float32: 1 / E - 1, by the cosine with the normal
    restored       likewise, but 0 for materials that scatter only once
    edge           likewise: albedo of a black metal, which Schlick's formula makes reflect at the edges, by single scattering
    dielectric     likewise: albedo of the layer
    below          likewise: transmittance of layer and coat for diffuse light, averaged over covered and uncovered parts
    dip            likewise: mean of cos (1 - cos)^6 over the lobe, by which an edge tint reduces Schlick's formula
    dip_rgb        (3, n_row) float32: factor of that reduction, relative to the reflectance at the edge; None if no metal has an edge tint
    coat           None if no material has a coat
    sheen          None if no material has sheen
    """

    surfaces: SurfaceMaterials
    tri_material: Int32
    tri_glossy: BoolArray
    rows: RoughnessRows
    alpha: Float32
    ior: Float32
    layer: Float32
    tint: Float32
    metal: Float32
    layer_mean: Float32
    kept_mean: Float32
    rising: Float32
    lost: Float32
    restored: Float32
    edge: Float32
    dielectric: Float32
    below: Float32
    dip: Float32
    dip_rgb: Float32 | None
    coat: Coat | None
    sheen: Sheen | None

    @classmethod
    def of(cls, scene: SceneSnapshot, surfaces: SurfaceMaterials) -> Gloss | None:
        """None if no surface reflects specularly."""
        shiny = np.array(
            [one.layer > 0 or (one.metal > 0 and any(one.metal_rgb)) or one.coat > 0 or any(one.sheen_rgb) for one in scene.materials], bool
        )
        reflects = np.array([any(one.seen_by) for one in scene.objects], bool)[scene.tri_object]
        glossy = shiny[scene.tri_material] & reflects
        if not glossy.any():
            return None
        found = RoughnessRows.of(scene)
        rows = found.materials
        layer = np.array([one.layer for one in rows], np.float32)
        metal = np.array([one.metal if any(one.metal_rgb) else 0.0 for one in rows], np.float32)
        coat = Coat.of(rows)
        alpha = np.array([max(one.roughness**2, ggx.LEAST_ALPHA) for one in rows], np.float32)
        ior = np.array([max(one.ior, 1.0) for one in rows], np.float32)
        tint = np.array([one.layer_tint for one in rows], np.float32)
        samples = [_SAMPLES if one.lobe_image < 0 else _LEVEL_SAMPLES for one in rows]
        lobes = [tabulate_lobe(float(a), float(n), float(t), k) for a, n, t, k in zip(alpha, ior, tint, samples, strict=True)]
        lost, edge, dip, dielectric = ggx.stack_tables(lobes)
        rising = np.array([not one.metal_flat for one in rows], np.float32)
        edge *= rising[:, None]
        layer_mean = np.array([average_fresnel(float(n), float(t)) for n, t in zip(ior, tint, strict=True)], np.float32)
        kept_mean = average_kept(lost).astype(np.float32)
        is_restored = np.array([one.multiscatter for one in rows], bool)[:, None]
        restored = np.where(is_restored, lost, np.float32(0))
        # With single scattering the layer also takes the energy that its lobe loses from the diffuse light.
        covered = dielectric * np.where(is_restored, 1 + layer_mean[:, None] * restored, 1 + lost)
        dielectric *= 1 + layer_mean[:, None] * restored
        diffuse = np.array([max(one.diffuse, _LEAST_SHARE) for one in rows], np.float32)
        below = 1 - np.minimum(layer / diffuse, 1)[:, None] * covered
        if coat:
            below *= 1 - coat.albedo * (np.minimum(coat.share / diffuse, 1) / np.maximum(coat.share, _LEAST_SHARE))[:, None]
        sheen = Sheen.of(rows)
        if sheen:
            below *= sheen.under
        at_edge = 1 - np.clip(np.array([one.metal_edge_rgb for one in rows], np.float32), 0, 1).T
        dip_rgb = at_edge / np.float32(EDGE_COSINE * _EDGE * (1 - EDGE_COSINE)) if at_edge.any() else None
        means = alpha, ior, layer, tint, metal, layer_mean, kept_mean, rising
        return cls(surfaces, scene.tri_material, glossy, found, *means, lost, restored, edge, dielectric, below, dip, dip_rgb, coat, sheen)

    def find_diffuse(self, tri: IntArray, u: FloatArray, v: FloatArray, albedo: Float32) -> tuple[Float32, Int32]:
        """(3, n): the part of an albedo (3, n) that is reflected diffusely; and (n,): rows of the tables."""
        row = self._find_lobes(tri, u, v)[0]
        left = albedo - self.surfaces.metal.at(tri, u, v).T
        if self.sheen:
            left -= gather(self.sheen.mean_rgb, row)
        return np.maximum(left, 0, out=left), row

    def find_rows(self, tri: IntArray, u: FloatArray, v: FloatArray) -> Int32:
        """(n,): rows of the tables at points of triangles."""
        return self._find_lobes(tri, u, v)[0]

    def _find_lobes(self, tri: IntArray, u: FloatArray, v: FloatArray) -> tuple[Int32, Float32, Float32]:
        """(n,) each: rows of the tables, and the shares of the surface that are metal and that have a layer."""
        material, rows = gather(self.tri_material, tri), self.rows
        if not self.surfaces.lobes.has_images:
            row = gather(rows.first, material)
            return row, gather(self.metal, row), gather(self.layer, row)
        rough, metal, layer = self.surfaces.lobes.at(tri, u, v).T
        row = rows.find(material, rough)
        return row, metal * (gather(self.metal, row) > 0), layer

    def _find_dip(self, row: IntArray, color: Float32, share: Float32) -> Float32 | None:
        """(3, n): factors of cos (1 - cos)^6 by which metals reflect less than by Schlick's formula; None if no metal does."""
        if self.dip_rgb is None:
            return None
        return (color * np.float32(1 - _EDGE) + share * np.float32(_EDGE)) * gather(self.dip_rgb, row)

    def albedo_at(self, tri: IntArray, u: FloatArray, v: FloatArray, cosine: Float32) -> Float32:
        """(3, n): specular albedo for directions at a cosine (n,) with the normal."""
        row, share, layer = self._find_lobes(tri, u, v)
        place = ggx.find_place(row, cosine)
        edge, lost = ggx.look_up(self.edge, *place), ggx.look_up(self.lost, *place)
        color = self.surfaces.metal.at(tri, u, v).T
        dip = self._find_dip(row, color, share)
        single: Float32 = color * (1 / (1 + lost) - edge) + share * edge
        if dip is not None:
            single = np.maximum(single - dip * ggx.look_up(self.dip, *place), 0)
        restored = ggx.look_up(self.restored, *place)
        single = single * _give_back(color, share, dip, restored, gather(self.kept_mean, row), gather(self.rising, row))
        out: Float32 = single + layer * ggx.look_up(self.dielectric, *place)
        if self.coat:
            covered = ggx.look_up(self.coat.albedo, *place)
            out = covered + (1 - covered) * out
        if self.sheen:
            out = out * ggx.look_up(self.sheen.under, *place) + gather(self.sheen.rgb, row) * ggx.look_up(self.sheen.albedo, *place)
        return out

    def below_layer(self, row: IntArray, cosine: Float32) -> Float32:
        """(n,): share of the diffuse light that layer, coat and sheen let out at a cosine (n,) with the normal.

        row   (n,), from find_rows
        """
        return ggx.look_up(self.below, *ggx.find_place(row, cosine))

    def below_coat(self, tri: IntArray, u: FloatArray, v: FloatArray, cosine: Float32) -> Float32 | None:
        """(n,): transmittance of the coat above glass at a view cosine (n,) with the normal; None if nothing has a coat."""
        return None if self.coat is None else 1 - ggx.look_up(self.coat.albedo, *ggx.find_place(self.find_rows(tri, u, v), cosine))

    def tint_below_coat(self, tri: IntArray, u: FloatArray, v: FloatArray, cosine: Float32) -> Float32 | None:
        """(3, n): factor by which a coat's tint, seen at a cosine (n,), colours glass more or less than on its mean path; None for none."""
        if self.coat is None or self.coat.tint is None:
            return None
        row = self.find_rows(tri, u, v)
        tint, share, ior = gather(self.coat.tint, row), gather(self.coat.share, row), gather(self.coat.ior, row)
        ior = np.maximum(ior, 1 + LEAST_COSINE)
        path = 1 / np.sqrt(1 - (1 - np.minimum(cosine, 1) ** 2) / ior**2)
        return tint_by_coat(tint, share, path) / np.maximum(tint_by_coat(tint, share, find_mean_path(ior)), LEAST_COSINE)

    def reflect(
        self, tri: IntArray, u: FloatArray, v: FloatArray, direction: Float32, normal: Float32, numbers: Float32, of_light: bool = False
    ) -> tuple[Float32, Float32]:
        """Directions (3, n) of reflected rays and their weights (3, n), whose mean is albedo_at; 0 below the surface.

        direction   (3, n) float32, unit: directions in which rays arrive, from the side of their normals (3, n)
        numbers     (2, n) float32, uniform in [0, 1)
        of_light    whether the rays are photons. In Cycles the compensation, and the transmittance of coat and sheen, depend on the view
                    direction, which is then the outgoing one: the weights are those of the adjoint (Veach 1997, 3.7.6)
        """
        if not self.sheen:
            return self._reflect_solid(tri, u, v, direction, normal, numbers, of_light)
        sheen, row, cosine = self.sheen, self.find_rows(tri, u, v), np.maximum(-ggx.dot(direction, normal), LEAST_COSINE)
        own = gather(sheen.rgb, row) * ggx.look_up(sheen.albedo, *ggx.find_place(row, cosine))
        chance = own.max(axis=0) / np.maximum(self.albedo_at(tri, u, v, cosine).max(axis=0), LEAST_COSINE)
        chosen, numbers = _choose(chance, numbers)
        turned, rgb = self._reflect_solid(tri, u, v, direction, normal, numbers, of_light)
        seen = np.maximum(ggx.dot(turned, normal), 0) if of_light else cosine
        rgb *= ggx.look_up(sheen.under, *ggx.find_place(row, seen)) / np.where(chosen, 1, 1 - chance)
        at = chosen.nonzero()[0]
        turned[:, at], fibre = self._reflect_fibres(
            gather(row, at), gather(direction, at), gather(normal, at), gather(numbers, at), of_light
        )
        rgb[:, at] = fibre / gather(chance, at)
        return turned, rgb

    def _reflect_fibres(
        self, row: IntArray, direction: Float32, normal: Float32, numbers: Float32, of_light: bool
    ) -> tuple[Float32, FloatArray]:
        """As reflect, for sheen only."""
        sheen = self.sheen
        assert sheen
        axes = ggx.find_axes(normal)
        local = ggx.view_along(direction, axes)
        if of_light:  # cosine sampling, since the lobe is given for the view direction, which is the outgoing one here
            radius, turn = np.sqrt(numbers[0]), 2 * np.pi * numbers[1]
            out = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.sqrt(1 - numbers[0])])
            place = ggx.find_place(row, out[2])
            worth = np.pi * evaluate_sheen(out, local, ggx.look_up(sheen.a, *place), ggx.look_up(sheen.b, *place))
        else:
            place = ggx.find_place(row, local[2])
            out, worth = sample_sheen(local, ggx.look_up(sheen.a, *place), ggx.look_up(sheen.b, *place), numbers), np.ones(len(row))
        return ggx.turn_back(out, axes).astype(np.float32), gather(sheen.rgb, row) * (ggx.look_up(sheen.albedo, *place) * worth)

    def _reflect_solid(
        self, tri: IntArray, u: FloatArray, v: FloatArray, direction: Float32, normal: Float32, numbers: Float32, of_light: bool
    ) -> tuple[Float32, Float32]:
        """As reflect, for everything but sheen."""
        row, share, layer = self._find_lobes(tri, u, v)
        alpha = gather(self.alpha, row)
        axes = ggx.find_axes(normal)
        local = ggx.view_along(direction, axes)
        if self.coat:
            place = ggx.find_place(row, local[2])
            covered, above = ggx.look_up(self.coat.albedo, *place), gather(self.coat.share, row)
            below = self.albedo_at(tri, u, v, local[2]).max(axis=0) - covered
            chance = covered / np.maximum(covered + np.maximum(below, 0), LEAST_COSINE)
            coats, numbers = _choose(chance, numbers)
            alpha = np.where(coats, gather(self.coat.alpha, row), alpha)
        half = ggx.sample_visible_normals(local, alpha, numbers)
        cosine = np.clip(ggx.dot(local, half), 0, 1)
        out = 2 * cosine * half - local
        rising = gather(self.rising, row)
        edge: FloatArray = rising * (1 - cosine) ** 5
        place = ggx.find_place(row, np.maximum(out[2], 0) if of_light else local[2])
        restored = ggx.look_up(self.restored, *place)
        color = self.surfaces.metal.at(tri, u, v).T
        dip = self._find_dip(row, color, share)
        rgb: FloatArray = color * (1 - edge) + share * edge
        if dip is not None:
            rgb = np.maximum(rgb - dip * (cosine * (1 - cosine) * edge), 0)
        rgb = rgb * _give_back(color, share, dip, restored, gather(self.kept_mean, row), rising)
        layer = layer * ggx.tinted_fresnel(cosine, gather(self.ior, row), gather(self.tint, row))
        rgb = rgb + layer * (1 + gather(self.layer_mean, row) * restored)
        if self.coat:
            again = 1 + gather(self.coat.mean, row) * ggx.look_up(self.coat.lost, *place)
            own = above * ggx.fresnel(cosine, gather(self.coat.ior, row)) * again
            left = 1 - ggx.look_up(self.coat.albedo, *place)
            rgb = np.where(coats, own / np.maximum(chance, LEAST_COSINE), rgb * left / np.where(coats, 1, 1 - chance))
        rgb = rgb * ggx.mask(local[2], out[2], alpha)
        return ggx.turn_back(out, axes).astype(np.float32), rgb.astype(np.float32)


def find_mean_path(ior: Any) -> Any:
    """Mean length of ways through a coat of thickness 1, for even light from all directions; ior a number or an array."""
    return 2 * ior**2 * (1 - np.sqrt(1 - 1 / ior**2))


def tint_by_coat(tint: FloatArray, share: Any, path: Any) -> FloatArray:
    """(3, ...): what a coat's tint (3, ...) leaves of light on a way of some length through it, where it covers a share of the surface."""
    return 1 - share + share * tint**path


def reflect_schlick(cosine: float, straight_on: FloatArray) -> FloatArray:
    """(n,): share of light that a metal reflects at a cosine, if it reflects straight_on (n,) at normal incidence."""
    return straight_on + (1 - straight_on) * (1 - cosine) ** 5


def reflect_conductor(cosine: float, ior: FloatArray, extinction: FloatArray) -> FloatArray:
    """(n,): share of unpolarised light that a conductor reflects at a cosine, by its index of refraction and extinction (n,).

    Source: Fresnel's equations; Born & Wolf, "Principles of optics", section 13.4.
    """
    eta = ior + 1j * extinction
    inside = np.sqrt(eta**2 - (1 - cosine**2))
    across, along = (cosine - inside) / (cosine + inside), (eta**2 * cosine - inside) / (eta**2 * cosine + inside)
    return 0.5 * (np.abs(across) ** 2 + np.abs(along) ** 2)


@lru_cache(maxsize=1024)
def average_fresnel(ior: float, tint: float = 1.0) -> float:
    """Cosine-weighted mean of tinted_fresnel over the hemisphere."""
    cosine = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    return float((2 * cosine * ggx.tinted_fresnel(cosine, np.full(_SAMPLES, ior), np.full(_SAMPLES, tint))).mean())


@lru_cache(maxsize=1024)
def tabulate_lobe(alpha: float, ior: float, tint: float = 1.0, samples: int = _SAMPLES) -> tuple[Float64, Float64, Float64, Float64]:
    """(ENTRIES,) each, by the cosine with the normal: 1 / E - 1, and the means over the lobe, by single scattering, of Schlick's
    (1 - cos)^5, of cos (1 - cos)^6 and of tinted_fresnel.
    """
    view, numbers = ggx.tabulated_views(ENTRIES, samples)
    cosine = view[2]
    half = ggx.sample_visible_normals(view, np.full_like(cosine, alpha), numbers)
    facing = np.clip(ggx.dot(view, half), 0, 1)
    weight = ggx.mask(cosine, 2 * facing * half[2] - cosine, np.full_like(cosine, alpha))

    def mean(values: FloatArray) -> Float64:
        return values.reshape(ENTRIES, samples).mean(axis=1)

    albedo, at_edge = mean(weight), weight * (1 - facing) ** 5
    reflected = ggx.tinted_fresnel(facing, np.full_like(cosine, ior), np.full_like(cosine, tint))
    return 1 / albedo - 1, mean(at_edge), mean(at_edge * facing * (1 - facing)), mean(weight * reflected)


def average_kept(lost: FloatArray) -> FloatArray:
    """(n,): cosine-weighted means of E over the hemisphere, from tables (n, ENTRIES) of 1 / E - 1."""
    root = np.linspace(0, 1, ENTRIES)
    kept = 1 / (1 + lost) * (4 * root**3)  # 2 cos d cos
    out: FloatArray = ((kept[:, 1:] + kept[:, :-1]) * 0.5).sum(axis=1) / (ENTRIES - 1)
    return np.minimum(out, 1)


def _give_back(
    color: FloatArray, share: FloatArray, dip: FloatArray | None, restored: FloatArray, kept_mean: FloatArray, rising: FloatArray
) -> FloatArray:
    """(3, n): factor by which multiple scattering increases a metal's reflection. color (3, n) is the metal's own times its share (n,) of
    the surface; dip (3, n), from _find_dip, likewise.

    Each scattering is tinted again, so F E' + F (1 - E') F E' + ... = F E' / (1 - F (1 - E')). F is the mean of Schlick's formula,
    F0 + (1 - F0) / 21, less dip / 126, or F0 itself where rising (n,) is 0; E' is the mean of E.
    Source: Kulla & Conty 2017, "Revisiting physically based shading at Imageworks", as the factor of Turquin 2019, eq. 16.
    """
    own = np.divide(color, share, out=np.zeros_like(color), where=share > 0)
    own = np.minimum(own / np.float32(MAX_ALBEDO), 1)  # the clamp of white counts once, not at each scattering
    mean = own + (1 - own) * (rising / np.float32(21))
    if dip is not None:
        mean = np.maximum(mean - np.divide(dip, share, out=np.zeros_like(dip), where=share > 0) / np.float32(126), 0)
    return 1 + mean * kept_mean / (1 - mean * (1 - kept_mean)) * restored


def _choose(chance: FloatArray, numbers: FloatArray) -> tuple[BoolArray, FloatArray]:
    """(n,) bool: whether the first of two options is chosen, with probabilities chance (n,); and (2, n): numbers (2, n) to use further."""
    first = numbers[0] < chance
    rest = np.where(first, numbers[0] / np.maximum(chance, LEAST_COSINE), (numbers[0] - chance) / np.maximum(1 - chance, LEAST_COSINE))
    return first, np.stack([np.clip(rest, 0, 1 - LEAST_COSINE), numbers[1]])
