from fractions import Fraction

import numpy as np
import pytest
from leaflight.core.util import geometry


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
