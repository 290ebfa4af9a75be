"""Samples that have a closed form: where texels lie, and what light is there."""

import numpy as np
import pytest
import sample_truths
from scenes import make_scene, quad_mesh

SIZE = 32
LAYOUT = np.array([[(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)], [(0.0, 0.0), (1.0, 1.0), (0.0, 1.0)], [(0.0, 0.0), (0.0, 0.0), (0.0, 0.0)]])


def test_the_square_is_lit_then_falls_off_then_is_dark():
    """As much of the lamp as (0.65 - x) / 0.3, by a lamp far enough that its parts are worth the same to 3 %."""
    x = np.array([0.1, 0.34, 0.42, 0.5, 0.58, 0.66, 0.9])
    light = sample_truths.square_light(np.column_stack([x, np.full(7, 0.5), np.zeros(7)]))
    whole = 40.0 / (np.pi * np.pi * 2.0**2) * (4.0 / (4.0 + (x - 0.5) ** 2)) ** 2
    np.testing.assert_allclose(light / whole, np.clip((0.65 - x) / 0.3, 0, 1), atol=0.03)


def test_pages_are_held_against_the_closed_form():
    scene = make_scene([quad_mesh("Square")])
    page = np.full((SIZE, SIZE, 4), 2.04, np.float32)
    errors = sample_truths.measure_truth("furnace", page, LAYOUT[:2], scene)
    assert errors.bias == pytest.approx(0.02, rel=1e-3)
    assert errors.texels == SIZE * SIZE
    assert sample_truths.measure_truth("two_rooms", page, LAYOUT[:2], scene) is None
