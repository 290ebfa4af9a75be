"""Seams are found and closed, and charts are cut at creases."""

import dataclasses
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from leaflight.core.atlas.charts import ChartAtlas, make_charts
from leaflight.core.filter.seams import match_seams
from leaflight.core.integrate.texel_light import TexelLight
from leaflight.core.output.resolve import Resolver, close_seams
from leaflight.core.scene.materials import SurfaceMaterials
from leaflight.core.scene.scene import Material
from leaflight.core.texels import creases
from leaflight.core.texels.creases import cut_at_creases
from leaflight.core.texels.seam_points import SeamPoints, find_seams
from leaflight.core.texels.texels import TexelMap, build_texel_map
from leaflight.core.util.settings import Settings
from scenes import (
    HINGE_LEFT,
    HINGE_RIGHT,
    Mesh,
    box_mesh,
    grid_mesh,
    hinge_mesh,
    join_meshes,
    make_scene,
    moved,
    shade_smooth,
    sphere_mesh,
    split_faces,
)
from seam_steps import measure_step

ALBEDO = (0.5, 0.25, 0.75)


@dataclass
class Lit:
    """A scene lit by a function of place and normal, with the same share of direct light everywhere."""

    scene: object
    points: SeamPoints
    texels: TexelMap
    light: TexelLight

    def closed(self):
        return close_seams(self.light, self.points, self.texels)

    def pages(self, light, name="lighting", margin=4):
        resolver = Resolver(light, self.texels, SurfaceMaterials(self.scene), margin)
        return np.stack([resolver.page(name, page) for page in range(self.texels.page_count)])


def light_scene(scene, irradiance, size=64, noise=0.0, stderr=0.0):
    """`irradiance` of positions (n, 3) and unit normals (n, 3); `noise` is relative, one value for each chart."""
    scene = dataclasses.replace(scene, materials=(Material("Tinted", ALBEDO, emission_rgb=(0.0, 0.0, 2.0)),))
    atlas = make_charts(scene, Settings(size=size))
    texels = build_texel_map(scene, cut_at_creases(scene, atlas), 2)
    weight, tri = texels.texel_bary[..., None], texels.texel_tri
    normal = (weight * scene.tri_normal[tri]).sum(axis=1)
    value = irradiance((weight * scene.tri_position[tri]).sum(axis=1), normal / np.linalg.norm(normal, axis=1, keepdims=True))
    value = value * (1 + noise * np.random.default_rng(4).normal(size=len(texels.chart_page))[texels.texel_chart])
    rgb = (value[:, None] * np.array([1.0, 0.8, 0.6])).astype(np.float32)
    doubt = np.broadcast_to(np.asarray(stderr, np.float32)[..., None], rgb.shape) * rgb
    light = TexelLight(rgb * np.float32(0.3), rgb * np.float32(0.7), doubt, np.zeros(len(rgb), np.int32))
    points = find_seams(scene, atlas.tri_chart, atlas.tri_uv, atlas.object_page[scene.tri_object])
    return Lit(scene, points, texels, light)


def by_sun(position, normal):
    return np.maximum(normal @ np.array([0.6, 0.0, 0.8]), 0.0) + 0.2


def rms_change(before, after):
    covered = before[..., 3] > 0
    return float(np.sqrt(((after[covered] / before[covered] - 1)[:, 0] ** 2).mean()))


@pytest.mark.parametrize("size", [64, 256])
def test_a_smooth_sphere_has_no_steps_and_hardly_other_light(hold, size):
    lit = light_scene(shade_smooth(make_scene([sphere_mesh()])), by_sun, size)
    light, report = lit.closed()
    before, after = lit.pages(lit.light), lit.pages(light)
    steps = measure_step(before, lit.points), measure_step(after, lit.points)
    hold("seams: step that is left on a smooth sphere, of what it was", 100 * steps[1] / steps[0], high=20, unit="%")
    assert (report.step_before, report.step_after) == pytest.approx(steps, rel=0.01)
    assert (report.edges, report.texels > 50) == (lit.points.n_edge, True)
    assert rms_change(before, after) < 0.02
    for name in ("direct", "indirect"):
        assert measure_step(lit.pages(light, name), lit.points) < 1.5 * steps[1]


@pytest.mark.parametrize("size", [64, 256])
def test_charts_of_a_plane_that_err_apart_meet(hold, size):
    """The truth is a ramp; the light of each chart is off by its own 4 %, as it says."""

    def ramp(position, normal):
        return 1.0 + 0.3 * position[:, 0] + 0.2 * position[:, 1]

    lit, truth = (light_scene(make_scene([hinge_mesh()]), ramp, size, noise, 0.04) for noise in (0.04, 0.0))
    light, _ = lit.closed()
    before, after, right = (one.pages(its) for one, its in ((lit, lit.light), (lit, light), (truth, truth.light)))
    steps = measure_step(before, lit.points), measure_step(after, lit.points)
    hold("seams: step that is left on a plane, of what it was", 100 * steps[1] / steps[0], high=20, unit="%")
    hold("seams: error of a plane with its seam closed, over that before", rms_change(right, after) / rms_change(right, before), high=1)


def test_a_seam_beside_the_edge_of_the_page_is_closed_as_within_it():
    """Both sides of it lie one texel from an edge of the page; rows go on at the other one in memory."""
    left = np.array([[16, 40], [0, 40], [0, 8], [16, 8]]) / 64
    found = []
    for shift in (1 / 64, 4 / 64):
        uv = left + np.array([shift, 0.0]), left[[1, 0, 3, 2]] * [-1.0, 1.0] + np.array([1.0 - shift, 0.0])
        lit = light_scene(make_scene([hinge_mesh(uv=uv)]), lambda position, normal: 1.0 + 0.3 * position[:, 0], noise=0.04, stderr=0.04)
        light, report = lit.closed()
        assert report.step_after < 0.1 * report.step_before
        found.append(light.direct)
    np.testing.assert_allclose(*found, rtol=1e-6)


def test_a_step_of_the_light_itself_stays():
    """Something stands on the very edge: the light is another one beyond it."""
    lit = light_scene(make_scene([hinge_mesh()]), lambda position, normal: np.where(position[:, 0] < 1.0, 1.0, 0.1), stderr=0.02)
    light, report = lit.closed()
    assert report.edges == 1
    assert report.step_before > 1.0
    np.testing.assert_array_equal(light.direct, lit.light.direct)
    np.testing.assert_array_equal(light.indirect, lit.light.indirect)


def test_the_noisier_side_moves_more():
    scene = make_scene([hinge_mesh()])
    left = light_scene(scene, lambda position, normal: position[:, 0]).light.direct[:, 0] < 0.3
    doubt = np.where(left, 0.02, 0.2)
    lit = light_scene(scene, lambda position, normal: np.where(position[:, 0] < 1.0, 1.0, 1.2), stderr=doubt)
    light, report = lit.closed()
    moved = np.abs(light.direct / lit.light.direct - 1)[:, 0]
    assert report.step_after < 0.1 * report.step_before
    assert moved[~left].max() > 3 * moved[left].max() > 0


def test_light_never_falls_below_zero_and_black_stays_black():
    scene = shade_smooth(make_scene([sphere_mesh()]))
    dim = light_scene(scene, lambda position, normal: np.maximum(normal[:, 2], 0.0) ** 8)
    light, _ = dim.closed()
    assert min(light.direct.min(), light.indirect.min(), light.empty.light.min()) >= 0
    black = light_scene(scene, lambda position, normal: np.zeros(len(position)))
    light, report = black.closed()
    assert not light.direct.any()
    assert (report.step_before, report.step_after) == (0.0, 0.0)


def test_seams_that_no_texel_lies_near_leave_the_light_as_it_was():
    """As of an object that is smaller than a texel."""
    lit = light_scene(make_scene([sphere_mesh()]), by_sun)
    points = light_scene(shade_smooth(make_scene([sphere_mesh()])), by_sun).points
    bare, light = np.full_like(lit.texels.entry_at, -1), lit.light
    for part in (slice(None), slice(0)):  # of all entries, and where there is none at all
        direct, central = light.direct[part], lit.texels.is_central[part]
        (matched,), empty, report = match_seams(points, [direct], light.stderr[part], central, bare)
        np.testing.assert_array_equal(matched, direct)
        assert (report.edges, report.texels, report.step_before, report.step_after) == (points.n_edge, 0, 0.0, 0.0)
        assert len(empty.page) == empty.light.shape[1] == 0


def test_without_seams_the_light_is_as_it_was():
    lit = light_scene(make_scene([sphere_mesh()]), by_sun)
    light, report = lit.closed()
    assert light is lit.light
    assert report.edges == report.texels == 0


def test_light_beside_charts_is_in_every_pass_of_light_and_no_other():
    lit = light_scene(shade_smooth(make_scene([sphere_mesh()])), by_sun)
    light, _ = lit.closed()
    x, y = light.empty.xy.T
    at = (light.empty.page, y, x)
    lighting = light.empty.light.sum(axis=0) / np.pi
    np.testing.assert_allclose(lit.pages(light)[at][:, :3], lighting, rtol=1e-5)
    np.testing.assert_allclose(lit.pages(light, "direct")[at][:, :3], light.empty.light[0] / np.pi, rtol=1e-5)
    np.testing.assert_allclose(lit.pages(light, "diffuse")[at][:, :3], lighting * ALBEDO, rtol=1e-5)
    np.testing.assert_allclose(lit.pages(light, "combined")[at][:, :3], lighting * ALBEDO + [0, 0, 2], rtol=1e-5)
    for name in ("lighting", "combined"):
        pages = lit.pages(light, name)
        assert not pages[at][:, 3].any(), "it is margin"
        np.testing.assert_array_equal(pages[..., 3], lit.pages(lit.light, name)[..., 3])
    for name in ("stderr", "albedo", "emission"):
        np.testing.assert_array_equal(lit.pages(light, name), lit.pages(lit.light, name))


def find(scene):
    atlas = make_charts(scene, Settings(size=64))
    return find_seams(scene, atlas.tri_chart, atlas.tri_uv, atlas.object_page[scene.tri_object]), atlas


def positions_of(scene, points):
    """(2, m, 3): where the points are in space, by their triangles on either side."""
    u, v = points.weight[..., 0], points.weight[..., 1]
    return np.einsum("smk,smkj->smj", np.stack([1 - u - v, u, v], axis=2), scene.tri_position[points.tri])


def test_no_seams_are_found_within_a_chart_whose_file_holds_vertices_for_each_face():
    points, atlas = find(make_scene([split_faces(grid_mesh(cells=4))]))
    assert len(atlas.chart_page) == 1
    assert points.n_edge == 0


def test_both_sides_of_a_point_are_one_place_in_space_and_their_own_on_the_page():
    scene = shade_smooth(make_scene([sphere_mesh(rings=10, segments=20)]))
    points, atlas = find(scene)
    assert points.n_edge > 20
    one, other = positions_of(scene, points)
    np.testing.assert_allclose(one, other, atol=1e-6)
    u, v = points.weight[..., 0], points.weight[..., 1]
    uv = np.einsum("smk,smkj->smj", np.stack([1 - u - v, u, v], axis=2), atlas.tri_uv[points.tri])
    np.testing.assert_allclose(uv, points.place, atol=1e-4)
    assert (np.linalg.norm(points.place[0] - points.place[1], axis=1) > 0.1).all()


@pytest.mark.parametrize("mesh", [box_mesh(), sphere_mesh()], ids=lambda mesh: mesh.name)
def test_flat_faces_with_an_angle_between_them_have_none(mesh):
    assert find(make_scene([mesh]))[0].n_edge == 0


def test_flat_faces_in_one_plane_have_one():
    points, _ = find(make_scene([hinge_mesh()]))
    assert points.n_edge == 1
    assert points.place.shape == (2, 52, 2)  # two to a texel of the side that is longer on the page, 0.4 * 64 texels
    assert points.page.tolist() == [[0] * 52] * 2
    np.testing.assert_allclose(points.place[0, :, 0], 0.3 * 64)
    np.testing.assert_allclose(points.place[1, :, 1], 0.6 * 64)


@pytest.mark.parametrize(("angle_deg", "count"), [(55, 1), (65, 0)])
def test_smooth_shading_joins_faces_that_are_not_folded(angle_deg, count):
    scene = make_scene([hinge_mesh(angle_deg)])
    assert find(scene)[0].n_edge == 0
    assert find(shade_smooth(scene))[0].n_edge == count


def test_vertices_in_one_place_are_one():
    """Files often hold a vertex once for each texture coordinate it has, and walls are made of panels."""
    one, other = Mesh("One", hinge_mesh().vertex[[0, 1, 2, 3]], [[0, 1, 2, 3]], [HINGE_LEFT]), hinge_mesh()
    panel = Mesh("Other", other.vertex[[1, 4, 5, 2]], [[0, 1, 2, 3]], [HINGE_RIGHT])
    assert find(make_scene([one, panel]))[0].n_edge == 1
    assert find(make_scene([one, moved(panel, (1e-3, 0, 0))]))[0].n_edge == 0
    both = make_scene([one, panel])
    odd = dataclasses.replace(both, objects=(both.objects[0], dataclasses.replace(both.objects[1], two_sided=True)))
    assert find(odd)[0].n_edge == 0


def test_edges_within_a_chart_and_of_three_faces_are_none():
    joined = hinge_mesh(uv=(HINGE_LEFT, HINGE_LEFT + np.array([0.2, 0.0])))
    assert find(make_scene([joined]))[0].n_edge == 0
    third = Mesh("Third", np.array([[1, 0, 0], [1, 1, 0], [1, 1, 1], [1, 0, 1.0]]), [[0, 1, 2, 3]], [HINGE_LEFT])
    assert find(make_scene([hinge_mesh(), third]))[0].n_edge == 0


# Where charts are cut: along edges at which shading normals differ, and nowhere else.
SIDE = 16.0  # texels, of each of the two faces of a strip


def strip(angle_deg, smooth=False, side=SIDE, faces=2):
    """Square faces in a row, each bent against the one before, on one chart; 1 m is `side` texels."""
    turn = np.radians(angle_deg) * np.arange(faces)
    x = np.concatenate([[0.0], np.cumsum(np.cos(turn))])
    z = np.concatenate([[0.0], np.cumsum(np.sin(turn))])
    position = np.array([[x[i], y, z[i]] for i in range(faces + 1) for y in (0.0, 1.0)])
    vertex, normal, uv = [], [], []
    flat = np.stack([-np.sin(turn), np.zeros(faces), np.cos(turn)], axis=1)
    at = [flat[max(i - 1, 0) : i + 1].mean(axis=0) for i in range(faces)] + [flat[-1]]
    for i in range(faces):
        for corners in ((0, 2, 3), (0, 3, 1)):
            index = [2 * i + corner for corner in corners]
            vertex.append(index)
            normal.append([at[k // 2] / np.linalg.norm(at[k // 2]) if smooth else flat[i] for k in index])
            uv.append([[side * (k // 2), side * (k % 2)] for k in index])
    n = len(vertex)
    scene = SimpleNamespace(
        vertex_position=position,
        tri_object=np.ones(n, np.int32),
        tri_vertex=np.array(vertex, np.int32),
        tri_normal=np.array(normal, np.float32),
        tri_position=position[np.array(vertex)],
        n_tri=n,
    )
    atlas = ChartAtlas(
        page_size=256,
        page_count=3,
        tri_chart=np.full(n, 1, np.int32),
        tri_uv=np.array(uv, float),
        chart_page=np.array([0, 2], np.int32),
        chart_object=np.array([0, 1], np.int32),
        object_page=np.array([0, 2], np.int32),
        object_block=np.full(2, -1, np.int32),
        object_place=np.tile([1.0, 1.0, 0.0, 0.0], (2, 1)),
        warnings=(),
    )
    return scene, atlas


@pytest.mark.parametrize(("angle_deg", "smooth", "charts"), [(0, False, 1), (10, False, 1), (60, False, 2), (60, True, 1)])
def test_a_chart_is_cut_where_its_shading_is(angle_deg, smooth, charts):
    cut = creases.cut_at_creases(*strip(angle_deg, smooth))
    assert cut.tri_chart.tolist() == ([0, 0, 1, 1] if charts == 2 else [0] * 4)
    assert cut.chart_page.tolist() == [2] * charts
    assert cut.chart_object.tolist() == [1] * charts


def test_faces_smaller_than_texels_stay_together():
    cut = creases.cut_at_creases(*strip(60, side=1.5, faces=5))
    assert set(cut.tri_chart.tolist()) == {0}


@pytest.mark.parametrize(
    ("widths", "charts"),
    [
        ((1, 1, 1), [0, 0, 0]),  # 8 texels^2 each, but light of the next one in every texel
        ((2, 2, 2), [0, 1, 2]),
        ((1, 2.5, 1), [0, 0, 0]),  # wide enough by itself, but lost among narrow ones
        ((1, 2.5, 9), [0, 1, 2]),
        ((1, 9, 1), [0, 1, 2]),
    ],
)
def test_only_faces_that_are_wide_in_texels_are_cut_apart(widths, charts):
    scene, atlas = strip(60, side=1.0, faces=len(widths))
    edges = np.concatenate([[0.0], np.cumsum(widths)])
    atlas.tri_uv[..., 0] = edges[atlas.tri_uv[..., 0].astype(int)]
    atlas.tri_uv[..., 1] *= 8.0
    assert creases.cut_at_creases(scene, atlas).tri_chart[::2].tolist() == charts


FLOOR = np.array([[x, y, 0] for y in (0, 1) for x in (0, 1, 2)], float)
TILES = [[0, 1, 4, 3], [1, 2, 5, 4]]
WALL = np.array([[1, 0, 0], [1, 1, 0], [1, 1, 1], [1, 0, 1]], float)


def chart_of_floor(mesh):
    """Facets of the first four triangles, two tiles, which lie on one chart as the rest does; at 20 texels a metre."""
    scene = make_scene([mesh])
    n = scene.n_tri
    side_on = scene.tri_position[..., [2, 1]] + [3.0, 0.0]
    uv = 20.0 * np.where((scene.tri_position[..., 2] == 0).all(axis=1)[:, None, None], scene.tri_position[..., :2], side_on)
    one, none = np.zeros(1, np.int32), np.full(1, -1, np.int32)
    atlas = ChartAtlas(256, 1, np.zeros(n, np.int32), uv, one, one, one, none, np.array([[1.0, 1.0, 0.0, 0.0]]), ())
    return creases.cut_at_creases(scene, atlas).tri_chart[:4].tolist()


@pytest.mark.parametrize("split", [False, True])
@pytest.mark.parametrize(
    ("others", "is_cut"),
    [
        ([], False),
        ([[1, 4, 6, 7]], True),
        ([[1, 4, 6, 7], [4, 1, 7, 6]], True),  # a wall with a face on either side
        ([[0, 3, 4, 1]], False),  # the back of a tile
        ([[0, 1, 4, 3]], False),  # the same tile again
        ([[1, 4, 8, 9]], True),  # a wall aslant, over the next tile
    ],
)
def test_a_floor_is_cut_where_a_wall_shares_an_edge_with_it(others, is_cut, split):
    mesh = Mesh("House", np.concatenate([FLOOR, WALL[2:], [[2, 1, 1], [2, 0, 1]]]), [*TILES, *others])
    if split:
        floor, rest = Mesh("House", FLOOR, TILES), Mesh("Rest", mesh.vertex, others)
        mesh = join_meshes("House", floor, split_faces(rest)) if others else split_faces(floor)
    assert chart_of_floor(mesh) == ([0, 0, 1, 1] if is_cut else [0] * 4)


def test_a_floor_is_whole_where_a_wall_ends_within_or_beside_an_edge_or_is_another_object():
    floor, wall = Mesh("House", FLOOR, TILES), Mesh("Wall", WALL, [[0, 1, 2, 3]])
    for moved_m, scale in (((1.0, 0.0, 0.0), 0.5), ((0.0, 0.1, 0.0), 1.0)):
        assert chart_of_floor(join_meshes("House", floor, moved(wall, moved_m, scale))) == [0] * 4
    scene, atlas = strip(0)
    wall = np.array([[1, 0, 0], [1, 1, 0], [1, 1, 1]], float)
    scene.vertex_position = np.concatenate([scene.vertex_position, wall])
    scene.tri_vertex = np.concatenate([scene.tri_vertex, len(scene.vertex_position) - 3 + np.arange(3)[None]])
    scene.tri_normal = np.concatenate([scene.tri_normal, np.tile(np.float32([1, 0, 0]), (1, 3, 1))])
    scene.tri_object = np.append(scene.tri_object, 0)
    atlas = replace(atlas, tri_chart=np.append(atlas.tri_chart, 0), tri_uv=np.concatenate([atlas.tri_uv, 40 + 16 * wall[None, :, 1:]]))
    assert creases.cut_at_creases(scene, atlas).tri_chart.tolist() == [0, 0, 0, 0, 1]
    scene.tri_object[:] = 1
    assert creases.cut_at_creases(scene, atlas).tri_chart.tolist() == [0, 0, 1, 1, 2]


@pytest.mark.parametrize("own_vertices", [False, True])
def test_a_smooth_surface_with_a_back_of_its_own_stays_whole(own_vertices):
    """Four faces lie at each edge, but go off in two directions alone; each side has its chart."""
    scene, atlas = strip(30, smooth=True, faces=5)
    n, back = len(scene.vertex_position), scene.tri_vertex[:, [0, 2, 1]]
    if own_vertices:
        scene.vertex_position, back = np.tile(scene.vertex_position, (2, 1)), back + n
    scene.tri_vertex = np.concatenate([scene.tri_vertex, back])
    scene.tri_normal = np.concatenate([scene.tri_normal, -scene.tri_normal[:, [0, 2, 1]]])
    scene.tri_object = np.tile(scene.tri_object, 2)
    uv = np.concatenate([atlas.tri_uv, atlas.tri_uv[:, [0, 2, 1]] + [0.0, 20.0]])
    atlas = replace(atlas, tri_chart=np.repeat([0, 1], 10).astype(np.int32), tri_uv=uv)
    assert creases.cut_at_creases(scene, atlas).tri_chart.tolist() == [0] * 10 + [1] * 10


def test_triangles_without_a_chart_stay_without():
    scene, atlas = strip(60)
    atlas.tri_chart[0] = -1
    assert creases.cut_at_creases(scene, atlas).tri_chart.tolist() == [-1, 0, 1, 1]
    atlas.tri_chart[:] = -1
    assert creases.cut_at_creases(scene, atlas).tri_chart.tolist() == [-1] * 4


def test_a_texel_across_a_crease_is_shown_by_the_side_that_holds_its_centre():
    scene, atlas = strip(60, side=16.25)  # the crease is at x = 16.25, short of the centre of texel 16
    texels = build_texel_map(scene, creases.cut_at_creases(scene, atlas), 0)
    across = np.flatnonzero((texels.texel_xy == [16, 5]).all(axis=1))
    assert texels.texel_chart[across].tolist() == [0, 1]
    assert texels.shown[across].tolist() == [False, True]
    areas = texels.texel_area[across] * 16.25**2
    np.testing.assert_allclose(areas, [0.25, 0.75], rtol=1e-9)
    assert texels.shown.sum() == len(np.unique(texels.texel_xy, axis=0))
