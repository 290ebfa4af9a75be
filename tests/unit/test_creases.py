"""Where charts are cut: along edges at which shading normals differ, and nowhere else."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from leaflight.core.atlas.charts import ChartAtlas
from leaflight.core.texels import creases
from leaflight.core.texels.texels import build_texel_map
from scenes import Mesh, join_meshes, make_scene, moved, split_faces

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
