"""World normals of a Normal Map node in tangent space, laid out as in a polygon atlas: what Cycles would bake, without Cycles."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...core.util.arrays import FloatArray, IntArray
from .mesh_arrays import LocalMesh
from .polygon_atlas import PolygonAtlas, find_rectangles

ColorsAt: TypeAlias = Callable[[FloatArray], FloatArray]  # (n, 2) texture coordinates -> (n, 3) colours of the normal map
_MOST_LOOKS = 1 << 24  # texels times triangles of their polygon; Blender evaluates what would take longer
_TEXELS_AT_ONCE = 1 << 17


def lay_tangent_normals(
    local: LocalMesh,
    uv: FloatArray,
    tri: IntArray,
    atlas: PolygonAtlas,
    matrix: FloatArray,
    colors_at: ColorsAt,
    color_uv: FloatArray,
    color_size: int,
    strength: float,
) -> tuple[NDArray[np.float32], bool] | None:
    """(height, width, 3) float32: unit normals in the world at polygons and around them, 0 elsewhere, each that at one place of a texel;
    and whether the normal map is finer than that, so that between texels no mean is to be taken. None where it would take long.

    A mean of normals is less tilted than they are, so that light at it is too bright on average; light at single ones is not. Of a finer
    map they are those at random places: middles could all miss what is regular in it, such as joints between tiles.

    uv         (n_corner, 2) float: the layer along which tangents lie
    tri        (k,) int, the triangles wanted
    matrix     (4, 4) float, object to world
    color_uv   (n_corner, 2) float: where the normal map lies, of color_size texels on its longest side
    Source: Blender, intern/cycles/kernel/svm/tex_coord.h, svm_node_normal_map.
    """
    polygons = np.unique(local.tri_polygon[tri])
    low, size = find_rectangles(local, atlas)
    first = np.searchsorted(local.tri_polygon, np.arange(local.n_polygon))
    count = np.diff(np.append(first, len(local.tri_polygon)))
    texels = size.prod(axis=1)
    if int((texels * count)[polygons].sum()) > _MOST_LOOKS:
        return None
    within = atlas.uv * (atlas.width, atlas.height) - np.repeat(low, np.diff(np.append(local.polygon_start, local.n_corner)), axis=0)
    weigh = _find_weights(within[local.tri_corner])  # of texels from their polygon's first on: small numbers are exact in float32
    lies = np.asarray(color_uv, np.float64)[local.tri_corner]
    along_uv = np.einsum("ijt,tik->kjt", weigh[:, :2], lies)
    is_finer = bool(np.abs(along_uv).sum(axis=1).max() * color_size > 1.0)
    smooth, tangent, sign = find_tangents(local, uv)
    normals, tangents, places = (np.float32(np.moveaxis(one, 0, -1)) for one in (smooth, tangent, lies))
    weigh, sign = np.float32(weigh), np.float32(sign)
    solid = np.asarray(matrix, np.float64)[:3, :3]
    turn = np.float32(np.linalg.inv(solid) if np.linalg.det(solid) else np.eye(3))
    pixels = np.zeros((atlas.height, atlas.width, 3), np.float32)
    ends, rng = np.cumsum(texels[polygons]), np.random.default_rng(1)
    for group in np.split(polygons, np.unique(np.searchsorted(ends, np.arange(_TEXELS_AT_ONCE, ends[-1], _TEXELS_AT_ONCE)))):
        polygon = np.repeat(group, texels[group])
        number = np.arange(len(polygon)) - np.repeat(np.cumsum(texels[group]) - texels[group], texels[group])
        row, column = np.divmod(number, size[:, 0].take(polygon))
        beyond = rng.random((2, len(polygon)), np.float32) if is_finer else np.full((2, 1), np.float32(0.5))
        x, y = np.float32(column) + beyond[0], np.float32(row) + beyond[1]
        which, weight = _find_triangles(weigh, x, y, first.take(polygon), count.take(polygon))
        x, y, z = colors_at(_blend(places, which, weight).T).T * np.float32(2.0) - 1.0
        if strength != 1.0:
            x, y, z = x * strength, y * strength, 1.0 + (z - 1.0) * min(strength, 1.0)
        weight = np.maximum(weight, 0.0)
        normal, along = _blend(normals, which, weight), _blend(tangents, which, weight)
        aside = _cross(normal, along) * sign.take(which)
        mapped = turn.T @ (x * along + y * aside + z * normal)
        mapped /= np.maximum(np.sqrt((mapped * mapped).sum(axis=0)), 1e-30)
        pixels[low[:, 1].take(polygon) + row, low[:, 0].take(polygon) + column] = mapped.T
    return pixels, is_finer


def find_tangents(local: LocalMesh, uv: FloatArray) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Normals and tangents (n_tri, 3, 3) of triangles' corners, unit, and on which side (n_tri,) the bitangent is: 1 or -1.

    Corners at one vertex with the same normal and texture coordinates share their tangent, if their triangles share an edge there, or
    others between them do: tiles that are turned against each other may meet in a vertex, and not along an edge.
    Source: Mikkelsen 2008, Simulation of wrinkled surfaces revisited; his mikktspace.c.
    """
    corner = local.tri_corner
    vertex = local.corner_vertex[corner]
    position, place = local.position[vertex], np.asarray(uv, np.float64)[corner]
    normal = local.corner_normal[corner]
    flat = _unit(np.cross(position[:, 1] - position[:, 0], position[:, 2] - position[:, 0]))
    normal = np.where((normal == 0.0).all(axis=2, keepdims=True), flat[:, None], normal)
    one, two = position[:, 1] - position[:, 0], position[:, 2] - position[:, 0]
    du, dv = (place[:, 1:] - place[:, :1]).transpose(2, 1, 0)
    twice = du[0] * dv[1] - du[1] * dv[0]
    sign = np.where(twice < 0.0, -1.0, 1.0)
    along = _unit((dv[1][:, None] * one - dv[0][:, None] * two) * sign[:, None]) * (twice != 0.0)[:, None]
    own = _unit(along[:, None] - (along[:, None] * normal).sum(axis=2, keepdims=True) * normal)
    after, before = (_unit(_remove(np.roll(position, shift, axis=1) - position, normal)) for shift in (-1, 1))
    angle = np.arccos(np.clip((after * before).sum(axis=2), -1.0, 1.0))
    key = np.concatenate([vertex[..., None], normal.astype(np.float32), place.astype(np.float32), np.repeat(sign[:, None, None], 3, 1)], 2)
    bits = np.ascontiguousarray(key.reshape(-1, 7) + 0.0).view(np.dtype((np.void, 56))).ravel()
    _, alike = np.unique(bits, return_inverse=True)
    group = _join_fans(alike.reshape(-1, 3))
    weighted = (own * angle[..., None]).reshape(-1, 3)
    total = np.stack([np.bincount(group, part, len(weighted)) for part in weighted.T], axis=1)
    return normal, _unit(total)[group].reshape(normal.shape), sign


def _join_fans(alike: IntArray) -> NDArray[np.int64]:
    """(3 n,): for each corner of triangles the first of its fan: corners of one number in alike (n, 3) whose triangles join at edges."""
    count = alike.size
    number, corner = alike.ravel(), np.arange(count).reshape(-1, 3)
    start, end = corner.ravel(), np.roll(corner, -1, axis=1).ravel()
    turned = number[start] > number[end]
    low, high = np.where(turned, end, start), np.where(turned, start, end)
    order = np.lexsort((number[high], number[low]))
    low, high = low[order], high[order]
    same = (number[low[1:]] == number[low[:-1]]) & (number[high[1:]] == number[high[:-1]])
    before = np.concatenate([low[:-1][same], high[:-1][same]])
    after = np.concatenate([low[1:][same], high[1:][same]])
    first = np.arange(count)
    while True:
        least = np.minimum(first[before], first[after])
        joined = first.copy()
        np.minimum.at(joined, before, least)
        np.minimum.at(joined, after, least)
        joined = joined[joined]
        if np.array_equal(joined, first):
            return first
        first = joined


def _find_weights(corner: FloatArray) -> NDArray[np.float64]:
    """(3, 3, n): rows that times (x, y, 1) are the barycentric weights in triangles (n, 3, 2), the first corner's alone without area."""
    one, two = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    area = one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]
    scale = np.where(area == 0.0, 0.0, 1.0 / np.where(area == 0.0, 1.0, area))
    b, c = np.stack([two[:, 1], -two[:, 0]]) * scale, np.stack([-one[:, 1], one[:, 0]]) * scale
    rows = [np.stack([x, y, -x * corner[:, 0, 0] - y * corner[:, 0, 1]]) for x, y in (b, c)]
    return np.stack([np.array([[0.0], [0.0], [1.0]]) - rows[0] - rows[1], *rows])


def _find_triangles(
    weigh: NDArray[np.float32], x: NDArray[np.float32], y: NDArray[np.float32], first: IntArray, count: IntArray
) -> tuple[IntArray, NDArray[np.float32]]:
    """Of each place (n,) the triangle of its polygon that it is in, or next to, and the weights (3, n) of that one's corners."""
    which, weight = first, _weigh_corners(weigh, first, x, y)
    if int(count.max()) > 1:
        which, least = first.copy(), weight.min(axis=0)
        for number in range(1, int(count.max())):
            rows = ((count > number) & (least < 0.0)).nonzero()[0]
            found = _weigh_corners(weigh, first[rows] + number, x[rows], y[rows])
            better = found.min(axis=0) > least[rows]
            rows, found = rows[better], found[:, better]
            which[rows], weight[:, rows], least[rows] = first[rows] + number, found, found.min(axis=0)
    return which, weight


def _weigh_corners(weigh: NDArray[np.float32], tri: IntArray, x: NDArray[np.float32], y: NDArray[np.float32]) -> NDArray[np.float32]:
    of_x, of_y, of_one = (weigh[:, axis].take(tri, axis=1) for axis in range(3))
    return of_x * x + of_y * y + of_one


def _blend(values: NDArray[np.float32], tri: IntArray, weight: NDArray[np.float32]) -> NDArray[np.float32]:
    """(k, n): values (3, k, n_tri) at the corners of triangles, weighed (3, n)."""
    return sum((values[corner].take(tri, axis=1) * weight[corner] for corner in range(1, 3)), values[0].take(tri, axis=1) * weight[0])


def _cross(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _remove(vector: FloatArray, normal: FloatArray) -> NDArray[np.float64]:
    """What of vectors lies in the planes of unit normals."""
    found: NDArray[np.float64] = vector - (vector * normal).sum(axis=-1, keepdims=True) * normal
    return found


def _unit(vector: FloatArray) -> NDArray[np.float64]:
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    found: NDArray[np.float64] = vector / np.where(length > 0.0, length, 1.0)
    return found
