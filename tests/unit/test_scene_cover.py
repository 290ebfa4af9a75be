"""The box by which light from infinity enters."""

import numpy as np
import pytest
from leaflight.core.scene_cover import SceneCover

COVER = SceneCover(np.float32([-0.5, -0.25, -0.1]), np.float32([0.5, 0.25, 0.1]))


def test_cover_of_a_flat_scene_has_a_thickness():
    cover = SceneCover.around(np.array([[-0.5, -0.5, 0], [0.5, 0.5, 0]], np.float32))
    assert (cover.low < [-0.5, -0.5, 0]).all()
    assert (cover.high > [0.5, 0.5, 0]).all()
    assert (cover.face_area > 0).all()


def test_without_points_it_is_the_unit_box():
    cover = SceneCover.around(np.zeros((0, 3)))
    assert [cover.low.tolist(), cover.high.tolist()] == [[-0.5] * 3, [0.5] * 3]


def test_outline_is_the_faces_that_a_direction_sees():
    assert COVER.face_area == pytest.approx([0.1, 0.2, 0.5])
    direction = np.array([[1, 0, 0], [0, -1, 0], [0, 0, 1], [0.6, 0, -0.8]])
    assert COVER.outline_area(direction) == pytest.approx([0.1, 0.2, 0.5, 0.46])


def test_axes_follow_their_weights_and_leave_a_uniform_rest():
    u = (np.arange(8000) + 0.5) / 8000
    axis, rest = COVER.choose_axis(u, COVER.face_area[None])
    assert np.bincount(axis) == pytest.approx([1000, 2000, 5000], abs=1)
    for k in range(3):
        assert rest[axis == k].mean() == pytest.approx(0.5, abs=0.01)


def test_places_lie_on_their_faces():
    axis, high = np.repeat([0, 1, 2], 2), np.tile([True, False], 3)
    place = COVER.place(axis, high, np.full(6, 0.25), np.full(6, 0.75))
    for k in range(6):
        side = COVER.high if high[k] else COVER.low
        assert place[k, axis[k]] == side[axis[k]]
    assert ((place >= COVER.low) & (place <= COVER.high)).all()
