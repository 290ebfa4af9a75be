"""Albedo, emission and transmittance at hits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..util.arrays import FloatArray, IntArray
from ..util.geometry import gather, locate_hits, triangle_frames, triangle_normals_areas
from .scene import DIFFUSE, GLOSSY, MAX_ALBEDO, RAY_KINDS, SEEN_BY_ALL, SHADOW, TRANSMISSION, Material, SceneSnapshot
from .textures import Textures, clamp_colours, sample_texture

_MAX_EMISSION = float(np.finfo(np.float32).max)
_LEAST_TOLD = dict.fromkeys(("albedo", "metal", "translucency"), 2.0 - MAX_ALBEDO)  # no warning for white: its clamp is invisible
_PIXELS_OF_ROW = 64


@dataclass(frozen=True)
class _Layer:
    """One quantity of all surfaces: a colour per triangle times an optional image.

    tri_rgb      (3, n_tri) float32, already clamped where there is no image
    tri_image    (n_tri,) int32, -1 for none; None if no triangle has one
    tri_uv       (3, 2, n_tri) float32: from triangle_frames; empty without images
    highest      upper limit of the product
    """

    tri_rgb: NDArray[np.float32]
    tri_image: NDArray[np.int32] | None
    tri_uv: NDArray[np.float32]
    textures: Textures
    highest: float

    def at(self, tri: IntArray, u: FloatArray, v: FloatArray) -> NDArray[np.float32]:
        rgb = gather(self.tri_rgb, tri)
        if self.tri_image is not None:
            image = gather(self.tri_image, tri)
            textured = (image >= 0).nonzero()[0]
            if len(textured):
                tri, u, v = gather(tri, textured), gather(u, textured), gather(v, textured)
                with np.errstate(over="ignore", invalid="ignore"):  # overflowing values are not finite, and count as 0
                    shown = self.textures.at(gather(image, textured), locate_hits(self.tri_uv, tri, u, v).T)
                    product = clamp_colours(gather(rgb, textured) * shown.T, self.highest)
                for channel, values in zip(rgb, product, strict=True):  # numpy is three times as fast row by row
                    channel[textured] = values
        return rgb.T


class SurfaceMaterials:
    """Albedo, emission and transmittance at points of triangles; a single gather where no image is involved.

    tri_seen   (3, 3, n_tri) float32: share of a surface's outgoing light that diffuse, glossy and transmission rays see, by channel; None
               if all see all
    by_kind    whether these kinds of rays between surfaces differ in any way
    """

    def __init__(self, scene: SceneSnapshot) -> None:
        materials = scene.materials
        self._albedo = _layer(
            scene, [m.albedo_rgb for m in materials], [m.albedo_image for m in materials], scene.tri_albedo_uv, MAX_ALBEDO
        )
        self._emission = _layer(
            scene, [m.emission_rgb for m in materials], [m.emission_image for m in materials], scene.tri_emission_uv, np.inf
        )
        self._metal = _layer(scene, [m.metal_rgb for m in materials], [m.metal_image for m in materials], scene.tri_metal_uv, MAX_ALBEDO)
        self._glass = _layer(scene, [m.glass_rgb for m in materials], [m.glass_image for m in materials], scene.tri_glass_uv, 1.0)
        self._through = _layer(
            scene, [m.through_rgb for m in materials], [m.through_image for m in materials], scene.tri_through_uv, MAX_ALBEDO
        )
        lobes = [(m.roughness, m.metal, m.layer) if m.lobe_image < 0 else (1.0, 1.0, 1.0) for m in materials]
        self._lobes = _layer(scene, lobes, [m.lobe_image for m in materials], scene.tri_lobe_uv, 1.0)
        of_glass = np.array([any(m.glass_rgb) or any(m.glass_mirror_rgb) for m in materials], bool)
        kinds = find_ray_kinds(materials)
        seen_by = np.array([[one.seen_by[kind] for one in scene.objects] for kind in kinds], bool)
        self._passing = _layer_passing(scene, kinds, seen_by)
        self.tri_seen = _find_seen(scene, kinds, seen_by)
        self.by_kind = self.tri_seen is not None or any(layer is not self._passing[DIFFUSE] for layer in self._passing[:SHADOW])
        self._reflecting = self._albedo
        unseen = ~seen_by.any(axis=0)[scene.tri_object]
        self._tri_glass: NDArray[np.bool_] = of_glass[scene.tri_material] & ~unseen
        if unseen.any():
            self._metal = replace(self._metal, **_fill(self._metal, unseen, 0.0))
            self._through = replace(self._through, **_fill(self._through, unseen, 0.0))
            self._reflecting = replace(self._albedo, **_fill(self._albedo, unseen, 0.0))
        back_rgb = np.array([one.back_rgb for one in materials], np.float32).reshape(-1, 3)
        self._tri_back = None if (back_rgb == 1).all() else np.ascontiguousarray(back_rgb[scene.tri_material].T)
        self._views = _Views.of(scene)
        self._tri_through: NDArray[np.bool_] = self._through.tri_rgb.any(axis=0)
        self.has_through = bool(self._tri_through.any())

    def has_images(self, emission: bool) -> bool:
        """Whether the albedo, or the emission, of any triangle varies over it."""
        return (self._emission if emission else self._albedo).tri_image is not None

    @property
    def reflects(self) -> bool:
        """Whether any triangle reflects or refracts light."""
        return bool(self._reflecting.tri_rgb.any() or self._tri_glass.any())

    def albedo_at(self, tri: IntArray, u: FloatArray, v: FloatArray) -> NDArray[np.float32]:
        """Diffuse reflectance, within [0, MAX_ALBEDO].

        tri    (n,) int      u, v   (n,) float, barycentric weights of corners 1 and 2
        out    (n, 3) float32; its transpose is contiguous
        """
        return self._albedo.at(tri, u, v)

    def reflectance_at(self, tri: IntArray, u: FloatArray, v: FloatArray) -> NDArray[np.float32]:
        """As albedo_at, but 0 on objects that rays between surfaces do not see: the share of light that other surfaces get."""
        return self._reflecting.at(tri, u, v)

    def emission_at(self, tri: IntArray, u: FloatArray, v: FloatArray) -> NDArray[np.float32]:
        """Emitted radiance, W/m^2/sr, finite and >= 0.

        tri    (n,) int      u, v   (n,) float, barycentric weights of corners 1 and 2
        out    (n, 3) float32; its transpose is contiguous
        """
        return self._emission.at(tri, u, v)

    def metal_at(self, tri: IntArray, u: FloatArray, v: FloatArray) -> NDArray[np.float32]:
        """The part of reflectance_at that a metal reflects specularly; arguments are as for albedo_at."""
        return self._metal.at(tri, u, v)

    @property
    def has_lobe_images(self) -> bool:
        """Whether roughness or shares vary over any triangle."""
        return self._lobes.tri_image is not None

    def lobes_at(self, tri: IntArray, u: FloatArray, v: FloatArray) -> NDArray[np.float32]:
        """(n, 3): roughness, and the shares of the surface that are metal and that have a dielectric layer, within [0, 1]."""
        return self._lobes.at(tri, u, v)

    def through_at(self, tri: IntArray, u: FloatArray, v: FloatArray) -> NDArray[np.float32]:
        """The part of reflectance_at that leaves diffusely on the other side; arguments are as for albedo_at."""
        return self._through.at(tri, u, v)

    def find_through(self) -> NDArray[np.bool_]:
        """(n_tri,) bool: translucent triangles, from which light leaves diffusely on the other side too."""
        return self._tri_through

    def glass_at(self, tri: IntArray, u: FloatArray, v: FloatArray) -> NDArray[np.float32]:
        """Tint of light that glass refracts, times the share of the surface that is glass; arguments are as for albedo_at."""
        return self._glass.at(tri, u, v)

    def find_glass(self) -> NDArray[np.bool_]:
        """(n_tri,) bool: triangles of glass that rays between surfaces see."""
        return self._tri_glass

    def dim_back(self, tri: IntArray, is_front: NDArray[np.bool_]) -> NDArray[np.float32] | None:
        """(3, n): factors on what triangles (n,) reflect of light on their fronts, is_front (n,), or backs; None where all are 1."""
        return None if self._tri_back is None else np.where(is_front, np.float32(1), gather(self._tri_back, tri))

    def passing_at(self, tri: IntArray, u: FloatArray, v: FloatArray, kind: int, toward: FloatArray) -> NDArray[np.float32]:
        """Share of light that goes straight on through a surface, within [0, 1].

        tri      (n,) int      u, v   (n,) float, barycentric weights of corners 1 and 2
        kind     SHADOW for light straight from a lamp; for light between surfaces the kind of ray in Cycles, which starts at the receiver
        toward   (3, n) float, unit: directions in which the light goes on
        out      (n, 3) float32; its transpose is contiguous
        """
        rgb = self._passing[kind].at(tri, u, v)
        return rgb if self._views is None else np.minimum(rgb.T * self._views.look_up(tri, toward), 1).T

    @property
    def has_two_passings(self) -> bool:
        """Whether the transmittance of any surface for light from lamps differs from that for diffuse rays between surfaces."""
        return self._passing[SHADOW] is not self._passing[DIFFUSE]

    def find_passing(self, kind: int) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """(n_tri,) bool each: triangles that light may pass through, and those that transmit all light everywhere."""
        layer = self._passing[kind]
        passes, whole = layer.tri_rgb.any(axis=0), (layer.tri_rgb == 1).all(axis=0)
        if self._views is not None:
            whole &= self._views.tri_row < 0
        return passes, whole if layer.tri_image is None else whole & (layer.tri_image < 0)

    def find_void(self) -> NDArray[np.bool_]:
        """(n_tri,) bool: triangles that have no effect on light."""
        void: NDArray[np.bool_] = ~(self._reflecting.tri_rgb.any(axis=0) | self._tri_glass)
        for kind in RAY_KINDS:
            void &= self.find_passing(kind)[1]
        return void


@dataclass(frozen=True)
class _Views:
    """Transmittances that differ by the direction to the viewer: Material.passing_views.

    tri_row   (n_tri,) int32: row of `factor`, -1 for none
    normal    (3, n_tri) float32, unit
    factor    (n_row, 2, k) float32
    """

    tri_row: NDArray[np.int32]
    normal: NDArray[np.float32]
    factor: NDArray[np.float32]

    @classmethod
    def of(cls, scene: SceneSnapshot) -> _Views | None:
        """None if no material has any."""
        has = np.array([bool(one.passing_views) for one in scene.materials], bool)
        if not has[scene.tri_material].any():
            return None
        row = np.where(has, np.cumsum(has) - 1, -1).astype(np.int32)
        factor = np.array([one.passing_views for one in scene.materials if one.passing_views], np.float32)
        normal = np.ascontiguousarray(triangle_normals_areas(scene.tri_position)[0].T, np.float32)
        return cls(row[scene.tri_material], normal, factor)

    def look_up(self, tri: IntArray, toward: FloatArray) -> NDArray[np.float32]:
        """(n,): factors of triangles (n,) for light that goes on in directions (3, n), unit."""
        row = gather(self.tri_row, tri)
        cosine = np.einsum("kn,kn->n", gather(self.normal, tri), toward)
        last = self.factor.shape[2] - 1
        place = np.minimum(np.abs(cosine), 1) * last
        low = np.minimum(place.astype(np.intp), last - 1)
        of_side = self.factor[row, (cosine > 0).astype(np.intp)]
        every = np.arange(len(row))
        below, above = of_side[every, low], of_side[every, low + 1]
        return np.where(row < 0, np.float32(1), below + (above - below) * (place - low)).astype(np.float32)


def find_ray_kinds(materials: Sequence[Material]) -> tuple[int, int, int]:
    """DIFFUSE, GLOSSY and TRANSMISSION; DIFFUSE replaces kinds of rays that no material sends."""
    bends = any(any(one.glass_rgb) for one in materials)
    shines = bends or any(
        one.layer > 0 or one.coat > 0 or any(one.metal_rgb) or any(one.sheen_rgb) or any(one.glass_mirror_rgb) for one in materials
    )
    return DIFFUSE, GLOSSY if shines else DIFFUSE, TRANSMISSION if bends else DIFFUSE


def _layer_passing(scene: SceneSnapshot, kinds: tuple[int, int, int], seen_by: NDArray[np.bool_]) -> list[_Layer]:
    """Transmittances for the kinds of rays between surfaces, and for shadow rays; equal ones are the same object.

    seen_by   (3, n_object) bool
    """

    def make(name: str) -> _Layer:
        of_kind = [
            (one.passing_rgb, one.passing_image)
            if getattr(one, f"{name}passing_rgb") is None
            else (getattr(one, f"{name}passing_rgb"), getattr(one, f"{name}passing_image"))
            for one in scene.materials
        ]
        return _layer(scene, [rgb for rgb, _ in of_kind], [image for _, image in of_kind], scene.tri_passing_uv, 1.0)

    def open_for(layer: _Layer, unseen: NDArray[np.bool_]) -> _Layer:
        return replace(layer, **_fill(layer, unseen[scene.tri_object], 1.0)) if unseen.any() else layer

    plain = make("")
    layers = [open_for(plain, ~seen_by[DIFFUSE])]
    for kind, name in ((GLOSSY, "glossy_"), (TRANSMISSION, "transmission_")):
        differs = any(getattr(one, f"{name}passing_rgb") is not None for one in scene.materials)
        if kinds[kind] == DIFFUSE or not (differs or (seen_by[kind] != seen_by[DIFFUSE]).any()):
            layers.append(layers[DIFFUSE])
        else:
            layers.append(open_for(make(name) if differs else plain, ~seen_by[kind]))
    shadowless = np.array([not one.casts_shadow for one in scene.objects], bool)
    differs = any(one.shadow_passing_rgb is not None for one in scene.materials)
    if not differs and np.array_equal(shadowless, ~seen_by[DIFFUSE]):
        return [*layers, layers[DIFFUSE]]
    return [*layers, open_for(make("shadow_") if differs else plain, shadowless)]


def _find_seen(scene: SceneSnapshot, kinds: tuple[int, int, int], seen_by: NDArray[np.bool_]) -> NDArray[np.float32] | None:
    """SurfaceMaterials.tri_seen; 1 for objects that no ray sees, whose reflectance is 0 already."""
    partly = seen_by.any(axis=0) & ~seen_by.all(axis=0)
    if not partly.any() and all(one.seen_rgb == SEEN_BY_ALL for one in scene.materials):
        return None
    of_material = np.array([[one.seen_rgb[kind] for kind in kinds] for one in scene.materials], np.float32).transpose(1, 2, 0)
    seen: NDArray[np.float32] = of_material[..., scene.tri_material]
    seen[:, :, partly[scene.tri_object]] *= seen_by[:, None, scene.tri_object][:, :, partly[scene.tri_object]]
    return None if (seen == 1).all() else np.ascontiguousarray(seen)


def clamp_warnings(scene: SceneSnapshot) -> list[tuple[str, str]]:
    """(material name, sentence) for each value that is clamped."""
    return [(material.name, text) for index, material in enumerate(scene.materials) for text in _material_warnings(scene, index, material)]


def _material_warnings(scene: SceneSnapshot, index: int, material: Material) -> list[str]:
    sentences = []
    for quantity, rgb, image, tri_uv, highest in (
        ("albedo", material.albedo_rgb, material.albedo_image, scene.tri_albedo_uv, MAX_ALBEDO),
        ("emission", material.emission_rgb, material.emission_image, scene.tri_emission_uv, _MAX_EMISSION),
        ("metal", material.metal_rgb, material.metal_image, scene.tri_metal_uv, MAX_ALBEDO),
        ("glass", material.glass_rgb, material.glass_image, scene.tri_glass_uv, 1.0),
        ("translucency", material.through_rgb, material.through_image, scene.tri_through_uv, MAX_ALBEDO),
        ("transmittance", material.passing_rgb, material.passing_image, scene.tri_passing_uv, 1.0),
    ):
        low, high = (np.array(rgb, np.float64),) * 2
        where = ""
        if image >= 0:
            picture = scene.images[image]
            shown = sample_texture(picture, tri_uv[scene.tri_material == index].reshape(-1, 2)) if picture.per_triangle else picture.pixels
            with np.errstate(invalid="ignore"):  # 0 times infinity is reported as not finite
                ends = [low * end.astype(np.float64) for end in _find_ends(shown.reshape(-1, 3))] if shown.size else [low * 0]
            low, high = np.min(ends, axis=0), np.max(ends, axis=0)
            where = f" with {'' if picture.per_triangle else 'image '}{picture.name}"
        if not (np.isfinite(low).all() and np.isfinite(high).all()):
            sentences.append(f"{material.name}: its {quantity}{where} is not a finite number and counts as 0; correct the value.")
        elif low.min() < 0 or high.max() > _LEAST_TOLD.get(quantity, highest):
            sentences.append(
                f"{material.name}: its {quantity}{where} reaches from {low.min():.4g} to {high.max():.4g} and is clamped to "
                f"0 ... {highest:.4g}; choose values within."
            )
    return sentences


def _find_ends(pixels: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Least and greatest (3,) of pixels (n, 3), n > 0; numpy is ten times as fast on rows of many pixels as on three numbers."""
    whole = len(pixels) // _PIXELS_OF_ROW * _PIXELS_OF_ROW
    parts = [pixels[:whole].reshape(-1, 3 * _PIXELS_OF_ROW), pixels[whole:].reshape(-1, 3)]
    ends = [[find(part, axis=0).reshape(-1, 3) for part in parts if len(part)] for find in (np.min, np.max)]
    return np.concatenate(ends[0]).min(axis=0), np.concatenate(ends[1]).max(axis=0)


def _fill(layer: _Layer, tri: NDArray[np.bool_], value: float) -> dict[str, Any]:
    """The arrays of a layer with one value on triangles tri (n_tri,) bool."""
    image = None if layer.tri_image is None else np.where(tri, np.int32(-1), layer.tri_image)
    return {"tri_rgb": np.where(tri, np.float32(value), layer.tri_rgb), "tri_image": image}


def _layer(
    scene: SceneSnapshot, rgb: list[tuple[float, float, float]], image: list[int], tri_uv: NDArray[np.float32], highest: float
) -> _Layer:
    with np.errstate(over="ignore"):
        material_rgb = np.array(rgb, np.float64).reshape(-1, 3).astype(np.float32)
    material_image = np.array(image, np.int32)
    plain = material_image < 0
    material_rgb[plain] = clamp_colours(material_rgb[plain], highest)
    tri_image = material_image[scene.tri_material]
    tri_rgb = np.ascontiguousarray(material_rgb[scene.tri_material].T)
    if not (tri_image >= 0).any():
        return _Layer(tri_rgb, None, np.zeros((3, 2, 0), np.float32), Textures([]), highest)
    with np.errstate(over="ignore", invalid="ignore"):  # as in _Layer.at
        return _Layer(tri_rgb, tri_image, triangle_frames(tri_uv), Textures(scene.images), highest)
