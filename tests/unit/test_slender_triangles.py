"""Slender triangles in parts: the same triangles, in parts that are not slender."""

import numpy as np
import pytest
from leaflight.core.scene.slender_triangles import cut_slender
from leaflight.core.util.geometry import triangle_normals_areas


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


def test_a_needle_without_width_is_not_cut_without_end():
    corner = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 0, 0], [1000, 0, 0], [1000, 1e-12, 0]]], np.float64)
    owner, _, area = cut_slender(corner, triangle_normals_areas(corner)[1])
    assert np.bincount(owner).tolist() == [1, 1]
    corner[0] *= 1e-6
    owner, _, area = cut_slender(corner, triangle_normals_areas(corner)[1])
    assert len(owner) < 2**19
    assert (area >= 0).all()
