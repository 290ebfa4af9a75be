"""Layout of all receiving triangles on pages: unwrapped and packed, or from an existing UV layer."""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NoReturn

import numpy as np

from ..scene.scene import SceneSnapshot
from ..util.arrays import Float64, Int32, Int64
from ..util.messages import Status
from ..util.progress import Watch, unwatched
from ..util.settings import MAX_PAGE_SIZE_TEXELS, Settings
from .chart_cache import ChartCache
from .chart_search import find_charts
from .density_search import find_greatest_density
from .even_out import even_out
from .outlines import Outlines
from .packing import Layout, Page, Shapes, place_charts, shape_charts
from .page_plan import FEWEST_TEXELS, ChartDemand, find_page_size, is_one_enough, plan_pages
from .sharing import BlockLayout, join_outlines, lay_block

_MANY_CHARTS = 1000
PACKING = Status("charts", "Packing charts")
_LEAST_SIDE = 2.0**-10  # texels, of the block of an object of almost no size: uv is divided by the side
_LESS_DENSE = 0.96  # factor of the density after a try that took more pages than planned
_TRIES, _MOST_TRIES = 4, 50  # tries before a page more is accepted, and where max_pages allows none


@dataclass(frozen=True)
class ChartAtlas:
    """Charts on square pages.

    page_size     texels
    tri_chart     (n_tri,) int32           -1 for triangles that get no texels
    tri_uv        (n_tri, 3, 2) float64    texels on the page, x right, y up; 0 where tri_chart is -1
    chart_page    (n_chart,) int32
    chart_object  (n_chart,) int32
    object_page   (n_object,) int32        -1 for none; all charts of an object are on one page
    object_block  (n_object,) int32        objects of one block share the UVs (tri_uv / page_size - offset) / scale; -1 for none
    object_place  (n_object, 4) float64    pages: scale along x and y, offset along x and y; 1, 1, 0, 0 without a block
    warnings      subject and sentence
    """

    page_size: int
    page_count: int
    tri_chart: Int32
    tri_uv: Float64
    chart_page: Int32
    chart_object: Int32
    object_page: Int32
    object_block: Int32
    object_place: Float64
    warnings: tuple[tuple[str, str], ...]


def make_charts(snapshot: SceneSnapshot, settings: Settings, watch: Watch = unwatched, kept: ChartCache | None = None) -> ChartAtlas:
    """Lay out the charts of all receiving objects at one density in texels/m; existing layers are kept and get pages of their own.

    If only the page size is chosen, small objects get a higher density (see even_out), and page_plan sets the number of pages. Pages are
    larger than chosen if the charts of one object, which lie on one page, do not fit.

    kept    charts of an earlier bake, see find_charts
    watch   receives UNWRAPPING, PACKING, and the finished share of each; it may raise
    Raises ValueError if charts do not fit the pages at any density, or if xatlas is needed and cannot be loaded, or crashes.
    """
    return _AtlasMaker(snapshot, settings, watch, kept).make()


@dataclass
class _BlockState:
    """The layout of a block.

    smallest, largest   objects of the block
    laid                layout at the last density
    alone               layout of the smallest object on a page, if every object has a page of its own
    """

    smallest: int
    largest: int
    laid: BlockLayout | None = None
    alone: Layout | None = None


class _PageTooSmallError(Exception):
    """The charts of an object, which is the argument, do not fit a page at any density."""


class _AtlasMaker:
    """The state while an atlas is made: pages fill up, warnings are collected."""

    def __init__(self, snapshot: SceneSnapshot, settings: Settings, watch: Watch, kept: ChartCache | None) -> None:
        self.snapshot, self.settings, self._watch = even_out(snapshot, settings), settings, watch
        self.page = Page(settings.size, settings.padding)
        self.page_count = 0
        self.found = find_charts(self.snapshot, settings.share_meshes, watch, kept)
        self.warnings: list[tuple[str, str]] = []
        count = len(snapshot.objects)
        self.start = snapshot.first_tri
        self.uv = np.zeros((snapshot.n_tri, 3, 2))
        self.density = np.full(count, settings.density)
        self.object_page = np.full(count, -1, np.int32)
        self.object_block = np.full(count, -1, np.int32)
        self.object_place = np.tile(np.array([1.0, 1.0, 0.0, 0.0]), (count, 1))
        self.size = np.ones(count)  # size in metres over that of the block's smallest object; `scale` is the same in texels
        self.blocks: list[_BlockState] = []
        for number, block in enumerate(self.found.blocks):
            members = np.array(block.members)
            self.object_block[members], self.size[members] = number, block.size / block.size.min()
            self.blocks.append(_BlockState(int(members[block.size.argmin()]), int(members[block.size.argmax()])))
        # If each object has a page of its own, a block has the same size on all of them.
        self.scale = self.size if settings.atlas or settings.density > 0 else np.ones(count)

    def make(self) -> ChartAtlas:
        found, layered = self.found, self.found.layered
        for i, sentence in found.findings:
            self._warn(i, sentence)
        unwrapped = [i for i in np.flatnonzero(np.diff(found.first_chart)).tolist() if i not in layered]
        n_warning = len(self.warnings)
        while True:
            try:
                self._pack(unwrapped)
                break
            except _PageTooSmallError as small:
                del self.warnings[n_warning:]
                self._enlarge_pages(int(small.args[0]), unwrapped)
                n_warning = len(self.warnings)
        for i in layered:
            self.object_page[i] = self._new_page()
            self.uv[self._rows(i)] = found.uv[self._rows(i)] * float(self.page.size)
        chart_object = np.repeat(np.arange(len(self.object_page)), np.diff(found.first_chart))
        return ChartAtlas(
            self.page.size,
            self.page_count,
            found.chart.astype(np.int32),
            self.uv,
            self.object_page[chart_object],
            chart_object.astype(np.int32),
            self.object_page,
            self.object_block,
            self.object_place,
            tuple(self.warnings),
        )

    def _pack(self, unwrapped: list[int]) -> None:
        self._begin(self.settings.density)
        if self.settings.density > 0:
            self._make_blocks_fit()
        if not self.settings.atlas:
            for i in self._each(unwrapped):
                self._pack_alone(i)
        elif self.settings.density > 0:
            self._pack_first_fit(unwrapped)
            self._check_count()
        elif unwrapped:
            self._pack_by_page_size(unwrapped)

    def _begin(self, density: float) -> None:
        """Remove all pages and set the density, texels/m; 0 for the greatest that fits."""
        self.page_count = 0
        self.density[:] = density
        for block in self.blocks:
            block.alone = None

    def _pack_by_page_size(self, objects: list[int]) -> None:
        """Pack on one page at the greatest density that fits, or on several pages if that is too low."""
        charts = self._select(objects)
        found = self._find_fit(objects)
        demand = self._measure_demand(objects)
        least = demand.find_least_density(self.page)
        several = len(objects) > 1 and self.settings.max_pages != 1
        if found and (not several or is_one_enough(float(np.median(charts.area)), found.density, least)):
            self._apply(objects, self._new_page(), found)
            self._warn_of_small_charts(objects, found.density)
            return
        if len(objects) == 1:
            raise _PageTooSmallError(objects[0])
        if not several:
            self._refuse(objects)
        plan = plan_pages(demand, self.page, self.settings.max_pages)
        density = plan.density
        for left in reversed(range(_MOST_TRIES)) if density else ():
            n_warning = len(self.warnings)
            self._begin(density)
            self._make_blocks_fit()
            self._pack_first_fit(objects)
            density *= _LESS_DENSE
            is_tried_enough = left < _MOST_TRIES - _TRIES or density < least  # then one more page is accepted, if allowed
            if self.page_count <= plan.pages or (is_tried_enough and not self._has_too_many()):
                return
            del self.warnings[n_warning:]
        self._check_count()
        self._refuse(objects)

    def _measure_demand(self, objects: list[int]) -> ChartDemand:
        first, extent = self.found.first_chart, self.found.outlines.extent
        parts = [extent[first[i] : first[i + 1]] for i in objects]
        count, box, around = zip(*((len(part), part.prod(axis=1).sum(), part.sum()) for part in parts), strict=True)
        return ChartDemand(*(np.array(numbers, np.float64) for numbers in (count, box, around)))

    def _has_too_many(self) -> bool:
        return 0 < self.settings.max_pages < self.page_count

    def _check_count(self) -> None:
        """Raise ValueError if there are more pages than max_pages."""
        if self._has_too_many():
            instead = "a lower density" if self.settings.density > 0 else "a greater page size"
            raise ValueError(
                f"The bake needs {self.page_count} pages of {self.page.size} texels, and the most that it may make is "
                f"{self.settings.max_pages}: allow more pages, or choose {instead}."
            )

    def _enlarge_pages(self, i: int, objects: list[int]) -> None:
        """Enlarge the pages until they hold all charts of an object; raises ValueError if no page size does."""
        count = self._count_charts([i])
        size = find_page_size(count, self.page, MAX_PAGE_SIZE_TEXELS) if self.page.inside and self.settings.atlas else 0
        if not size:
            self._refuse(objects if self.settings.atlas else [i])
        self._warn(
            i,
            f"its {count:,} charts do not fit a page of {self.page.size} texels, so pages of {size} are made; "
            "choose that page size or less padding, or separate it into several objects",
        )
        self.page = Page(size, self.page.padding)

    def _refuse(self, objects: list[int]) -> NoReturn:
        names = self.snapshot.objects[objects[0]].name if len(objects) == 1 else f"{len(objects)} objects"
        raise ValueError(
            f"The {self._count_charts(objects):,} charts of {names} do not fit a page of {self.page.size} texels: "
            f"choose a greater page size or less padding{', or allow more pages' if self.settings.max_pages and len(objects) > 1 else ''}."
        )

    def _each(self, objects: list[int]) -> Iterator[int]:
        """The objects in turn, with progress messages."""
        for done, i in enumerate(objects):
            self._watch(PACKING, done / len(objects), self.snapshot.objects[i].name)
            yield i

    def _rows(self, i: int) -> slice:
        return slice(int(self.start[i]), int(self.start[i + 1]))

    def _warn(self, i: int, sentence: str) -> None:
        name = self.snapshot.objects[i].name
        self.warnings.append((name, f"{name}: {sentence}."))

    def _new_page(self) -> int:
        self.page_count += 1
        return self.page_count - 1

    def _select(self, objects: Sequence[int]) -> Outlines:
        first = self.found.first_chart
        return self.found.outlines.select(np.concatenate([np.arange(first[i], first[i + 1]) for i in objects]))

    def _lay_out(self, objects: Sequence[int], density: float) -> Outlines | None:
        """Outlines to place for the objects, in order: of their charts, or of their blocks; None if a block does not fit a page."""
        parts: list[Outlines] = []
        for blocked, group in itertools.groupby(objects, lambda i: self.object_block[i] >= 0):
            if not blocked:
                parts.append(self._select(list(group)))
                continue
            for i in group:
                laid = self._lay_block(i, density)
                if laid is None:
                    return None
                parts.append(laid.outline.scale(float(self.scale[i])))
        return join_outlines(parts)

    def _lay_block(self, i: int, density: float) -> BlockLayout | None:
        """The layout of an object's block; None if it does not fit a page."""
        block = self.blocks[int(self.object_block[i])]
        if block.laid is None or block.laid.layout.density != density:
            block.laid = lay_block(self._select([block.smallest]), density, self.page)
        return block.laid

    def _fit(self, objects: list[int]) -> Layout:
        """The layout of objects on a page at the greatest density; raises _PageTooSmallError if they do not fit."""
        found = self._find_fit(objects)
        if found is None:
            raise _PageTooSmallError(max(objects, key=lambda i: self._count_charts([i])))
        self._warn_of_small_charts(objects, found.density)
        return found

    def _find_fit(self, objects: list[int]) -> Layout | None:
        """As _fit, or None."""
        return find_greatest_density(self._select(objects), self.page, lambda density: self._try(objects, density))

    def _warn_of_small_charts(self, objects: list[int], density: float) -> None:
        first_chart = self.found.first_chart
        for i in objects:
            area = self.found.outlines.area[first_chart[i] : first_chart[i + 1]]
            if float(np.median(area)) * density**2 < FEWEST_TEXELS:
                self._warn(i, "half of its UV islands are smaller than a texel; choose a larger page size or density, or merge small faces")

    def _try(self, objects: list[int], density: float) -> Outlines | None:
        if self._count_charts(objects) >= _MANY_CHARTS:  # a try takes long, so allow cancellation
            self._watch(PACKING, 0.0, "")
        return self._lay_out(objects, density)

    def _count_charts(self, objects: list[int]) -> int:
        first = self.found.first_chart
        return int(sum(first[i + 1] - first[i] for i in objects))

    def _make_blocks_fit(self) -> None:
        """Lower the density of all objects of a block whose largest object does not fit a page."""
        for state, block in zip(self.blocks, self.found.blocks, strict=True):
            shapes = self._shape(state.largest)
            if shapes is None or place_charts(shapes, self.page.empty_horizon()) is None:
                self.density[list(block.members)] = self._fit([state.largest]).density
                if self.settings.density > 0:
                    for i in block.members:
                        self._warn_less_dense(i, float(self.density[i]))

    def _warn_less_dense(self, i: int, density: float) -> None:
        factor = self.snapshot.objects[i].density_factor
        self._warn(
            i,
            f"does not fit a page of {self.page.size} texels at {self.settings.density * factor:g} texels per metre "
            f"and is baked at {density * factor:.3g}; choose a greater page size or a lower density",
        )

    def _pack_alone(self, i: int) -> None:
        shapes = self._shape(i) if self.settings.density > 0 else None
        if shapes and self._try_on(i, shapes, self.page_count, self.page.empty_horizon()):
            self._new_page()
        elif self.object_block[i] < 0:
            self._pack_less_dense(i)
        else:
            block = self.blocks[int(self.object_block[i])]
            block.alone = block.alone or self._fit([block.smallest])
            self._apply([i], self._new_page(), block.alone)

    def _pack_less_dense(self, i: int) -> None:
        layout = self._fit([i])
        if self.settings.density > 0:
            self._warn_less_dense(i, layout.density)
        self._apply([i], self._new_page(), layout)

    def _shape(self, i: int) -> Shapes | None:
        """Shapes of an object at its density; None if it does not fit a page."""
        density = float(self.density[i])
        outlines = self._lay_out([i], density)
        return None if outlines is None else shape_charts(outlines, density, self.page)

    def _try_on(self, i: int, shapes: Shapes, page: int, horizon: Int32) -> bool:
        """Place an object at its density above the horizon, which is raised; returns whether it fits."""
        layout = place_charts(shapes, horizon)
        if layout is not None:
            self._apply([i], page, layout)
        return layout is not None

    def _pack_first_fit(self, objects: list[int]) -> None:
        """Place whole objects, the largest first, each on the first page that has room for it."""
        area = {i: float(self._select([i]).area.sum()) for i in objects}
        horizons: list[tuple[int, Int32]] = []
        for i in self._each(sorted(objects, key=lambda i: (-area[i], i))):
            shapes = self._shape(i)
            needed = area[i] * float(self.density[i]) ** 2
            roomy = (page for page in horizons if self._room_above(page[1]) >= needed)
            if shapes and any(self._try_on(i, shapes, page, horizon) for page, horizon in roomy):
                continue
            horizon = self.page.empty_horizon()
            if shapes and self._try_on(i, shapes, self.page_count, horizon):
                horizons.append((self._new_page(), horizon))
            else:
                self._pack_less_dense(i)

    def _room_above(self, horizon: Int32) -> float:
        return float((self.page.inside - horizon).sum()) * self.page.step

    def _apply(self, objects: list[int], page: int, layout: Layout) -> None:
        """Put objects on a page by the layout of their charts or blocks."""
        part = 0
        for i in objects:
            rows = np.arange(self.start[i], self.start[i + 1])
            rows = rows[self.found.chart[rows] >= 0]
            uv, chart = self.found.uv[rows], self.found.chart[rows] - self.found.first_chart[i]
            if self.object_block[i] < 0:
                self.uv[rows] = layout.place(uv, part + chart)
                part += int(self.found.first_chart[i + 1] - self.found.first_chart[i])
            else:
                self.uv[rows] = self._place_block(i, uv, chart, layout, part)
                part += 1
            self.object_page[i] = page

    def _place_block(self, i: int, uv: Float64, chart: Int64, layout: Layout, part: int) -> Float64:
        """UVs of an object of a block, in texels; sets its object_place."""
        block = self._lay_block(i, layout.density)
        assert block is not None, "it was laid out to be packed"
        offset = layout.offset[part]
        side = max(float(block.side.max()) * self.scale[i], _LEAST_SIDE)
        self.object_place[i] = np.array([side, side, *offset]) / self.page.size
        return block.place(uv / self.size[i], chart) * self.scale[i] + offset
