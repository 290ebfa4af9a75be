"""Debug passes: edges of leaves, their levels and photons, and charts.

Each has values, for files of numbers, and a look, for pictures.
"""

from collections.abc import Callable
from functools import cached_property

import numpy as np

from ..integrate.light_field import LightField
from ..radiosity.quadtree import node_of_texel
from ..texels.margin import add_margin
from ..texels.texel_map import TexelMap
from ..util.arrays import BoolArray, Float32, Float64, Int32, Int64
from .image_file import srgb_to_linear

# sRGB bytes at equal steps of viridis, from dark to bright. Source: S. van der Walt, N. Smith, matplotlib 1.5, CC0.
_VIRIDIS = ((68, 1, 84), (71, 45, 123), (59, 82, 139), (44, 114, 142), (33, 144, 140), (39, 173, 129), (93, 200, 99), (170, 220, 50))
_VIRIDIS_END = (253, 231, 37)
_GOLDEN_RATIO = 0.6180339887498949  # step between successive hues: any number of them stay distinct
_CHART_SATURATION, _CHART_VALUE = 0.5, 0.85
_LINE_SHARE = 0.75  # opacity of a line over the light
_LINE_ON_DARK, _LINE_ON_BRIGHT = 0.55, 0.01  # grey of a line, linear
_BRIGHT = 0.18  # light above it is bright


class DebugPages:
    """Pages (h, w, 4) float32 of debug passes, row 0 at the bottom; alpha is 1 where a chart covers the texel."""

    def __init__(self, light: LightField, texels: TexelMap, margin: int) -> None:
        self._light, self._texels, self._margin = light, texels, margin

    @cached_property
    def _leaf(self) -> Int32:
        return node_of_texel(self._light.tree, self._light.leaves, len(self._texels))

    def page(self, name: str, page: int) -> Float32:
        """The values of a pass, equal in red, green and blue.

        leaf_edges: 1 where a leaf ends, else 0; level: halvings of the chart's root; photons: number that the leaf received; charts: index
        from 0.
        Raises ValueError for another pass.
        """
        entry = self._entries(page)
        value = np.zeros((*entry.shape, 3), np.float32)
        covered = entry >= 0
        value[covered] = self._values(name, entry)[covered][:, None]
        return self._finish(value, covered)

    def look(self, name: str, page: int, combined: Callable[[], Float32]) -> Float32:
        """The pass as a picture, linear Rec.709; edges are drawn over the page of the pass combined, which `combined` returns."""
        entry = self._entries(page)
        covered, value = entry >= 0, self._values(name, entry)
        if name == "leaf_edges":
            light = np.clip(combined()[..., :3], 0.0, 1.0)
            bright = light.mean(-1, keepdims=True) > _BRIGHT
            share = np.float32(_LINE_SHARE) * value[..., None].astype(np.float32)
            line = np.where(bright, np.float32(_LINE_ON_BRIGHT), np.float32(_LINE_ON_DARK))
            return self._finish((1 - share) * light + share * line, covered)
        if name == "charts":
            colour = _hue_colours(value * _GOLDEN_RATIO % 1.0)
        else:
            scale = np.log1p if name == "photons" else np.asarray
            colour = _map_colours(scale(value) / max(float(scale(self._greatest(name))), 1.0))
        return self._finish(np.where(covered[..., None], colour, np.float32(0)), covered)

    def _entries(self, page: int) -> Int64:
        """(h, w): the shown texel entries, -1 for none."""
        size = self._texels.page_size
        entry = np.flatnonzero(self._texels.shown & (self._texels.page_of(slice(None)) == page))
        at = np.full((size, size), -1, np.int64)
        at[self._texels.texel_xy[entry, 1], self._texels.texel_xy[entry, 0]] = entry
        return at

    def _values(self, name: str, entry: Int64) -> Float64:
        """(h, w): values at entries; arbitrary where there is none."""
        if name == "charts":
            return np.asarray(self._texels.texel_chart[entry], np.float64)
        leaf = np.where(entry >= 0, self._leaf[entry], -1)
        if name == "leaf_edges":
            edge = np.zeros(leaf.shape, bool)  # compared with the left and lower neighbours only, for lines of one texel
            edge[:, 1:] |= (leaf[:, 1:] != leaf[:, :-1]) & (leaf[:, :-1] >= 0)
            edge[1:] |= (leaf[1:] != leaf[:-1]) & (leaf[:-1] >= 0)
            return np.asarray(edge, np.float64)
        if name in ("level", "photons"):
            return np.asarray(self._per_node(name)[leaf], np.float64)
        raise ValueError(f"pass: {name!r} is not known")

    def _per_node(self, name: str) -> Float64:
        tree = self._light.tree
        if name == "photons":
            return np.asarray(self._light.received, np.float64)
        return np.asarray(self._texels.chart_log2[tree.chart] - np.log2(tree.side), np.float64)

    def _greatest(self, name: str) -> np.float64:
        """Greatest value on all pages, so that a colour means the same on each."""
        return np.float64(self._per_node(name)[self._light.leaves].max(initial=0.0))

    def _finish(self, colour: Float32, covered: BoolArray) -> Float32:
        image = np.zeros((*covered.shape, 4), np.float32)
        image[covered, :3], image[..., 3] = colour[covered], covered
        add_margin(image[..., :3], covered, self._margin)
        return image


def _map_colours(fraction: Float64) -> Float32:
    """Linear colours (h, w, 3) for numbers (h, w) in [0, 1], from dark to bright."""
    stops = np.array([*_VIRIDIS, _VIRIDIS_END]) / 255.0
    place = np.linspace(0.0, 1.0, len(stops))
    encoded = np.stack([np.interp(fraction, place, stops[:, channel]) for channel in range(3)], -1)
    return srgb_to_linear(encoded.astype(np.float32))


def _hue_colours(hue: Float64) -> Float32:
    """Linear colours (h, w, 3) of hues (h, w) in [0, 1).

    Source: A. R. Smith, "Color Gamut Transform Pairs", 1978.
    """
    spread = np.clip(np.abs((hue[..., None] * 6.0 + [0.0, 4.0, 2.0]) % 6.0 - 3.0) - 1.0, 0.0, 1.0)
    encoded = _CHART_VALUE * (1.0 - _CHART_SATURATION * (1.0 - spread))
    return srgb_to_linear(encoded.astype(np.float32))
