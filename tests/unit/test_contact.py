"""Contact: the floor knows where the leg of a table stands."""

import numpy as np
import pytest
from leaflight.core.scene.rays import RayScene
from leaflight.core.texels.contact import (
    are_close,
    find_contacts,
    find_covers,
)
from leaflight.core.util.geometry import UnitBox
from scenes import box_mesh, make_scene, quad_mesh

SIDE = 64
LEG_M = 0.1


def find_on_floor(meshes, texel_m=1 / SIDE, normal=(0.0, 0.0, 1.0)):
    """(SIDE, SIDE) bool over a floor of a square metre, row 0 at y = 0, and the distance of each texel to the leg's square, m."""
    scene = make_scene([quad_mesh("Floor"), *meshes])
    unit_box = UnitBox.from_points(scene.vertex_position)
    line = (np.arange(SIDE) + 0.5) / SIDE
    x, y = (grid.ravel() for grid in np.meshgrid(line, line))
    position = unit_box.to_unit(np.stack([x, y, 0 * x], axis=1)).astype(np.float32)
    up = np.broadcast_to(np.float32(normal), position.shape)
    met, _ = find_contacts(RayScene(unit_box.to_unit(scene.tri_position)), position, up, np.full(len(x), texel_m * unit_box.scale))
    found = (met >= 0).any(axis=0)
    beyond = np.maximum(np.abs(np.stack([x - 0.3, y - 0.6])) - LEG_M / 2, 0)
    return found.reshape(SIDE, SIDE), np.hypot(*beyond).reshape(SIDE, SIDE)


def leg(height_m=0.7, gap_m=0.0):
    return box_mesh("Leg", (LEG_M, LEG_M, height_m), (0.3, 0.6, gap_m + height_m / 2))


def test_texels_at_the_leg_are_found_and_those_far_away_are_not():
    found, distance = find_on_floor([leg()])
    beside = (distance > 0) & (distance < 1 / SIDE)
    assert beside.sum() > 4 * LEG_M * SIDE - 4
    assert np.count_nonzero(beside & ~found) <= 4  # the corners' own, which the feelers pass on both sides
    assert not found[distance > 2 / SIDE].any()


def test_the_reach_is_measured_in_texels():
    near, far = (find_on_floor([leg()], texel_m=size)[0].sum() for size in (1 / SIDE, 4 / SIDE))
    assert far > 2 * near


def test_a_bare_floor_and_what_hangs_high_above_it_are_no_contact():
    assert not find_on_floor([])[0].any()
    assert not find_on_floor([leg(gap_m=1 / SIDE)])[0].any()


def test_what_nearly_touches_counts():
    assert find_on_floor([leg(gap_m=0.1 / SIDE)])[0].sum() > 4 * LEG_M * SIDE - 8


def test_a_surface_without_direction_is_quiet():
    scene = make_scene([quad_mesh("Floor")])
    rays = RayScene(scene.tri_position.astype(np.float32))
    nothing = np.zeros((3, 3), np.float32)
    assert (find_contacts(rays, nothing + np.float32(0.5), nothing, np.full(3, 0.1))[0] == -1).all()
    assert find_contacts(rays, nothing[:0], nothing[:0], np.zeros(0))[1].shape == (4, 0)


def rug_scene(low_m, high_m, x_m=(0.25, 0.6)):
    """Ray tracer, unit box, and what find_covers asks for at a floor's texels (SIDE * SIDE), with a rug from x to x on it."""
    rug = box_mesh("Rug", (x_m[1] - x_m[0], 2.0, high_m - low_m), (sum(x_m) / 2, 0.5, (low_m + high_m) / 2))
    scene = make_scene([quad_mesh("Floor"), rug])
    unit_box = UnitBox.from_points(scene.vertex_position)
    line = (np.arange(SIDE) + 0.5) / SIDE
    x, y = (grid.ravel() for grid in np.meshgrid(line, line))
    position = unit_box.to_unit(np.stack([x, y, 0 * x], axis=1)).astype(np.float32)
    up = np.broadcast_to(np.float32([0, 0, 1]), position.shape)
    return RayScene(unit_box.to_unit(scene.tri_position)), position, up, np.full(len(x), unit_box.scale / SIDE), x


@pytest.mark.parametrize(("low", "high"), [(0.0, 0.02), (0.0, 0.2), (0.1, 0.2), (2.7, 9.0), (0.0, 9.0)])
def test_what_lies_on_the_surface_or_hangs_close_above_covers_it(low, high):
    """A rug much lower than the feelers, one a little above the floor, a cupboard on legs, a box on the floor; in texels."""
    rays, position, up, size, x = rug_scene(low / SIDE, high / SIDE)
    met, height = find_covers(rays, position, up, size)
    inside = (x > 0.25) & (x < 0.6) & (high < 9.0 or low > 0)
    np.testing.assert_array_equal(met >= 0, inside)
    np.testing.assert_array_equal(are_close(height), inside)
    assert height[inside] == pytest.approx(low or high, abs=0.01)
    assert np.isinf(height[~inside]).all()


def test_what_hangs_above_covers_nothing():
    rays, position, up, size, x = rug_scene(5.1 / SIDE, 5.3 / SIDE)
    assert (find_covers(rays, position, up, size)[0] == -1).all()
    rays, position, up, size, x = rug_scene(3.1 / SIDE, 5.3 / SIDE)
    height = find_covers(rays, position, up, size)[1]
    assert not are_close(height).any()
    np.testing.assert_array_equal(np.isfinite(height), (x > 0.25) & (x < 0.6))  # as a thing that rises from a cover would be
