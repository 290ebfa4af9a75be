"""Pages from the light at texels: seams are closed, light is multiplied by the surface, and images get a margin.

Pages are (height, width, 4) float32, row 0 at the bottom; alpha is 1 where a chart covers the texel, else 0, also in the margin. Passes and
their units: docs/units.md.
"""

import dataclasses
from collections.abc import Callable

import numpy as np

from ..filter import seams
from ..integrate.texel_light import TexelLight
from ..scene.materials import Layer, SurfaceMaterials
from ..texels.margin import add_margin
from ..texels.seam_points import SeamPoints
from ..texels.texel_footprint import centred_strata
from ..texels.texel_map import TexelMap
from ..util.arrays import Float32, IntArray
from ..util.coverage import as_slice
from ..util.threads import run_on_threads

_LIGHT_PASSES = ("lighting", "direct", "indirect", "diffuse", "combined")
_ALBEDO_POINTS = 4  # points over which a texel's albedo is averaged, for textures finer than the lightmap


def close_seams(light: TexelLight, points: SeamPoints, texels: TexelMap) -> tuple[TexelLight, seams.SeamReport]:
    """The light with steps across seams closed; `stderr` stays as before."""
    if not points.place.size or light.stderr is None:
        return light, seams.SeamReport(0, 0, 0.0, 0.0)
    parts = light.direct, light.indirect
    (direct, indirect), empty, report = seams.match_seams(points, parts, light.stderr, texels.is_central, texels.entry_at)
    return dataclasses.replace(light, direct=direct, indirect=indirect, empty=empty), report


class Resolver:
    """Pages of any pass from one light field."""

    def __init__(self, light: TexelLight, texels: TexelMap, surfaces: SurfaceMaterials, margin: int, threads: int = 1):
        self._light, self._texels, self._surfaces = light, texels, surfaces
        self._margin, self._threads = margin, threads

    def page(self, name: str, page: int) -> Float32:
        """One page (h, w, 4) of the pass `name`."""
        size = self._texels.page_size
        image = np.zeros((size, size, 4), np.float32)
        texel = image.reshape(-1, 4)

        def fill(part: slice) -> None:  # in the order of texel entries, which is several times faster than by rows of the page
            entry = part.start + np.flatnonzero((self._texels.page_of(part) == page) & self._texels.shown[part])
            x, y = self._texels.texel_xy[as_slice(entry)].T
            value = np.ones((len(entry), 4), np.float32)
            value[:, :3] = self._pass_values(name, entry)
            texel[y.astype(np.int64) * size + x] = value

        run_on_threads(fill, len(self._texels), self._threads)
        filled = image[..., 3] > 0.0
        if self._light.empty is not None and name in _LIGHT_PASSES:
            column, row, value = self._beside_charts(name, page, self._light.empty)
            image[row, column, :3], filled[row, column] = value, True
        add_margin(image[..., :3], filled, self._margin)
        return image

    def find_lighting(self) -> Float32:
        """(n,) float32, W/m^2/sr: the pass `lighting` of each texel entry, mean of channels."""
        value = np.zeros(len(self._texels), np.float32)

        def fill(part: slice) -> None:
            value[part] = (self._light.direct[part] + self._light.indirect[part]).mean(axis=1) / np.float32(np.pi)

        run_on_threads(fill, len(self._texels), self._threads)
        return value

    def _pass_values(self, name: str, entry: IntArray) -> Float32:
        light, rows = self._light, as_slice(entry)
        if name in _LIGHT_PASSES:
            return self._shade(name, light.direct[rows], light.indirect[rows], lambda layer: self._average(layer, entry))
        if name == "stderr" and light.stderr is not None:
            return light.stderr[rows] / np.float32(np.pi)
        if name in ("albedo", "emission"):
            return self._average(self._surfaces.albedo if name == "albedo" else self._surfaces.emission, entry)
        raise ValueError(f"pass: {name!r} is not known")

    def _shade(self, name: str, direct: Float32, indirect: Float32, look_up: Callable[[Layer], Float32]) -> Float32:
        """(n, 3) float32: a pass of light, from irradiance (n, 3) and a function that looks up a layer of the surface."""
        total = {"direct": direct, "indirect": indirect}.get(name)
        lighting: Float32 = (direct + indirect if total is None else total) / np.float32(np.pi)
        if name in ("diffuse", "combined"):
            lighting = lighting * look_up(self._surfaces.albedo)
        return lighting + look_up(self._surfaces.emission) if name == "combined" else lighting

    def _beside_charts(self, name: str, page: int, empty: seams.EmptyTexels) -> tuple[IntArray, IntArray, Float32]:
        """Columns and rows (m,) of a page's empty texels beside seams, and their values (m, 3)."""
        rows = np.flatnonzero(empty.page == page)
        tri, (u, v) = empty.tri[rows], empty.weight[rows].T
        value = self._shade(name, empty.light[0, rows], empty.light[1, rows], lambda layer: layer.at(tri, u, v))
        return empty.xy[rows, 0], empty.xy[rows, 1], value

    def _average(self, layer: Layer, entry: IntArray) -> Float32:
        """(n, 3): mean of a layer over the covered part of each texel entry (n,)."""
        if not layer.has_images:
            flat = np.zeros(len(entry), np.float32)
            return layer.at(self._texels.texel_tri[entry], flat, flat)
        tri, uv = self._texels.sub_points(entry, centred_strata(_ALBEDO_POINTS))
        values = layer.at(tri.ravel(), uv[..., 0].ravel(), uv[..., 1].ravel())
        return values.reshape(_ALBEDO_POINTS, -1, 3).mean(0)
