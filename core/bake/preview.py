"""Small pages for a viewport while the bake runs. They are quick to draw, and left out where they would slow the bake.

A page shows integrate.texel_light.glance_at: each leaf's own function, unblended, so that one can watch leaves become finer, and light by
rays wherever some have been sent. The first light comes from photons alone; rays then replace its direct light texel by texel.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..integrate.direct_field import DirectField
from ..integrate.light_field import LightField
from ..integrate.texel_light import glance_at
from ..output.image_file import HALF_MAX
from ..parallel.executors import InlineExecutor
from ..scene.materials import Layer, SurfaceMaterials
from ..texels.margin import add_margin
from ..texels.texel_map import TexelMap
from ..util.arrays import IntArray
from ..util.messages import Message, Preview
from ..util.settings import Settings
from .solve import Solver

FIRST_PHOTONS = 1 << 17  # photons of the first light, which should appear at once
FIRST_ROUND = 1 << 30  # its round number, for random numbers of its own: rounds of a bake and turns of shadow rays never reach it
FIRST_LEVEL = 1  # level of its nodes, since there are no rounds that would split them
MOST_TEXELS = 1 << 19  # on all pages together
LEAST_PAUSE_S = 0.3
PAUSE_OF_COST = 10.0  # pause before the next preview, over the time that the last one took
# With the first light the viewer gives all objects materials and redraws everything, which takes a third longer while a bake runs.
FIRST_DRAWN_S = 0.3
_KEPT_TURNS = 3  # pages of so many last turns are kept, since a viewer may lag behind

# Pass -> factors on direct and indirect light, whether they are multiplied by the albedo, and the surface colour that is added.
_PASSES = {
    "combined": (1.0, 1.0, True, "emission"),
    "diffuse": (1.0, 1.0, True, ""),
    "direct": (1.0, 0.0, False, ""),
    "indirect": (0.0, 1.0, False, ""),
    "emission": (0.0, 0.0, False, "emission"),
    "albedo": (0.0, 0.0, False, "albedo"),
}
_LIGHTING = (1.0, 1.0, False, "")  # shown for all other passes


def find_first_light(folder: Path, settings: Settings, texels: TexelMap) -> LightField:
    """All light by a few photons, traced in this process before any worker runs; not part of the bake's result.

    folder   of traced_scene.open_tracing
    """
    level = max(settings.min_level, FIRST_LEVEL)
    # Linear functions fitted to so few photons would dip to black.
    quick = replace(settings, direct="photons", basis="constant", max_photons=FIRST_PHOTONS, min_level=level, hierarchical=True)
    n_texel = len(texels)
    solver = Solver(folder, quick, InlineExecutor(), DirectField.none(n_texel), np.zeros(n_texel, bool))
    solver.round = FIRST_ROUND
    return solver.glance()


class PreviewPages:
    """Writes pages of the first pass into `folder` and announces them."""

    def __init__(
        self,
        folder: Path,
        texels: TexelMap,
        surfaces: SurfaceMaterials,
        settings: Settings,
        tell: Callable[[Message], None],
    ) -> None:
        folder.mkdir(exist_ok=True)
        self._folder, self._tell, self._turn, self._texels = folder, tell, 0, texels
        self._pages = texels.page_count
        self.side = min(texels.page_size, max(math.isqrt(MOST_TEXELS // self._pages), 1))
        self._margin = max(settings.margin * self.side // texels.page_size, 1)
        show_direct, show_indirect, coloured, added = _PASSES.get(settings.passes[0], _LIGHTING)
        self._cell, self._entry = _choose_entries(texels, self.side)
        albedo = _surface_at(texels, surfaces.albedo, self._entry)
        emission = _surface_at(texels, surfaces.emission, self._entry)
        tint = (albedo if coloured else np.ones_like(albedo)) / np.float32(np.pi)
        self._direct_tint, self._indirect_tint = np.float32(show_direct) * tint, np.float32(show_indirect) * tint
        self._added = {"emission": emission, "albedo": albedo}.get(added, np.zeros_like(albedo))
        self._next_s = -math.inf

    def show(self, light: LightField, rays_alone: bool = False) -> None:
        """Write pages of the present light, unless it is too soon after the last ones; rays_alone is as for glance_at."""
        if time.monotonic() < self._next_s:
            return
        begin = time.thread_time()  # CPU time, since load by other processes is no cost of the preview
        for page, pixels in enumerate(self.draw(light, rays_alone)):
            path = self._path(page, self._turn)
            np.save(path, pixels)
            with contextlib.suppress(PermissionError):  # Windows refuses while Blender reads it; it is then deleted with the job's folder
                self._path(page, self._turn - _KEPT_TURNS).unlink(missing_ok=True)
            self._tell(Preview(page, str(path)))
        self._turn += 1
        self._next_s = time.monotonic() + max(LEAST_PAUSE_S, PAUSE_OF_COST * (time.thread_time() - begin))

    def join(self, light: LightField, direct: DirectField) -> Callable[[Message], None]:
        """Show first light and wait until it is drawn. Returns a callback for messages, which updates the direct light that is shown."""
        mixed = replace(light, direct=direct)
        self.show(mixed, rays_alone=True)
        time.sleep(FIRST_DRAWN_S)

        def send_and_show(message: Message) -> None:
            self._tell(message)
            self.show(mixed, rays_alone=True)

        return send_and_show

    def draw(self, light: LightField, rays_alone: bool = False) -> list[NDArray[np.float16]]:
        """(side, side, 4) float16 for each page, row 0 at the bottom; rays_alone is as for glance_at."""
        direct, indirect = glance_at(light, self._texels, self._entry, rays_alone)
        colour = direct * self._direct_tint + indirect * self._indirect_tint + self._added
        side = self.side
        flat = np.zeros((self._pages * side * side, 4), np.float32)
        flat[self._cell, :3] = np.minimum(colour, HALF_MAX)
        flat[self._cell, 3] = 1.0
        pages = flat.reshape(self._pages, side, side, 4)
        for pixels in pages:
            add_margin(pixels[..., :3], pixels[..., 3] > 0.0, self._margin)
        return [pixels.astype(np.float16) for pixels in pages]

    def _path(self, page: int, turn: int) -> Path:
        return self._folder / f"page_{page}_{turn}.npy"


def _choose_entries(texels: TexelMap, side: int) -> tuple[IntArray, IntArray]:
    """Pixels (m,) of all preview pages that a chart covers, as flat indices, and a texel entry (m,) in each."""
    x, y = (texels.texel_xy.astype(np.int64) * side // texels.page_size).T
    cell = (texels.page_of(slice(None)).astype(np.int64) * side + y) * side + x
    first = np.full(texels.page_count * side * side, -1)
    first[cell[::-1]] = np.arange(len(cell))[::-1]
    covered = np.flatnonzero(first >= 0)
    return covered, first[covered]


def _surface_at(texels: TexelMap, layer: Layer, entry: IntArray) -> NDArray[np.float32]:
    """(m, 3) float32: the layer at one point of each texel entry (m,)."""
    if layer.has_images:
        _, u, v = texels.bary_at(entry).T
    else:
        u = v = np.zeros(len(entry), np.float32)
    return layer.at(texels.texel_tri[entry], u, v)
