"""Charts of all receiving objects before packing: unwrapped, or from an existing UV layer."""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..scene.scene import SceneSnapshot
from ..scene.topology import join_open_sides
from ..util.arrays import BoolArray, Float64, Int64, IntArray
from ..util.geometry import triangle_normals_areas
from ..util.messages import Status
from ..util.progress import Watch, unwatched
from .chart_cache import ChartCache, PendingCharts
from .layer_check import check_layer, label_charts
from .outlines import Outlines, measure_outlines, straighten_charts
from .sharing import Block, find_blocks, find_copies, follow_charts
from .unfolding import UnfolderDied

_NO_FACES = "no face can be baked, so it gets no lightmap; give it faces with an area, or leave it out of the bake"
_NO_LAYER = "no face can be baked as the UV layer has it, so it gets no lightmap; mend the layer, or have it unwrapped instead"
UNWRAPPING = Status("charts", "Unwrapping")
_AT_ONCE = 1 << 10  # small objects are grouped up to this number of triangles for post-processing, since numpy is slow on few
_MOST_AHEAD = 1 << 18  # triangles sent to xatlas ahead of the post-processing of its results, to bound memory


@dataclass(frozen=True)
class FoundCharts:
    """The charts of a scene; charts of one object are consecutive.

    chart         (n_tri,) int64         -1 for triangles that get no texels
    uv            (n_tri, 3, 2) float64  in metres, each chart upright and with its corner at 0; in pages for kept layers
    first_chart   (n_object + 1,) int64: charts of object i are first_chart[i]:first_chart[i + 1]
    outlines      outlines of all charts; empty for kept layers, which are not packed
    layered       objects whose layer is kept
    blocks        objects that share charts, each in its own metres
    findings      (object, warning)
    """

    chart: Int64
    uv: Float64
    first_chart: Int64
    outlines: Outlines
    layered: tuple[int, ...]
    blocks: tuple[Block, ...]
    findings: tuple[tuple[int, str], ...]


def find_charts(snapshot: SceneSnapshot, share_meshes: bool, watch: Watch = unwatched, kept: ChartCache | None = None) -> FoundCharts:
    """The charts of all receiving objects.

    share_meshes   whether objects that share a mesh share charts where possible
    watch          receives UNWRAPPING, the finished share of triangles, and the current object; it may raise
    kept           charts of an earlier bake; updated to those of this one
    Raises ValueError if xatlas is needed and cannot be loaded, or crashes.
    """
    search = _Search(snapshot, find_blocks(snapshot) if share_meshes else [], watch, kept or ChartCache())
    count = np.zeros(len(snapshot.objects) + 1, np.int64)
    layered = []
    try:
        for i, one in enumerate(snapshot.objects):
            if not one.receives:
                continue
            search.watch(i)
            count[i + 1] = search.read_layer(i) if one.has_layer else search.unwrap(i)
            if not count[i + 1]:
                search.findings.append((i, _NO_LAYER if one.has_layer and search.find_solid(i).any() else _NO_FACES))
            elif one.has_layer:
                layered.append(i)
    finally:
        search.cancel()
    first_chart = np.cumsum(count)
    chart = np.where(search.chart >= 0, search.chart + first_chart[snapshot.tri_object], -1)
    packed = (chart >= 0) & ~np.isin(snapshot.tri_object, layered)
    outlines = measure_outlines(search.uv[packed], chart[packed], search.shared[packed], int(first_chart[-1]))
    return FoundCharts(chart, search.uv, first_chart, outlines, tuple(layered), tuple(search.blocks), tuple(search.findings))


class _Search:
    """State of the search: arrays that are filled object by object. `chart` counts from 0 in each object."""

    def __init__(self, snapshot: SceneSnapshot, blocks: list[Block], watch: Watch, kept: ChartCache) -> None:
        self.snapshot, self.blocks, self._watch, self._kept = snapshot, blocks, watch, kept
        self.findings: list[tuple[int, str]] = []
        self.chart = np.full(snapshot.n_tri, -1, np.int64)
        self.uv = np.zeros((snapshot.n_tri, 3, 2))
        self.shared = np.zeros((snapshot.n_tri, 3), bool)
        self._vertex = join_open_sides(snapshot.vertex_position, snapshot.tri_vertex, snapshot.tri_object)
        self._start = snapshot.first_tri
        self._owner_of = self._find_owners()
        self._unwrapped: dict[int, tuple[Int64, Float64, BoolArray]] = {}  # charts by their owner
        owners = [self._owner_of.get(i, (i, 1.0))[0] for i in self._unlayered()]
        self._to_begin = deque(dict.fromkeys(owners))
        self._begun: deque[tuple[list[int], PendingCharts]] = deque()  # owners of each request
        receiving = np.array([one.receives for one in snapshot.objects], bool)
        self._done = np.concatenate([[0], np.cumsum(np.diff(self._start) * receiving)])  # triangles before each object, and in total
        self._ahead = 0  # triangles of the begun objects

    def watch(self, i: int, done: int = 0) -> None:
        """Report progress within object i, of which `done` triangles are finished."""
        self._watch(UNWRAPPING, float((self._done[i] + done) / max(self._done[-1], 1)), self.snapshot.objects[i].name)

    def unwrap(self, i: int) -> int:
        """Find the charts of an object and return their number."""
        owner, size = self._owner_of.get(i, (i, 1.0))
        while owner not in self._unwrapped:
            self._unfold_more(i)
        chart, uv, shared = self._unwrapped[owner]
        if i not in self._owner_of:
            return self._keep(i, *self._unwrapped.pop(i))
        corner = self.snapshot.tri_corner
        uv, shared = follow_charts(corner[self._rows(i)], corner[self._rows(owner)], uv, shared)
        return self._keep(i, chart, uv * size, shared)

    def cancel(self) -> None:
        """Give up all pending charts."""
        for _, unwrapping in self._begun:
            unwrapping.cancel()

    def read_layer(self, i: int) -> int:
        """Take the charts of an object from its UV layer and return their number."""
        scene, rows = self.snapshot, self._rows(i)
        check = check_layer(scene.tri_uv[rows], scene.tri_polygon[rows], self.find_solid(i))
        self.findings += [(i, finding) for finding in check.findings]
        uv = np.where(check.usable[:, None, None], scene.tri_uv[rows], 0.0)
        chart, shared = label_charts(self._vertex[rows], scene.tri_corner[rows], uv, np.where(check.usable, 0, -1))
        return self._keep(i, chart, np.clip(uv, 0.0, 1.0), shared)

    def find_solid(self, i: int) -> BoolArray:
        """(n,) bool: whether an object's triangles have an area in space."""
        return triangle_normals_areas(self.snapshot.vertex_position[self.snapshot.tri_vertex[self._rows(i)]])[1] > 0

    def _rows(self, i: int) -> slice:
        return slice(int(self._start[i]), int(self._start[i + 1]))

    def _rows_of(self, objects: list[int]) -> Int64:
        return np.concatenate([np.arange(self._start[i], self._start[i + 1]) for i in objects])

    def _count(self, i: int) -> int:
        return int(self._start[i + 1] - self._start[i])

    def _unlayered(self) -> list[int]:
        return [i for i, one in enumerate(self.snapshot.objects) if one.receives and not one.has_layer]

    def _find_owners(self) -> dict[int, tuple[int, float]]:
        """For each object with shared charts: their owner, which may be the object itself, and the object's size relative to the owner."""
        in_block = {i: (block.members[0], float(size)) for block in self.blocks for i, size in zip(block.members, block.size, strict=True)}
        copies = find_copies(self.snapshot, self._vertex, [i for i in self._unlayered() if in_block.get(i, (i,))[0] == i])
        owner_of = {leader: (leader, 1.0) for leader, _ in copies.values()}
        for i, (leader, size) in [*copies.items(), *in_block.items()]:
            owner, size_of_leader = copies.get(leader, (leader, 1.0))
            owner_of[i] = owner, size * size_of_leader
        return owner_of

    def _unfold_more(self, waiting: int) -> None:
        """Wait for the charts of the first pending request and store them."""
        for _ in self._begin_more():
            self.watch(waiting)
        objects, unwrapping = self._begun[0]
        rows = self._rows_of(objects)
        try:
            chart, uv, shared = unwrapping.finish(self.watch)
        except UnfolderDied as died:
            code, i = died.args
            raise ValueError(
                f"{self.snapshot.objects[i].name}: the unwrapper xatlas ended unexpectedly on it (code {code}); give it a UV layer of "
                "its own and choose that, make its mesh simpler, or leave it out of the bake."
            ) from died
        self._begun.popleft()
        self._ahead -= len(rows)
        owner = self.snapshot.tri_object[rows]
        uv *= np.array([one.density_factor for one in self.snapshot.objects])[owner][:, None, None]
        used = chart >= 0
        uv[used] = straighten_charts(uv[used], chart[used], shared[used], int(chart.max(initial=-1)) + 1)
        begin = done = 0
        for i in objects:
            own = slice(begin, begin := begin + self._count(i))
            self._unwrapped[i] = np.where(chart[own] >= 0, chart[own] - done, -1), uv[own], shared[own]
            done = max(done, int(chart[own].max(initial=-1)) + 1)

    def _begin_more(self) -> Iterator[None]:
        """Send further objects to xatlas, which then works during the post-processing of earlier ones; yields after each request."""
        scene = self.snapshot
        while self._to_begin and self._ahead < _MOST_AHEAD:
            objects = [self._to_begin.popleft()]
            while self._to_begin and sum(map(self._count, objects)) + self._count(self._to_begin[0]) <= _AT_ONCE:
                objects.append(self._to_begin.popleft())
            rows = self._rows_of(objects)
            owner = scene.tri_object[rows]
            position = scene.vertex_position[scene.tri_vertex[rows]]
            polygon, corner = _number_by_owner(scene.tri_polygon[rows], owner), _number_by_owner(scene.tri_corner[rows], owner[:, None])
            self._begun.append((objects, self._kept.begin(position, self._vertex[rows], polygon, corner, owner)))
            self._ahead += len(rows)
            yield

    def _keep(self, i: int, chart: Int64, uv: Float64, shared: BoolArray) -> int:
        rows = self._rows(i)
        self.chart[rows], self.uv[rows], self.shared[rows] = chart, uv, shared
        return int(chart.max(initial=-1)) + 1


def _number_by_owner(number: IntArray, owner: IntArray) -> Int64:
    """Numbers that are unique within each object, made unique among all objects."""
    return owner.astype(np.int64) * (int(number.max(initial=0)) + 1) + number
