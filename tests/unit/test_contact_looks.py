"""What texels of a floor meet along it and above it, asked of whole tiles first."""

from dataclasses import fields, replace
from itertools import pairwise

import numpy as np
import pytest
from boxes import prepare_folder
from leaflight.core.parallel import folders
from leaflight.core.scene.scene import Light
from leaflight.core.texels.tiles import TILE_TEXELS
from leaflight.core.transport import traced_scene
from leaflight.core.transport.contact_looks import Looks, Surroundings
from leaflight.core.util.settings import Settings
from scenes import Mesh, box_mesh, make_scene, quad_mesh

SIDE = 64  # texels of the floor, a square metre
TEXEL_M = 1.0 / SIDE
SQUARE = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
LAMP = Light("POINT", "Lamp", (0.2, 0.5, 0.9), power_rgb=(1.0,) * 3)


def thing(size, centre):
    """In texels, on the floor."""
    return replace(box_mesh("Thing", [TEXEL_M * one for one in size], [TEXEL_M * one for one in centre]), receives=False)


@pytest.fixture
def around(tmp_path):
    """The floor among things."""

    def open_floor(*things, floor=None):
        scene = make_scene([floor or quad_mesh("Floor", uv=SQUARE), *things], [LAMP])
        texels = prepare_folder(tmp_path, scene, Settings(size=SIDE, margin=0))[1]
        return Surroundings.of(traced_scene.open_scene(str(tmp_path)), texels)

    yield open_floor
    folders.forget_folders()


def look_everywhere(around):
    return around.look(slice(0, len(around.frames.texels)))


def xy_of(around, looks):
    """(k, 2): the first texel of each patch."""
    return around.frames.texels.texel_xy[looks.start]


def test_nothing_touches_a_bare_floor(around):
    looks = look_everywhere(around())
    inside = looks.size == TILE_TEXELS
    assert inside.sum() >= (SIDE // 8 - 2) ** 2  # all tiles but those across the diagonal and at the border, which cover texels in part
    assert looks.size.sum() == SIDE**2
    assert not looks.touched.any()
    assert np.isinf(looks.height).all()
    assert np.isinf(looks.distance).all()


def test_a_wall_is_met_from_both_sides_as_far_away_as_it_is(around):
    """Between columns 20 and 21, from one end of the floor to the other."""
    floor = around(thing((0.1, 90, 30), (20.8, 32, 15)))
    looks = look_everywhere(floor)
    x = xy_of(floor, looks)[:, 0]
    single = looks.size == 1
    for column, way, expected in ((20, 0, 0.25), (21, 2, 0.65)):  # to its faces, from the texels' middles
        rows = np.flatnonzero(single & (x == column))
        assert len(rows) == SIDE
        np.testing.assert_allclose(looks.distance[way, rows], expected, atol=0.01)
    assert looks.touched[np.isin(floor.frames.texels.texel_xy[:, 0], (20, 21))].all()
    assert set(x[np.isfinite(looks.distance).any(axis=0)]) <= {19, 20, 21, 22}


def test_a_board_is_as_high_above_as_it_hangs(around):
    """Over columns and rows 10 to 29."""
    floor = around(thing((20, 20, 1), (20, 20, 2.5)))
    looks = look_everywhere(floor)
    x, y = xy_of(floor, looks).T
    below = (looks.size == 1) & (x >= 10) & (x < 30) & (y >= 10) & (y < 30)
    assert below.any()
    np.testing.assert_allclose(looks.height[below], 2.0, atol=0.01)
    beside = (looks.size == 1) & ((x < 9) | (x > 30) | (y < 9) | (y > 30))
    assert np.isinf(looks.height[beside]).all()
    assert not looks.touched.any()


def test_a_fin_of_the_floor_itself_is_no_other_thing(around):
    """It touches, for no leaf goes over its foot; but it stands in nobody's way."""
    rows = [[x, y, 0] for y in (0, 1) for x in (0, 0.5, 1)]
    halves = [np.array([[low, 0], [high, 0], [high, 0.4], [low, 0.4]]) for low, high in ((0, 0.5), (0.5, 1))]
    faces = [[0, 1, 4, 3], [1, 2, 5, 4], [1, 4, 7, 6]]
    fin = Mesh("Floor", np.array([*rows, [0.5, 0, 0.5], [0.5, 1, 0.5]]), faces, [*halves, SQUARE * 0.2 + [0, 0.7]])
    looks = look_everywhere(around(floor=fin))
    assert looks.touched.any()
    assert np.isinf(looks.distance).all()


def test_what_stands_between_two_texels_and_where_a_board_ends(around):
    floor = around(thing((0.1, 90, 30), (20.8, 32, 15)), thing((20, 20, 1), (44.3, 20, 2.5)))
    entry = {tuple(xy): i for i, xy in enumerate(floor.frames.texels.texel_xy.tolist())}
    left, right = ([entry[x, y] for y in range(4, 60)] for x in (20, 21))
    assert floor.are_parted(np.array(left), np.array(right)).all()
    further = [entry[x, y] for x, y in ((19, y) for y in range(4, 60))]
    assert not floor.are_parted(np.array(left), np.array(further)).any()
    covered, bare = (np.array([entry[x, y] for y in range(12, 28)]) for x in (34, 33))  # it begins at x = 34.3, of middles at 34.5
    one, other = floor.find_ends(np.ones(len(covered), bool), covered, bare)
    np.testing.assert_allclose(one, 0.2, atol=0.04)
    np.testing.assert_allclose(one + other, 1.0, rtol=1e-6)
    swapped = floor.find_ends(np.zeros(len(covered), bool), bare, covered)
    np.testing.assert_array_equal(swapped, (other, one))


def test_parts_are_joined_to_what_one_look_tells(around):
    floor = around(thing((0.1, 90, 30), (20.8, 32, 15)))
    count, told = len(floor.frames.texels), []
    cuts = [0, count // 4, count // 2, count]
    joined = Looks.join([floor.look(slice(*ends)) for ends in pairwise(cuts)], told.append)
    whole = look_everywhere(floor)
    for field in fields(Looks):
        np.testing.assert_array_equal(getattr(joined, field.name), getattr(whole, field.name))
    assert told == sorted(told)
    some = whole.of_patches(np.arange(3, 9))
    np.testing.assert_array_equal(some.distance, whole.distance[:, 3:9])
    assert some.touched is whole.touched
