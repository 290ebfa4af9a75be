"""Texels where other geometry touches or nearly touches the surface: the foot of a table's leg, a shelf on a wall, a curtain before it.

The preview of a large node averages over such small shadows and so misses them, which is the shadow leak that [Tobler97]
describes in section 4; its remedy, forced subdivision (3.7), needs these texels.
"""

import numpy as np

from ..scene.rays import RayScene
from ..util.arrays import BoolArray, Float32, FloatArray, Int32, Int64
from ..util.geometry import offset_origin, take_rows
from .split_texels import WAYS
from .tiles import TILE_SIDE

_LIFT_TEXELS = 0.25  # height of the contact rays above the surface
_REACH_TEXELS = 1.5  # their length
# Height up to which an object covers the surface below it. At the edge of a cover light changes over about as many texels as the cover is
# high; if it changes over more than four, it is better not to cut leaves there.
_COVER_TEXELS = 3.0
_SHEER_TEXELS = 2.0  # a cover ends where it rises by this to the next texel; if it rises by less, as a ball does, light has no edge
_COVER_STEPS = 5  # bisections between two texels for the edge of a cover
_TILE_LOOKS = 3  # points per side of a tile at which covers are searched
_CHUNK = 1 << 18


def find_contacts(
    rays: RayScene, position: Float32, normal: Float32, texel_size: FloatArray, axes: Float32 | None = None
) -> tuple[Int32, Float32]:
    """Geometry within about a texel of each point, found by short rays along the surface.

    position     (n, 3) float32, unit box
    normal       (n, 3) float32, unit
    texel_size   (n,) float, unit box: side of a texel on the surface
    axes         (2, n, 3) float32, unit: the rays go along these and against them; if None, along any two tangents
    out          (4, n) int32: the triangle met towards each of WAYS, whose columns and rows run along the axes; -1 for none;
                 and (4, n) float32, texels: its distance, inf for none
    """
    found = np.full((len(WAYS), len(position)), -1, np.int32)
    texels = np.full(found.shape, np.inf, np.float32)
    for start in range(0, len(position), _CHUNK):
        part = slice(start, start + _CHUNK)
        size = texel_size[part, None].astype(np.float32)
        along, across = axes[:, part] if axes is not None else _any_axes(normal[part])
        origin = position[part] + normal[part] * (_LIFT_TEXELS * size)
        reach = _REACH_TEXELS * size[:, 0]
        for k, direction in enumerate((along, across, -along, -across)):
            stopped = np.flatnonzero(rays.occluded(origin, direction, reach))
            met = rays.closest(take_rows(origin, stopped), take_rows(direction, stopped))
            found[k, start + stopped], texels[k, start + stopped] = met.tri, met.distance / size[stopped, 0]
    return found, texels


def find_between(rays: RayScene, position: Float32, normal: Float32, texel_size: FloatArray, pairs: Int64) -> Int32:
    """(m,) int32: the triangle met first on the segment from point to point, -1 for none.

    position, normal, texel_size   as for find_contacts
    pairs                          (2, m) int64: the points
    """
    lifted = position + normal * (_LIFT_TEXELS * texel_size[:, None].astype(np.float32))
    origin, end = lifted[pairs]
    found = np.full(len(origin), -1, np.int32)
    stopped = np.flatnonzero(rays.occluded(origin, end - origin, np.ones(len(origin), np.float32)))
    origin, end = origin[stopped], end[stopped]
    met = rays.closest(origin, end - origin)
    found[stopped] = np.where(met.distance < 1.0, met.tri, np.int32(-1))
    return found


def find_covers(rays: RayScene, position: Float32, normal: Float32, texel_size: FloatArray) -> tuple[Int32, Float32]:
    """Geometry on the surface or close above it, which the rays of find_contacts miss because they pass above or below it.

    Arguments are as for find_contacts. A rug is often much thinner than a texel is wide, but the floor below it is as dark as below a
    cupboard; so is a wall behind a curtain.
    out   (n,) int32: the triangle met first, -1 for none; and (n,) float32, texels: its height, inf for none
    """
    found, texels = np.full(len(position), -1, np.int32), np.full(len(position), np.inf, np.float32)
    origin, size = offset_origin(position, normal), texel_size.astype(np.float32)
    above = np.flatnonzero(rays.occluded(origin, normal, (_COVER_TEXELS + _SHEER_TEXELS) * size))
    met = rays.closest(take_rows(origin, above), take_rows(normal, above))
    found[above], texels[above] = met.tri, met.distance / size[above]
    return found, texels


def are_close(height: Float32) -> BoolArray:
    """(m,) bool: whether a surface at this height above points, texels (m,), covers them."""
    return height < _COVER_TEXELS


def ends_between(one: Float32, other: Float32) -> BoolArray:
    """(m,) bool: whether a cover ends between points with surfaces at these heights above them, texels, (m,) and (m,)."""
    return are_close(np.minimum(one, other)) & (np.maximum(one, other) >= _COVER_TEXELS + _SHEER_TEXELS)


def find_cover_edges(rays: RayScene, covered: Float32, bare: Float32, normal: Float32, texel_size: FloatArray) -> Float32:
    """(m,) float32, 0 to 1: where the cover ends on the way from covered to bare points (m, 3). The rest is as for find_covers."""
    low, step = np.zeros((len(covered), 1), np.float32), np.float32(0.5)
    for _ in range(_COVER_STEPS):
        place = covered + (low + step) * (bare - covered)
        low += step * _are_covered(rays, place, normal, texel_size)[:, None]
        step *= np.float32(0.5)
    return low[:, 0] + step


def _are_covered(rays: RayScene, position: Float32, normal: Float32, texel_size: FloatArray) -> BoolArray:
    """(n,) bool: whether a surface is within _COVER_TEXELS above; arguments as for find_covers."""
    return rays.occluded(offset_origin(position, normal), normal, (_COVER_TEXELS * texel_size).astype(np.float32))


def find_clear_tiles(rays: RayScene, corner: Float32, normal: Float32, texel_size: FloatArray) -> BoolArray:
    """(m,) bool: square tiles of texels where no ray of find_contacts along rows and columns meets anything, and no cover ends.

    The rays of a row lie on one line, so that one ray stands for all of them.

    corner       (3, m, 3) float32, unit box: middles of a tile's first texel, and of the last ones of its first row and column
    normal       (m, 3) float32, unit
    texel_size   (m,) float, unit box
    """
    size = texel_size[:, None].astype(np.float32)
    first, *ends = corner + normal * (_LIFT_TEXELS * size)
    clear = np.ones(len(first), bool)
    for end, other in (ends, ends[::-1]):
        length = np.linalg.norm(end - first, axis=1, keepdims=True)
        direction = (end - first) / np.maximum(length, np.finfo(np.float32).tiny)
        origin = first - direction * (_REACH_TEXELS * size)
        whole = length[:, 0] + 2 * _REACH_TEXELS * size[:, 0]
        for line in range(TILE_SIDE):
            step = np.float32(line / (TILE_SIDE - 1)) * (other - first)
            clear &= ~rays.occluded(origin + step, direction, whole)
    clear[clear] = _are_covered_alike(rays, corner[:, clear], normal[clear], texel_size[clear])
    return clear


def _are_covered_alike(rays: RayScene, corner: Float32, normal: Float32, texel_size: FloatArray) -> BoolArray:
    """(m,) bool: tiles of which all texels are covered, or none; covers narrower than 5 texels may be missed.

    Arguments as find_clear_tiles.
    """
    first, *ends = corner
    across = [end - first for end in ends]
    margin = _REACH_TEXELS / (TILE_SIDE - 1)
    looks = [
        _are_covered(rays, first + x * across[0] + y * across[1], normal, texel_size)
        for x in np.linspace(-margin, 1 + margin, _TILE_LOOKS, dtype=np.float32)
        for y in np.linspace(-margin, 1 + margin, _TILE_LOOKS, dtype=np.float32)
    ]
    return np.all(looks, axis=0) | ~np.any(looks, axis=0)


def texel_axes(corner: FloatArray, corner_xy: FloatArray, normal: Float32) -> Float32:
    """(2, n, 3) float32, unit: directions of increasing columns and rows of texels on triangles; any tangents where undefined.

    corner      (n, 3, 3) float
    corner_xy   (n, 3, 2) float, texels
    normal      (n, 3) float32, unit
    """
    edge, edge_xy = corner[:, 1:] - corner[:, :1], corner_xy[:, 1:] - corner_xy[:, :1]
    (x_1, y_1), (x_2, y_2) = edge_xy[:, 0].T, edge_xy[:, 1].T
    along = edge[:, 0] * y_2[:, None] - edge[:, 1] * y_1[:, None]
    across = edge[:, 1] * x_1[:, None] - edge[:, 0] * x_2[:, None]
    turn = np.copysign(1.0, x_1 * y_2 - x_2 * y_1)  # in mirrored layouts both have the opposite sign
    out = np.stack(_any_axes(normal))
    for axis, found in zip(out, (along, across), strict=True):
        length = np.linalg.norm(found, axis=1)
        known = length > 0
        axis[known] = found[known] / (length * turn)[known, None]
    return out


def _any_axes(normal: Float32) -> tuple[Float32, Float32]:
    along = _any_tangent(normal)
    return along, np.cross(normal, along)


def _any_tangent(normal: Float32) -> Float32:
    least = np.abs(normal).argmin(1)
    axis = np.zeros_like(normal)
    axis[np.arange(len(normal)), least] = 1.0
    tangent = np.cross(normal, axis)
    length = np.linalg.norm(tangent, axis=1, keepdims=True)
    return (tangent / np.where(length > 0.0, length, 1.0)).astype(np.float32)
