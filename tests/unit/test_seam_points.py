import dataclasses

import numpy as np
import pytest
from leaflight.core.atlas.charts import make_charts
from leaflight.core.texels.seam_points import find_seams
from leaflight.core.util.settings import Settings
from scenes import HINGE_LEFT, HINGE_RIGHT, Mesh, box_mesh, grid_mesh, hinge_mesh, make_scene, moved, shade_smooth, sphere_mesh, split_faces


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
