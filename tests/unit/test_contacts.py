"""A floor is cut where walls and boxes stand on it, and what lies on one side of them does not leak to the other."""

from copy import deepcopy
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from boxes import prepare_folder, to_bytes
from leaflight.core.bake import bake, solve
from leaflight.core.filter.denoise import denoise
from leaflight.core.integrate import texel_light
from leaflight.core.integrate.direct_field import DirectField
from leaflight.core.output.image_file import read_image
from leaflight.core.parallel import executors, folders, shared_arrays
from leaflight.core.scene.scene import Light
from leaflight.core.scene.snapshot import save_snapshot
from leaflight.core.scene.topology import join_sets
from leaflight.core.texels.tiles import TILE_TEXELS
from leaflight.core.transport import contact_map, traced_scene
from leaflight.core.transport.contact_map import ContactMap, cut_at_contacts, find_contacts
from leaflight.core.util.job import SNAPSHOT_FILE, Job
from leaflight.core.util.settings import Settings
from processes import wait_until_ready
from scenes import Mesh, box_mesh, join_meshes, make_scene, moved, quad_mesh, sphere_mesh, split_faces

# A floor is cut where walls and boxes stand on it, and what lies on one side of them does not leak to the other.
SIDE = 64  # texels of the floor, a square metre
SETTINGS = Settings(size=SIDE, margin=0, error=1e-4, denoise=False, direct="photons")
LAMP = Light("POINT", "Lamp", (0.2, 0.5, 0.4), power_rgb=(1.0,) * 3)
SUN = Light("SUN", "Sun", rotation=((0.5**0.5, 0, 0.5**0.5), (0, 1, 0), (-(0.5**0.5), 0, 0.5**0.5)), power_rgb=(1.0,) * 3)  # from the left
SQUARE = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
# The same page seen from behind, turned, and both.
LAYERS = {"plain": SQUARE, "mirrored": SQUARE * [-1, 1] + [1, 0], "turned": SQUARE[:, ::-1] * [1, -1] + [0, 1]}


def wall(x_m=0.5, low_m=-0.1, high_m=1.1, thick_m=0.1):
    """It stands on the floor from y = low_m to y = high_m."""
    size = (thick_m, high_m - low_m, 0.5)
    return replace(box_mesh("Wall", size, (x_m, (low_m + high_m) / 2, 0.25)), receives=False)


def sheet(x_m=0.503, high_m=1.1):
    """A wall without thickness."""
    corners = np.array([[x_m, -0.1, 0], [x_m, high_m, 0], [x_m, high_m, 0.5], [x_m, -0.1, 0.5]])
    return Mesh("Sheet", corners, [[0, 1, 2, 3]], receives=False)


def with_fin(x_m, depth_m=1.0, y=0.0):
    """A floor with a wall of its own, which shares an edge with both halves; its layer starts at y."""
    rows = [[x, depth_m * y, 0] for y in (0, 1) for x in (0, x_m, 1)]
    vertex = np.array([*rows, [x_m, 0, 0.5], [x_m, depth_m, 0.5]])
    left, right = ([[low, y], [high, y], [high, y + 0.4 * depth_m], [low, y + 0.4 * depth_m]] for low, high in ((0, x_m), (x_m, 1)))
    return Mesh("Floor", vertex, [[0, 1, 4, 3], [1, 2, 5, 4], [1, 4, 7, 6]], [np.array(left), np.array(right), SQUARE * 0.2 + [0, 0.7]])


def cut_floor(folder, *meshes, layer="plain", floor=None, light=LAMP):
    """The map of a floor with things on it before and after it was cut, what was found, and the scene."""
    floor = floor or quad_mesh("Floor", uv=LAYERS[layer])
    scene = make_scene([floor, *(replace(mesh, receives=False) for mesh in meshes)], [light])
    atlas, texels = prepare_folder(folder, scene, SETTINGS)
    found = find_contacts(traced_scene.open_scene(str(folder)), texels)
    cut, cut_atlas, touched = cut_at_contacts(deepcopy(texels), atlas, found)
    assert {tuple(xy) for xy in cut.texel_xy[touched]} == {tuple(xy) for xy in texels.texel_xy[found.touched]}
    assert len(cut_atlas.chart_page) == len(cut_atlas.chart_object) == len(cut.chart_page)
    assert touched.sum() == found.touched.sum()
    folders.forget_folders()
    return texels, cut, cut_atlas, scene


def places_of(texels, scene):
    """(n, 2) x and y of the floor's texels in space, in texels from its corner."""
    return np.einsum("nk,nkj->nj", texels.texel_bary, scene.tri_position[texels.texel_tri])[:, :2] * SIDE


def draw(texels, scene, values):
    """(SIDE, SIDE) values of the floor's texels by their places in space, row 0 at y = 0, column 0 at x = 0; -1 where there is none."""
    column, row = places_of(texels, scene).astype(int).T
    picture = np.full((SIDE, SIDE), -1, values.dtype)
    picture[row, column] = values
    return picture


def draw_pieces(cut, scene):
    """(SIDE, SIDE) int: the chart of each texel of the floor."""
    picture = draw(cut, scene, cut.texel_chart)
    assert picture.min() == 0
    return picture


@pytest.mark.parametrize("layer", LAYERS)
def test_a_wall_parts_a_floor_and_what_is_below_it_is_a_third_piece(tmp_path, layer):
    _, cut, _, scene = cut_floor(tmp_path, wall(), layer=layer)
    pieces = draw_pieces(cut, scene)
    below = np.abs((np.arange(SIDE) + 0.5) / SIDE - 0.5) < 0.05
    assert len(cut.chart_page) == 3
    assert (pieces == pieces[0]).all()
    assert [len(np.unique(pieces[0, columns])) for columns in (slice(0, 28), below, slice(36, None))] == [1, 1, 1]
    assert len(np.unique(pieces[0])) == 3


@pytest.mark.parametrize("layer", LAYERS)
def test_a_wall_thinner_than_a_texel_parts_it_too(tmp_path, layer):
    _, cut, _, scene = cut_floor(tmp_path, sheet(), layer=layer)
    pieces = draw_pieces(cut, scene)
    assert len(cut.chart_page) == 2
    assert (pieces[:, :32] == pieces[0, 0]).all()
    assert (pieces[:, 32:] == 1 - pieces[0, 0]).all()


@pytest.mark.parametrize("layer", LAYERS)
@pytest.mark.parametrize("middle", [0.505, 0.51])
def test_what_a_texel_has_within_the_corner_of_a_hut_is_the_hut_s(tmp_path, layer, middle):
    """Corners of the hut lie in texels whose middles see neither of its walls; two of them where the floor's triangles meet."""
    x, y = np.array([-0.25, 0.25, 0.25, -0.25]) + middle, np.array([-0.25, -0.25, 0.25, 0.25]) + middle
    vertex = np.array([[*place, z] for z in (0.0, 0.5) for place in zip(x, y, strict=True)])
    hut = Mesh("Hut", vertex, [[0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]])
    _, cut, _, scene = cut_floor(tmp_path, hut, layer=layer)
    assert len(cut.chart_page) == 2
    tri, u, v = make_hits(400_000)
    place = (scene.tri_position[tri] * np.stack([1 - u - v, u, v], axis=1)[:, :, None]).sum(axis=1)[:, :2] - middle
    x, y = cut.hit_texel_xy(tri, u, v)
    chart = cut.texel_chart[cut.owner_of(cut.entry_of(tri, x, y), x, y)]
    inside = chart[np.abs(place).max(axis=1).argmin()]
    at_corner = (np.abs(np.abs(place) - 0.25) < 1 / SIDE).all(axis=1) & (np.abs(place) < 0.25).all(axis=1)
    assert at_corner.sum() > 300
    assert (chart[at_corner] != inside).mean() < 1e-3
    beyond = (np.abs(place) > 0.25 + 1 / SIDE).any(axis=1)
    assert not (chart[beyond] == inside).any()


def make_hits(count):
    """Places on the floor: its triangles (count,), and weights of their corners 1 and 2."""
    rng = np.random.default_rng(1)
    u, v = np.sort(rng.random((2, count)), axis=0)
    return rng.integers(0, 2, count), u, v - u


def rug(x_m, high_m, low_m=0.0):
    """It lies on the floor, or hangs above it, from x = x_m on."""
    return box_mesh("Rug", (2.0, 4.0, high_m - low_m), (x_m + 1.0, 0.5, (low_m + high_m) / 2))


@pytest.mark.parametrize("layer", LAYERS)
@pytest.mark.parametrize(("low", "high"), [(0.0, 0.02), (0.05, 0.1), (1.0, 1.02), (2.8, 9.0)])
def test_a_rug_much_thinner_than_a_texel_parts_the_floor(tmp_path, layer, low, high):
    """Rays along the floor pass above it, or below: a board that hangs close above the floor parts it as well."""
    x_m = 32.3 / SIDE
    _, cut, _, scene = cut_floor(tmp_path, rug(x_m, high / SIDE, low / SIDE), layer=layer)
    pieces = draw_pieces(cut, scene)
    assert len(cut.chart_page) == 2
    assert (pieces[:, :32] == pieces[0, 0]).all()
    assert (pieces[:, 32:] == pieces[0, -1]).all()
    assert len(cut.borders.entry) == 2 * SIDE
    reach = cut.borders.reach.min(axis=0)
    is_known = np.isfinite(reach)  # not where the layer's edge cuts texels by a hair
    assert is_known.mean() > 0.9
    expected = np.abs(x_m * SIDE - places_of(cut, scene)[cut.borders.entry, 0])
    np.testing.assert_allclose(reach[is_known], expected[is_known], atol=1 / 16)


@pytest.mark.parametrize("height", [0.002, 0.004])
@pytest.mark.parametrize("turn", [0, 20, 45])
def test_below_an_edge_that_hovers_a_texel_s_area_is_where_its_hits_go(tmp_path, height, turn):
    """Light comes below the edge of a roof hung upside down, from where rays along the floor meet one of its faces or the other."""
    vertex = np.array([[-0.2, -0.3, 0.3], [-0.2, 0.3, 0.3], [0, 0.3, 0], [0, -0.3, 0], [0.2, 0.3, 0.3], [0.2, -0.3, 0.3]])
    spin = np.array(
        [[np.cos(np.radians(turn)), -np.sin(np.radians(turn)), 0], [np.sin(np.radians(turn)), np.cos(np.radians(turn)), 0], [0, 0, 1]]
    )
    roof = Mesh("Roof", vertex @ spin.T + [0.5, 0.5, height], [[0, 1, 2, 3], [3, 2, 4, 5]])
    texels, cut, _, _ = cut_floor(tmp_path, roof)
    tri, u, v = make_hits(2_000_000)
    x, y = cut.hit_texel_xy(tri, u, v)
    hits = np.bincount(cut.owner_of(cut.entry_of(tri, x, y), x, y), minlength=len(cut))
    expected = len(tri) * cut.texel_area / cut.texel_area.sum()
    assert (np.abs(hits - expected) < 6 * np.sqrt(expected) + 3).all()
    assert cut.texel_area.sum() == pytest.approx(texels.texel_area.sum(), rel=1e-6)


def test_a_thing_covers_no_part_of_itself(tmp_path):
    """A floor with a lip of its own just above it."""
    vertex = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0, 0.1 / SIDE], [0.5, 1, 0.1 / SIDE]])
    lip = Mesh("Floor", vertex, [[0, 1, 2, 3], [1, 4, 5, 2]], [SQUARE, np.array([[2, 0], [2.5, 0], [2.5, 1], [2, 1.0]])])
    _, cut, _, _ = cut_floor(tmp_path, floor=lip)
    assert len(cut.borders.entry) == 0


def test_a_corridor_of_two_columns_is_one_piece(tmp_path):
    """What is met beyond the next texel's point parts nothing from that."""
    _, cut, _, scene = cut_floor(tmp_path, wall(31.3 / SIDE - 0.05), wall(32.7 / SIDE + 0.05))
    pieces = draw_pieces(cut, scene)
    assert (pieces[:, 31:33] == pieces[0, 31]).all()
    assert len(cut.chart_page) == len(np.unique(pieces[0, [10, 28, 31, 36, 50]])) == 5
    left, right = (np.flatnonzero(cut.texel_xy[:, 0] == column) for column in (31, 32))
    assert not cut.borders.are_between(0, left, right).any()


def turned(degrees, side):
    """The layer of a quad that is turned on its page."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return (SQUARE - 0.5) @ np.array([[c, s], [-s, c]]) * side


@pytest.mark.parametrize("x_m", [0.21, 0.36, 0.51, 0.66])
@pytest.mark.parametrize("degrees", [20, 45, 110, 200, 290])
def test_a_floor_that_is_turned_on_its_page_is_parted_too(tmp_path, x_m, degrees):
    """Points of texels at its border lie beside their middles: rays along rows and columns do not go from one to the next."""
    _, cut, _, scene = cut_floor(tmp_path, sheet(x_m), floor=quad_mesh("Floor", uv=turned(degrees, 0.7) + 0.5))
    assert len(cut.chart_page) == 2
    central = cut.is_central
    x = places_of(cut, scene)[central, 0]
    np.testing.assert_array_equal(cut.texel_chart[central] == cut.texel_chart[central][x.argmin()], x < x_m * SIDE)


@pytest.mark.parametrize("x_m", [0.5, 0.503])  # between two texels, and within one
def test_a_thing_does_not_part_itself(tmp_path, x_m):
    """A rough or hollow surface meets itself everywhere. The foot of the fin, an edge, has parted the floor before this is asked."""
    texels, cut, _, _ = cut_floor(tmp_path, floor=with_fin(x_m))
    assert len(cut.chart_page) == len(texels.chart_page) == 3
    assert len(cut.borders.entry) == 0


@pytest.mark.parametrize("split", [False, True])
def test_what_was_joined_parts_as_before(tmp_path, split):
    """A wall that only stands on the floor is a thing of its own, also where each face has vertices for itself, as in many files."""
    floor = quad_mesh("Floor", uv=SQUARE * [1, 0.5] + [0, 0.5])
    box = replace(wall(), uv=[SQUARE * 0.1 + [0.15 * k, 0.1] for k in range(6)])
    drawn = []
    for name, whole, things in (
        ("joined", join_meshes("House", floor, split_faces(box) if split else box), []),
        ("apart", floor, [wall()]),
    ):
        _, cut, _, _ = cut_floor(tmp_path / name, *things, floor=whole)
        picture = np.full((SIDE, SIDE), -1)
        picture[cut.texel_xy[:, 1], cut.texel_xy[:, 0]] = cut.texel_chart
        drawn.append(picture[SIDE // 2 :])
    assert [len(np.unique(one)) for one in drawn] == [3, 3]
    assert len(np.unique(np.stack(drawn, axis=2).reshape(-1, 2), axis=0)) == 3


def test_charts_know_nothing_of_each_other(tmp_path, part_entries):
    """Boxes on a floor and on each other; a wall with an end stands on it too, and a rug and a ball lie there."""
    boxes = [
        box_mesh(f"Box {k}", (0.2, 0.15, 0.3), (x, y, z))
        for k, (x, y, z) in enumerate([(0.3, 0.3, 0.15), (0.4, 0.3, 0.4), (0.3, 0.7, 0.15)])
    ]
    ball = moved(sphere_mesh(radius_m=0.15), (0.55, 0.8, 0.15))
    things = [replace(mesh, receives=False) for mesh in (wall(0.55, high_m=0.6, thick_m=0.02), rug(0.72, 0.02 / SIDE), ball)]
    scene = make_scene([quad_mesh("Floor", uv=turned(20, 0.7) + 0.5), *boxes, *things], [LAMP])
    texels = prepare_folder(tmp_path, scene, replace(SETTINGS, size=4 * SIDE))[1]
    part_entries(3000)
    opened = traced_scene.open_scene(str(tmp_path))
    whole = find_contacts(opened, texels)
    starts = np.unique(texels.chart_start).tolist()
    assert len(starts) > 10
    for ends in (starts, [0, starts[3], starts[-1]], [0, starts[-1]]):
        joined = ContactMap.join([find_contacts(opened, texels, part=slice(*part)) for part in pairwise(ends)])
        assert to_bytes(joined) == to_bytes(whole)
    folders.forget_folders()
    chart = texels.texel_chart[whole.patches.start]
    assert len(np.unique(chart[whole.piece != whole.whole])) >= 1  # or the test would say little
    assert len(np.unique(chart)) >= 4
    assert set(whole.patches.size.tolist()) == {1, TILE_TEXELS}  # tiles are known only within what one look is at
    assert whole.touched.any()
    assert len(np.unique(texels.texel_chart[whole.borders.entry])) >= 2


def test_what_rises_from_the_floor_parts_nothing(tmp_path):
    """A board that leaves the floor at forty-five degrees, where it lies on it and where it is high above: no light jumps below it."""
    x_m = np.array([0.4, 1.2])
    corners = np.array([[x_m[i], y, x_m[i] - 0.4 + 0.3 / SIDE] for i, y in ((0, -0.1), (1, -0.1), (1, 1.1), (0, 1.1))])
    _, cut, cut_atlas, scene = cut_floor(tmp_path, Mesh("Board", corners, [[0, 1, 2, 3]], receives=False))
    pieces = draw_pieces(cut, scene)
    assert len(cut_atlas.chart_page) == 2  # parted where it begins
    assert (pieces == pieces[0]).all()
    assert np.flatnonzero(np.diff(pieces[0])).tolist() == [int(0.4 * SIDE + 0.5) - 1]


def test_nothing_moves_on_the_page_and_no_area_is_lost(tmp_path):
    """A floor that is turned on its page, so that texels at its border are covered in part."""
    turn = np.array([[0.8, 0.6], [-0.6, 0.8]])
    floor = quad_mesh("Floor", uv=(SQUARE - 0.5) @ turn * 0.7 + 0.5)
    texels, cut, cut_atlas, scene = cut_floor(tmp_path, wall(), sheet(0.8), floor=floor)
    assert len(cut.chart_page) == 4
    assert (np.diff(cut.list_keys(slice(None))) > 0).all()
    assert cut.chart_start.tolist() == [*np.flatnonzero(np.diff(cut.texel_chart, prepend=-1)), len(cut.texel_chart)]
    assert set(cut_atlas.chart_object) == set(cut_atlas.chart_page) == {0}

    tri, u, v = make_hits(50_000)
    x, y = texels.hit_texel_xy(tri, u, v)
    before, after = texels.entry_of(tri, x, y), cut.entry_of(tri, x, y)
    nowhere = texels.grid.cell_entry < 0
    assert nowhere.any()
    np.testing.assert_array_equal(cut.grid.cell_entry < 0, nowhere)
    for name in ("texel_xy", "texel_code", "texel_tri", "texel_bary"):
        np.testing.assert_array_equal(getattr(cut, name)[after], getattr(texels, name)[before])
    np.testing.assert_array_equal(cut.is_central[after], texels.is_central[before])
    point = np.random.default_rng(2).random((3, 1, 2))
    for one, other in zip(texels.sub_points(before, point), cut.sub_points(after, point), strict=True):
        np.testing.assert_array_equal(one, other)

    def moments(texel_map):
        count = len(texel_map.chart_start) - 1
        frame = np.full((count, 2), 32.0), np.full(count, 32.0)
        return texel_map.range_moments(texel_map.chart_start[:-1], texel_map.chart_start[1:], *frame, 2).sum(axis=0)

    assert (cut.texel_area[after] != texels.texel_area[before]).any()
    shares = np.isfinite(cut.borders.reach).any(axis=0)  # a texel that is covered in part keeps all of that
    entry = cut.borders.entry[shares]
    assert 0 < len(entry) < len(shares)
    found = cut.range_moments(entry, entry + 1, cut.texel_xy[entry] + 0.5, np.ones(len(entry)), 2)
    place = np.full(len(cut.texel_chart), -1)
    place[after] = before
    assert (place[entry] >= 0).all()
    first = np.searchsorted(cut.part_entry, entry)
    alone = np.diff(cut.pair_start)[first] == 1  # not where the floor's two triangles meet
    assert 0 < alone.sum() < len(entry)
    np.testing.assert_array_equal(cut.pair_tri[cut.pair_start[first[alone]]], cut.texel_tri[entry[alone]])
    assert np.diff(cut.pair_start).min() == 1
    np.testing.assert_allclose(found.T, cut.borders.measure(2)[:, shares] * texels.texel_area[place[entry]], rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(moments(cut), moments(texels), rtol=1e-4, atol=1e-4)  # but for corners, and where the layer ends
    assert scene.tri_object[cut.texel_tri].max() == 0


@pytest.mark.parametrize(("x_m", "most"), [(33 / SIDE, 0.0), (0.512, 0.02), (0.518, 0.02)])
def test_light_does_not_leak_below_a_thin_wall(tmp_path, x_m, most):
    """A lamp on one side, and so few photons that leaves are many texels wide; also where a texel lies on both sides."""
    settings = replace(SETTINGS, max_photons=20_000)
    _, cut, cut_atlas, scene = cut_floor(tmp_path, sheet(x_m))
    dark = cut.texel_chart == draw_pieces(cut, scene)[0, -1]
    _, whole = prepare_folder(tmp_path / "whole", scene, SETTINGS)
    leaking = light_of(tmp_path / "whole", settings, whole, replace(cut_atlas, chart_page=whole.chart_page))
    right = places_of(whole, scene)[:, 0] > x_m * SIDE
    assert leaking[right].sum() > 0.005 * leaking.sum()  # or the test could not fail
    assert light_of(tmp_path, settings, cut, cut_atlas)[dark].sum() <= most * leaking[right].sum()


@pytest.mark.parametrize("layer", LAYERS)
def test_the_filter_does_not_spread_what_a_texel_takes_from_beyond_a_wall(tmp_path, layer):
    """Texels of one column have their middles in the dark, but a part of their squares in the light: they are bright, and noisy."""
    x_m = 32.4 / SIDE
    _, cut, _, scene = cut_floor(tmp_path, sheet(x_m), layer=layer)
    column = places_of(cut, scene)[:, 0].astype(int)
    light, noise = np.select([column < 32, column == 32], [10.0, 3.0], 0.1), np.select([column < 32, column == 32], [1.0, 3.0], 0.1)
    light += noise * np.random.default_rng(1).standard_normal(len(cut))
    rgb, variance = (np.repeat(values[:, None], 3, axis=1).astype(np.float32) for values in (light, noise**2))
    found = denoise(rgb[None], variance, np.ones(len(cut), bool), cut)
    out = light.copy()
    out[found.entry] = found.light[0, :, 0]
    assert out[column > 32].std() < 0.05
    assert out[column > 32].mean() == pytest.approx(0.1, abs=0.01)
    assert out[column == 33].mean() == pytest.approx(0.1, abs=0.05)
    assert out[column == 32].mean() == pytest.approx(3.0, abs=1.0)
    assert out[column == 32].std() < 2.0


def test_a_texel_that_a_rug_ends_in_is_as_bright_as_the_floor_beside_it(tmp_path):
    """The rug covers 0.2 of the texels of its edge, which lay in a dark rim: photons fall on what is left of them."""
    settings = replace(SETTINGS, max_photons=400_000)
    above = replace(SUN, rotation=((1, 0, 0), (0, 1, 0), (0, 0, 1)))
    _, cut, cut_atlas, scene = cut_floor(tmp_path, rug(32.8 / SIDE, 0.02 / SIDE), light=above)
    column = places_of(cut, scene)[:, 0].astype(int)
    light = light_of(tmp_path, settings, cut, cut_atlas)
    assert light[column == 32].mean() == pytest.approx(light[column < 32].mean(), rel=0.04)
    assert light[column > 32].max() < 0.001 * light[column < 32].mean()  # its edge is known to a thirtieth of a texel


def test_light_does_not_leak_below_what_hangs_close_above(tmp_path):
    """A shelf two texels above the floor, a sun straight above, and so few photons that leaves are many texels wide."""
    settings = replace(SETTINGS, max_photons=20_000)
    above = replace(SUN, rotation=((1, 0, 0), (0, 1, 0), (0, 0, 1)))
    _, cut, cut_atlas, scene = cut_floor(tmp_path / "cut", rug(35 / SIDE, 2.2 / SIDE, 2.0 / SIDE), light=above)
    _, whole = prepare_folder(tmp_path / "whole", scene, SETTINGS)
    beside, below = {}, {}
    for name, texels in (("cut", cut), ("whole", whole)):
        column = places_of(texels, scene)[:, 0].astype(int)
        light = light_of(tmp_path / name, settings, texels, replace(cut_atlas, chart_page=texels.chart_page))
        beside[name], below[name] = (light[(column >= k) & (column < k + 4)].mean() / light[column < 28].mean() for k in (31, 35))
    assert below["whole"] > 0.3  # or the test could not fail
    assert beside["whole"] < 0.9
    assert below["cut"] < 0.1
    assert beside["cut"] == pytest.approx(1.0, abs=0.02)


def light_of(folder, settings, texels, atlas):
    """(n,) brightness of the texels, of a bake with contacts."""
    shared_arrays.remove_struct(folder / folders.TEXELS_FOLDER)
    shared_arrays.save_struct(folder / folders.TEXELS_FOLDER, texels)
    n_texel = len(texels.texel_chart)
    executor, direct = executors.InlineExecutor(), DirectField.none(n_texel)
    try:
        light = solve.Solver(folder, settings, executor, direct, np.zeros(n_texel, bool)).run(lambda message: None, lambda: False)
    finally:
        folders.forget_folders()
    at_texels = texel_light.light_at_texels(light, texels, smooth_grain=False)
    return (at_texels.direct + at_texels.indirect).sum(axis=1)


@pytest.mark.parametrize("seed", range(3))
def test_light_does_not_leak_below_a_wall_with_a_door(tmp_path, monkeypatch, seed):
    """Its foot in the dark is one column of texels in a square that holds the foot in the light too; and few photons make large leaves."""
    settings = replace(SETTINGS, max_photons=20_000, seed=seed)
    door = wall(29 / SIDE, high_m=0.8, thick_m=4 / SIDE - 1e-3)
    light = {}
    for name in ("cut", "whole"):
        if name == "whole":
            monkeypatch.setattr(contact_map, "part_in_squares", lambda key, size, ways, *_: (join_sets(len(key), *ways),) * 2)
        _, cut, cut_atlas, scene = cut_floor(tmp_path / name, door)
        page = draw(cut, scene, light_of(tmp_path / name, settings, cut, cut_atlas))
        light[name] = page[:40, 31].mean() / page[:40, :27].mean()
    assert light["whole"] > 0.05  # or the test could not fail
    assert light["cut"] < 0.02


@pytest.mark.parametrize("foot", [33.0, 33.7])  # texels
def test_light_does_not_leak_below_a_wall_where_the_floor_has_an_edge(tmp_path, foot):
    """Floors often have an edge at a wall's foot: texels there are covered by two faces, in part by each."""
    x_m = foot / SIDE
    corners = np.array([[0, 0, 0], [x_m, 0, 0], [1, 0, 0], [1, 1, 0], [x_m, 1, 0], [0, 1, 0]])
    faces = [[0, 1, 4, 5], [1, 2, 3, 4]]
    floor = Mesh("Floor", corners, faces, uv=[corners[face, :2] for face in faces])
    _, cut, cut_atlas, scene = cut_floor(tmp_path, sheet(x_m, high_m=0.8), floor=floor, light=SUN)
    page = draw(cut, scene, light_of(tmp_path, replace(SETTINGS, max_photons=20_000), cut, cut_atlas))
    behind = int(np.ceil(foot))
    assert page[:40, behind : behind + 4].mean() < 0.01 * page[:40, :30].mean()


# Contacts that several processes look for are those that one finds.
COARSE = Settings(size=224, direct="photons", max_photons=20_000, error=0.5, passes=("lighting",))
HIGH_LAMP = Light("POINT", "Lamp", (0.2, 0.5, 0.9), power_rgb=(1.0,) * 3)


@pytest.fixture
def scene():
    """Boxes on a floor that a wall parts."""
    boxes = [box_mesh(f"Box {k}", (0.2, 0.2, 0.3), (x, y, 0.15)) for k, (x, y) in enumerate([(0.2, 0.2), (0.4, 0.2), (0.7, 0.7)])]
    wall = replace(box_mesh("Wall", (0.02, 0.7, 0.5), (0.55, 0.3, 0.25)), receives=False)
    return make_scene([quad_mesh("Floor"), *boxes, wall], [HIGH_LAMP])


@pytest.fixture
def as_many(monkeypatch):
    """Has so many processes counted, of which this one does all the work."""
    return lambda count: monkeypatch.setattr(executors.LocalExecutor, "idle", count)


def test_a_bake_by_two_processes_has_the_light_of_one(tmp_path, scene, as_many, open_image_io):
    """Though they are still at the first photons, so that a bake as small as this would not ask them."""
    images = []
    for count in (1, 2):
        folder = tmp_path / str(count)
        folder.mkdir()
        save_snapshot(folder / SNAPSHOT_FILE, scene)
        Job(replace(COARSE, workers=count), str(folder / "images"), "room").save(folder)
        executor = executors.make_executor(count)
        if count > 1:
            wait_until_ready(executor)
            as_many(count)
        bake.run_bake(folder, lambda message: None, lambda: False, lambda settings, executor=executor: executor)
        images.append(read_image(folder / "images" / "room_0.lighting.exr")[0])
    np.testing.assert_array_equal(*images)
