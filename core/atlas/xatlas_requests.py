"""Requests to xatlas for objects' charts, and the reading of its results."""

from collections import Counter, deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial

import numpy as np

from ..scene.topology import join_sets, pair_sides
from ..util.arrays import BoolArray, Float64, Int64, IntArray
from ..util.geometry import orthonormal_basis
from .layer_check import signed_areas
from .unfolding import UnfolderDied, own_unfolder, wait_for
from .xatlas_process import Mesh, Unfolded

_LARGEST_COORDINATE = 1e5  # float32 then still resolves 1 % of a triangle of median size
_AT_ONCE = 1 << 14  # triangles per request, 0.1 s to a few seconds of work
_FLATNESS = 1e-5  # of a chart's extent: a chart nearer to its plane is projected onto it, in float64
_COPLANAR = 1.0 - 1e-7  # cosine between triangles above which they lie in one plane


@dataclass(frozen=True)
class _Ask:
    """One request: its objects, its pieces, and the future result."""

    objects: list[int]
    pieces: list[int]
    answer: Future[list[Unfolded]]


class XatlasRequests:
    """Requests to xatlas for some objects, which are sent on construction."""

    def __init__(
        self, position: Float64, normal: Float64, area: Float64, tri_vertex: IntArray, tri_polygon: IntArray, tri_object: IntArray
    ) -> None:
        """position      (n, 3, 3) float64, m
        normal        (n, 3) float64
        area          (n,) float64, m^2, above 0
        tri_vertex    (n, 3) int   objects have no vertices in common, nor polygons
        tri_polygon   (n,) int
        tri_object    (n,) int, triangles of an object are consecutive
        """
        self._position, self._normal, self._area = position, normal, area
        vertex = np.unique(tri_vertex, return_inverse=True)[1].reshape(-1, 3)
        loose = join_sets(vertex.max(initial=-1) + 1, vertex.ravel(), np.roll(vertex, -1, axis=1).ravel())[vertex[:, 0]]
        _, one, other = pair_sides(vertex, np.zeros(len(vertex), np.int64))
        one, other = one // 3, other // 3
        cosine = _dot(normal[one], normal[other])
        facet = join_sets(len(vertex), one[cosine > _COPLANAR], other[cosine > _COPLANAR])
        centre = position.mean(axis=1)
        # Loose parts are separate meshes, each centred and scaled, since float32 would not resolve a teaspoon in a hall.
        self._pieces = [
            part[rows] for part in _split(loose, tri_object) for rows in split_part(facet[part], tri_polygon[part], centre[part])
        ]
        self._meshes, self._scaled_area = _make_meshes(self._pieces, position, area, vertex)
        self._dense = np.array([is_dense(facet[rows]) for rows in self._pieces], bool)
        self._of_piece = np.array([tri_object[rows[0]] for rows in self._pieces], np.int64)
        self._asks: deque[_Ask] = deque()
        if self._pieces:
            self._put(np.unique(tri_object).tolist())

    def _put(self, objects: list[int]) -> None:
        """Send requests. Each has several small objects, since making an atlas takes longer than unfolding a box; but there are several
        requests, so that first results come early.
        """
        wanted, asked = np.isin(self._of_piece, objects), []
        for dense in (False, True):
            pieces = np.flatnonzero(wanted & (self._dense == dense))
            part = np.cumsum([len(self._pieces[k]) for k in pieces]) // _AT_ONCE
            asked += np.split(pieces, np.flatnonzero(np.diff(part)) + 1) if len(pieces) else []
        for own in sorted(asked, key=lambda pieces: int(pieces[0])):  # in the order of objects, which progress follows
            answer = own_unfolder().ask([self._meshes[k] for k in own], float(self._scaled_area[own].sum()), bool(self._dense[own[0]]))
            self._asks.append(_Ask(np.unique(self._of_piece[own]).tolist(), own.tolist(), answer))

    def cancel(self) -> None:
        """Give up the results."""
        for ask in self._asks:
            own_unfolder().give_up(ask.answer)

    def read(self, watch: Callable[[int, int], None] = lambda *_: None) -> tuple[Int64, Float64]:
        """(n,) int64 chart, -1 if xatlas left a triangle out; (n, 3, 2) float64 UV, m, each chart with its area in space as UV area.

        watch   called regularly while xatlas works, with the current object and its number of finished triangles; it may raise
        Raises ValueError if xatlas cannot be loaded, UnfolderDied with the code and the object if it crashes.
        """
        group, uv = np.full(len(self._area), -1, np.int64), np.zeros((len(self._area), 3, 2))
        done: Counter[int] = Counter()
        while self._asks:  # requests stay in the list until they are read, so that `cancel` finds the rest
            ask = self._asks[0]
            try:
                answer = wait_for(ask.answer, partial(watch, ask.objects[0], done[ask.objects[0]]))
            except UnfolderDied as died:
                if len(ask.objects) == 1:
                    raise UnfolderDied(died.args[0], ask.objects[0]) from died
                for one in ask.objects:  # one of them made xatlas crash; find out which
                    self._put([one])
            else:
                for k, (chart, piece_uv) in zip(ask.pieces, answer, strict=True):
                    rows = self._pieces[k]
                    group[rows], uv[rows] = np.where(chart >= 0, chart + k * len(group), -1), piece_uv
                    done[int(self._of_piece[k])] += len(rows)
            self._asks.popleft()
        placed = group >= 0
        position, area = self._position[placed], self._area[placed]
        chart = np.unique(group[placed], return_inverse=True)[1].ravel()
        is_flat, projected = _project_flat_charts(position, self._normal[placed], area, chart)
        if not is_flat.all():
            projected = np.where(is_flat[:, None, None], projected, _restore_proportions(position, uv[placed], area, chart))
        group[placed], uv[placed] = chart, projected
        return group, uv


def _split(loose: Int64, tri_object: IntArray) -> list[Int64]:
    """Rows of the triangles of each loose part, ordered by object."""
    order = np.lexsort((loose, tri_object))
    return np.split(order, np.flatnonzero(np.diff(loose[order])) + 1) if len(order) else []


def _make_meshes(pieces: list[Int64], position: Float64, area: Float64, vertex: Int64) -> tuple[list[Mesh], Float64]:
    """The pieces as meshes for xatlas, centred and scaled, and their scaled areas."""
    if not pieces:
        return [], np.zeros(0)
    rows, count = np.concatenate(pieces), np.array([len(piece) for piece in pieces])
    owner = np.repeat(np.arange(len(pieces)), count)
    first = np.cumsum(count) - count
    points = position[rows]
    centre = 0.5 * (np.minimum.reduceat(points.min(axis=1), first) + np.maximum.reduceat(points.max(axis=1), first))
    points -= centre[owner][:, None]
    # xatlas leaves out triangles below an absolute area, so the median triangle gets area 1.
    by_area = area[rows[np.lexsort((area[rows], owner))]]
    median = 0.5 * (by_area[first + (count - 1) // 2] + by_area[first + count // 2])
    scale = np.minimum(median**-0.5, _LARGEST_COORDINATE / np.maximum.reduceat(np.abs(points).max(axis=(1, 2)), first))
    points *= scale[owner][:, None, None]
    n_vertex = int(vertex.max()) + 1
    known, place, index = np.unique(owner[:, None] * n_vertex + vertex[rows], return_index=True, return_inverse=True)
    corner = np.ascontiguousarray(points.reshape(-1, 3)[place], np.float32)
    begin = np.searchsorted(known, np.arange(len(pieces) + 1) * n_vertex)
    triangle = (index.reshape(-1, 3) - begin[owner][:, None]).astype(np.uint32)
    meshes = [(corner[begin[k] : begin[k + 1]], triangle[first[k] : first[k] + count[k]]) for k in range(len(pieces))]
    return meshes, np.bincount(owner, area[rows]) * scale**2


def _restore_proportions(position: Float64, uv: Float64, area: Float64, group: Int64) -> Float64:
    """Undo xatlas's stretching of charts to whole texels: scale u and v so that each chart is as conformal as possible, not mirrored, and
    has its area in space.
    """
    edge, uv_edge = position[:, 1:] - position[:, :1], uv[:, 1:] - uv[:, :1]
    uv_area = signed_areas(uv)
    steep = np.abs(uv_area) > 1e-9 * (uv_edge**2).sum(axis=(1, 2))  # the map of a degenerate triangle has no derivative
    weight = np.where(steep, area / np.where(steep, uv_area**2, 1.0), 0.0)
    along_u = ((edge[:, 0] * uv_edge[:, 1, 1:] - edge[:, 1] * uv_edge[:, 0, 1:]) ** 2).sum(axis=1)
    along_v = ((edge[:, 1] * uv_edge[:, 0, :1] - edge[:, 0] * uv_edge[:, 1, :1]) ** 2).sum(axis=1)
    n_chart = group.max(initial=-1) + 1
    sums = [np.bincount(group, values, n_chart) for values in (weight * along_u, weight * along_v, area, uv_area)]
    known = (sums[0] > 0) & (sums[1] > 0)
    ratio = np.sqrt(np.where(known, sums[0], 1.0) / np.where(known, sums[1], 1.0)) ** 0.5
    size = np.sqrt(sums[2] / np.where(sums[3] != 0, np.abs(sums[3]), 1.0))
    scale = np.stack([np.where(sums[3] < 0, -1.0, 1.0) * size * ratio, size / ratio], axis=1)
    return uv * scale[group][:, None]


def _project_flat_charts(position: Float64, normal: Float64, area: Float64, group: Int64) -> tuple[BoolArray, Float64]:
    """(n,) bool: whether triangles are in flat charts; and (n, 3, 2): all projected onto their charts' planes, exact for flat charts."""
    n_chart = group.max(initial=-1) + 1
    axis = sum_by(group, normal * area[:, None], n_chart)
    length = np.linalg.norm(axis, axis=1)
    axis = axis / np.where(length > 0, length, 1.0)[:, None]
    centre = sum_by(group, position.mean(axis=1), n_chart) / np.maximum(np.bincount(group, minlength=n_chart), 1)[:, None]
    offset = position - centre[group][:, None]
    height, extent = np.zeros(n_chart), np.zeros(n_chart)
    np.maximum.at(height, group, np.abs(_dot(offset, axis[group][:, None])).max(axis=1))
    np.maximum.at(extent, group, np.abs(offset).max(axis=(1, 2)))
    facing = (normal * axis[group]).sum(axis=1) > 0
    is_flat: BoolArray = (height <= _FLATNESS * extent)[group] & (np.bincount(group, ~facing, n_chart) == 0)[group]
    return is_flat, project(offset, axis[group])


def project(position: Float64, axis: Float64) -> Float64:
    """(n, 3, 2) float64: corners (n, 3, 3) projected onto the planes normal to the unit vectors (n, 3)."""
    tangent, bitangent = orthonormal_basis(axis)
    return np.stack([_dot(position, tangent[:, None]), _dot(position, bitangent[:, None])], axis=2)


def _dot(one: Float64, other: Float64) -> Float64:
    """Dot products, summed term by term: unlike with einsum, the rounding does not depend on the position in the array."""
    x, y, z = (one[..., k] * other[..., k] for k in range(3))
    return np.asarray(x + y + z)


def sum_by(group: Int64, values: Float64, count: int) -> Float64:
    """(count, 3) float64: sums of vectors (n, 3) over the members of each group."""
    return np.stack([np.bincount(group, values[:, k], count) for k in range(3)], axis=1)


_MOST_FACETS = 1 << 11  # with half as many more, xatlas takes half as long again on rough grounds, and hardly more texels fit on a page
_DENSE_FACETS = 1 << 10  # pieces with fewer grow large charts in little time


def is_dense(tri_facet: IntArray) -> bool:
    """Whether a piece has so many facets, given for each of its triangles (n,), that xatlas should grow small charts first."""
    return len(tri_facet) > _DENSE_FACETS and len(np.unique(tri_facet)) > _DENSE_FACETS


def split_part(tri_facet: IntArray, tri_polygon: IntArray, tri_centre: Float64) -> list[Int64]:
    """Rows of the triangles of each piece: the part is halved along its longest axis until no piece has more than _MOST_FACETS facets.

    For each triangle that xatlas adds to a chart, it evaluates the whole chart again, so its time grows with the square of the number of
    triangles: a smooth ground of 20,000 takes ten times as long as one of 5,000, and one of a million would take half a day. Coplanar
    triangles cost nothing. In dense pieces, xatlas also grows small charts first and then joins them (xatlas_process).

    tri_facet     (n,) int, equal for connected coplanar triangles, which stay together
    tri_polygon   (n,) int, equal for triangles of a polygon, which stay together too
    tri_centre    (n, 3) float64
    """
    if len(tri_facet) <= _MOST_FACETS:
        return [np.arange(len(tri_facet))]
    facet, polygon = (np.unique(label, return_inverse=True)[1].ravel() for label in (tri_facet, tri_polygon))
    n_facet = int(facet.max()) + 1
    whole = join_sets(n_facet + len(polygon), facet, n_facet + polygon)[:n_facet]  # facets that share a polygon
    whole = np.unique(whole, return_inverse=True)[1].ravel()
    owner = whole[facet]
    count = np.bincount(owner)
    centre = sum_by(owner, tri_centre, len(count)) / count[:, None]
    piece = np.zeros(len(count), np.int64)
    for number, rows in enumerate(_halve(centre, np.bincount(whole))):
        piece[rows] = number
    order = np.argsort(piece[owner], kind="stable")
    return np.split(order, np.flatnonzero(np.diff(piece[owner[order]])) + 1)


def _halve(place: Float64, facets: Int64) -> list[Int64]:
    """Sets of rows near each other, with at most _MOST_FACETS facets each, of items at positions (n, 3) with facets (n,)."""
    rest, done = [np.arange(len(place))], []
    while rest:
        rows = rest.pop()
        if len(rows) == 1 or facets[rows].sum() <= _MOST_FACETS:
            done.append(rows)
            continue
        axis = int(np.ptp(place[rows], axis=0).argmax())
        order = rows[np.argsort(place[rows, axis], kind="stable")]
        rest += [order[len(rows) // 2 :], order[: len(rows) // 2]]
    return done
