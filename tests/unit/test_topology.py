"""Sides of triangles that are one edge, and sets that hang together."""

import numpy as np
from leaflight.core.topology import find_ends, join_sets, pair_sides
from scenes import grid_mesh, make_scene

RNG = np.random.default_rng(7)


def test_sets_are_joined_as_one_by_one():
    one, other = RNG.integers(0, 300, (2, 200))
    label = np.arange(300)
    for a, b in zip(one, other, strict=True):
        label[(label == label[a]) | (label == label[b])] = min(label[a], label[b])
    np.testing.assert_array_equal(join_sets(300, one, other), label)


def test_long_chain_is_one_set():
    order = RNG.permutation(5000)
    assert not join_sets(5000, order[:-1], order[1:]).any()


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


def test_ends_are_numbered_by_place():
    """Zeros of both signs are one place."""
    position = RNG.integers(-1, 2, (40, 3)) * RNG.choice([-1.0, 1.0], (40, 3))
    ends = RNG.integers(0, 40, (2, 100))
    low, high = find_ends(position, ends)
    assert (low <= high).all()
    places = [sorted((position[ends[:, k]] + 0.0).tolist()) for k in range(100)]
    for a in range(100):
        for b in range(a):
            assert ((low[a], high[a]) == (low[b], high[b])) == (places[a] == places[b])
    assert find_ends(position, np.zeros((2, 0), int)).shape == (2, 0)
