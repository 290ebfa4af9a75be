import numpy as np
import pytest
from leaflight.core.atlas.layer_check import find_overlaps, signed_areas
from leaflight.core.atlas.unwrap import Unwrapping
from leaflight.core.util.geometry import triangle_normals_areas
from scenes import Mesh, box_mesh, grid_mesh, join_meshes, make_scene, moved, quad_mesh, sphere_mesh


def unwrap(mesh):
    scene = make_scene([mesh])
    return scene, *Unwrapping(scene.tri_position, scene.tri_vertex, scene.tri_polygon, scene.tri_corner, scene.tri_object).finish()


def overlaps_within_charts(chart, uv):
    """How many triangles lie over others of their chart, each chart looked at by itself."""
    found = 0
    for k in range(chart.max() + 1):
        own = uv[chart == k] - uv[chart == k].min(axis=(0, 1))
        found += int(find_overlaps(own / own.max()).sum())
    return found


def check_promises(mesh):
    scene, chart, uv, shared = unwrap(mesh)
    area = triangle_normals_areas(scene.tri_position)[1]
    used = chart >= 0
    np.testing.assert_array_equal(used, area > 0, err_msg="every triangle with an area has a chart, no other has one")
    assert np.isfinite(uv).all()
    assert not shared[~used].any()
    assert set(chart[used]) == set(range(chart.max() + 1))
    uv_of_corner, chart_of_corner = {}, {}
    for tri in np.flatnonzero(used):
        for corner, point in zip(scene.tri_corner[tri].tolist(), uv[tri].tolist(), strict=True):
            assert uv_of_corner.setdefault(corner, point) == point, f"corner {corner} has two UVs"
            assert chart_of_corner.setdefault(corner, chart[tri]) == chart[tri], f"corner {corner} has two charts"
    assert (np.abs(signed_areas(uv[used])) > 0).all()
    count = chart.max() + 1
    uv_area = np.bincount(chart[used], np.abs(signed_areas(uv[used])), count)
    return scene, chart, uv, uv_area, np.bincount(chart[used], area[used], count)


SOUND = {
    "quad": quad_mesh(),
    "box": box_mesh(),
    "sphere": sphere_mesh(),
    "bent grid 0.6": grid_mesh(noise=0.6),
    "bent grid 1.5": grid_mesh(noise=1.5),
    "two of every face": Mesh("Double", box_mesh().vertex, box_mesh().polygons * 2),
    "both sides": Mesh("Both", grid_mesh().vertex, [*grid_mesh().polygons, *(p[::-1] for p in grid_mesh().polygons)]),
    "one triangle": Mesh("Triangle", np.eye(3), [[0, 1, 2]]),
}


@pytest.mark.parametrize("name", SOUND)
def test_charts_keep_their_promises(name):
    _, chart, uv, uv_area, area = check_promises(SOUND[name])
    assert overlaps_within_charts(chart, uv) == 0
    np.testing.assert_allclose(uv_area, area, rtol=1e-9)


@pytest.mark.parametrize(("scale", "offset"), [(1e-4, 1e6), (1e5, 0.0)])
def test_scale_and_place_do_not_matter(scale, offset):
    mesh = sphere_mesh(rings=8, segments=16)
    _, chart, _, uv_area, area = check_promises(moved(mesh, scale=scale))
    _, far_chart, *_, far_uv_area, _ = check_promises(moved(mesh, (offset * scale,) * 3, scale))
    assert chart.max() == far_chart.max()
    np.testing.assert_allclose(uv_area, area, rtol=1e-3)
    np.testing.assert_allclose(np.sort(far_uv_area), np.sort(uv_area), rtol=1e-3)


def test_flat_charts_are_isometric():
    """Every side of a box's faces keeps its length, to float64."""
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    box = box_mesh(size_m=(3.0, 0.2, 0.01))
    scene, chart, uv, *_ = check_promises(Mesh("Box", box.vertex @ turn.T, box.polygons))
    assert chart.max() == 5
    length, uv_length = (np.linalg.norm(p - np.roll(p, 1, axis=1), axis=2) for p in (scene.tri_position, uv))
    np.testing.assert_allclose(uv_length, length, rtol=1e-12)


def test_torn_quads_are_unfolded_over_their_diagonal():
    """A steep pair of triangles is one chart, each triangle congruent with itself in space."""
    vertex = np.array([[0, 0, 0], [1, 0, 5], [1, 1, 0], [0, 1, 5.0]])
    scene, chart, uv, *_ = check_promises(Mesh("Bent", vertex, [[0, 1, 2, 3]]))
    assert chart.tolist() == [0, 0]
    length, uv_length = (np.linalg.norm(p - np.roll(p, 1, axis=1), axis=2) for p in (scene.tri_position, uv))
    np.testing.assert_allclose(uv_length, length, rtol=1e-6)
    assert np.prod(signed_areas(uv)) > 0


@pytest.mark.parametrize("height", [0.0, 1.0])
@pytest.mark.parametrize(("seed", "n_vertex", "most_corners"), [(1, 12, 3), (22, 12, 3), (3, 60, 7)])
def test_wild_polygons_never_overlap(seed, n_vertex, most_corners, height):
    """The first two, flat, are charts of xatlas's that lie over themselves."""
    rng = np.random.default_rng(seed)
    polygons = [
        rng.choice(n_vertex, rng.integers(3, most_corners + 1), replace=False).tolist() for _ in range({12: 20, 30: 60, 60: 40}[n_vertex])
    ]
    _, chart, uv, *_ = check_promises(Mesh("Wild", rng.normal(size=(n_vertex, 3)) * (1, 1, height), polygons))
    assert overlaps_within_charts(chart, uv) == 0


def test_zero_area_triangles_are_left_out():
    grid = grid_mesh(cells=8)
    start = len(grid.vertex)
    rng = np.random.default_rng(5)
    pairs = start + rng.integers(0, 1000, (20_000, 2))
    line = [[start + 1000 + k, start + 1001 + k, start + 1002 + k] for k in range(20_000)]
    on_line = np.arange(20_002)[:, None] * np.full(3, 1e-5)
    vertex = np.concatenate([grid.vertex, rng.uniform(0, 8, (1000, 3)), on_line])
    _, chart, *_ = check_promises(Mesh("Waste", vertex, [*grid.polygons, *([a, a, b] for a, b in pairs.tolist()), *line]))
    assert chart.max() == 0


def test_needles_have_charts():
    height = np.arange(51) * 1e-6
    ends = [np.stack([np.full(51, x), height, 0 * height], axis=1) for x in (0.0, 1.0)]
    strip = Mesh("Needles", np.concatenate(ends), [[k, 51 + k, 52 + k, k + 1] for k in range(50)])
    check_promises(strip)
    check_promises(Mesh("Needle", np.array([[0, 0, 0], [1, 0, 0], [0.5, 1e-6, 0]]), [[0, 1, 2]]))


def test_a_needle_whose_width_vanishes_beside_its_length_is_laid_out():
    needle = Mesh("Needle", np.array([[0, 0, 0], [0.1, 0.2, 0.3], [3e37, 8e37, -2e38]]), [[0, 1, 2]])
    _, chart, uv, _ = unwrap(join_meshes("Both", quad_mesh(), needle))
    assert np.isfinite(uv[chart >= 0]).all()


def test_a_polygon_that_its_plane_lays_over_itself_is_laid_out_on_a_circle():
    """A ribbon of more than one turn, all of it one polygon: xatlas cuts it, and its plane does not part it."""
    angle = np.linspace(0.0, 2.6 * np.pi, 60)
    inner = np.stack([np.cos(angle), np.sin(angle), 0.01 * angle], axis=1)
    vertex = np.concatenate([inner, inner[::-1] * [1.2, 1.2, 1.0]])  # in the order of the polygon, and so corners too
    tri = np.concatenate([[[119 - k, 118 - k, k], [k, 118 - k, k + 1]] for k in range(59)])
    one = np.zeros(len(tri), int)
    chart, uv, _ = Unwrapping(vertex[tri], tri, one, tri, one).finish()
    assert chart.tolist() == one.tolist()
    assert overlaps_within_charts(chart, uv) == 0
