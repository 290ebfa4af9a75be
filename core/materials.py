"""Albedo and emission at hits."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from .geometry import gather, locate_hits, triangle_frames
from .scene import MAX_ALBEDO, FloatArray, IntArray, Material, SceneSnapshot, TextureImage

_MAX_EMISSION = float(np.finfo(np.float32).max)
_LEAST_TOLD = {"albedo": 2.0 - MAX_ALBEDO}  # white is 1, and what that loses nobody sees
_PIXELS_OF_ROW = 64
_PERIODS = {"REPEAT": 1.0, "MIRROR": 2.0}  # in UV, by extension


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
    images: tuple[TextureImage, ...]
    highest: float

    def at(self, tri: IntArray, u: FloatArray, v: FloatArray) -> NDArray[np.float32]:
        rgb = gather(self.tri_rgb, tri)
        if self.tri_image is not None:
            hit_image = gather(self.tri_image, tri)
            for index in np.bincount(hit_image + 1)[1:].nonzero()[0]:
                rows = (hit_image == index).nonzero()[0]
                with np.errstate(over="ignore", invalid="ignore"):  # what overflows is not finite, and so 0
                    uv = locate_hits(self.tri_uv, gather(tri, rows), gather(u, rows), gather(v, rows)).T
                    product = clamp_colours(gather(rgb, rows) * sample_texture(self.images[index], uv).T, self.highest)
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
    out   (n, 3) float32; its transpose is contiguous
    """
    height, width = image.pixels.shape[:2]
    if not height * width:
        return np.zeros((len(uv), 3), np.float32)
    finite = np.isfinite(uv)
    place = (uv if finite.all() else np.where(finite, uv, 0)).T
    size = np.array([[width], [height]], place.dtype)
    if image.extension in _PERIODS:
        period = _PERIODS[image.extension]
        place = size * (place - period * np.floor(place / period))
    else:
        place = np.clip(size * place, -0.5, size + 0.5)
    place += 1 if image.closest else 0.5  # _neighbours counts from the texel before the image
    low = np.floor(place)
    x, y = low.astype(np.intp)
    column, row = gather(_neighbours(width, image.extension), x), gather(_neighbours(height, image.extension), y)
    place -= low
    share = np.array([1 - place, place], np.float32)  # of both neighbours, by axis
    if image.closest:
        column, row, share = column[:1], row[:1], np.ones_like(share[:1])
    if image.extension == "CLIP":
        share *= np.stack([column, row], axis=1) >= 0
    return _weigh_texels(image, row[:, None] * width + column, share[:, 1, None] * share[:, 0])


def _weigh_texels(image: TextureImage, texel: IntArray, weight: NDArray[np.float32]) -> NDArray[np.float32]:
    """(n, 3) view of rows: sums of texels (i, j, n) times their weights (i, j, n)."""
    pixels, first = image.pixels.reshape(-1), texel * 3
    rgb = np.empty((3, *texel.shape), np.float32)
    for channel, row in enumerate(rgb):  # four times as quick as whole texels, of 12 bytes each
        pixels[channel:].take(first, out=row, mode="wrap")
    out: NDArray[np.float32] = np.einsum("cijn,ijn->cn", rgb, weight)
    return out.T


@lru_cache(maxsize=64)
def _neighbours(size: int, extension: str) -> IntArray:
    """(2, k) int: of a place along an image, k - 1 to k texels from its start, the texels before and after; -1 where none is shown."""
    texel = np.arange(-1, (2 if extension == "MIRROR" else 1) * size + 2)
    if extension == "REPEAT":
        texel %= size
    elif extension == "MIRROR":
        texel = np.minimum(texel % (2 * size), 2 * size - 1 - texel % (2 * size))
    elif extension == "EXTEND":
        texel = texel.clip(0, size - 1)
    else:
        texel[texel >= size] = -1
    return np.stack([texel[:-1], texel[1:]])


def clamp_warnings(scene: SceneSnapshot) -> list[tuple[str, str]]:
    """What albedo_at and emission_at had to change: (material name, sentence)."""
    return [(material.name, text) for index, material in enumerate(scene.materials) for text in _material_warnings(scene, index, material)]


def _material_warnings(scene: SceneSnapshot, index: int, material: Material) -> list[str]:
    sentences = []
    for quantity, rgb, image, tri_uv, highest in (
        ("albedo", material.albedo_rgb, material.albedo_image, scene.tri_albedo_uv, MAX_ALBEDO),
        ("emission", material.emission_rgb, material.emission_image, scene.tri_emission_uv, _MAX_EMISSION),
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
        return _Layer(tri_rgb, None, np.zeros((3, 2, 0), np.float32), scene.images, highest)
    with np.errstate(over="ignore", invalid="ignore"):  # as where they are used
        return _Layer(tri_rgb, tri_image, triangle_frames(tri_uv), scene.images, highest)


def clamp_colours(values: FloatArray, highest: float) -> FloatArray:
    """What surfaces show of colours: within 0 ... highest, and 0 where they are not finite."""
    finite = np.isfinite(values)
    return (values if finite.all() else np.where(finite, values, 0)).clip(0, np.float32(highest))
