"""Where texels look: squares keep their points' order, pieces get their share of them."""

from __future__ import annotations

import numpy as np
import pytest
from leaflight.core.texels.texel_footprint import TexelLooks, centred_strata

UNIT = np.array([[[0, 0]], [[1, 0]], [[0, 1]]], float).transpose(0, 2, 1)[:, :, [0] * 3]  # corner 0, edges to 1 and 2, of three texels


def looks_with_pieces() -> TexelLooks:
    """Three texels of squares half as wide as their triangles' corners tell; the second has two pieces instead, of shares 1 and 3."""
    squares = TexelLooks.of_squares(np.array([4, 5, 6]), 0.5 * UNIT)
    halves = np.array([[[0, 0.5], [0, 0]], [[0.5, 0.5], [0, 0]], [[0, 0], [1, 0.5]]])
    return squares.with_pieces(np.array([1]), np.array([0, 0]), np.array([7, 8]), halves, np.array([1.0, 3.0]))


def test_squares_carry_points_over_as_they_are():
    point = np.random.default_rng(1).random((5, 3, 2))
    tri, weight = TexelLooks.of_squares(np.array([4, 5, 6]), 0.5 * UNIT).points(point)
    assert (tri == [4, 5, 6]).all()
    assert weight == pytest.approx(0.5 * point, abs=1e-6)


def test_pieces_get_points_by_their_share_uniformly():
    tri, weight = looks_with_pieces().points(centred_strata(128**2))
    assert (tri[:, [0, 2]] == [4, 6]).all()
    first = tri[:, 1] == 7
    assert first.mean() == pytest.approx(0.25, abs=1e-3)
    assert set(tri[:, 1]) == {7, 8}
    # A triangle's centroid, and its second moment along x about 0.
    assert weight[first, 1].mean(axis=0) == pytest.approx([1 / 6, 1 / 3], abs=2e-3)
    assert weight[~first, 1].mean(axis=0) == pytest.approx([0.5 + 1 / 6, 1 / 6], abs=2e-3)
    assert (weight[first, 1, 0] ** 2).mean() == pytest.approx(0.25 / 6, abs=2e-3)


def test_parts_choose_by_themselves():
    """Numbers just below one stay in their part, and the next begins with its own first piece."""
    looks, ends = looks_with_pieces(), np.array([[[0.0, 0.5]], [[1 - 1e-9, 0.5]]])
    element, *along = looks.choose(looks.part[[1]], ends)
    assert element[:, 0].tolist() == [3, 4]
    assert (np.array(along) >= 0).all()
    assert (np.sum(along, axis=0) <= 1).all()


def test_centred_strata_refuses_what_is_not_a_square() -> None:
    with pytest.raises(ValueError, match="count: expected a square number, got 3"):
        centred_strata(3)
