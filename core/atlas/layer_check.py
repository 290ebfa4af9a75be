"""Charts of a UV layer, and checks of a layer that was made elsewhere."""

from dataclasses import dataclass

import numpy as np

from ..scene.topology import join_sets, pair_corners, pair_sides
from ..util.arrays import BoolArray, Float64, Int32, Int64, IntArray
from ..util.coverage import find_row_spans

_SAME_UV = 1e-5  # pages; UVs nearer than this are one point, since rounding to float32 may have moved them
_PAGE_TOLERANCE = 1e-5  # pages; rounding may move a UV this far off its page
_NO_HEIGHT = 1e-7  # height over longest side below which a triangle is a line in float32 UVs
_INSET = 0.05  # raster texels taken off every side of a triangle, so that neighbours do not overlap
_RASTER_MIN, _RASTER_MAX = 256, 2048
_TEXELS_PER_TRIANGLE = 64
_MAX_RASTER_TEXELS = 2e7


@dataclass(frozen=True)
class LayerCheck:
    """Result of a check: usable (n_tri,) bool are the triangles that can be baked; findings are sentences with what to do."""

    usable: BoolArray
    findings: tuple[str, ...]


def label_charts(
    tri_vertex: IntArray, tri_corner: IntArray, tri_uv: Float64, tri_group: IntArray, same_uv: float | Float64 = _SAME_UV
) -> tuple[Int64, BoolArray]:
    """Charts: triangles of one group that share a corner, or an edge with the same UVs at both its ends.

    tri_vertex   (n, 3) int
    tri_corner   (n, 3) int       a corner has one UV, so the triangles of a polygon stay together
    tri_uv       (n, 3, 2) float64
    tri_group    (n,) int         -1 for triangles without a chart
    same_uv      greatest distance of UVs that count as one point, for all triangles or (n,) for each
    out          (n,) int64 chart, 0, 1, ... in order of its first triangle, or -1; (n, 3) bool whether side k, which starts at corner k, is
                 shared within its chart
    """
    ends, one, other = pair_sides(tri_vertex, tri_group, tri_uv)
    end_uv, near = tri_uv.reshape(-1, 2)[ends], np.broadcast_to(same_uv, len(tri_vertex))[one // 3]
    same = (np.abs(end_uv[:, one] - end_uv[:, other]) <= near[:, None]).all(axis=(0, 2))
    one, other = one[same], other[same]
    shared = np.zeros(tri_vertex.size, bool)
    shared[one] = shared[other] = True
    corner, twin = pair_corners(tri_corner, tri_group >= 0)
    together = tri_group[corner // 3] == tri_group[twin // 3]
    label = join_sets(len(tri_vertex), np.append(one, corner[together]) // 3, np.append(other, twin[together]) // 3)
    chart = np.full(len(tri_vertex), -1, np.int64)
    used = tri_group >= 0
    chart[used] = np.unique(label[used], return_inverse=True)[1].ravel()
    return chart, shared.reshape(-1, 3)


def signed_areas(tri_uv: Float64) -> Float64:
    """(n,) float64: areas of triangles, negative for clockwise ones.

    tri_uv   (n, 3, 2) float64
    """
    one, other = tri_uv[:, 1] - tri_uv[:, 0], tri_uv[:, 2] - tri_uv[:, 0]
    return 0.5 * (one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0])


def check_layer(tri_uv: Float64, tri_polygon: IntArray, solid: BoolArray) -> LayerCheck:
    """Find the triangles of an existing layer that can be baked.

    tri_uv        (n, 3, 2) float64, pages
    tri_polygon   (n,) int
    solid         (n,) bool, triangles with an area in space; others are left out without a warning
    """
    finite = np.isfinite(tri_uv).all(axis=(1, 2))
    uv = np.where(finite[:, None, None], tri_uv, 0.0)
    inside = ((uv >= -_PAGE_TOLERANCE) & (uv <= 1.0 + _PAGE_TOLERANCE)).all(axis=(1, 2))
    area = signed_areas(uv)
    longest = np.linalg.norm(uv - np.roll(uv, 1, axis=1), axis=2).max(axis=1)
    flat = np.abs(area) <= 0.5 * _NO_HEIGHT * longest * np.maximum(longest, _NO_HEIGHT)
    usable = solid & finite & inside & ~flat
    overlapping = np.zeros(len(uv), bool)
    overlapping[usable] = find_overlaps(uv[usable])
    kinds = (
        (solid & ~finite, "{} without a valid position in the UV layer, left unbaked; unwrap them anew"),
        (solid & finite & ~inside, "{} outside the page (0 to 1) of the UV layer, left unbaked; move them onto it"),
        (solid & finite & inside & flat, "{} without an area in the UV layer, left unbaked; unwrap them"),
        (overlapping, "{} overlapping others in the UV layer, where their light is mixed up; unwrap them apart"),
        (usable & (area < 0), "{} mirrored in the UV layer, baked as they are; turn them over if a normal map needs it"),
    )
    counts = [len(np.unique(tri_polygon[faces])) for faces, _ in kinds]
    findings = [text.format(f"{count:,} face{'s'[: count != 1]}") for count, (_, text) in zip(counts, kinds, strict=True) if count]
    return LayerCheck(usable, tuple(findings))


def find_overlaps(tri_uv: Float64) -> BoolArray:
    """Triangles that overlap others: on a raster, one covers a whole texel that the other touches.

    tri_uv   (n, 3, 2) float64, pages, within 0 to 1; no triangle without area
    out      (n,) bool
    """
    overlapping = np.zeros(len(tri_uv), bool)
    if not len(tri_uv):
        return overlapping
    area = float(np.abs(signed_areas(tri_uv)).sum())
    size = np.sqrt(min(_TEXELS_PER_TRIANGLE * len(tri_uv), _MAX_RASTER_TEXELS) / max(area, 1e-30))
    size = int(np.clip(size, _RASTER_MIN, _RASTER_MAX))
    spans = find_row_spans(_inset(tri_uv * size))
    row = np.clip(spans.y, 0, size - 1).astype(np.int64) * size
    is_shared = _count_texels(row + spans.full_start, row + spans.full_end, size) > 0
    start, end = row + np.clip(spans.touched_start, 0, size), row + np.clip(spans.touched_end, 0, size)
    is_shared &= _count_texels(start, end, size) > 1
    shared_before = np.zeros(len(is_shared) + 1, np.int32)
    np.cumsum(is_shared, out=shared_before[1:])
    overlapping[spans.tri[shared_before[np.maximum(end, start)] > shared_before[start]]] = True
    return overlapping


def _inset(uv: Float64) -> Float64:
    """Triangles scaled about their incentres, so that every side moves inwards by _INSET; narrow ones become points."""
    opposite = np.linalg.norm(np.roll(uv, -1, axis=1) - np.roll(uv, -2, axis=1), axis=2)
    perimeter = opposite.sum(axis=1)
    centre = (opposite[:, :, None] * uv).sum(axis=1) / perimeter[:, None]
    radius = 2.0 * np.abs(signed_areas(uv)) / perimeter
    factor = np.maximum(1.0 - _INSET / radius, 0.0)
    return centre[:, None] + factor[:, None, None] * (uv - centre[:, None])


def _count_texels(start: Int64, end: Int64, size: int) -> Int32:
    """(size * size,) int32: number of ranges that contain each texel. With few triangles on a large raster this is most of the work."""
    change = np.bincount(start, minlength=size * size + 1)
    change -= np.bincount(np.maximum(end, start), minlength=size * size + 1)
    return np.cumsum(change, dtype=np.int32)[: size * size]
