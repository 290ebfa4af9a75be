"""Contact: the floor knows where the leg of a table stands."""

from types import SimpleNamespace

import numpy as np
import pytest
from leaflight.core.scene.rays import RayScene
from leaflight.core.texels.contact import (
    are_close,
    ends_between,
    find_clear_tiles,
    find_contacts,
    find_cover_edges,
    find_covers,
    rises_between,
    texel_axes,
)
from leaflight.core.texels.split_texels import WAYS
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


@pytest.mark.parametrize("normal", [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.6, 0.0, 0.8), (0.48, 0.6, 0.64)])
def test_feelers_lie_in_the_surface_whatever_its_normal(normal):
    """Along x the surface is the plane x = const: a feeler that left it would meet the quad beside it."""
    normal = np.array(normal)
    rng = np.random.default_rng(1)
    position = rng.random((50, 3)).astype(np.float32)
    directions = []

    class Recorder:
        def occluded(self, origin, direction, distance):
            directions.append(direction)
            assert np.allclose((origin - position) @ normal, 0.25 * 0.01, atol=1e-6)
            assert np.allclose(distance, 1.5 * 0.01)
            return np.zeros(len(origin), bool)

        def closest(self, origin, direction):
            assert not len(origin)
            return SimpleNamespace(tri=np.zeros(0, np.int32), distance=np.zeros(0, np.float32))

    find_contacts(Recorder(), position, np.broadcast_to(np.float32(normal), (50, 3)), np.full(50, 0.01))
    assert len(directions) >= 4
    for direction in directions:
        assert np.allclose(np.linalg.norm(direction, axis=1), 1, atol=1e-5)
        assert np.allclose(direction @ normal, 0, atol=1e-5)
    assert np.allclose(sum(directions), 0, atol=1e-5)


def test_a_surface_without_direction_is_quiet():
    scene = make_scene([quad_mesh("Floor")])
    rays = RayScene(scene.tri_position.astype(np.float32))
    nothing = np.zeros((3, 3), np.float32)
    assert (find_contacts(rays, nothing + np.float32(0.5), nothing, np.full(3, 0.1))[0] == -1).all()
    assert find_contacts(rays, nothing[:0], nothing[:0], np.zeros(0))[1].shape == (4, 0)


@pytest.mark.parametrize("place", [(0.3, 0.6), (0.26, 0.5), (0.62, 0.124)])
def test_clear_tiles_are_those_where_no_texel_finds_anything(place):
    """Rods of half a texel and of a few, seen from a floor of eight by eight tiles."""
    for side_m in (0.5 / SIDE, 5.0 / SIDE):
        scene = make_scene([quad_mesh("Floor"), box_mesh("Rod", (side_m, side_m, 0.5), (*place, 0.25))])
        unit_box = UnitBox.from_points(scene.vertex_position)
        rays = RayScene(unit_box.to_unit(scene.tri_position))
        line = (np.arange(SIDE) + 0.5) / SIDE
        x, y = np.meshgrid(line, line)
        position = unit_box.to_unit(np.stack([x, y, 0 * x], axis=2).reshape(-1, 3)).astype(np.float32)
        up, size = np.broadcast_to(np.float32([0, 0, 1]), position.shape), np.full(len(position), unit_box.scale / SIDE)
        axes = np.broadcast_to(np.float32([[1, 0, 0], [0, 1, 0]])[:, None], (2, *position.shape))
        met, _ = find_contacts(rays, position, up, size, axes)
        tiles = (met >= 0).any(axis=0).reshape(8, 8, 8, 8).any(axis=(1, 3)).ravel()
        grid = position.reshape(8, 8, 8, 8, 3)
        corner = np.stack([grid[:, 0, :, 0], grid[:, 0, :, 7], grid[:, 7, :, 0]]).reshape(3, 64, 3)
        np.testing.assert_array_equal(find_clear_tiles(rays, corner, up[:64], size[:64]), ~tiles)
        assert 0 < tiles.sum() < 10


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


def test_a_cover_ends_where_the_next_texel_has_nothing_near_and_rises_where_it_is_not_far():
    one = np.float32([0.1, 2.9, np.inf, 2.9, 2.9, 0.1, np.inf, 3.1])
    other = np.float32([np.inf, np.inf, 0.1, 5.1, 4.9, 2.9, np.inf, np.inf])
    assert ends_between(one, other).tolist() == [True, True, True, True, False, False, False, False]
    assert ends_between(other, one).tolist() == ends_between(one, other).tolist()
    assert rises_between(one, other).tolist() == [True, True, True, True, True, False, False, False]


@pytest.mark.parametrize("low", [0.0, 2.5])
@pytest.mark.parametrize("x_m", [0.5931, 0.6, 0.6015])
def test_where_a_cover_ends_is_known_to_a_thirtieth_of_a_texel(x_m, low):
    rays, position, up, size, x = rug_scene(low / SIDE, (low + 0.02) / SIDE, (0.25, x_m))
    last = np.flatnonzero((x < x_m) & (x > x_m - 1 / SIDE))
    share = find_cover_edges(rays, position[last], position[last + 1], up[last], size[last])
    assert share == pytest.approx((x_m - x[last]) * SIDE, abs=1 / 32)


@pytest.mark.parametrize("low", [0.0, 2.5])
@pytest.mark.parametrize("edge", [0.3, 1.7, 4.0, 6.8, 7.2])
def test_a_tile_is_clear_below_a_rug_and_beside_it_and_not_where_that_ends(edge, low):
    """Texels from the start of the fourth tile to the rug's right edge; feelers pass above the rug, or below."""
    rays, position, up, size, _ = rug_scene(low / SIDE, (low + 0.02) / SIDE, (-0.5, (24 + edge) / SIDE))
    grid = position.reshape(8, 8, 8, 8, 3)
    corner = np.stack([grid[:, 0, :, 0], grid[:, 0, :, 7], grid[:, 7, :, 0]]).reshape(3, 64, 3)
    clear = find_clear_tiles(rays, corner, up[:64], size[:64]).reshape(8, 8)[1:-1, 1:-1]
    near = {0.3: [2, 3], 7.2: [3, 4]}.get(edge, [3])  # a texel and a half from its first or last point, or less
    np.testing.assert_array_equal(clear, np.broadcast_to(~np.isin(np.arange(1, 7), near), clear.shape))


def test_axes_are_those_of_the_page():
    """A triangle whose page runs along z and against y, its mirror image, and one that its page knows as a line: in its surface anyhow."""
    corner = np.array([[[0, 0, 0], [0, 0, 2.0], [0, -3.0, 0]]] * 3)
    corner_xy = np.array([[[5, 5], [9, 5], [5, 8.0]], [[9, 5], [5, 5], [9, 8.0]], [[5, 5], [9, 5], [7, 5.0]]])
    axes = texel_axes(corner, corner_xy, np.float32([[1, 0, 0]] * 3))
    assert axes[:, 0].tolist() == [[0, 0, 1], [0, -1, 0]]
    assert axes[:, 1].tolist() == [[0, 0, -1], [0, -1, 0]]
    assert np.abs(axes[:, 2, 0]).max() < 1e-6
    assert np.linalg.norm(axes, axis=2) == pytest.approx(1)


def test_each_feeler_tells_what_it_meets():
    """A post to the right of a point, another one below it: of either the side that faces the point."""
    posts = [box_mesh("Right", (0.02, 0.02, 1.0), (0.52, 0.5, 0.5)), box_mesh("Below", (0.02, 0.02, 1.0), (0.5, 0.48, 0.5))]
    scene = make_scene([quad_mesh("Floor"), *posts])
    axes = np.float32([[[1, 0, 0]], [[0, 1, 0]]])
    rays = RayScene(scene.tri_position.astype(np.float32))
    met, texels = find_contacts(rays, np.float32([[0.5, 0.5, 0.0]]), np.float32([[0, 0, 1]]), np.full(1, 0.02), axes)
    assert texels[:, 0] == pytest.approx([0.5, np.inf, np.inf, 0.5], rel=1e-4)
    assert WAYS == ((1, 0), (0, 1), (-1, 0), (0, -1))
    assert [scene.objects[scene.tri_object[tri]].name if tri >= 0 else "" for tri in met[:, 0]] == ["Right", "", "", "Below"]
