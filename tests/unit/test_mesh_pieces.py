"""Pieces of dense meshes: nothing is lost, planes stay whole, and none is larger than a chart may be."""

import numpy as np
from leaflight.core.atlas.mesh_pieces import is_dense, split_part

rng = np.random.default_rng(5)


def test_what_is_not_dense_is_one_piece():
    (rows,) = split_part(np.arange(2048) * 7, np.zeros(2048, int), rng.random((2048, 3)))
    np.testing.assert_array_equal(rows, np.arange(2048))


def test_pieces_are_near_each_other_and_have_every_triangle_once():
    centre = rng.random((25_600, 3)) * [8.0, 1.0, 1.0]
    pieces = split_part(rng.permutation(25_600), np.arange(25_600), centre)
    np.testing.assert_array_equal(np.sort(np.concatenate(pieces)), np.arange(25_600))
    assert len(pieces) == 16
    assert max(len(rows) for rows in pieces) <= 2048
    assert max(np.ptp(centre[rows, 0]) for rows in pieces) < 1.5


def test_what_lies_in_one_plane_stays_in_one_piece_and_counts_once():
    facet = np.where(np.arange(15_000) < 2200, 10**6, np.arange(15_000))
    pieces = split_part(facet, np.arange(15_000), rng.random((15_000, 3)))
    assert len(pieces) == 8  # of 12,801 facets
    (whole,) = (rows for rows in pieces if 0 in rows)
    assert set(range(2200)) <= set(whole.tolist())
    assert len(split_part(np.zeros(5000, int), np.arange(5000), rng.random((5000, 3)))) == 1


def test_equal_places_are_halved_too():
    assert [len(rows) for rows in split_part(np.arange(8192), np.arange(8192), np.zeros((8192, 3)))] == [2048] * 4


def test_polygons_are_never_cut():
    """Bent quads, whose triangles lie in different planes, beside one large polygon that alone is more than a piece may be."""
    polygon = np.append(np.arange(10_000) // 2, np.full(4000, 9999))
    pieces = split_part(np.arange(14_000), polygon, rng.random((14_000, 3)))
    assert len(np.unique(np.concatenate([np.unique(polygon[rows]) for rows in pieces]))) == 5001
    assert sum(len(np.unique(polygon[rows])) for rows in pieces) == 5001
    assert max(sorted(len(rows) for rows in pieces)[:-1]) <= 2048


def test_dense_is_what_has_many_facets_however_many_triangles():
    assert is_dense(np.arange(1025) * 5)
    assert not is_dense(np.arange(1024))
    assert not is_dense(np.arange(10_000) % 1024)
