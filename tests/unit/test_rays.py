"""What rays meet, and the geometry that they rest on."""

import dataclasses
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from known_light import interpolate_corners
from leaflight.core.scene import rays
from leaflight.core.scene.morton import code_places, find_facing
from leaflight.core.scene.slender_triangles import cut_slender
from leaflight.core.util import geometry, sampling
from leaflight.core.util.geometry import triangle_normals_areas
from scenes import box_mesh, make_scene, sphere_mesh

TRIANGLE = np.array([[[0, 0, 0], [0.5, 0, 0], [0, 0.25, 0]]], np.float32)
DOWN = np.array([[0, 0, -1]], np.float32)

TURN = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
BOX, SPHERE = (
    make_scene([mesh]).tri_position.astype(np.float32)
    for mesh in (dataclasses.replace(box_mesh(), vertex=0.57 * box_mesh().vertex @ TURN), sphere_mesh(rings=24, segments=48, radius_m=0.5))
)


def test_u_weighs_corner_1_and_v_corner_2():
    weights = sampling.square_to_uniform_triangle(np.random.default_rng(1).random((100, 2), np.float32))
    tilted = np.array([[[0.1, 0.2, 0], [0.4, -0.1, 0.2], [-0.3, 0.3, -0.1]]], np.float32)
    target = interpolate_corners(np.repeat(tilted, 100, axis=0), weights[:, 0], weights[:, 1])
    origin = np.tile(np.float32([[0, 0, 0.5]]), (100, 1))
    hits = rays.RayScene(tilted).closest(origin, target - origin)
    assert hits.tri.dtype == np.int32
    assert not hits.tri.any()
    np.testing.assert_allclose(np.stack([hits.u, hits.v], axis=1), weights, atol=2e-6)
    np.testing.assert_allclose(hits.distance, 1, atol=1e-6)


def test_the_first_of_two_triangles_is_met_from_either_side():
    scene = rays.RayScene(np.concatenate([TRIANGLE - np.float32([0, 0, 0.25]), TRIANGLE]))
    origin = np.float32([[0.1, 0.1, 0.5], [0.1, 0.1, -0.5], [0.4, 0.4, 0.5]])
    hits = scene.closest(origin, np.concatenate([DOWN, -DOWN, DOWN]))
    np.testing.assert_array_equal(hits.tri, [1, 0, -1])
    np.testing.assert_allclose(hits.distance[:2], [0.5, 0.25])
    assert np.isfinite(np.concatenate([hits.u, hits.v, hits.distance])).all()


def test_occluded_only_below_the_distance_which_is_left_alone():
    origin, distance = np.float32([[0.1, 0.1, 0.5]] * 2 + [[0.4, 0.4, 0.5]]), np.float32([0.49, 0.51, 9])
    distance.flags.writeable = False
    scene = rays.RayScene(TRIANGLE)
    np.testing.assert_array_equal(scene.occluded(origin, np.repeat(DOWN, 3, axis=0), distance), [False, True, False])
    np.testing.assert_array_equal(distance, np.float32([0.49, 0.51, 9]))


@pytest.mark.parametrize("positions", [np.zeros((0, 3, 3), np.float32), np.zeros((2, 3, 3), np.float32)])
def test_a_scene_without_area_is_missed(positions):
    scene = rays.RayScene(positions)
    origin, direction = np.zeros((4, 3), np.float32), np.ones((4, 3), np.float32)
    hits = scene.closest(origin, direction)
    np.testing.assert_array_equal(hits.tri, [-1] * 4)
    assert not hits.u.any()
    assert not hits.v.any()
    assert not scene.occluded(origin, direction, np.ones(4, np.float32)).any()
    assert len(scene.closest(origin[:0], direction[:0]).tri) == 0


def test_triangles_without_area_are_left_out_but_counted():
    line = np.repeat(TRIANGLE[:, :1], 3, axis=1)
    scene = rays.RayScene(np.concatenate([line, TRIANGLE, line, TRIANGLE - np.float32([0, 0, 0.25])]))
    origin = np.float32([[0.1, 0.1, 0.5], [0.1, 0.1, -0.5], [0.4, 0.4, 0.5]])
    np.testing.assert_array_equal(scene.closest(origin, np.concatenate([DOWN, -DOWN, DOWN])).tri, [1, 3, -1])


def test_a_missing_embreex_is_told_with_what_to_do(monkeypatch):
    monkeypatch.setitem(sys.modules, "embreex.rtcore_scene", None)
    with pytest.raises(ValueError, match=r"embreex cannot be loaded .*; reinstall Leaflight"):
        rays.RayScene(TRIANGLE)
    rays.load_ahead()  # nobody has asked for rays yet


_LITTLE_ROOM = """
import resource
from pathlib import Path
import numpy as np
from leaflight.core.scene import rays
if {loaded}:
    rays.load_ahead()
limit = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize() + {room}
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
rays.load_ahead()
try:
    rays.RayScene(np.float32([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]]).repeat({n_triangles}, axis=0))
except MemoryError as reason:
    print(reason)
"""


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="the limit is set from the address space that Linux tells in /proc")
@pytest.mark.parametrize(("loaded", "n_triangles", "room_mb"), [(False, 1, 20), (True, 1, 150), (True, 300_000, 200)])
def test_little_memory_is_told_where_embree_would_end_the_process(loaded, n_triangles, room_mb):
    code = _LITTLE_ROOM.format(loaded=loaded, n_triangles=n_triangles, room=room_mb << 20)
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "MB for the ray tracer" in told.stdout


def test_rays_aimed_at_edges_hardly_slip_between_triangles():
    corners = SPHERE
    rng = np.random.default_rng(4)
    tri, along = rng.integers(0, len(corners), 100_000), rng.random((100_000, 1), np.float32).round(1)
    on_edge = corners[tri, 0] * along + corners[tri, 1] * (1 - along)
    origin = rng.uniform(-0.2, 0.2, (100_000, 3)).astype(np.float32)
    missed = rays.RayScene(corners).closest(origin, on_edge - origin).tri < 0
    assert missed.mean() < 1e-3  # 6.5 % without embree's robust mode


def _count_self_hits(corners, offset, n):
    """Rays that land somewhere, and start anew from there within 1e-5 ... 1 of the surface's plane, log-uniform."""
    rng = np.random.default_rng(5)
    scene, normals = rays.RayScene(corners), geometry.triangle_normals_areas(corners)[0].astype(np.float32)
    first = scene.closest(rng.uniform(-0.1, 0.1, (n, 3)).astype(np.float32), rng.normal(size=(n, 3)).astype(np.float32))
    assert (first.tri >= 0).all()
    normal = -normals[first.tri]  # all face outwards
    tangent, bitangent = geometry.orthonormal_basis(normal)
    phi, height = 2 * np.pi * rng.random((n, 1), np.float32), (10 ** -rng.uniform(0, 5, (n, 1))).astype(np.float32)
    across = np.sqrt(1 - height**2)
    direction = across * np.cos(phi) * tangent + across * np.sin(phi) * bitangent + height * normal
    landed = interpolate_corners(corners[first.tri], first.u, first.v)
    return int((scene.closest(landed + np.float32(offset) * normal, direction).tri == first.tri).sum())


@pytest.mark.parametrize(("corners", "n"), [(BOX, 200_000), (SPHERE, 200_000)])
def test_no_ray_meets_the_triangle_it_starts_from(corners, n):
    assert _count_self_hits(corners, geometry.ORIGIN_OFFSET, n) == 0
    assert _count_self_hits(corners, 0.0, 10_000) > 0


@pytest.mark.parametrize(("scale", "offset"), [(1e-4, 1e6), (1e5, 0.0)])
def test_unit_box_is_the_same_for_scaled_and_moved_scenes(scale, offset):
    points = np.random.default_rng(1).uniform(-3, 5, (100, 3))
    plain, moved = geometry.UnitBox.from_points(points), geometry.UnitBox.from_points(points * scale + offset)
    unit = moved.to_unit(points * scale + offset)
    assert unit.dtype == np.float32
    assert np.abs(unit).max() == pytest.approx(0.5, abs=1e-6)
    # 1e6 m away float64 itself knows places to 1.2e-10 m only
    np.testing.assert_allclose(unit, plain.to_unit(points), atol=1e-7 + np.spacing(offset) / (8 * scale))
    assert moved.to_unit_length(scale) == pytest.approx(plain.to_unit_length(1.0), rel=1e-5)


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.full((1, 3), 7e5), np.full((4, 3), -2.0)])
def test_unit_box_without_extent_has_scale_one(points):
    box = geometry.UnitBox.from_points(points)
    assert box.scale == 1
    assert not box.to_unit(points).any()


def test_unit_box_of_a_flat_scene():
    box = geometry.UnitBox.from_points(np.array([[0, 0, 4], [2, 1, 4]]))
    np.testing.assert_array_equal(box.to_unit(np.array([[2, 1, 4]])), [[0.5, 0.25, 0]])


def _exact_double_area(corners):
    (ax, ay), (bx, by), (cx, cy) = [[Fraction(float(x)) for x in corner[:2]] for corner in corners]
    return float((bx - ax) * (cy - ay) - (by - ay) * (cx - ax))


def test_needles_keep_their_area_and_normal():
    rng = np.random.default_rng(2)
    start, end = rng.uniform(-1, 1, (2, 50, 2))
    tip = end + (end - start)[:, ::-1] * [-1, 1] * 10.0 ** rng.uniform(-12, -6, (50, 1))
    flat = np.stack([start, end, tip], axis=1)
    corners = np.concatenate([flat, np.zeros((50, 3, 1))], axis=2)
    for turn in range(3):
        normal, area = geometry.triangle_normals_areas(np.roll(corners, turn, axis=1))
        np.testing.assert_allclose(area, [_exact_double_area(c) / 2 for c in corners], rtol=1e-12)
        np.testing.assert_allclose(normal, np.tile([0, 0, 1.0], (50, 1)))


def test_triangles_without_area_have_no_normal():
    line = np.outer([0.1, 0.3, 0.7], [0.3, 0.7, 0.9])
    corners = np.array([np.zeros((3, 3)), np.eye(3)[[0, 0, 1]], line, line * 1e6, line * 1e-9, line[[2, 0, 1]]])
    normal, area = geometry.triangle_normals_areas(corners)
    assert not normal.any()
    assert not area.any()


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_frames_are_orthonormal_and_right_handed(dtype):
    normal = np.random.default_rng(3).normal(size=(1000, 3))
    normal[:6] = [[0, 0, 1], [0, 0, -1], [1, 0, 0], [0, -1, 0], [1e-9, 0, -1], [1, 1, -0.0]]
    normal = (normal / np.linalg.norm(normal, axis=1, keepdims=True)).astype(dtype)
    frame = np.stack([*geometry.orthonormal_basis(normal), normal], axis=1).astype(np.float64)
    np.testing.assert_allclose(frame @ frame.transpose(0, 2, 1), np.tile(np.eye(3), (1000, 1, 1)), atol=10 * np.finfo(dtype).eps)
    assert (np.linalg.det(frame) > 0).all()


# Slender triangles in parts: the same triangles, in parts that are not slender.
def test_a_needle_without_width_is_not_cut_without_end():
    corner = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 0, 0], [1000, 0, 0], [1000, 1e-12, 0]]], np.float64)
    owner, _, area = cut_slender(corner, triangle_normals_areas(corner)[1])
    assert np.bincount(owner).tolist() == [1, 1]
    corner[0] *= 1e-6
    owner, _, area = cut_slender(corner, triangle_normals_areas(corner)[1])
    assert len(owner) < 2**19
    assert (area >= 0).all()


def corners_of(corner: np.ndarray, owner: np.ndarray, part: np.ndarray) -> np.ndarray:
    """(n, 3, 3): those of the parts."""
    first = corner[owner][:, None, 0]
    return first + part[..., :1] * (corner[owner][:, None, 1] - first) + part[..., 1:] * (corner[owner][:, None, 2] - first)


def needles(turn: int) -> np.ndarray:
    """A plump triangle, half of a strip, a needle, one whose height stands in the middle, an obtuse one; each from another corner on."""
    flat = [
        [[0, 0], [1, 0], [0, 1]],
        [[0, 0], [30, 0], [30, 0.04]],
        [[0, -0.01], [10, 0], [0, 0.01]],
        [[0, 0], [20, 0], [10, 0.02]],
        [[0, 0], [20, 0], [25, 0.05]],
    ]
    corner = np.concatenate([np.array(flat, np.float64), np.zeros((5, 3, 1))], axis=2)
    return np.roll(corner, turn, axis=1)


@pytest.mark.parametrize("turn", [0, 1, 2])
def test_parts_are_the_triangle(turn):
    corner = needles(turn)
    area = triangle_normals_areas(corner)[1]
    owner, part, part_area = cut_slender(corner, area)
    assert (np.diff(owner) >= 0).all()
    assert np.bincount(owner)[0] == 1
    assert np.bincount(owner, part_area) == pytest.approx(area, rel=1e-5)
    pieces = corners_of(corner, owner, part)
    assert triangle_normals_areas(pieces)[1] == pytest.approx(part_area, rel=1e-2, abs=1e-6)
    # Random points of the triangles lie in one part each, but for those on edges.
    rng = np.random.default_rng(1)
    u = rng.random((2000, 2))
    u[u.sum(axis=1) > 1] = 1 - u[u.sum(axis=1) > 1]
    for tri in range(len(corner)):
        first, second, third = part[owner == tri].astype(np.float64).transpose(1, 0, 2)
        det = (second - first)[:, 0] * (third - first)[:, 1] - (second - first)[:, 1] * (third - first)[:, 0]
        at = u[:, None] - first
        v = (at[..., 0] * (third - first)[:, 1] - at[..., 1] * (third - first)[:, 0]) / det
        w = ((second - first)[:, 0] * at[..., 1] - (second - first)[:, 1] * at[..., 0]) / det
        inside = ((v >= 0) & (w >= 0) & (v + w <= 1)).sum(axis=1)
        assert (inside == 1).mean() > 0.99


GRID_SIDE = 16


@pytest.mark.parametrize("larger", [0, 1, 2, 4])
def test_leading_bits_are_the_larger_cell(larger):
    place = np.stack(np.meshgrid(*[np.arange(GRID_SIDE)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    cell, block = code_places(place) >> 3 * larger, (place >> larger) @ [1, 100, 10_000]
    assert len(np.unique(np.stack([cell, block], axis=1), axis=0)) == len(np.unique(cell)) == len(np.unique(block))


def test_the_way_a_facet_faces_is_that_of_its_greatest_part():
    normals = np.array([[0.8, 0.6, 0], [-0.8, 0.6, 0], [0.6, 0.8, 0], [0, -1, 0], [0, 0.6, 0.8], [0.1, 0, -0.9]])
    assert find_facing(normals).tolist() == [0, 1, 2, 3, 4, 5]
