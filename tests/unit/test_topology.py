"""Sides of triangles that are one edge, and sets that hang together."""

import numpy as np
import pytest
from leaflight.core.scene.topology import find_groups_with_twins, join_open_sides, join_sets, pair_sides
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


def joined(*meshes):
    """How many vertices the triangles of each mesh have left, and where these lie."""
    scene = make_scene(meshes)
    vertex = join_open_sides(scene.vertex_position, scene.tri_vertex, scene.tri_object)
    np.testing.assert_array_equal(scene.vertex_position[vertex], scene.tri_position)
    return [len(np.unique(vertex[scene.tri_object == i])) for i in range(len(meshes))]


@pytest.mark.parametrize("mesh", [box_mesh(), sphere_mesh(), grid_mesh(noise=0.3), moved(box_mesh(), (1e3, -7.1, 0.3), 0.1)])
def test_vertices_that_a_file_holds_for_each_face_are_one(mesh):
    count = len(np.unique(np.concatenate([np.asarray(polygon) for polygon in mesh.polygons])))
    assert joined(mesh, split_faces(mesh)) == [count] * 2


def test_what_is_whole_is_given_back_as_it_is():
    scene = make_scene([grid_mesh(), moved(grid_mesh(), (1, 0, 0)), join_meshes("Tower", box_mesh(), moved(box_mesh(), (0, 0, 1)))])
    np.testing.assert_array_equal(join_open_sides(scene.vertex_position, scene.tri_vertex, scene.tri_object), scene.tri_vertex)
    assert join_open_sides(np.zeros((0, 3)), np.zeros((0, 3), np.int32), np.zeros(0, np.int32)).shape == (0, 3)


def test_vertices_are_joined_where_sides_meet_alone():
    """Quads that touch at a corner or along half of an edge stay apart, those side by side share two vertices, whatever sign zeros have."""
    assert joined(join_meshes("Quads", quad_mesh(), moved(quad_mesh(), (1, 1, 0)), moved(quad_mesh(), (-1, -0.5, 0)))) == [12]
    one, other = quad_mesh(), moved(quad_mesh(), (-1, 0, 0))
    other.vertex[other.vertex == 0] = -0.0
    assert joined(join_meshes("Quads", one, other)) == [6]
    back = Mesh("Back", quad_mesh().vertex, [quad_mesh().polygons[0][::-1]])
    assert joined(join_meshes("Card", quad_mesh(), back)) == [4]


def test_groups_with_two_vertices_at_a_place_are_found():
    scene = make_scene([quad_mesh(), split_faces(box_mesh()), box_mesh(), moved(box_mesh(), (0, 0, 1)), split_faces(quad_mesh())])
    found = find_groups_with_twins(scene.vertex_position, scene.tri_vertex, scene.tri_object)
    assert found.tolist() == [False, True, False, False, False]
    unused = np.zeros((2, 3)), np.zeros((1, 3), int), np.zeros(1, int)
    assert find_groups_with_twins(*unused).tolist() == [False]
