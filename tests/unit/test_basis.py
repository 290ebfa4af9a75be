"""Bases are orthonormal on clipped domains, and sums move exactly between levels."""

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


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_projection_reproduces_a_polynomial(degree):
    rng = np.random.default_rng(7)
    s, t, weight, moment = clipped_moments(rng, degree)
    values = np.array(basis.monomials(s, t, degree))
    coefficient = rng.normal(size=len(values))
    raw = values @ (weight * (coefficient @ values))
    functions = basis.orthonormal_functions(basis.gram_matrix(moment[None], degree))
    np.testing.assert_allclose((basis.projector(functions)[0] @ raw), coefficient, rtol=1e-6)


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_raw_sums_move_up_and_coefficients_down(degree):
    rng = np.random.default_rng(1)
    transforms = basis.parent_transforms(degree)
    for quadrant, (x, y) in enumerate(basis.QUADRANTS):
        s, t = rng.uniform(-1, 1, (2, 5))
        child = np.array(basis.monomials(s, t, degree))
        parent = np.array(basis.monomials((s + 2 * x - 1) / 2, (t + 2 * y - 1) / 2, degree))
        np.testing.assert_allclose(transforms[quadrant] @ child, parent, atol=1e-14)
        coefficient = rng.normal(size=len(parent))
        np.testing.assert_allclose((transforms[quadrant].T @ coefficient) @ child, coefficient @ parent, atol=1e-14)
