"""The covered texels of all charts: their moments, points of a texel on triangles, and the texel of a hit."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ..util.arrays import BoolArray, Float32, Float64, FloatArray, Int32, Int64, IntArray
from ..util.coverage import CHUNK_SIZE, as_slice, clip_to_texels, expand_ranges
from .split_texels import TexelBorders
from .texel_footprint import TexelFootprints, are_inside
from .texel_grid import TexelGrid
from .texel_moments import EvenSquares, PartMoments

CHART_SHIFT = 30  # bits of a key below its chart: a Morton code of a 2^14 root has 28
FOOTPRINT_SIDE = 0.5  # side of a texel's footprint, a square around its centre
_EVEN = 1e-3  # relative difference of densities up to which a texel of several triangles counts as evenly covered


@dataclass(frozen=True)
class TexelMap:
    """One entry per (chart, texel) with covered area, sorted by (chart, Morton code).

    chart_page     (n_chart,) int32
    chart_origin   (n_chart, 2) int32       page texel of the quadtree root's lower left corner
    chart_log2     (n_chart,) int32         the root's side is 2**k texels
    chart_piece    (n_chart,) int32         parts of one original chart share a piece: light is continuous between them
    chart_start    (n_chart + 1,) int64     entries of chart c are chart_start[c]:chart_start[c + 1]
    texel_chart    (n,) int32
    texel_xy       (n, 2) int32             page texel
    texel_code     (n,) int32               Morton code of texel_xy - chart_origin
    texel_area     (n,) float64, m^2        world area of the chart inside the texel
    texel_tri      (n,) int32               triangle of the representative point
    grid           lookup of entries by triangle and texel
    tri_uv         (n_tri + 1, 3, 2) float64   page texels; the last stands for no triangle
    tri_density    (n_tri,) float64         m^2 per texel^2
    part_entry     (n_part,) int64          entries that are not wholly inside their triangles, ascending
    part_point     (n_part, 2) float64      their representative points, texels from the texel's centre; 0 if the centre is covered
    part_moments   (n_part, M) float64, m^2 their moments about the texel's centre, in texels, less those of a full texel of equal area
    pair_start     (n_part + 1,) int64      pairs of part i are pair_start[i]:pair_start[i + 1]
    pair_tri       (n_pair,) int32          triangles with a share in the part
    borders        borders of texels that another surface divides
    """

    page_size: int
    page_count: int
    degree: int
    chart_page: Int32
    chart_origin: Int32
    chart_log2: Int32
    chart_piece: Int32
    chart_start: Int64
    texel_chart: Int32
    texel_xy: Int32
    texel_code: Int32
    texel_area: Float64
    texel_tri: Int32
    grid: TexelGrid
    tri_uv: Float64
    tri_density: Float64
    part_entry: Int64
    part_point: Float64
    part_moments: Float64
    pair_start: Int64
    pair_tri: Int32
    borders: TexelBorders = field(default_factory=TexelBorders.none)

    def __len__(self) -> int:
        """Number of entries."""
        return len(self.texel_tri)

    def page_of(self, entry: IntArray | slice) -> Int32:
        """(m,) int32: the pages of entries (m,)."""
        return self.chart_page[self.texel_chart[entry]]

    @property
    def texel_bary(self) -> Float32:
        """(n, 3) float32: corner weights on texel_tri of each entry's representative point, which is covered."""
        return self.bary_at(np.arange(len(self)))

    def bary_at(self, entry: IntArray) -> Float32:
        """texel_bary at entries (m,) int; a view of (3, m) rows."""
        u, v = self._corner_weights(self.texel_tri[entry], *self.own_points_at(entry))
        return np.stack([np.maximum(1.0 - (u + v), 0.0), u, v]).astype(np.float32).T

    def own_points(self, start: int, stop: int) -> Float64:
        """(2, stop - start) float64, page texels: x and y of the representative points of entries start ... stop - 1."""
        point = np.add(self.texel_xy[start:stop].T, 0.5, order="C")
        parts = slice(*np.searchsorted(self.part_entry, (start, stop)))
        point[:, self.part_entry[parts] - start] += self.part_point[parts].T
        return point

    def own_points_at(self, entry: IntArray) -> Float64:
        """(2, m) float64: own_points at entries (m,)."""
        rows, part = self._find_parts(entry)
        point = np.add(self.texel_xy[entry].T, 0.5, order="C")
        point[:, rows] += self.part_point[part].T
        return point

    def _find_parts(self, entry: IntArray) -> tuple[Int64, Int64]:
        """Which of entries (m,) are covered in part: (k,) int64 of them, and (k,) int64 rows of the part_ fields."""
        rows = np.flatnonzero(self.is_part.take(entry))
        return rows, np.searchsorted(self.part_entry, entry[rows])

    @cached_property
    def is_part(self) -> BoolArray:
        """(n,) bool: whether an entry is covered in part."""
        is_part = np.zeros(len(self), bool)
        is_part[self.part_entry] = True
        return is_part

    @cached_property
    def is_central(self) -> BoolArray:
        """(n,) bool: whether the chart covers the texel's centre."""
        central = np.ones(len(self), bool)
        central[self.off_centre] = False
        return central

    @cached_property
    def off_centre(self) -> Int64:
        """(k,) int64, ascending: entries that are not central."""
        return self.part_entry.compress(self.part_point.any(axis=1))

    @cached_property
    def entry_at(self) -> Int32:
        """(page_count, size, size) int32: the entry that a page shows at each texel, -1 where no chart covers it.

        This is the entry that covers the texel's centre, where image filters sample it; if several do, or none does, the largest one.
        """
        entry_at = np.full(self.page_count * self.page_size**2, -1, np.int32)
        for entry in self._parts():
            entry_at[self._find_cells(entry)] = entry
        if not self._has_room_for_all(entry_at):  # rare: charts meet along a crease, or a layer overlaps itself
            hidden = [cell[entry_at[cell] != entry] for entry in self._parts() for cell in [self._find_cells(entry)]]
            shared = np.zeros(len(entry_at), bool)
            shared[np.concatenate(hidden)] = True
            rivals = np.concatenate([entry[shared[self._find_cells(entry)]] for entry in self._parts()])
            cell = self._find_cells(rivals)
            order = np.lexsort((self.texel_area[rivals], self.is_central[rivals], cell))
            entry_at[cell[order]] = rivals[order]  # of several assignments to one place the last stays
        return entry_at.reshape(self.page_count, self.page_size, self.page_size)

    @cached_property
    def shown(self) -> BoolArray:
        """(n,) bool: whether the page shows the entry, see entry_at."""
        if self._has_room_for_all(self.entry_at):
            return np.ones(len(self), bool)
        parts = (self.entry_at.ravel()[self._find_cells(entry)] == entry for entry in self._parts())
        return np.concatenate([np.zeros(0, bool), *parts])

    def _has_room_for_all(self, entry_at: Int32) -> bool:
        """Whether no two entries share a texel of a page."""
        return np.count_nonzero(entry_at >= 0) == len(self)

    def list_keys(self, entry: IntArray | slice) -> Int64:
        """(m,) int64: chart and Morton code of entries (m,), in one number that ascends with the entries."""
        keys = self.texel_chart[entry].astype(np.int64)
        keys <<= CHART_SHIFT
        keys |= self.texel_code[entry]
        return keys

    def are_covered(self) -> BoolArray:
        """(n,) bool: entries that their chart covers in full and evenly, by one triangle or several."""
        covered = np.ones(len(self), bool)
        first, tri = self.part_entry, self.pair_tri[self.pair_start[0] : self.pair_start[-1]]
        density = self.tri_density[self.texel_tri[first]]
        part = np.repeat(np.arange(len(first)), np.diff(self.pair_start))
        is_uneven = np.abs(self.tri_density[tri] - density[part]) > _EVEN * density[part]
        is_uneven = np.bincount(part, is_uneven, len(first)) > 0
        is_uneven |= np.abs(self.texel_area[first] - density) > _EVEN * density
        covered[first] = ~(is_uneven | self.part_point.any(axis=1))
        return covered

    def _parts(self) -> Iterator[Int64]:
        """All entries in chunks whose intermediate arrays fit the cache."""
        return (np.arange(start, min(start + CHUNK_SIZE, len(self))) for start in range(0, len(self), CHUNK_SIZE))

    def _find_cells(self, entry: Int64) -> Int64:
        """(m,) int64: flat indices of entries (m,), ascending, among the texels of all pages."""
        rows = as_slice(entry)
        x, y = self.texel_xy[rows].T
        cell: Int64 = y.astype(np.int64)
        cell *= self.page_size
        cell += x
        if self.page_count > 1:
            cell += self.page_of(rows).astype(np.int64) * self.page_size**2
        return cell

    @cached_property
    def _corner_frames(self) -> Float64:
        """(7, n_tri + 1) float64: x, y of corner 0 and of both edges from it, and twice the signed area."""
        corner_0, corner_1, corner_2 = self.tri_uv.transpose(1, 2, 0)
        (x_1, y_1), (x_2, y_2) = corner_1 - corner_0, corner_2 - corner_0
        return np.stack([*corner_0, x_1, y_1, x_2, y_2, x_1 * y_2 - y_1 * x_2])

    def hit_texel_xy(self, tri: IntArray, u: FloatArray, v: FloatArray) -> tuple[Float64, Float64]:
        """Page texel coordinates of hits.

        tri   (m,) int      -1 gives 0, 0
        u, v  (m,) float    weights of corners 1 and 2
        out   (m,) float64 x, (m,) float64 y
        """
        x, y, x_1, y_1, x_2, y_2 = self._corner_frames[:6].take(tri, axis=1, mode="wrap")
        for at, edge_1, edge_2 in ((x, x_1, x_2), (y, y_1, y_2)):
            edge_1 *= u
            edge_2 *= v
            at += edge_1
            at += edge_2
        return x, y

    def entry_of(self, tri: IntArray, x: FloatArray, y: FloatArray) -> Int32:
        """(m,) int32: entries that hits belong to; -1 for a miss and where the triangle has no texels.

        tri   (m,) int      -1 for a miss
        x, y  (m,) float    page texel coordinates
        """
        return self.grid.find(tri, x, y)

    def owner_of(self, entry: Int32, x: FloatArray, y: FloatArray) -> Int32:
        """(m,) int32: entries that own hits in texels entry (m,) >= 0: beyond a dividing surface, the entry on the other side.

        x, y   (m,) float, page texel coordinates
        """
        if not len(self.borders.entry):
            return entry
        column, row = self.texel_xy.take(entry, axis=0, mode="wrap").T
        return self.borders.find_owners(entry, x - column - 0.5, y - row - 0.5)

    def range_moments(self, start: IntArray, end: IntArray, centre: FloatArray, half: FloatArray, degree: int) -> Float64:
        """World-area integrals of the monomials in s = (x - centre) / half over ranges of entries.

        start, end  (k,) int        ranges may be empty, overlap and nest
        centre      (k, 2) float    page texels
        half        (k,) float      texels
        out         (k, M) float64, m^2, in the order 1, s, t, s^2, st, t^2, s^3, s^2 t, ...
        Raises ValueError when the degree is not 0, 2 or 4 or exceeds that of the map.
        """
        if degree > self.degree:
            raise ValueError(f"degree: expected at most {self.degree}, that of the texel map, got {degree}")
        moments = self._even_squares.range_moments(start, end, centre, half, degree)
        if degree:
            moments += PartMoments(self.part_entry, self.texel_xy, self.part_moments).range_moments(start, end, centre, half, degree)
        return np.ascontiguousarray(moments.T)

    @cached_property
    def _even_squares(self) -> EvenSquares:
        return EvenSquares.of(self.texel_chart, self.texel_code, self.texel_xy, self.texel_area, self.part_entry)

    def sub_points(self, entry: IntArray, point: FloatArray, side: float = FOOTPRINT_SIDE) -> tuple[Int32, Float32]:
        """Points of the unit square mapped to the texels' footprints, see `footprints_at` and `TexelFootprints.points`."""
        return self.footprints_at(entry, side).points(point)

    def footprints_at(self, entry: IntArray, side: float = FOOTPRINT_SIDE) -> TexelFootprints:
        """Footprints of texels, uniform in world area.

        Image filters sample a texel at its centre. Its footprint is the square of half its side around the centre, on the triangle there,
        as in Cycles' bake of Blender 5.0 (measured); if no triangle covers the centre, the footprint is the texel's covered part.

        entry    (m,) int
        side     side of that square, texels; 1 for the whole covered part
        """
        tri = self.texel_tri[entry]
        x_0, y_0, x_1, y_1, x_2, y_2, double_area = self._corner_frames.take(tri, axis=1)
        x, y = self.texel_xy[entry].T + (0.5 - 0.5 * side)
        x -= x_0
        y -= y_0
        weight = np.empty((3, 2, len(tri)))
        weight[0] = x * y_2 - y * x_2, y * x_1 - x * y_1
        weight[1] = side * y_2, -side * y_1
        weight[2] = -side * x_2, side * x_1
        weight /= double_area
        squares = TexelFootprints.of_squares(tri, weight)
        rows, part = self._find_parts(entry)
        clipped = self.part_point[part].any(axis=1) | ~are_inside(weight[:, :, rows])
        return self._clip_squares(squares, rows[clipped], part[clipped], side) if clipped.any() else squares

    def _clip_squares(self, squares: TexelFootprints, rows: Int64, part: Int64, side: float) -> TexelFootprints:
        """The footprints with covered pieces instead of the squares in rows (p,); part (p,) are their rows of the part_ fields."""
        owner, pair = expand_ranges(self.pair_start[part], self.pair_start[part + 1])
        central = ~self.part_point[part].any(axis=1)
        if side < 1.0:  # light differs across a crease, so only the triangle at the centre counts, as in Cycles
            counts = ~central[owner] | (self.pair_tri[pair] == self.texel_tri[self.part_entry[part]][owner])
            owner, pair = owner[counts], pair[counts]
        tri, xy = self.pair_tri[pair], self.texel_xy[self.part_entry[part[owner]]]
        pieces = clip_to_texels(self.tri_uv[tri], xy, np.where(central, side, 1.0)[owner])
        tri, xy, owner = tri[pieces.pair], xy[pieces.pair], owner[pieces.pair]
        u, v = self._corner_weights(tri, pieces.x + (xy[:, 0] + 0.5), pieces.y + (xy[:, 1] + 0.5))
        weight = np.stack([u, v], axis=1)
        weight[1:] -= weight[0]
        covered, owner = np.unique(owner, return_inverse=True)  # where clipping rounds all pieces away, the square remains
        return squares.with_pieces(rows[covered], owner, tri, weight, pieces.area * self.tri_density[tri])

    def _corner_weights(self, tri: Int32, x: Float64, y: Float64) -> tuple[Float64, Float64]:
        """Weights of corners 1 and 2 at page texel coordinates x, y (..., m), clamped to the triangles (m,) or (..., m)."""
        x_0, y_0, x_1, y_1, x_2, y_2, double_area = self._corner_frames.take(tri, axis=1)
        x, y = x - x_0, y - y_0
        u = np.clip((x * y_2 - y * x_2) / double_area, 0.0, 1.0)
        v = np.clip((y * x_1 - x * y_1) / double_area, 0.0, 1.0)
        total = np.maximum(u + v, 1.0)
        return u / total, v / total
