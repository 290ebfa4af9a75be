"""Albedo and emission at hits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from .geometry import gather
from .scene import MAX_ALBEDO, FloatArray, IntArray, Material, SceneSnapshot, TextureImage

_PERIODS = {"REPEAT": 1.0, "MIRROR": 2.0}  # in UV, by extension
_Wrapped: TypeAlias = tuple[IntArray, NDArray[np.bool_] | np.bool_]  # numbers of texels, and whether they are shown


@dataclass(frozen=True)
class _Layer:
    """One quantity of all surfaces: a colour per triangle times an optional image.

    tri_rgb      (3, n_tri) float32, already clamped where there is no image
    tri_image    (n_tri,) int32, -1 none; None when no triangle has one
    tri_uv       (3, 2, n_tri) float32: corner, axis; none without images
    highest      upper limit of the product
    """

    tri_rgb: NDArray[np.float32]
    tri_image: NDArray[np.int32] | None
    tri_uv: NDArray[np.float32]
    images: tuple[TextureImage, ...]
    highest: float

    def at(self, tri: IntArray, u: FloatArray, v: FloatArray) -> NDArray[np.float32]:
        rgb = gather(self.tri_rgb, tri)
        if self.tri_image is not None:
            hit_image = gather(self.tri_image, tri)
            for index in np.bincount(hit_image + 1)[1:].nonzero()[0]:
                rows = (hit_image == index).nonzero()[0]
                corner, s, t = gather(self.tri_uv, gather(tri, rows)), gather(u, rows), gather(v, rows)
                uv = (corner[0] * (1 - s - t) + corner[1] * s + corner[2] * t).T
                with np.errstate(over="ignore", invalid="ignore"):  # what overflows is not finite, and so 0
                    product = _clamp(gather(rgb, rows) * sample_texture(self.images[index], uv).T, self.highest)
                for channel, values in zip(rgb, product, strict=True):  # numpy is three times as quick row by row
                    channel[rows] = values
        return rgb.T


class SurfaceMaterials:
    """Answers albedo and emission at points of triangles; one gather where no image is involved."""

    def __init__(self, scene: SceneSnapshot) -> None:
        materials = scene.materials
        self._albedo = _layer(
            scene, [m.albedo_rgb for m in materials], [m.albedo_image for m in materials], scene.tri_albedo_uv, MAX_ALBEDO
        )
        self._emission = _layer(
            scene, [m.emission_rgb for m in materials], [m.emission_image for m in materials], scene.tri_emission_uv, np.inf
        )

    def has_images(self, emission: bool) -> bool:
        """Whether the albedo, or the emission, of any triangle varies over it."""
        return (self._emission if emission else self._albedo).tri_image is not None

    @property
    def reflects(self) -> bool:
        """Whether any triangle reflects any light."""
        return bool(self._albedo.tri_rgb.any())

    def albedo_at(self, tri: IntArray, u: FloatArray, v: FloatArray) -> NDArray[np.float32]:
        """Diffuse reflectance, within [0, MAX_ALBEDO].

        tri    (n,) int      u, v   (n,) float, barycentric weights of corners 1 and 2
        out    (n, 3) float32; its transpose is contiguous
        """
        return self._albedo.at(tri, u, v)

    def emission_at(self, tri: IntArray, u: FloatArray, v: FloatArray) -> NDArray[np.float32]:
        """Emitted radiance, W/m^2/sr, finite and >= 0.

        tri    (n,) int      u, v   (n,) float, barycentric weights of corners 1 and 2
        out    (n, 3) float32; its transpose is contiguous
        """
        return self._emission.at(tri, u, v)


def sample_texture(image: TextureImage, uv: FloatArray) -> NDArray[np.float32]:
    """Colours of an image; texel (x, y) has its centre at ((x + 0.5) / width, (y + 0.5) / height), as in Blender.

    uv    (n, 2) float; not finite counts as 0. An image without texels is black
    out   (n, 3) float32
    """
    height, width = image.pixels.shape[:2]
    if not height * width:
        return np.zeros((len(uv), 3), np.float32)
    finite = np.isfinite(uv)
    place = (uv if finite.all() else np.where(finite, uv, 0)).T.astype(np.float64)
    if image.extension in _PERIODS:
        place -= _PERIODS[image.extension] * np.floor(place / _PERIODS[image.extension])
    else:
        np.clip(place, -2, 3, out=place)  # keeps texel numbers within int64
    place *= np.array([[width], [height]])
    if image.closest:
        x, y = np.floor(place).astype(np.int64)
        return _weigh_texels(image, _wrap(x, width, image.extension), _wrap(y, height, image.extension), np.float32(1))
    place -= 0.5
    low = np.floor(place)
    place -= low
    s, t = place.astype(np.float32)
    x, y = low.astype(np.int64)
    left, right = _wrap(x, width, image.extension), _wrap(x + 1, width, image.extension)
    bottom, top = _wrap(y, height, image.extension), _wrap(y + 1, height, image.extension)
    out = _weigh_texels(image, left, bottom, (1 - s) * (1 - t))
    out += _weigh_texels(image, right, bottom, s * (1 - t))
    out += _weigh_texels(image, left, top, (1 - s) * t)
    out += _weigh_texels(image, right, top, s * t)
    return out


def _weigh_texels(image: TextureImage, column: _Wrapped, row: _Wrapped, weight: NDArray[np.float32] | np.float32) -> NDArray[np.float32]:
    """(n, 3) view of rows: texels times their weights (n,)."""
    (x, shown_x), (y, shown_y) = column, row
    rgb = np.ascontiguousarray(image.pixels.reshape(-1, 3).take(y * image.pixels.shape[1] + x, axis=0).T)
    rgb *= weight * (shown_x & shown_y)
    return rgb.T


def _wrap(index: IntArray, size: int, extension: str) -> _Wrapped:
    """The texels that stand for some beyond the image."""
    if extension == "REPEAT":
        return _remainder(index, size), np.True_
    if extension == "MIRROR":
        folded = _remainder(index, 2 * size)
        return np.minimum(folded, 2 * size - 1 - folded), np.True_
    inside = np.clip(index, 0, size - 1)
    return inside, inside == index if extension == "CLIP" else np.True_


def _remainder(index: IntArray, size: int) -> IntArray:
    """index % size of an index in -size ... 2 * size - 1."""
    out: IntArray = index + size * ((index < 0).astype(index.dtype) - (index >= size))
    return out


def clamp_warnings(scene: SceneSnapshot) -> list[tuple[str, str]]:
    """What albedo_at and emission_at had to change: (material name, sentence)."""
    return [(material.name, sentence) for material in scene.materials for sentence in _material_warnings(material, scene.images)]


def _material_warnings(material: Material, images: tuple[TextureImage, ...]) -> list[str]:
    sentences = []
    for quantity, rgb, image, highest in (
        ("albedo", material.albedo_rgb, material.albedo_image, MAX_ALBEDO),
        ("emission", material.emission_rgb, material.emission_image, float(np.finfo(np.float32).max)),
    ):
        low, high = (np.array(rgb, np.float64),) * 2
        where = ""
        if image >= 0:
            pixels = images[image].pixels.reshape(-1, 3)
            with np.errstate(invalid="ignore"):  # 0 times infinity is reported as not finite
                ends = [low * end.astype(np.float64) for end in (pixels.min(axis=0), pixels.max(axis=0))] if len(pixels) else [low * 0]
            low, high = np.min(ends, axis=0), np.max(ends, axis=0)
            where = f" with image {images[image].name}"
        if not (np.isfinite(low).all() and np.isfinite(high).all()):
            sentences.append(f"{material.name}: its {quantity}{where} is not a finite number and counts as 0; correct the value.")
        elif low.min() < 0 or high.max() > highest:
            sentences.append(
                f"{material.name}: its {quantity}{where} reaches from {low.min():.4g} to {high.max():.4g} and is clamped to "
                f"0 ... {highest:.4g}; choose values within."
            )
    return sentences


def _layer(
    scene: SceneSnapshot, rgb: list[tuple[float, float, float]], image: list[int], tri_uv: NDArray[np.float32], highest: float
) -> _Layer:
    with np.errstate(over="ignore"):
        material_rgb = np.array(rgb, np.float64).reshape(-1, 3).astype(np.float32)
    material_image = np.array(image, np.int32)
    plain = material_image < 0
    material_rgb[plain] = _clamp(material_rgb[plain], highest)
    tri_image = material_image[scene.tri_material]
    tri_rgb = np.ascontiguousarray(material_rgb[scene.tri_material].T)
    if not (tri_image >= 0).any():
        return _Layer(tri_rgb, None, np.zeros((3, 2, 0), np.float32), scene.images, highest)
    return _Layer(tri_rgb, tri_image, np.ascontiguousarray(tri_uv.transpose(1, 2, 0)), scene.images, highest)


def _clamp(values: FloatArray, highest: float) -> FloatArray:
    finite = np.isfinite(values)
    return (values if finite.all() else np.where(finite, values, 0)).clip(0, np.float32(highest))
