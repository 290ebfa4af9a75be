"""Galerkin bases on a quadtree node, orthonormal on the node's own covered domain.

A node's coordinates s, t run over [-1, 1] across its square. Functions are polynomials in s and t. They are orthonormal by the Gram matrix
of the monomials over the part of the square that the chart covers, by world area. A node stores plain sums of monomials over its photons
("raw sums"), which transform exactly from child to parent.

Source: Zatz 1993 (Galerkin radiosity); Feda 1996 and [Tobler97] eq. 9, with W = A, for the sums over photons.
"""

from __future__ import annotations

from functools import lru_cache
from math import comb

import numpy as np

from ..util.arrays import Float64, FloatArray, IntArray

DEGREES = {"constant": 0, "linear": 1, "quadratic": 2}
EXPONENTS = tuple((total - j, j) for total in range(5) for j in range(total + 1))  # 1, s, t, s^2, st, t^2, ...
QUADRANTS = ((0, 0), (1, 0), (0, 1), (1, 1))  # Morton order: x is the low bit

# A function is dropped if its squared norm outside the span of the others is below this share of its squared norm: on a sliver of a
# domain, rounding in float64 makes it linearly dependent on them.
_DROP_BELOW = 1e-6
_ROUNDING = 1e-13  # of a whole square's moments, over its area; a square beyond this tolerance is treated like any other node


def count_functions(degree: int) -> int:
    """Number of basis functions up to `degree`: 1, 3, 6; of products, up to 2 * degree: 1, 6, 15."""
    return (degree + 1) * (degree + 2) // 2


def monomials(s: FloatArray, t: FloatArray, degree: int) -> list[FloatArray]:
    """The monomials 1, s, t, s^2, st, t^2 up to `degree`, each of the shape of s.

    s, t   (...) float, node coordinates
    """
    powers_s: list[FloatArray] = [np.ones_like(s)]
    powers_t: list[FloatArray] = [np.ones_like(t)]
    for _ in range(degree):
        powers_s.append(powers_s[-1] * s)
        powers_t.append(powers_t[-1] * t)
    exponents = EXPONENTS[: count_functions(degree)]
    return [powers_s[i] * powers_t[j] if i and j else powers_s[i] if i else powers_t[j] for i, j in exponents]


def gram_matrix(moment: Float64, degree: int) -> Float64:
    """Inner products of the monomials over each domain.

    moment   (n, M) float64, m^2: integrals of the monomials up to 2 * degree over the domain
    out      (n, K, K) float64, m^2
    """
    used = EXPONENTS[: count_functions(degree)]
    product = [[EXPONENTS.index((a[0] + b[0], a[1] + b[1])) for b in used] for a in used]
    return moment[:, np.array(product)]


def orthonormal_functions(gram: Float64) -> Float64:
    """Orthonormal functions on each domain, as rows of monomial coefficients; dropped functions are rows of zeros.

    gram   (n, K, K) float64, m^2
    out    (n, K, K) float64, 1/m: out @ gram @ out^T is the identity on the kept rows
    Source: Cholesky with pivoting by relative norm (Higham 2002, 10.3), the constant first; done twice, for which
            Giraud et al. 2005 show that orthogonality holds to rounding.
    """
    whole, of_whole = _whole_square(gram.shape[1])
    area = gram[:, 0, 0]
    is_whole, least = area > 0.0, _ROUNDING * area
    for i, j in zip(*np.triu_indices(len(whole)), strict=True):
        is_whole &= np.abs(gram[:, i, j] - area * whole[i, j]) <= least
    out = np.empty_like(gram)
    out[is_whole] = of_whole / np.sqrt(area[is_whole])[:, None, None]  # these are most nodes of a large page
    out[~is_whole] = _orthonormalize(gram[~is_whole])
    return out


def _orthonormalize(gram: Float64) -> Float64:
    first = _pivoted_gram_schmidt(gram, _DROP_BELOW)
    kept_gram = first @ gram @ first.transpose(0, 2, 1)
    return _pivoted_gram_schmidt(kept_gram, 0.5) @ first


@lru_cache
def _whole_square(size: int) -> tuple[Float64, Float64]:
    """Gram matrix (size, size) of a whole square of area 1, and orthonormal functions on it, (size, size)."""
    total = np.array(EXPONENTS[:size])[:, None] + np.array(EXPONENTS[:size])
    gram = np.where(total % 2 == 0, 1.0 / (total + 1.0), 0.0).prod(axis=2)  # means of s^i t^j
    functions = _orthonormalize(gram[None])[0]
    gram.flags.writeable = functions.flags.writeable = False
    return gram, functions


def _pivoted_gram_schmidt(gram: Float64, drop_below: float) -> Float64:
    n, size, _ = gram.shape
    rows, each = np.arange(n), np.arange(size)
    residual = gram.transpose(1, 2, 0).copy()  # (size, size, n): numpy is many times faster on long rows
    scale = residual[each, each]
    scale[scale <= 0.0] = np.inf  # an empty domain keeps no function
    function = np.zeros_like(residual)  # each monomial minus its projections, in monomials
    function[each, each] = 1.0
    unused = np.ones((size, n), bool)
    out = np.zeros_like(residual)
    for step in range(size):
        relative = np.where(unused, residual[each, each] / scale, -1.0)
        pivot = np.zeros(n, int) if step == 0 else relative.argmax(axis=0)
        keep = relative[pivot, rows] > drop_below
        at = (pivot * size + each[:, None]) * n + rows
        left = residual.take(at)
        norm = np.sqrt(np.where(keep, left[pivot, rows], 1.0))
        unit = np.where(keep, function.take(at) / norm, 0.0)
        inner = np.where(keep, left / norm, 0.0)
        out[step] = unit
        function -= inner[:, None] * unit
        residual -= inner[:, None] * inner
        unused[pivot, rows] = False
    return np.ascontiguousarray(out.transpose(2, 0, 1))


def projector(functions: Float64) -> Float64:
    """Matrix from raw sums to the monomial coefficients of the fitted function: the pseudo-inverse of the Gram matrix.

    With m the monomials at a point, m @ projector @ m is the sum of the squared basis functions there.
    functions   (n, K, K) float64, of orthonormal_functions
    out         (n, K, K) float64, 1/m^2
    """
    return functions.transpose(0, 2, 1) @ functions


def apply_matrices(matrix: Float64, vector: Float64) -> Float64:
    """Each node's matrix times its vectors; K is at most 6, so plain loops over it are far faster than einsum.

    matrix   (n, K, K) float64
    vector   (..., K, n) float64
    out      (..., K, n) float64
    """
    rows = np.ascontiguousarray(matrix.transpose(1, 2, 0))
    out = np.zeros(vector.shape)
    for i, row in enumerate(rows):
        for j, factor in enumerate(row):
            out[..., i, :] += factor * vector[..., j, :]
    return out


def evaluate(coefficient: FloatArray, s: FloatArray, t: FloatArray, degree: int) -> Float64:
    """Values of polynomials at points.

    coefficient   (..., K, m) float, of monomials up to `degree`
    s, t          (m,) float
    out           (..., m) float64
    """
    out: Float64 = coefficient[..., 0, :].astype(np.float64)
    for k, power in enumerate(monomials(s, t, degree)[1:], start=1):
        out += coefficient[..., k, :] * power
    return out


def square_norm(project: Float64, s: FloatArray, t: FloatArray, degree: int) -> Float64:
    """(m,) float64, 1/m^2: the sum of the squared basis functions at points.

    project   (m, K, K) float64, 1/m^2: projectors of functions up to `degree`
    s, t      (m,) float
    """
    power = np.array(monomials(s, t, degree))
    return (power * apply_matrices(project, power)).sum(0)


def parent_transforms(degree: int) -> Float64:
    """For each quadrant the matrix X with monomials(parent) = X @ monomials(child).

    X takes raw sums from child to parent, X transposed takes polynomial coefficients from parent to child; both are exact.
    out   (4, K, K) float64
    """
    size = count_functions(degree)
    used = EXPONENTS[:size]
    out = np.zeros((4, size, size))
    for quadrant, (x, y) in enumerate(QUADRANTS):
        shift = (2 * x - 1, 2 * y - 1)
        for row, (i, j) in enumerate(used):  # ((s + x) / 2)^i ((t + y) / 2)^j, expanded
            for a in range(i + 1):
                for b in range(j + 1):
                    weight = comb(i, a) * shift[0] ** (i - a) * comb(j, b) * shift[1] ** (j - b)
                    out[quadrant, row, used.index((a, b))] += weight / 2.0 ** (i + j)
    return out


def apply_transforms(transforms: Float64, quadrant: IntArray, vector: Float64) -> Float64:
    """The sparse matrix of each node's quadrant times the node's vectors.

    transforms   (4, K, K) float64, from parent_transforms, or their transposes
    quadrant     (n,) int
    vector       (..., K, n) float64
    out          (..., K, n) float64
    """
    out = np.zeros(vector.shape)
    for i, j in zip(*np.nonzero(transforms.any(0)), strict=True):
        factor = transforms[:, i, j]
        out[..., i, :] += (factor[0] if (factor == factor[0]).all() else factor.take(quadrant)) * vector[..., j, :]
    return out
