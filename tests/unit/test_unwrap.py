"""Charts of meshes: what the unwrapping promises, the process that it asks, and what is wrong with a layer."""

import os
import signal
import subprocess
import sys
import threading
from concurrent.futures import Future
from pathlib import Path

import numpy as np
import pytest
from leaflight.core.atlas import unfolding
from leaflight.core.atlas.layer_check import check_layer, find_overlaps, label_charts, signed_areas
from leaflight.core.atlas.outlines import measure_outlines, straighten_charts
from leaflight.core.atlas.unfolding import Unfolder, UnfolderDied, own_unfolder
from leaflight.core.atlas.unwrap import Unwrapping
from leaflight.core.atlas.xatlas_requests import XatlasRequests
from leaflight.core.util.geometry import triangle_normals_areas
from processes import wait_for_end
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


SQUARE = (np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32), np.array([[0, 1, 2], [0, 2, 3]], np.uint32))


@pytest.fixture
def unfolder():
    own = Unfolder()
    yield own
    own._kill()


def test_meshes_of_one_question_lie_side_by_side():
    (chart, uv), (other_chart, other_uv) = own_unfolder().unfold([SQUARE, SQUARE], 2.0, False)
    assert chart.tolist() == [0, 0]
    assert set(other_chart.tolist()) == {1}
    np.testing.assert_allclose(np.abs(signed_areas(uv)), np.abs(signed_areas(other_uv)), rtol=1e-5)
    assert (uv.max(axis=(0, 1)) < other_uv.min(axis=(0, 1))).any() or (other_uv.max(axis=(0, 1)) < uv.min(axis=(0, 1))).any()


def test_child_that_was_killed_between_two_questions_is_replaced(unfolder):
    first = unfolder.unfold([SQUARE], 1.0, False)
    unfolder._child.kill()
    unfolder._child.wait()
    np.testing.assert_array_equal(unfolder.unfold([SQUARE], 1.0, False)[0][1], first[0][1])


def plant_xatlas(monkeypatch, folder, deaths):
    """An xatlas whose process dies when it is loaded, so many times; `deaths` files are left of them."""
    (folder / "xatlas.py").write_text(
        f"""
import importlib, os, pathlib, sys
fallen = len(list(pathlib.Path({str(folder)!r}).glob("*.died")))
if fallen < {deaths}:
    pathlib.Path({str(folder)!r}, f"{{fallen}}.died").touch()
    os._exit(7)
sys.path.remove({str(folder)!r})
del sys.modules["xatlas"]
sys.modules["xatlas"] = importlib.import_module("xatlas")
"""
    )
    monkeypatch.syspath_prepend(str(folder))


def test_a_question_that_a_child_died_of_is_put_again(unfolder, tmp_path, monkeypatch):
    expected = own_unfolder().unfold([SQUARE], 1.0, False)
    plant_xatlas(monkeypatch, tmp_path, deaths=2)
    np.testing.assert_array_equal(unfolder.unfold([SQUARE], 1.0, False)[0][1], expected[0][1])
    assert len(list(tmp_path.glob("*.died"))) == 2


def test_crash_is_told_and_the_next_question_answered(unfolder, tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        plant_xatlas(patch, tmp_path, deaths=100)
        with pytest.raises(UnfolderDied, match=r"^7$"):
            unfolder.unfold([SQUARE], 1.0, False)
        assert len(list(tmp_path.glob("*.died"))) == 3
    assert len(unfolder.unfold([SQUARE], 1.0, False)) == 1


def test_whoever_waits_is_called_until_the_answer_is_there(unfolder, monkeypatch):
    may_answer, calls = threading.Event(), []
    monkeypatch.setattr(unfolder, "unfold", lambda meshes, area, dense: may_answer.wait(60) and [area])

    def watch():
        calls.append(1)
        if len(calls) == 3:
            may_answer.set()

    assert unfolding.wait_for(unfolder.ask([SQUARE], 1.0, False), watch) == [1.0]
    assert len(calls) >= 3


def test_missing_xatlas_says_what_to_do(tmp_path, monkeypatch, unfolder):
    (tmp_path / "xatlas.py").write_text("raise ImportError('planted')\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(ValueError, match=r"xatlas cannot be loaded \(planted\).*choose an existing UV layer"):
        unfolder.ask([SQUARE], 1.0, False).result()


@pytest.mark.skipif(os.name != "posix", reason="asks for a process by its number")
def test_child_ends_with_its_parent():
    script = """
import os
from leaflight.core.atlas import unfolding
from leaflight.core.atlas.layer_check import signed_areas
from test_unwrap import SQUARE
unfolder = unfolding.Unfolder()
unfolder.unfold([SQUARE], 1.0, False)
print(unfolder._child.pid, flush=True)
os.kill(os.getpid(), 9)
"""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
    ended = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == -signal.SIGKILL, ended.stderr
    assert not ended.stderr
    assert wait_for_end([int(ended.stdout)]) == []


# What xatlas is asked, and that it does not matter to the charts how.
def ask(*meshes):
    scene = make_scene([Mesh("One", np.concatenate([mesh.vertex for mesh in meshes]), join_polygons(meshes))])
    normal, area = triangle_normals_areas(scene.tri_position)
    return XatlasRequests(scene.tri_position, normal, area, scene.tri_vertex, scene.tri_polygon, scene.tri_object)


def join_polygons(meshes):
    first = np.cumsum([0, *(len(mesh.vertex) for mesh in meshes)])
    return [[int(k + corner) for corner in polygon] for k, mesh in zip(first, meshes, strict=False) for polygon in mesh.polygons]


def test_a_dense_ground_is_unwrapped_by_pieces():
    """Of 2,048 triangles at most, so that time grows with their number; no quad is cut, and as many in a plane are one chart still."""
    group, _ = ask(grid_mesh(cells=70, noise=0.05)).read()
    assert len(np.unique(group)) == 8
    assert np.bincount(group).max() <= 2048
    np.testing.assert_array_equal(group[::2], group[1::2])
    assert np.unique(ask(grid_mesh(cells=70)).read()[0]).size == 1


def ask_apart(*meshes):
    scene = make_scene(meshes)
    normal, area = triangle_normals_areas(scene.tri_position)
    polygon = scene.tri_object * 1000 + scene.tri_polygon
    return XatlasRequests(scene.tri_position, normal, area, scene.tri_vertex, polygon, scene.tri_object)


@pytest.mark.parametrize("cursed", [1, None])
def test_of_objects_that_xatlas_crashes_on_together_the_one_is_told(monkeypatch, cursed):
    """The second has two triangles fewer than the others."""
    real = Unfolder.ask

    def ask(unfolder, meshes, area, dense):
        crashes = len(meshes) > 1 or (cursed and len(meshes[0][1]) == 10)
        if not crashes:
            return real(unfolder, meshes, area, dense)
        answer = Future()
        answer.set_exception(UnfolderDied(-11))
        return answer

    monkeypatch.setattr(Unfolder, "ask", ask)
    open_box = Mesh("Open", box_mesh().vertex, box_mesh().polygons[:5])
    question = ask_apart(box_mesh(), open_box, box_mesh())
    if cursed is None:
        assert len(np.unique(question.read()[0])) == 17
        return
    with pytest.raises(UnfolderDied) as died:
        question.read()
    assert died.value.args == (-11, 1)


def turned_grids(angles, depth=3.0):
    """Flat grids of 6 by `depth` metres, one chart each, turned and moved."""
    scene = make_scene([grid_mesh(str(k), cells=6) for k in range(len(angles))])
    uv = scene.tri_position[..., :2] * (1.0, depth / 6.0)
    c, s = np.cos(angles)[scene.tri_object, None], np.sin(angles)[scene.tri_object, None]
    uv = np.stack([c * uv[..., 0] - s * uv[..., 1] + 5, s * uv[..., 0] + c * uv[..., 1] - 9], axis=2)
    corner = scene.tri_corner + 1000 * scene.tri_object[:, None]
    chart, shared = label_charts(scene.tri_vertex, corner, uv, scene.tri_object)
    return uv, chart, shared


def test_rectangles_are_turned_upright():
    uv, chart, shared = turned_grids(np.array([0.0, 0.4, 1.1, 2.7]))
    upright = straighten_charts(uv, chart, shared, 4)
    found = measure_outlines(upright, chart, shared, 4)
    np.testing.assert_allclose(np.sort(found.extent, axis=1), [[3.0, 6.0]] * 4)
    np.testing.assert_allclose(found.area, 18.0)
    for k in range(4):
        np.testing.assert_allclose(upright[chart == k].min(axis=(0, 1)), 0.0, atol=1e-12)


def test_the_smallest_box_is_found_of_few_charts_and_of_many():
    """Of three loose triangles each, around which the smallest box seldom lies along the longest side."""
    count = 1500
    uv, chart, shared = np.random.default_rng(3).random((3 * count, 3, 2)), np.repeat(np.arange(count), 3), np.zeros((3 * count, 3), bool)
    together = straighten_charts(uv, chart, shared, count)
    box = together.reshape(count, 9, 2).max(axis=1).prod(axis=1)
    for angle in np.arange(24) * np.pi / 48:
        turned = uv @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        assert (box <= np.ptp(turned.reshape(count, 9, 2), axis=1).prod(axis=1) / 0.999 + 1e-12).all()
    for first in (0, 700, count - 40):
        some = slice(3 * first, 3 * (first + 40))
        np.testing.assert_array_equal(straighten_charts(uv[some], chart[:120], shared[some], 40), together[some])


def test_rounding_does_not_choose_between_edges_that_are_as_long():
    """All border edges of a grid of squares are."""
    uv, chart, shared = turned_grids(np.array([0.0, 0.4, 1.1, 2.7]), depth=6.0)
    upright = straighten_charts(uv, chart, shared, 4)
    rng = np.random.default_rng(1)
    place = np.unique(uv.reshape(-1, 2).round(6), axis=0, return_inverse=True)[1].reshape(chart.size, 3)
    for _ in range(10):
        moved = uv + rng.uniform(-1e-6, 1e-6, (place.max() + 1, 2))[place]
        np.testing.assert_allclose(straighten_charts(moved, chart, shared, 4), upright, atol=1e-4)


def grid_layer(cells=8):
    """A grid and the layer that lays it out as it is, in 0.1 to 0.9."""
    scene = make_scene([grid_mesh(cells=cells)])
    return scene, 0.1 + 0.8 * scene.tri_position[..., :2] / cells


def check(uv, scene):
    return check_layer(uv, scene.tri_polygon, np.ones(len(uv), bool))


def test_charts_end_where_uvs_part():
    scene, uv = grid_layer()
    right = scene.tri_position[..., 0].min(axis=1) >= 4
    uv[right, :, 0] += 0.01
    chart, shared = label_charts(scene.tri_vertex, scene.tri_corner, uv, np.zeros(len(uv), int))
    np.testing.assert_array_equal(chart, right)
    border_sides = 2 * (2 * 8 + 2 * 4)
    assert (~shared).sum() == border_sides


def test_one_uv_in_common_is_not_enough():
    """Two charts that touch in a point, and two that share an edge in space but one of its UVs only."""
    scene, uv = grid_layer(cells=1)
    chart, _ = label_charts(scene.tri_vertex, np.arange(6).reshape(2, 3), uv, np.zeros(2, int))
    assert chart.tolist() == [0, 0]
    uv[1, 2] += 0.1  # off the diagonal
    uv[1, 1] += 0.1
    chart, _ = label_charts(scene.tri_vertex, np.arange(6).reshape(2, 3), uv, np.zeros(2, int))
    assert chart.tolist() == [0, 1]


def test_groups_are_never_joined():
    scene, uv = grid_layer(cells=2)
    group = np.array([0, 0, 1, 1, -1, -1, 0, 0])
    chart, _ = label_charts(scene.tri_vertex, scene.tri_corner, uv, group)
    assert chart.tolist() == [0, 0, 1, 1, -1, -1, 2, 2]


@pytest.mark.parametrize("angle", [0.0, 0.3, np.pi / 4])
@pytest.mark.parametrize("cells", [1, 7, 16, 60])
def test_neighbours_do_not_overlap(cells, angle):
    """At any alignment with the raster."""
    _, uv = grid_layer(cells)
    c, s = np.cos(angle), np.sin(angle)
    turned = (uv - 0.5) @ np.array([[c, -s], [s, c]]) * 0.7 + 0.5
    assert not find_overlaps(turned.astype(np.float32).astype(float)).any()


def test_overlaps_are_counted_in_faces():
    scene, uv = grid_layer()
    uv[:6] = uv[20:26]  # three quads onto three others
    found = check(uv, scene)
    assert found.usable.all()
    (sentence,) = found.findings
    assert sentence.startswith("6 faces overlapping others in the UV layer")


def test_small_overlap_on_a_large_face_is_found():
    large = np.array([[0.05, 0.05], [0.95, 0.05], [0.05, 0.95]])
    small = np.array([[0.3, 0.3], [0.34, 0.3], [0.3, 0.34]])
    assert find_overlaps(np.stack([large, small])).tolist() == [True, True]
    assert find_overlaps(np.stack([large, small + 0.5])).tolist() == [False, False]


def test_overlap_near_a_corner_of_a_large_face_is_found():
    """A face loses a little of each side before faces are compared, and no more."""
    large = np.array([[0.05, 0.05], [0.95, 0.05], [0.05, 0.95]])
    small = np.array([[0.06, 0.06], [0.10, 0.06], [0.06, 0.10]])
    assert find_overlaps(np.stack([large, small])).tolist() == [True, True]
    assert find_overlaps(np.stack([large, small + np.array([0.78, 0.0])])).tolist() == [True, True]


def test_each_fault_is_found_and_counted():
    scene, uv = grid_layer()
    uv[0, 1] = np.nan
    uv[2:6] += 0.9  # two quads outside the page
    uv[6:8] = uv[6, 0]  # no area
    uv[10:12, :, 0] = 0.08 - 0.1 * (uv[10:12, :, 0] - 0.6)  # somewhere else, mirrored
    uv[10:12, :, 1] *= 0.1
    found = check(uv, scene)
    starts = [sentence.split(" the ")[0] for sentence in found.findings]
    assert starts == ["1 face without a valid position in", "2 faces outside", "1 face without an area in", "1 face mirrored in"]
    np.testing.assert_array_equal(np.flatnonzero(~found.usable), [0, 2, 3, 4, 5, 6, 7])


def test_triangles_without_area_in_space_are_left_out_in_silence():
    scene, uv = grid_layer()
    uv[0] = np.nan
    solid = np.arange(len(uv)) > 0
    found = check_layer(uv, scene.tri_polygon, solid)
    np.testing.assert_array_equal(found.usable, solid)
    assert found.findings == ()


def test_rounding_at_the_page_border_is_no_fault():
    scene, uv = grid_layer()
    assert check((uv - 0.1) / 0.8 * (1 + 1e-7), scene).findings == ()
