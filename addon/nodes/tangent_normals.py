"""What normal maps in tangent space are relative to: tangents, bitangents and normals of a mesh, as Cycles has them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...core.scene.scene import TextureImage
from ...core.util.arrays import FloatArray, IntArray
from .images_read import ImageTable
from .mesh_arrays import LocalMesh, WorldMesh

_MOST_NORMALS = 2048  # texels on a side of a normal map


def thin_out(images: ImageTable, index: int) -> int:
    """A normal map of the table without what is finer than any page shows; where it is.

    Of a block of texels one is taken at random: their mean would be less tilted than they are, and a regular choice could miss what is
    regular, such as joints between tiles.
    """
    image = images.images[index]
    height, width = image.pixels.shape[:2]
    block = -(-max(height, width) // _MOST_NORMALS)
    if block < 2:
        return index
    known = images.find_derived(("thinned out", index))
    if known is not None:
        return known
    rng = np.random.default_rng(1)
    row, column = np.mgrid[0:height:block, 0:width:block] + rng.integers(0, block, (2, -(-height // block), -(-width // block)))
    pixels = image.pixels[np.minimum(row, height - 1), np.minimum(column, width - 1)]
    return images.add_derived(("thinned out", index), TextureImage(image.name, pixels, image.extension, closest=True))


def lay_tangents(local: LocalMesh, uv: FloatArray, world: WorldMesh, matrix: FloatArray) -> NDArray[np.float32]:
    """(n_tri, 3, 3, 3) float32: the tangent, bitangent and normal at each corner of the world's triangles, as of a SceneSnapshot.

    uv       (n_corner, 2) float: the layer along which tangents lie
    matrix   (4, 4) float, object to world
    """
    normal, tangent, sign = find_tangents(local, uv)
    frame = np.stack([tangent, np.cross(normal, tangent) * sign[:, None, None], normal], axis=2)
    solid = np.asarray(matrix, np.float64)[:3, :3]
    turn = np.linalg.inv(solid) if np.linalg.det(solid) else np.eye(3)  # normals are turned by the transpose
    frame = frame @ (turn / max(float(np.abs(turn).max()), 1e-300))
    own = np.flatnonzero(np.isin(local.tri_polygon, world.tri_polygon))  # whole polygons are left out there
    place = (local.tri_corner[own][:, None] == world.tri_corner[:, :, None]).argmax(axis=2)  # it may have turned their corners
    return np.nan_to_num(frame[own[:, None], place]).astype(np.float32)


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


def _remove(vector: FloatArray, normal: FloatArray) -> NDArray[np.float64]:
    """What of vectors lies in the planes of unit normals."""
    found: NDArray[np.float64] = vector - (vector * normal).sum(axis=-1, keepdims=True) * normal
    return found


def _unit(vector: FloatArray) -> NDArray[np.float64]:
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    found: NDArray[np.float64] = vector / np.where(length > 0.0, length, 1.0)
    return found
