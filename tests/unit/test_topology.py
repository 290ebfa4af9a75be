"""Sides of triangles that are one edge, and what hangs together by them, whatever vertices a file has."""

import numpy as np
import pytest
from leaflight.core.scene.topology import find_groups_with_twins, find_loose_parts, join_open_sides, join_sets, pair_sides
from scenes import Mesh, box_mesh, grid_mesh, join_meshes, make_scene, moved, quad_mesh, sphere_mesh, split_faces

RNG = np.random.default_rng(7)


def test_sets_are_joined_as_one_by_one():
    one, other = RNG.integers(0, 300, (2, 200))
    label = np.arange(300)
    for a, b in zip(one, other, strict=True):
        label[(label == label[a]) | (label == label[b])] = min(label[a], label[b])
    np.testing.assert_array_equal(join_sets(300, one, other), label)


def test_sides_are_paired_within_their_group():
    scene = make_scene([grid_mesh(cells=2)])
    group = np.array([0, 0, 1, 1, -1, -1, 0, 0])
    ends, one, other = pair_sides(scene.tri_vertex, group)
    vertex = scene.tri_vertex.ravel()
    sides = [frozenset(pair) for pair in zip(vertex, np.roll(scene.tri_vertex, -1, axis=1).ravel(), strict=True)]
    expected = {(a, b) for b in range(24) for a in range(b) if sides[a] == sides[b] and group[a // 3] == group[b // 3] >= 0}
    assert {tuple(sorted(pair)) for pair in zip(one.tolist(), other.tolist(), strict=True)} == expected
    assert len(expected) == len(one) == 3  # the diagonals
    assert (vertex[ends[0]] < vertex[ends[1]]).all()
    assert [frozenset(vertex[ends[:, side]]) for side in range(24)] == sides
    assert not len(pair_sides(np.array([[0, 1, 2], [1, 2, 3]]), np.array([0, 1]))[1])


def parts_of(*meshes):
    """The loose part of each triangle, and how many vertices their triangles have once open sides are joined."""
    scene = make_scene(meshes)
    vertex = join_open_sides(scene.vertex_position, scene.tri_vertex, scene.tri_object)
    np.testing.assert_array_equal(scene.vertex_position[vertex], scene.tri_position)
    return find_loose_parts(scene, np.arange(scene.n_tri)).tolist(), len(np.unique(vertex))


@pytest.mark.parametrize("mesh", [box_mesh(), sphere_mesh(), grid_mesh(noise=0.3), moved(box_mesh(), (1e3, -7.1, 0.3), 0.1)])
def test_a_surface_is_one_part_also_with_vertices_for_each_face(mesh):
    count = len(np.unique(np.concatenate([np.asarray(polygon) for polygon in mesh.polygons])))
    for one in (mesh, split_faces(mesh)):
        part, left = parts_of(one)
        assert (set(part), left) == ({0}, count)


def test_joined_things_are_parts_and_each_is_told_by_its_first_triangle():
    things = quad_mesh(), moved(box_mesh(), (0.5, 0.5, 0.5)), moved(box_mesh(), (0.3, 0.2, 1.5))
    assert parts_of(join_meshes("House", *things)) == ([0] * 2 + [2] * 12 + [14] * 12, 20)


def test_boxes_of_one_size_on_each_other_stay_apart():
    """Their edges lie at one place, but each has its own other face there."""
    assert parts_of(join_meshes("Tower", box_mesh(), moved(box_mesh(), (0, 0, 1)))) == ([0] * 12 + [12] * 12, 16)


def test_only_whole_sides_join():
    """The next quad touches this one at a corner, the last one along half of an edge; zeros may have any sign."""
    quads = quad_mesh(), moved(quad_mesh(), (1, 1, 0)), moved(quad_mesh(), (-1, -0.5, 0))
    assert parts_of(join_meshes("Quads", *quads)) == ([0, 0, 2, 2, 4, 4], 12)
    fan = Mesh("Fan", np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]], float), [[0, 1, 2], [0, 3, 4]])
    assert parts_of(fan) == ([0, 1], 5)
    one, other = quad_mesh(), moved(quad_mesh(), (-1, 0, 0))
    other.vertex[other.vertex == 0] = -0.0
    assert parts_of(join_meshes("Quads", one, other)) == ([0] * 4, 6)
    assert parts_of(join_meshes("Card", quad_mesh(), Mesh("Back", quad_mesh().vertex, [quad_mesh().polygons[0][::-1]]))) == ([0] * 4, 4)


def test_three_faces_at_an_edge_are_one_part():
    vertex = np.array([[0, 0, 0], [0, 1, 0], [1, 0, 0], [-1, 0, 0], [0, 0, 1]], float)
    assert parts_of(split_faces(Mesh("Fin", vertex, [[0, 1, 2], [1, 0, 3], [0, 1, 4]]))) == ([0] * 3, 5)


def test_what_was_split_off_an_edge_within_a_surface_is_a_part():
    """Its side lies where two others do that have each other."""
    floor = grid_mesh(cells=2)
    fin = Mesh("Fin", np.array([[1, 0, 0], [1, 1, 0], [1, 1, 1], [1, 0, 1]], float), [[0, 1, 2, 3]])
    assert parts_of(join_meshes("Floor", floor, fin)) == ([0] * 8 + [8] * 2, 13)


def test_objects_at_one_place_are_apart_and_a_part_of_the_triangles_may_be_asked():
    scene = make_scene([box_mesh(), box_mesh()])
    assert parts_of(box_mesh(), box_mesh()) == ([0] * 12 + [12] * 12, 16)
    assert find_loose_parts(scene, np.arange(12, 24)).tolist() == [0] * 12
    assert find_loose_parts(scene, np.arange(0)).tolist() == []
    assert parts_of(quad_mesh(), quad_mesh())[0] == [0, 0, 2, 2]  # whose sides no other face has


def test_groups_with_two_vertices_at_a_place_are_found():
    scene = make_scene([quad_mesh(), split_faces(box_mesh()), box_mesh(), moved(box_mesh(), (0, 0, 1)), split_faces(quad_mesh())])
    found = find_groups_with_twins(scene.vertex_position, scene.tri_vertex, scene.tri_object)
    assert found.tolist() == [False, True, False, False, False]
    unused = np.zeros((2, 3)), np.zeros((1, 3), int), np.zeros(1, int)
    assert find_groups_with_twins(*unused).tolist() == [False]
