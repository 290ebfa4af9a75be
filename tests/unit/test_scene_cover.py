"""The box by which light from infinity enters."""

import numpy as np
import pytest
from leaflight.core.scene.scene_cover import SceneCover

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


@pytest.mark.parametrize("weight", [COVER.face_area[None], np.tile(COVER.face_area, (8000, 1))])
def test_faces_follow_their_weights_and_leave_a_uniform_rest(weight):
    u = (np.arange(8000) + 0.5) / 8000
    across, rest = COVER.choose_faces(u, weight)
    assert (across.sum(axis=0) == 1).all()
    assert across.sum(axis=1) == pytest.approx([1000, 2000, 5000], abs=1)
    for chosen in across == 1:
        assert np.sort(rest[chosen]) == pytest.approx((np.arange(chosen.sum()) + 0.5) / chosen.sum(), abs=2e-3)
