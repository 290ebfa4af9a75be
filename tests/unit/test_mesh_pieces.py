"""Pieces of dense meshes: nothing is lost, planes stay whole, and none is larger than a chart may be."""

import numpy as np
import pytest
from leaflight.core.atlas import mesh_pieces
from leaflight.core.atlas.mesh_pieces import is_dense, split_part

rng = np.random.default_rng(5)


@pytest.fixture(autouse=True)
def _small(monkeypatch):
    monkeypatch.setattr(mesh_pieces, "_MOST_FACETS", 16)
    monkeypatch.setattr(mesh_pieces, "_DENSE_FACETS", 8)


def test_what_is_not_dense_is_one_piece():
    (rows,) = split_part(np.arange(16) * 7, np.zeros(16, int), rng.random((16, 3)))
    np.testing.assert_array_equal(rows, np.arange(16))


def test_pieces_are_near_each_other_and_have_every_triangle_once():
    centre = rng.random((200, 3)) * [8.0, 1.0, 1.0]
    pieces = split_part(rng.permutation(200), np.arange(200), centre)
    np.testing.assert_array_equal(np.sort(np.concatenate(pieces)), np.arange(200))
    assert len(pieces) == 16
    assert max(len(rows) for rows in pieces) <= 16
    assert max(np.ptp(centre[rows, 0]) for rows in pieces) < 1.5


def test_what_lies_in_one_plane_stays_in_one_piece_and_counts_once():
    facet = np.where(np.arange(300) < 200, 1000, np.arange(300))
    pieces = split_part(facet, np.arange(300), rng.random((300, 3)))
    assert len(pieces) == 8  # of 101 facets
    (whole,) = (rows for rows in pieces if 0 in rows)
    assert set(range(200)) <= set(whole.tolist())
    assert len(split_part(np.zeros(500, int), np.arange(500), rng.random((500, 3)))) == 1


def test_equal_places_are_halved_too():
    assert [len(rows) for rows in split_part(np.arange(64), np.arange(64), np.zeros((64, 3)))] == [16] * 4


def test_polygons_are_never_cut():
    """Bent quads, whose triangles lie in different planes, beside one large polygon that alone is more than a piece may be."""
    polygon = np.append(np.arange(100) // 2, np.full(40, 99))
    pieces = split_part(np.arange(140), polygon, rng.random((140, 3)))
    assert len(np.unique(np.concatenate([np.unique(polygon[rows]) for rows in pieces]))) == 51
    assert sum(len(np.unique(polygon[rows])) for rows in pieces) == 51
    assert sorted(len(rows) for rows in pieces)[:-1] <= [16] * len(pieces)


def test_dense_is_what_has_many_facets_however_many_triangles():
    assert is_dense(np.arange(9) * 5)
    assert not is_dense(np.arange(8))
    assert not is_dense(np.arange(100) % 8)
