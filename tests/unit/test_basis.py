"""Bases are orthonormal on clipped domains."""

import numpy as np
import pytest
from leaflight.core.radiosity import basis


def clipped_moments(rng, degree, points=400):
    """Moments of a random point cloud in a random strip across the square: a discrete measure stands for a clipped domain."""
    along, across = rng.uniform(-1, 1, (2, points))
    across = rng.uniform(-0.5, 0.5) + 0.5 * rng.uniform(0.1, 1.0) * across
    turn = rng.uniform(0, np.pi)
    s, t = np.cos(turn) * along - np.sin(turn) * across, np.sin(turn) * along + np.cos(turn) * across
    weight = rng.uniform(0.1, 1.0, points)
    values = np.array(basis.monomials(s, t, 2 * degree))
    return s, t, weight, (values * weight).sum(1)


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_functions_are_orthonormal_on_clipped_domains(degree, hold):
    rng, off = np.random.default_rng(4), 0.0
    for _ in range(50):
        s, t, weight, moment = clipped_moments(rng, degree)
        functions = basis.orthonormal_functions(basis.gram_matrix(moment[None], degree))[0]
        values = functions @ np.array(basis.monomials(s, t, degree))
        off = max(off, np.abs((values * weight) @ values.T - np.eye(len(values))).max())
    hold("basis: inner products on random clipped domains off the identity", off, high=1e-10)


def test_a_line_of_a_domain_drops_to_lower_order():
    t = np.linspace(-1, 1, 9)
    s = np.full_like(t, 0.3)  # no extent in s: 1 and s are the same function here
    moment = np.array(basis.monomials(s, t, 2)).sum(1)
    functions = basis.orthonormal_functions(basis.gram_matrix(moment[None], 1))[0]
    assert (np.abs(functions).sum(1) > 0).sum() == 2
    assert np.isfinite(functions).all()


def test_an_empty_domain_keeps_no_function():
    assert not basis.orthonormal_functions(np.zeros((1, 3, 3))).any()
