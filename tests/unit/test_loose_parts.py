"""What hangs together by edges is one part, whatever vertices the file has, and objects are looked into when it matters alone."""

import numpy as np
import pytest
from leaflight.core.scene.topology import find_loose_parts
from scenes import Mesh, box_mesh, grid_mesh, join_meshes, make_scene, moved, quad_mesh, sphere_mesh, split_faces


def parts_of(*meshes):
    scene = make_scene(meshes)
    return find_loose_parts(scene, np.arange(scene.n_tri))


@pytest.mark.parametrize("mesh", [box_mesh(), sphere_mesh(), grid_mesh(noise=0.3), moved(box_mesh(), (1e3, -7.1, 0.3), 0.1)])
def test_a_surface_is_one_part_also_with_vertices_for_each_face(mesh):
    for one in (mesh, split_faces(mesh)):
        assert not parts_of(one).any()


def test_joined_things_are_parts_and_each_is_told_by_its_first_triangle():
    things = quad_mesh(), moved(box_mesh(), (0.5, 0.5, 0.5)), moved(box_mesh(), (0.3, 0.2, 1.5))
    assert parts_of(join_meshes("House", *things)).tolist() == [0] * 2 + [2] * 12 + [14] * 12


def test_boxes_of_one_size_on_each_other_stay_apart():
    """Their edges lie at one place, but each has its own other face there."""
    assert parts_of(join_meshes("Tower", box_mesh(), moved(box_mesh(), (0, 0, 1)))).tolist() == [0] * 12 + [12] * 12


def test_things_that_share_a_corner_or_a_place_within_an_edge_are_apart():
    """The next quad touches this one at a corner, the last one along half of an edge."""
    quads = quad_mesh(), moved(quad_mesh(), (1, 1, 0)), moved(quad_mesh(), (-1, -0.5, 0))
    assert parts_of(join_meshes("Quads", *quads)).tolist() == [0, 0, 2, 2, 4, 4]
    fan = Mesh("Fan", np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]], float), [[0, 1, 2], [0, 3, 4]])
    assert parts_of(fan).tolist() == [0, 1]


def test_three_faces_at_an_edge_are_one_part():
    vertex = np.array([[0, 0, 0], [0, 1, 0], [1, 0, 0], [-1, 0, 0], [0, 0, 1]], float)
    assert not parts_of(split_faces(Mesh("Fin", vertex, [[0, 1, 2], [1, 0, 3], [0, 1, 4]]))).any()


def test_what_was_split_off_an_edge_within_a_surface_is_a_part():
    """Its side lies where two others do that have each other."""
    floor = grid_mesh(cells=2)
    fin = Mesh("Fin", np.array([[1, 0, 0], [1, 1, 0], [1, 1, 1], [1, 0, 1]], float), [[0, 1, 2, 3]])
    assert parts_of(join_meshes("Floor", floor, fin)).tolist() == [0] * 8 + [8] * 2


def test_objects_at_one_place_are_apart_and_a_part_of_the_triangles_may_be_asked():
    scene = make_scene([box_mesh(), box_mesh()])
    assert find_loose_parts(scene, np.arange(scene.n_tri)).tolist() == [0] * 12 + [12] * 12
    assert find_loose_parts(scene, np.arange(12, 24)).tolist() == [0] * 12
    assert find_loose_parts(scene, np.arange(0)).tolist() == []
    assert parts_of(quad_mesh(), quad_mesh()).tolist() == [0, 0, 2, 2]  # whose sides no other face has
