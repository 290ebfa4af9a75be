"""Textures made of others by arithmetic: what nodes between an image and a shader make of it, texel by texel."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Hashable, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from ...core.scene.scene import TextureImage
from .color_attributes import ColorLayer
from .images_read import MAX_TEXTURE_SIDE_TEXELS, ImageTable
from .node_colors import Color, to_rgb
from .node_formulas import Array

Formula: TypeAlias = Callable[..., Array]

MIXED = "textures that are mapped in different ways meet, so one of them counts by its mean"
AT_CORNERS = "what nodes make of its vertex colours is baked from the corners of its faces"
PAINTED = "what nodes make of its vertex colours is baked as their mean"
COARSE = "nodes make so many textures that some of them are coarser"
_BLOCK_TEXELS = 1 << 16  # at once, to bound memory
_MOST_TEXELS = 1 << 27  # of all such images, 1.6 GB; one for each object, as an object's colour makes them, would know no bounds
_COARSE_SIDE = 256  # of those beyond


def derive(images: ImageTable, key: Hashable, formula: Formula, colors: Sequence[Color], name: str) -> tuple[Color, str]:
    """What a formula makes of colours: a constant, or an image of its own where one of them is an image; and what was replaced.

    key      tells this formula from others
    formula  takes as many (..., 3) arrays as there are colours, which it must not write to
    name     of the image
    """
    textured = [color for color in colors if color.image >= 0]
    if not textured:
        return Color(_evaluate_constants(formula, [color.rgb for color in colors])), ""
    mapped = [_find_place(images, color) for color in textured if not isinstance(color.mapping, ColorLayer)]
    if not mapped:
        return _scale_painted(formula, colors, textured[0]), PAINTED
    place = Counter(mapped).most_common(1)[0][0]
    here = [color.image >= 0 and not isinstance(color.mapping, ColorLayer) and _find_place(images, color) == place for color in colors]
    note = MIXED if sum(here) < len(textured) else ""
    kept = tuple(color if ours else Color(color.mean) for color, ours in zip(colors, here, strict=True))
    known = images.find_derived((key, kept))
    sources = [images.images[color.image] if color.image >= 0 else None for color in kept]
    if known is None:
        most = _COARSE_SIDE if images.derived_texels > _MOST_TEXELS else MAX_TEXTURE_SIDE_TEXELS
        known = images.add_derived((key, kept), _make_image(formula, kept, sources, name, most))
    pixels = images.images[known].pixels
    if any(source is not None and source.pixels.size > pixels.size for source in sources):
        note = note or COARSE
    mean = pixels.mean(axis=(0, 1), dtype=np.float64)
    return Color((1.0, 1.0, 1.0), known, place[0], to_rgb(mean)), note


def derive_painted(key: Hashable, formula: Formula, colors: Sequence[Color]) -> ColorLayer | None:
    """The layer of what a formula makes of vertex colours and constants; None where something else is among them."""
    layers = {color.mapping for color in colors if color.image >= 0}
    layer = next(iter(layers), None)
    if len(layers) != 1 or not isinstance(layer, ColorLayer):
        return None

    def made(rgb: Array) -> Array:
        painted = rgb if layer.formula is None else layer.formula(rgb)
        return formula(*(np.asarray(color.rgb) * (painted if color.image >= 0 else 1.0) for color in colors))

    return replace(layer, key=(layer.key, key, tuple(colors)), formula=made)


def lie_alike(images: ImageTable, first: Color, second: Color) -> bool:
    """Whether the texels of two colours lie on each other, as those of a constant do on any texture."""
    textured = [color for color in (first, second) if color.image >= 0]
    if any(isinstance(color.mapping, ColorLayer) for color in textured):
        return len({color.mapping for color in textured}) == 1
    return len({_find_place(images, color) for color in textured}) < 2


def _evaluate_constants(formula: Formula, values: Sequence[tuple[float, float, float]]) -> tuple[float, float, float]:
    with np.errstate(all="ignore"):
        made = formula(*(np.array(rgb) for rgb in values))
    return to_rgb(np.nan_to_num(np.broadcast_to(made, 3), posinf=0.0, neginf=0.0))


def _find_place(images: ImageTable, color: Color) -> tuple[object, str]:
    """What two images must share for their texels to lie on each other."""
    return color.mapping, images.images[color.image].extension


def _scale_painted(formula: Formula, colors: Sequence[Color], painted: Color) -> Color:
    """Vertex colours as they are, scaled to the mean that is asked for."""
    made = _evaluate_constants(formula, [color.mean for color in colors])
    factors = [to / of if of > 0.0 else 0.0 for to, of in zip(made, painted.mean, strict=True)]
    return painted.times((factors[0], factors[1], factors[2]))


def _make_image(formula: Formula, colors: Sequence[Color], sources: Sequence[TextureImage | None], name: str, most: int) -> TextureImage:
    """The formula at each texel, of as many rows and columns as the largest source has, but no more than `most`."""
    found = [source for source in sources if source is not None]
    height, width = (min(max(source.pixels.shape[axis] for source in found), most) for axis in (0, 1))
    pixels = np.empty((height, width, 3), np.float32)
    step = max(_BLOCK_TEXELS // width, 1)
    for low in range(0, height, step):
        rows = np.arange(low, min(low + step, height))
        values = [
            np.asarray(color.rgb, np.float32)
            if source is None
            else _sample(source, rows, height, width) * np.asarray(color.rgb, np.float32)
            for color, source in zip(colors, sources, strict=True)
        ]
        with np.errstate(all="ignore"):
            pixels[rows] = np.nan_to_num(formula(*values), posinf=0.0, neginf=0.0)
    return TextureImage(name, pixels, found[0].extension, all(source.closest for source in found))


def _sample(source: TextureImage, rows: Array, height: int, width: int) -> Array:
    """(n_row, width, 3) of a source at these rows of another grid, bilinear."""
    pixels = source.pixels
    if pixels.shape[:2] == (height, width):
        return pixels[rows]
    wraps = source.extension == "REPEAT"
    below, above, up = _find_texels(rows, height, pixels.shape[0], wraps, source.closest)
    left, right, aside = _find_texels(np.arange(width), width, pixels.shape[1], wraps, source.closest)
    line = pixels[below] + (pixels[above] - pixels[below]) * up[:, None, None]
    return line[:, left] + (line[:, right] - line[:, left]) * aside[:, None]


def _find_texels(place: Array, n_fine: int, n_coarse: int, wraps: bool, closest: bool) -> tuple[Array, Array, Array]:
    """The two coarse texels around each fine one, and how far it lies towards the second."""
    at = (place + 0.5) * (n_coarse / n_fine) - 0.5
    low = np.floor(at + 0.5 if closest else at).astype(np.int64)
    far = np.zeros(len(at), np.float32) if closest else (at - low).astype(np.float32)
    if wraps:
        return low % n_coarse, (low + 1) % n_coarse, far
    return low.clip(0, n_coarse - 1), (low + 1).clip(0, n_coarse - 1), far
