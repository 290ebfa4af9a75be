import numpy as np
import pytest
from leaflight.core.atlas.layer_check import check_layer, find_overlaps, label_charts
from scenes import grid_mesh, make_scene


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
