"""Which objects wear the charts of one, and which triangles hang together."""

import dataclasses

import numpy as np
import pytest
from leaflight.core.atlas.sharing import find_blocks, find_copies, follow_charts
from leaflight.core.atlas.unwrap import Unwrapping
from leaflight.core.scene.topology import find_groups_with_twins, find_loose_parts, join_open_sides, pair_sides
from scenes import Mesh, box_mesh, grid_mesh, join_meshes, make_scene, moved, quad_mesh, shared_mesh, sphere_mesh, split_faces

# Which objects wear the charts of one.
BOX = box_mesh("Box", (1.0, 0.7, 0.4))


def blocks_of(meshes):
    """Names of each block's members, and their sizes."""
    scene = make_scene(meshes)
    found = find_blocks(scene)
    return [[scene.objects[i].name for i in block.members] for block in found], [block.size for block in found]


def test_linked_duplicates_of_any_size_and_turn_are_one_block():
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    turned = shared_mesh("C", BOX)
    turned = dataclasses.replace(turned, vertex=turned.vertex @ turn.T)
    names, sizes = blocks_of(
        [shared_mesh("A", BOX), shared_mesh("B", BOX, (3, 3, 3), (9, 0, 0)), turned, shared_mesh("D", BOX, (-1, 1, 1))]
    )
    assert [sorted(group) for group in names] == [["A", "B", "C", "D"]]
    by_name = dict(zip(names[0], sizes[0], strict=True))
    assert by_name["B"] / by_name["A"] == pytest.approx(3.0)
    assert by_name["C"] / by_name["A"] == pytest.approx(1.0)


def test_what_shares_no_mesh_or_gets_no_charts_is_in_none():
    alone = [BOX, moved(BOX, name="Same shape"), shared_mesh("Only one", BOX)]
    others = [dataclasses.replace(shared_mesh("Shade", BOX), receives=False), shared_mesh("Flat", BOX, (0, 0, 0))]
    assert blocks_of([*alone, *others]) == ([], [])


def test_a_kept_layer_is_not_shared():
    uv = [np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])] * 6
    assert blocks_of([dataclasses.replace(shared_mesh(name, BOX), uv=uv) for name in "AB"]) == ([], [])


def test_the_stretched_and_the_tiny_are_left_out_or_have_a_block_of_their_own():
    plain = [shared_mesh(f"Plain {k}", BOX) for k in range(3)]
    slab = [shared_mesh(f"Slab {k}", BOX, (10, 10, 0.1)) for k in range(2)]
    names, _ = blocks_of([slab[0], *plain, slab[1], shared_mesh("Crumb", BOX, (0.05, 0.05, 0.05))])
    assert names == [["Plain 0", "Plain 1", "Plain 2"], ["Slab 0", "Slab 1"]]


@pytest.mark.parametrize("scale", [(1, 1, 1), (-1, 1, 1)])
def test_a_follower_has_the_leaders_uv_at_every_corner(scale):
    cloth = grid_mesh("Cloth", cells=5, noise=0.8)
    scene = make_scene([shared_mesh("A", cloth), shared_mesh("B", cloth, scale)])
    rows = np.split(np.arange(scene.n_tri), 2)
    _, uv, shared = Unwrapping(
        *(a[rows[0]] for a in (scene.tri_position, scene.tri_vertex, scene.tri_polygon, scene.tri_corner, scene.tri_object))
    ).finish()
    own, leaders = scene.tri_corner[rows[1]], scene.tri_corner[rows[0]]
    found, sides = follow_charts(own, leaders, uv, shared)
    of_corner = dict(zip(leaders.ravel().tolist(), uv.reshape(-1, 2).tolist(), strict=True))
    assert [of_corner[corner] for corner in own.ravel().tolist()] == found.reshape(-1, 2).tolist()
    ends = {(t, *sorted((a, b))) for t, k in zip(*np.nonzero(shared), strict=True) for a, b in [(leaders[t, k], leaders[t, (k + 1) % 3])]}
    own_ends = {(t, *sorted((a, b))) for t, k in zip(*np.nonzero(sides), strict=True) for a, b in [(own[t, k], own[t, (k + 1) % 3])]}
    assert ends == own_ends
    assert 0 < len(ends) < shared.size


CLOTH = grid_mesh("Cloth", cells=5, noise=0.8)


def copies_of(*meshes):
    scene = make_scene(meshes)
    return find_copies(scene, scene.tri_vertex, list(range(len(meshes))))


def turned(mesh, seed=3):
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return dataclasses.replace(mesh, vertex=mesh.vertex @ (turn * np.linalg.det(turn)).T)


def test_a_copy_is_known_wherever_it_stands_and_whatever_its_size():
    far = moved(turned(CLOTH), (300.0, -200.0, 1.0), 5.0)
    rounded = dataclasses.replace(far, vertex=far.vertex.astype(np.float32))
    copies = copies_of(BOX, CLOTH, moved(BOX, scale=0.5), rounded, moved(CLOTH, (1.0, 0.0, 0.0)))
    assert {i: leader for i, (leader, _) in copies.items()} == {2: 0, 3: 1, 4: 1}
    np.testing.assert_allclose([copies[i][1] for i in (2, 3, 4)], [0.5, 5.0, 1.0], rtol=1e-5)


def test_what_is_bent_stretched_mirrored_cut_or_nothing_is_no_copy():
    moved_corner = dataclasses.replace(CLOTH, vertex=CLOTH.vertex + np.eye(len(CLOTH.vertex), 3) * 0.01)
    stretched = dataclasses.replace(CLOTH, vertex=CLOTH.vertex * [1.0, 1.01, 1.0])
    fewer = dataclasses.replace(CLOTH, polygons=CLOTH.polygons[:-1])
    triangles = dataclasses.replace(CLOTH, polygons=[part for a, b, c, d in CLOTH.polygons for part in ([a, b, c], [a, c, d])])
    nothing = [dataclasses.replace(BOX, vertex=BOX.vertex * 0) for _ in range(2)]
    nothing += [dataclasses.replace(BOX, polygons=[]) for _ in range(2)]
    assert (
        copies_of(
            CLOTH, moved_corner, stretched, shared_mesh("Mirrored", CLOTH, (-1, 1, 1)), fewer, triangles, split_faces(CLOTH), *nothing
        )
        == {}
    )


def test_a_cloth_that_is_folded_the_other_way_is_no_copy():
    """Its triangles' sides are as long."""
    vertex = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [-1, 0, 1], [-1, 1, 1], [-2, 0, 0], [-2, 1, 0.0]])
    polygons = [[0, 1, 2, 3], [4, 0, 3, 5], [6, 4, 5, 7]]
    other = vertex * 1.0
    other[6:, 2] = 2.0
    assert copies_of(Mesh("Fold", vertex, polygons), Mesh("Fold", other, polygons)) == {}


# Sides of triangles that are one edge, and what hangs together by them, whatever vertices a file has.
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
