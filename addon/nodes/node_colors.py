"""A colour as a constant times an image, and arithmetic with it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, TypeAlias

from .color_attributes import ColorLayer
from .polygon_atlas import BakedLayer
from .texture_mapping import UNMAPPED, UvMapping

Rgb: TypeAlias = tuple[float, float, float]

WHITE: Rgb = (1.0, 1.0, 1.0)
BLACK: Rgb = (0.0, 0.0, 0.0)
GREY: Rgb = (0.8, 0.8, 0.8)  # of a surface without a material, and of a new one


@dataclass(frozen=True)
class Color:
    """A constant times an optional image; `mean_rgb` is that of the product."""

    rgb: Rgb
    image: int = -1
    mapping: UvMapping | ColorLayer | BakedLayer = UNMAPPED
    mean_rgb: Rgb | None = None

    @property
    def mean(self) -> Rgb:
        return self.rgb if self.mean_rgb is None else self.mean_rgb

    def times(self, factor: Rgb | float) -> Color:
        factors = (factor, factor, factor) if isinstance(factor, (int, float)) else factor
        return replace(self, rgb=multiply_rgb(self.rgb, factors), mean_rgb=self.mean_rgb and multiply_rgb(self.mean_rgb, factors))


def to_rgb(values: Any) -> Rgb:
    return float(values[0]), float(values[1]), float(values[2])


def add_rgb(a: Rgb, b: Rgb) -> Rgb:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def multiply_rgb(a: Rgb, b: Rgb) -> Rgb:
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


def find_brightness(rgb: Rgb) -> float:
    return rgb[0] if rgb[0] == rgb[1] == rgb[2] else 0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2]
