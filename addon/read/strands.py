"""Hair, hair curves and point clouds as meshes: tubes of three sides and octahedra that shade as much as what they stand for.

A convex body shades, on the average over all directions, a quarter of its surface (Cauchy 1850). A regular prism of three sides has the
mean shade of a cylinder of radius r when its corners lie 2 pi / (3 sqrt 3) r from the axis, an octahedron that of a sphere when they
lie sqrt(pi / sqrt 3) r from its centre.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from mathutils import Matrix
from numpy.typing import NDArray

from ...core.util.arrays import FloatArray, IntArray
from ..nodes.mesh_arrays import LocalMesh
from .export_pieces import Piece
from .render_levels import Warnings

MOST_TRIANGLES = 600_000  # of one object; beyond it some strands or points stand for their neighbours too
LAYER = "hair root"  # the UV layer that strands have from the surface they grow on

_SIDES = 3
_TUBE_CORNER = 2.0 * np.pi / (3.0 * np.sqrt(3.0))
_BALL_CORNER = float(np.sqrt(np.pi / np.sqrt(3.0)))
_HAIR_RADIUS_M, _POINT_RADIUS_M = 0.005, 0.01  # Cycles' own where there is no attribute
_BALL_VERTICES = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)], np.float64)
_BALL_FACES = np.array([(0, 2, 4), (2, 1, 4), (1, 3, 4), (3, 0, 4), (2, 0, 5), (1, 2, 5), (3, 1, 5), (0, 3, 5)], np.int32)


@dataclass(frozen=True)
class Strands:
    """Polylines with a radius at each point.

    position   (n_point, 3) float64, in the object's space
    radius     (n_point,) float64
    count      (n_strand,) int64, points of each
    root_uv    (n_strand, 2) float64: where on the surface's UV layer it grows; None if it is not known
    """

    position: NDArray[np.float64]
    radius: NDArray[np.float64]
    count: NDArray[np.int64]
    root_uv: NDArray[np.float64] | None = None


def read_strands(piece: Piece, warnings: Warnings) -> LocalMesh:
    """A piece of kind STRANDS as a mesh in its object's space."""
    if piece.hair >= 0:
        mesh, stride = read_particle_hair(piece.evaluated, piece.evaluated.modifiers[piece.hair])
    else:
        mesh, stride = read_points(piece.evaluated) if piece.evaluated.type == "POINTCLOUD" else read_curves(piece.evaluated)
    if stride > 1:
        what = "points" if piece.evaluated.type == "POINTCLOUD" else "strands"
        warnings.append((piece.source.name, f"has so many {what} that one of {stride} stands for its neighbours, thicker"))
    return mesh


def read_particle_hair(evaluated: Any, modifier: Any) -> tuple[LocalMesh, int]:
    """The strands of a particle system as a mesh in its object's space, and for how many strands each of them stands.

    evaluated, modifier   of the depsgraph that `evaluate_for_render` gives
    """
    system = modifier.particle_system
    settings = system.settings
    n_parent, n_child = len(system.particles), len(system.child_particles)
    first = n_parent if settings.child_type != "NONE" and n_child else 0
    n_step = 2**settings.display_step + 1  # which holds the render's value meanwhile
    strands = np.arange(first, first + (n_child or n_parent))
    stride = _find_stride(len(strands) * (n_step - 1) * 2 * _SIDES)
    strands = strands[::stride]
    world = np.array([system.co_hair(object=evaluated, particle_no=int(i), step=step) for i in strands for step in range(n_step)])
    inverse = np.array(_invert(evaluated.matrix_world))
    position = world.reshape(-1, 3) @ inverse[:3, :3].T + inverse[:3, 3]
    radius = np.tile(_find_radii(settings, n_step), len(strands))
    count = np.full(len(strands), n_step, np.int64)
    live = position.reshape(-1, n_step, 3).any(axis=(1, 2))  # Blender gives the origin for what it has not made
    rows = np.repeat(live, n_step)
    uv = _read_root_uv(evaluated, modifier, system, strands) if evaluated.data.uv_layers else None
    found = Strands(position[rows], radius[rows] * stride, count[live], None if uv is None else uv[live])
    return make_tubes(found, settings.material - 1), stride


def read_curves(evaluated: Any) -> tuple[LocalMesh, int]:
    """The strands of an evaluated hair curves object as a mesh in its space, and for how many strands each of them stands."""
    data = evaluated.data
    position = _read(data.attributes, "position", "vector", 3, len(data.points))
    radius = _read(data.attributes, "radius", "value", 1, len(data.points), _HAIR_RADIUS_M)[:, 0]
    offset = np.empty(len(data.curves) + 1, np.int32)
    data.curve_offset_data.foreach_get("value", offset)
    count = np.diff(offset).astype(np.int64)
    uv = _read(data.attributes, "surface_uv_coordinate", "vector", 2, len(count)) if "surface_uv_coordinate" in data.attributes else None
    stride = _find_stride(int(np.maximum(count - 1, 0).sum()) * 2 * _SIDES)
    kept = np.arange(0, len(count), stride)
    rows = np.concatenate([np.arange(offset[i], offset[i + 1]) for i in kept] or [np.zeros(0, np.int64)]).astype(np.int64)
    found = Strands(position[rows], radius[rows] * stride, count[kept], None if uv is None else uv[kept])
    return make_tubes(found, 0), stride


def read_points(evaluated: Any) -> tuple[LocalMesh, int]:
    """The points of an evaluated point cloud as octahedra, and for how many points each of them stands."""
    data = evaluated.data
    position = _read(data.attributes, "position", "vector", 3, len(data.points))
    radius = _read(data.attributes, "radius", "value", 1, len(data.points), _POINT_RADIUS_M)[:, 0]
    stride = _find_stride(len(position) * len(_BALL_FACES))
    position, radius = position[::stride], radius[::stride] * np.sqrt(stride)
    vertices = position[:, None] + _BALL_CORNER * radius[:, None, None] * _BALL_VERTICES
    faces = _BALL_FACES + 6 * np.arange(len(position), dtype=np.int32)[:, None, None]
    return _make_mesh(vertices.reshape(-1, 3), faces.reshape(-1, 3), 0, None), stride


def make_tubes(strands: Strands, slot: int) -> LocalMesh:
    """Strands as tubes of three sides, without lids."""
    n_point = len(strands.position)
    last = np.zeros(n_point, bool)
    last[np.cumsum(strands.count)[strands.count > 0] - 1] = True
    first = np.roll(last, 1) if n_point else last
    step = np.roll(strands.position, -1, axis=0) - strands.position
    step[last] = 0.0
    back = np.roll(step, 1, axis=0)
    back[first] = 0.0
    along = _to_unit(step + back, np.array([0.0, 0.0, 1.0]))
    strand = np.repeat(np.arange(len(strands.count)), strands.count)
    # One direction for each strand keeps its tube from twisting.
    start = np.cumsum(strands.count) - strands.count
    aside = np.eye(3)[np.abs(along[np.minimum(start, max(n_point - 1, 0))]).argmin(axis=1)] if n_point else np.zeros((0, 3))
    x = _to_unit(np.cross(along, aside[strand]), np.array([1.0, 0.0, 0.0]))
    y = np.cross(along, x)
    angle = 2.0 * np.pi / _SIDES * np.arange(_SIDES)
    ring = x[:, None] * np.cos(angle)[:, None] + y[:, None] * np.sin(angle)[:, None]
    vertices = strands.position[:, None] + _TUBE_CORNER * strands.radius[:, None, None] * ring
    low = np.flatnonzero(~last)
    side = np.arange(_SIDES)
    a, b = _SIDES * low[:, None] + side, _SIDES * low[:, None] + (side + 1) % _SIDES
    quads = np.stack([a, b, b + _SIDES, a, b + _SIDES, a + _SIDES], axis=-1)  # two triangles
    uv = None if strands.root_uv is None else np.repeat(strands.root_uv[strand[low]], 2 * _SIDES * 3, axis=0)
    return _make_mesh(vertices.reshape(-1, 3), quads.reshape(-1, 3).astype(np.int32), slot, uv)


def _make_mesh(position: FloatArray, tri_vertex: IntArray, slot: int, uv: FloatArray | None) -> LocalMesh:
    n_tri = len(tri_vertex)
    return LocalMesh(
        position=position.astype(np.float64),
        corner_vertex=np.ascontiguousarray(tri_vertex.reshape(-1)).astype(np.int32),
        polygon_start=np.arange(0, 3 * n_tri, 3, dtype=np.int32),
        polygon_slot=np.full(n_tri, max(slot, 0), np.int32),
        corner_normal=np.zeros((3 * n_tri, 3)),
        tri_corner=np.arange(3 * n_tri, dtype=np.int32).reshape(-1, 3),
        tri_polygon=np.arange(n_tri, dtype=np.int32),
        layers={} if uv is None else {LAYER: uv},
        render_layer="" if uv is None else LAYER,
        colors={},
        short=frozenset(),
        attributes=frozenset(),
    )


def _find_stride(n_tri: int) -> int:
    return max(1, -(-n_tri // MOST_TRIANGLES))


def _find_radii(settings: Any, n_step: int) -> NDArray[np.float64]:
    """(n_step,) radii of a particle system's strand from root to tip.

    Source: Blender, intern/cycles/blender/curves.cpp, shaperadius
    """
    root, tip = (0.5 * settings.radius_scale * end for end in (settings.root_radius, settings.tip_radius))
    part = 1.0 - np.linspace(0.0, 1.0, n_step)
    shape = settings.shape
    part = part ** (1.0 + shape if shape < 0.0 else 1.0 / max(1.0 - shape, 1e-6))
    radii: NDArray[np.float64] = part * (root - tip) + tip
    if settings.use_close_tip:
        radii[-1] = 0.0
    return radii


def _read_root_uv(evaluated: Any, modifier: Any, system: Any, strands: IntArray) -> NDArray[np.float64]:
    layers = evaluated.data.uv_layers
    layer = next((i for i, one in enumerate(layers) if one.active_render), 0)
    n_parent = len(system.particles)
    particles, out = system.particles, np.zeros((len(strands), 2))
    for row, i in enumerate(strands):
        particle = particles[int(i)] if i < n_parent else particles[0]
        out[row] = system.uv_on_emitter(modifier, particle=particle, particle_no=int(i), uv_no=layer)
    return out


def _read(attributes: Any, name: str, field: str, width: int, count: int, default: float = 0.0) -> NDArray[np.float64]:
    values = np.full((count, width), default, np.float32)
    attribute = attributes.get(name)
    if attribute is not None and len(attribute.data) == count:
        attribute.data.foreach_get(field, values.reshape(-1))
    return np.nan_to_num(values.astype(np.float64))


def _to_unit(vectors: FloatArray, otherwise: FloatArray) -> NDArray[np.float64]:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    out: NDArray[np.float64] = np.where(length > 0.0, vectors / np.where(length > 0.0, length, 1.0), otherwise)
    return out


def _invert(matrix: Any) -> Any:
    return matrix.inverted() if matrix.determinant() else Matrix()
