"""Albedo, emission and transmittance at hits."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..util.arrays import FloatArray, IntArray
from ..util.geometry import gather, locate_hits, triangle_frames
from .scene import MAX_ALBEDO, Material, SceneSnapshot
from .textures import Textures, clamp_colours, sample_texture

_MAX_EMISSION = float(np.finfo(np.float32).max)
_LEAST_TOLD = dict.fromkeys(("albedo", "metal", "translucency"), 2.0 - MAX_ALBEDO)  # white is 1; the loss is invisible
_PIXELS_OF_ROW = 64


@dataclass(frozen=True)
class _Layer:
    """One quantity of all surfaces: a colour per triangle times an optional image.

    tri_rgb      (3, n_tri) float32, already clamped where there is no image
    tri_image    (n_tri,) int32, -1 none; None when no triangle has one
    tri_uv       (3, 2, n_tri) float32: of triangle_frames; none without images
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
                with np.errstate(over="ignore", invalid="ignore"):  # what overflows is not finite, and so 0
                    shown = self.textures.at(gather(image, textured), locate_hits(self.tri_uv, tri, u, v).T)
                    product = clamp_colours(gather(rgb, textured) * shown.T, self.highest)
                for channel, values in zip(rgb, product, strict=True):  # numpy is three times as quick row by row
                    channel[textured] = values
        return rgb.T


class SurfaceMaterials:
    """Answers albedo, emission and transmittance at points of triangles; one gather where no image is involved."""

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
        seen = np.array([one.reflects for one in scene.objects], bool)
        self._tri_glass: NDArray[np.bool_] = of_glass[scene.tri_material] & seen[scene.tri_object]
        self._passing = _layer(scene, [m.passing_rgb for m in materials], [m.passing_image for m in materials], scene.tri_passing_uv, 1.0)
        self._shadow = self._passing
        if any(material.shadow_passing_rgb is not None for material in materials):
            shadow = [
                (m.passing_rgb, m.passing_image) if m.shadow_passing_rgb is None else (m.shadow_passing_rgb, m.shadow_passing_image)
                for m in materials
            ]
            self._shadow = _layer(scene, [rgb for rgb, _ in shadow], [image for _, image in shadow], scene.tri_passing_uv, 1.0)
        self._reflecting = self._albedo
        unseen = np.array([not one.reflects for one in scene.objects], bool)[scene.tri_object]
        if unseen.any():
            self._passing = replace(self._passing, **_fill(self._passing, unseen, 1.0))
            self._metal = replace(self._metal, **_fill(self._metal, unseen, 0.0))
            self._through = replace(self._through, **_fill(self._through, unseen, 0.0))
            self._reflecting = replace(self._albedo, **_fill(self._albedo, unseen, 0.0))
        self._tri_through: NDArray[np.bool_] = self._through.tri_rgb.any(axis=0)
        self.has_through = bool(self._tri_through.any())
        lets_shadow = np.array([not one.casts_shadow for one in scene.objects], bool)[scene.tri_object]
        if lets_shadow.any():
            self._shadow = replace(self._shadow, **_fill(self._shadow, lets_shadow, 1.0))

    def has_images(self, emission: bool) -> bool:
        """Whether the albedo, or the emission, of any triangle varies over it."""
        return (self._emission if emission else self._albedo).tri_image is not None

    @property
    def reflects(self) -> bool:
        """Whether any triangle reflects any light, or bends it."""
        return bool(self._reflecting.tri_rgb.any() or self._tri_glass.any())

    def albedo_at(self, tri: IntArray, u: FloatArray, v: FloatArray) -> NDArray[np.float32]:
        """Diffuse reflectance, within [0, MAX_ALBEDO].

        tri    (n,) int      u, v   (n,) float, barycentric weights of corners 1 and 2
        out    (n, 3) float32; its transpose is contiguous
        """
        return self._albedo.at(tri, u, v)

    def reflectance_at(self, tri: IntArray, u: FloatArray, v: FloatArray) -> NDArray[np.float32]:
        """Share of the light that arrives which other surfaces get: the albedo, but 0 on objects that they do not see; as albedo_at."""
        return self._reflecting.at(tri, u, v)

    def emission_at(self, tri: IntArray, u: FloatArray, v: FloatArray) -> NDArray[np.float32]:
        """Emitted radiance, W/m^2/sr, finite and >= 0.

        tri    (n,) int      u, v   (n,) float, barycentric weights of corners 1 and 2
        out    (n, 3) float32; its transpose is contiguous
        """
        return self._emission.at(tri, u, v)

    def metal_at(self, tri: IntArray, u: FloatArray, v: FloatArray) -> NDArray[np.float32]:
        """The part of reflectance_at that a metal reflects as a mirror does; as albedo_at."""
        return self._metal.at(tri, u, v)

    @property
    def has_lobe_images(self) -> bool:
        """Whether roughness or shares of any triangle vary over it."""
        return self._lobes.tri_image is not None

    def lobes_at(self, tri: IntArray, u: FloatArray, v: FloatArray) -> NDArray[np.float32]:
        """Roughness, and the shares of the surface that are metal and that have a dielectric layer, within [0, 1]; as albedo_at."""
        return self._lobes.at(tri, u, v)

    def through_at(self, tri: IntArray, u: FloatArray, v: FloatArray) -> NDArray[np.float32]:
        """The part of reflectance_at that leaves diffusely on the other side; as albedo_at."""
        return self._through.at(tri, u, v)

    def find_through(self) -> NDArray[np.bool_]:
        """(n_tri,) bool: triangles through which light leaves diffusely on the other side."""
        return self._tri_through

    def glass_at(self, tri: IntArray, u: FloatArray, v: FloatArray) -> NDArray[np.float32]:
        """Tint of light that glass refracts, times the share of the surface that is glass; as albedo_at."""
        return self._glass.at(tri, u, v)

    def find_glass(self) -> NDArray[np.bool_]:
        """(n_tri,) bool: triangles of glass that other surfaces see."""
        return self._tri_glass

    def passing_at(self, tri: IntArray, u: FloatArray, v: FloatArray, shadow: bool) -> NDArray[np.float32]:
        """Share of light that goes straight on through a surface, within [0, 1].

        tri      (n,) int      u, v   (n,) float, barycentric weights of corners 1 and 2
        shadow   for light on its way from a lamp, as shadow rays take it; else for light between surfaces
        out      (n, 3) float32; its transpose is contiguous
        """
        return (self._shadow if shadow else self._passing).at(tri, u, v)

    @property
    def has_two_passings(self) -> bool:
        """Whether anything lets another share of light pass from lamps than between surfaces."""
        return self._shadow is not self._passing

    def find_passing(self, shadow: bool) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """(n_tri,) bool: triangles that light may pass through, and those that it passes through whole, everywhere on them."""
        layer = self._shadow if shadow else self._passing
        passes, whole = layer.tri_rgb.any(axis=0), (layer.tri_rgb == 1).all(axis=0)
        return passes, whole if layer.tri_image is None else whole & (layer.tri_image < 0)

    def find_void(self) -> NDArray[np.bool_]:
        """(n_tri,) bool: triangles that light passes as if they were not there."""
        stops: NDArray[np.bool_] = self._reflecting.tri_rgb.any(axis=0) | self._tri_glass
        return ~stops & self.find_passing(shadow=True)[1] & self.find_passing(shadow=False)[1]


def clamp_warnings(scene: SceneSnapshot) -> list[tuple[str, str]]:
    """Values changed by albedo_at and emission_at: (material name, sentence)."""
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
    """Least and greatest (3,) of pixels (n, 3), n > 0; of many in a row numpy finds them ten times as quickly as of three numbers."""
    whole = len(pixels) // _PIXELS_OF_ROW * _PIXELS_OF_ROW
    parts = [pixels[:whole].reshape(-1, 3 * _PIXELS_OF_ROW), pixels[whole:].reshape(-1, 3)]
    ends = [[find(part, axis=0).reshape(-1, 3) for part in parts if len(part)] for find in (np.min, np.max)]
    return np.concatenate(ends[0]).min(axis=0), np.concatenate(ends[1]).max(axis=0)


def _fill(layer: _Layer, tri: NDArray[np.bool_], value: float) -> dict[str, Any]:
    """The arrays of a layer with one value on some triangles (n_tri,)."""
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
    with np.errstate(over="ignore", invalid="ignore"):  # as where they are used
        return _Layer(tri_rgb, tri_image, triangle_frames(tri_uv), Textures(scene.images), highest)
