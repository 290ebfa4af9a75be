"""Evaluated meshes as arrays: read once in local space, placed in the world as often as they are used."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...core.util.arrays import FloatArray, IntArray
from ..nodes.mesh_arrays import LocalMesh, WorldMesh, read_corner_vertices, read_faces, read_positions
from .mesh_attributes import read_attributes
from .steps import Pause, Steps, run_steps

_BLOCK_TRIANGLES = 1 << 15  # between two pauses; what is computed at once stays in the cache


def read_mesh(mesh: Any, asked: frozenset[str] = frozenset(), left_out: str = "") -> LocalMesh:
    """The arrays of a Blender mesh.

    asked      names of attributes that are shown, if they are no colours of faces or vertices
    left_out   name of a UV layer that is none of the user's
    """
    mesh.calc_loop_triangles()
    n_corner, n_polygon, n_tri = len(mesh.loops), len(mesh.polygons), len(mesh.loop_triangles)
    colors, short = read_attributes(mesh, asked)
    uv_layers = [layer for layer in mesh.uv_layers if layer.name != left_out]
    render_layer = next((layer.name for layer in uv_layers if layer.active_render), "")
    return LocalMesh(
        position=read_positions(mesh).astype(np.float64),
        corner_vertex=read_corner_vertices(mesh),
        polygon_start=_get(mesh.polygons, "loop_start", (n_polygon,), np.int32),
        polygon_slot=read_faces(mesh, "material_index", np.int32),
        corner_normal=_read_corner_normals(mesh, n_corner, n_polygon),
        tri_corner=_get(mesh.loop_triangles, "loops", (n_tri, 3), np.int32),
        tri_polygon=_get(mesh.loop_triangle_polygons, "value", (n_tri,), np.int32),
        layers={layer.name: _get(layer.uv, "vector", (n_corner, 2), np.float32).astype(np.float64) for layer in uv_layers},
        render_layer=render_layer,
        colors=colors,
        short=short,
        attributes=frozenset(attribute.name for attribute in mesh.attributes),
    )


def _read_corner_normals(mesh: Any, n_corner: int, n_polygon: int) -> NDArray[np.float64]:
    normal = _get(mesh.corner_normals, "vector", (n_corner, 3), np.float32).astype(np.float64)
    if not mesh.has_custom_normals:
        flat = read_faces(mesh, "sharp_face", np.bool_)
        if flat.any():
            normal[np.repeat(flat, _get(mesh.polygons, "loop_total", (n_polygon,), np.int32))] = 0.0
    return normal


def has_corners_of(mesh: Any, local: LocalMesh) -> bool:
    """Whether a Blender mesh has the very polygons and corners of `local`, so that a corner means the same in both."""
    if len(mesh.loops) != local.n_corner or len(mesh.polygons) != local.n_polygon or len(mesh.vertices) != len(local.position):
        return False
    start = _get(mesh.polygons, "loop_start", (local.n_polygon,), np.int32)
    return np.array_equal(start, local.polygon_start) and np.array_equal(read_corner_vertices(mesh), local.corner_vertex)


class PlacedMesh:
    """A mesh in the world, which is computed when it is first asked for, or in steps."""

    def __init__(self, local: LocalMesh, matrix: FloatArray) -> None:
        self.local, self.matrix = local, matrix
        self._world: WorldMesh | None = None

    @property
    def world(self) -> WorldMesh:
        """All at once."""
        return run_steps(self.steps())

    def steps(self) -> Steps[WorldMesh]:
        """The same, with pauses."""
        if self._world is None:
            self._world = yield from place_steps(self.local, self.matrix)
        return self._world


def place_mesh(local: LocalMesh, matrix: FloatArray) -> WorldMesh:
    """A mesh in the world.

    matrix  (4, 4) float, object to world; where it mirrors, the winding is turned so that fronts stay fronts, as in Cycles
    """
    return run_steps(place_steps(local, matrix))


def place_steps(local: LocalMesh, matrix: FloatArray) -> Steps[WorldMesh]:
    """place_mesh, a block of triangles at a time."""
    linear, shift = np.asarray(matrix, np.float64)[:3, :3], np.asarray(matrix, np.float64)[:3, 3]
    with np.errstate(invalid="ignore", over="ignore"):
        position = local.position @ linear.T + shift
        mirrored = bool(np.linalg.det(linear) < 0.0)
    tri_corner, tri_polygon = local.tri_corner[:, [0, 2, 1]] if mirrored else local.tri_corner, local.tri_polygon
    tri_vertex = local.corner_vertex[tri_corner]
    broken = np.zeros(local.n_polygon, bool)
    finite_vertex = np.isfinite(position).all(axis=1)
    if not finite_vertex.all():
        broken[tri_polygon[~finite_vertex[tri_vertex].all(axis=1)]] = True
        finite = ~broken[tri_polygon]
        tri_corner, tri_vertex, tri_polygon = tri_corner[finite], tri_vertex[finite], tri_polygon[finite]

    used = np.zeros(len(position), bool)
    used[tri_vertex] = True
    tri_vertex = (np.cumsum(used, dtype=np.int32) - 1)[tri_vertex].astype(np.int32, copy=False)
    vertex_position = position[used]
    tri_normal = np.empty((len(tri_corner), 3, 3), np.float32)
    for low in range(0, len(tri_corner), _BLOCK_TRIANGLES):
        if low:
            yield Pause.FREE
        block = slice(low, low + _BLOCK_TRIANGLES)
        corner = vertex_position[tri_vertex[block]]
        tri_normal[block] = _world_normals(local.corner_normal[tri_corner[block]], linear, mirrored, corner)
    return WorldMesh(
        vertex_position=vertex_position,
        tri_vertex=tri_vertex,
        tri_corner=np.ascontiguousarray(tri_corner),
        tri_polygon=tri_polygon,
        tri_slot=local.polygon_slot[tri_polygon],
        tri_normal=tri_normal,
        left_out=int(broken.sum()),
    )


def count_duplicates(world: WorldMesh) -> int:
    """How many triangles lie exactly on an earlier one of the same mesh, whichever way they face; those without an area do not count."""
    if not len(world.tri_vertex):
        return 0
    with np.errstate(over="ignore"):  # a hash of the coordinates' bits, wrapping by design; + 0.0 makes -0 and 0 one
        bits = np.ascontiguousarray(world.vertex_position + 0.0).view(np.uint64)
        vertex_key = np.zeros(len(bits), np.uint64)
        for axis in range(3):
            vertex_key = _mix_bits(vertex_key ^ bits[:, axis])
        corner_key = vertex_key[world.tri_vertex]
        whole = (corner_key != np.roll(corner_key, 1, axis=1)).all(axis=1)
        tri_key = _mix_bits(corner_key[whole]).sum(axis=1, dtype=np.uint64)
    tri_key.sort()  # NumPy 2.3 and later hash in `unique`, which takes 50 times as long
    return int(np.count_nonzero(tri_key[1:] == tri_key[:-1]))


def _get(collection: Any, name: str, shape: tuple[int, ...], dtype: Any) -> NDArray[Any]:
    values = np.empty(shape, dtype)
    collection.foreach_get(name, values.reshape(-1))
    return values


def _world_normals(normal: FloatArray, linear: FloatArray, mirrored: bool, corner_position: FloatArray) -> NDArray[np.float32]:
    """Unit normals by the cofactor matrix, which also a flattened object has; the face's own where a corner has none."""
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        one, two, three = corner_position.transpose(1, 2, 0)
        face = _to_unit(_cross(two - one, three - one)).T
    face[~np.isfinite(face).all(axis=1)] = (0.0, 0.0, 1.0)
    world = np.repeat(face.astype(np.float32)[:, None, :], 3, axis=1)
    smooth = normal.any(axis=(1, 2))
    if smooth.any():
        world[smooth] = _turn_normals(normal[smooth], linear, mirrored, face[smooth])
    return world


def _turn_normals(normal: FloatArray, linear: FloatArray, mirrored: bool, face: FloatArray) -> FloatArray:
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        after, before = linear[[1, 2, 0]], linear[[2, 0, 1]]
        cofactor = _cross(after.T, before.T).T
        turned = _to_unit((-cofactor if mirrored else cofactor) @ normal.reshape(-1, 3).T)
    world = turned.T.reshape(normal.shape)
    bad = ~np.isfinite(turned).all(axis=0).reshape(normal.shape[:2])
    if bad.any():
        world[bad] = np.broadcast_to(face[:, None, :], world.shape)[bad]
    return world


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """(3, n): as np.cross, several times as fast where vectors lie in columns."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _to_unit(vector: FloatArray) -> FloatArray:
    """(3, n) vectors, scaled in place; a tiny object's would underflow when they are squared first."""
    vector /= np.abs(vector).max(axis=0)
    vector /= np.sqrt((vector * vector).sum(axis=0))
    return vector


def _mix_bits(key: IntArray) -> NDArray[np.uint64]:
    """Spreads every bit over the word.

    Source: SplitMix64's finaliser; Steele, Lea & Flood 2014.
    """
    key = (key ^ (key >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    key = (key ^ (key >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    mixed: NDArray[np.uint64] = key ^ (key >> np.uint64(31))
    return mixed
