"""Which texels of which page each receiving triangle gets: unwrapped and packed, or as an existing UV layer says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from .geometry import triangle_normals_areas
from .layer_check import check_layer, label_charts
from .outlines import Outlines, measure_outlines, straighten_charts
from .packing import (
    Page,
    Placement,
    Shapes,
    find_greatest_density,
    fits_alone,
    place_charts,
    place_uv,
    shape_charts,
)
from .scene import SceneSnapshot
from .settings import Settings
from .unwrap import unwrap_triangles

Float64: TypeAlias = NDArray[np.float64]
Int32: TypeAlias = NDArray[np.int32]
Int64: TypeAlias = NDArray[np.int64]

_FEWEST_TEXELS = 1.0  # a chart of less area than this is hardly a lightmap


@dataclass(frozen=True)
class ChartAtlas:
    """Charts on square pages.

    page_size     texels
    tri_chart     (n_tri,) int32           -1 for triangles that get no texels
    tri_uv        (n_tri, 3, 2) float64    texels of its page, x right, y up; 0 where tri_chart is -1
    chart_page    (n_chart,) int32
    chart_object  (n_chart,) int32
    object_page   (n_object,) int32        -1 none; all charts of an object are on one page
    warnings      subject and sentence
    """

    page_size: int
    page_count: int
    tri_chart: NDArray[np.int32]
    tri_uv: NDArray[np.float64]
    chart_page: NDArray[np.int32]
    chart_object: NDArray[np.int32]
    object_page: NDArray[np.int32]
    warnings: tuple[tuple[str, str], ...]


def make_charts(snapshot: SceneSnapshot, settings: Settings) -> ChartAtlas:
    """Charts of all receiving objects, of one density in texels/m; layers that exist are kept and get pages of their own.

    Raises ValueError when charts do not fit a page at any density, or when xatlas is needed and cannot be loaded.
    """
    return _AtlasMaker(snapshot, settings).make()


@dataclass(frozen=True)
class _Packed:
    """Charts placed on a page: the objects, the density in texels/m, and where."""

    objects: list[int]
    page: int
    density: float
    shapes: Shapes
    placement: Placement


class _AtlasMaker:
    """The state while an atlas is made: pages fill up, warnings are collected."""

    def __init__(self, snapshot: SceneSnapshot, settings: Settings) -> None:
        self.snapshot, self.settings = snapshot, settings
        self.page = Page(settings.size, settings.padding)
        self.page_count = 0
        self.warnings: list[tuple[str, str]] = []
        self.outlines: Outlines  # of all charts, once they are found
        tri_object, count = snapshot.tri_object, len(snapshot.objects)
        self.start = np.searchsorted(tri_object, np.arange(count + 1))
        self.chart = np.full(snapshot.n_tri, -1, np.int64)
        self.uv = np.zeros((snapshot.n_tri, 3, 2))
        self.shared = np.zeros((snapshot.n_tri, 3), bool)
        self.first_chart = np.zeros(count + 1, np.int64)
        self.object_page = np.full(count, -1, np.int32)

    def make(self) -> ChartAtlas:
        layered = self._find_charts()
        self.outlines = self._straighten(layered)
        unwrapped = [i for i in np.flatnonzero(np.diff(self.first_chart)) if i not in layered]
        if not self.settings.atlas:
            for i in unwrapped:
                self._pack_alone(i)
        elif self.settings.density > 0:
            self._pack_first_fit(unwrapped)
        elif unwrapped:
            self._apply(self._fit(unwrapped, self._new_page()))
        for i in layered:
            self.object_page[i] = self._new_page()
        chart_object = np.repeat(np.arange(len(self.object_page)), np.diff(self.first_chart))
        return ChartAtlas(
            self.settings.size,
            self.page_count,
            self.chart.astype(np.int32),
            self.uv,
            self.object_page[chart_object],
            chart_object.astype(np.int32),
            self.object_page,
            tuple(self.warnings),
        )

    def _rows(self, i: int) -> slice:
        return slice(int(self.start[i]), int(self.start[i + 1]))

    def _warn(self, i: int, sentence: str) -> None:
        name = self.snapshot.objects[i].name
        self.warnings.append((name, f"{name}: {sentence}."))

    def _new_page(self) -> int:
        self.page_count += 1
        return self.page_count - 1

    def _find_charts(self) -> dict[int, None]:
        """Charts of every object; gives those whose layer is kept."""
        layered: dict[int, None] = {}
        for i, one in enumerate(self.snapshot.objects):
            count = 0
            if one.receives:
                count = self._read_layer(i) if one.has_layer else self._unwrap(i)
                if count and one.has_layer:
                    layered[i] = None
                elif not count:
                    self._warn(i, "no face can be baked, so it gets no lightmap; give it faces with an area, or leave it out of the bake")
            self.first_chart[i + 1] = self.first_chart[i] + count
        return layered

    def _unwrap(self, i: int) -> int:
        scene, rows = self.snapshot, self._rows(i)
        position = scene.vertex_position[scene.tri_vertex[rows]]
        chart, uv, shared = unwrap_triangles(position, scene.tri_vertex[rows], scene.tri_polygon[rows], scene.tri_corner[rows])
        return self._keep(i, chart, uv * scene.objects[i].density_factor, shared)

    def _read_layer(self, i: int) -> int:
        scene, rows = self.snapshot, self._rows(i)
        solid = triangle_normals_areas(scene.vertex_position[scene.tri_vertex[rows]])[1] > 0
        check = check_layer(scene.tri_uv[rows], scene.tri_polygon[rows], solid)
        for finding in check.findings:
            self._warn(i, finding)
        uv = np.where(check.usable[:, None, None], scene.tri_uv[rows], 0.0)
        chart, shared = label_charts(scene.tri_vertex[rows], scene.tri_corner[rows], uv, np.where(check.usable, 0, -1))
        return self._keep(i, chart, np.clip(uv, 0.0, 1.0) * float(self.settings.size), shared)

    def _keep(self, i: int, chart: Int64, uv: Float64, shared: NDArray[np.bool_]) -> int:
        rows = self._rows(i)
        self.chart[rows] = np.where(chart >= 0, chart + self.first_chart[i], -1)
        self.uv[rows], self.shared[rows] = uv, shared
        return int(chart.max(initial=-1)) + 1

    def _straighten(self, layered: dict[int, None]) -> Outlines:
        """Turns unwrapped charts upright; the outlines of layered ones, never packed, are empty."""
        packed = self.chart >= 0
        for i in layered:
            packed[self._rows(i)] = False
        count = int(self.first_chart[-1])
        self.uv[packed] = straighten_charts(self.uv[packed], self.chart[packed], self.shared[packed], count)
        return measure_outlines(self.uv[packed], self.chart[packed], self.shared[packed], count)

    def _select(self, objects: Sequence[int]) -> Outlines:
        return self.outlines.select(self._charts(objects))

    def _charts(self, objects: Sequence[int]) -> Int64:
        return np.concatenate([np.arange(self.first_chart[i], self.first_chart[i + 1]) for i in objects])

    def _fit(self, objects: list[int], page: int) -> _Packed:
        outlines = self._select(objects)
        found = find_greatest_density(outlines, self.page)
        if found is None:
            names = self.snapshot.objects[objects[0]].name if len(objects) == 1 else f"{len(objects)} objects"
            raise ValueError(
                f"The {len(outlines.extent):,} charts of {names} do not fit a page of {self.page.size} texels: "
                "choose a greater page size or less padding."
            )
        for i in objects:
            area = self.outlines.area[self.first_chart[i] : self.first_chart[i + 1]]
            if float(np.median(area)) * found[0] ** 2 < _FEWEST_TEXELS:
                self._warn(i, "half of its charts are smaller than a texel; choose a greater page size or density, or merge small faces")
        return _Packed(objects, page, *found)

    def _pack_alone(self, i: int) -> None:
        if self.settings.density > 0 and self._try_on(i, self.page_count, self.page.empty_horizon()):
            self._new_page()
        else:
            self._pack_less_dense(i)

    def _pack_less_dense(self, i: int) -> None:
        packed = self._fit([i], self._new_page())
        if self.settings.density > 0:
            factor = self.snapshot.objects[i].density_factor
            self._warn(
                i,
                f"does not fit a page of {self.page.size} texels at {self.settings.density * factor:g} texels per metre "
                f"and is baked at {packed.density * factor:.3g}; choose a greater page size or a lower density",
            )
        self._apply(packed)

    def _try_on(self, i: int, page: int, horizon: Int32) -> bool:
        """Places an object at the wanted density above the horizon, which is raised, if it fits."""
        outlines, density = self._select([i]), self.settings.density
        if not fits_alone(outlines, density, self.page):
            return False
        shapes = shape_charts(outlines, density, self.page)
        placement = place_charts(shapes, horizon)
        if placement is None:
            return False
        self._apply(_Packed([i], page, density, shapes, placement))
        return True

    def _pack_first_fit(self, objects: list[int]) -> None:
        """Whole objects, the largest first, each on the first page that has room for it."""
        area = {i: float(self._select([i]).area.sum()) for i in objects}
        horizons: list[tuple[int, Int32]] = []
        for i in sorted(objects, key=lambda i: (-area[i], i)):
            needed = area[i] * self.settings.density**2
            roomy = (page for page in horizons if self._room_above(page[1]) >= needed)
            if any(self._try_on(i, page, horizon) for page, horizon in roomy):
                continue
            horizon = self.page.empty_horizon()
            if self._try_on(i, self.page_count, horizon):
                horizons.append((self._new_page(), horizon))
            else:
                self._pack_less_dense(i)

    def _room_above(self, horizon: Int32) -> float:
        return float((self.page.inside - horizon).sum()) * self.page.step

    def _apply(self, packed: _Packed) -> None:
        charts = self._charts(packed.objects)
        for i in packed.objects:
            rows = np.arange(self.start[i], self.start[i + 1])
            rows = rows[self.chart[rows] >= 0]
            self.uv[rows] = place_uv(
                self.uv[rows], np.searchsorted(charts, self.chart[rows]), packed.density, packed.shapes, packed.placement
            )
            self.object_page[i] = packed.page
