"""Texel areas, moments and lookups against supersampling, totals and hand-made charts."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from leaflight.core.texels.texel_footprint import centred_strata
from leaflight.core.texels.texel_grid import interleave_bits
from leaflight.core.texels.texels import TexelMap
from leaflight.core.util.coverage import monomial_exponents
from trees import make_map


def world_areas(position: np.ndarray) -> np.ndarray:
    return 0.5 * np.linalg.norm(np.cross(position[:, 1] - position[:, 0], position[:, 2] - position[:, 0]), axis=1)


def fan(rng: np.random.Generator, n: int, size: float) -> np.ndarray:
    """n triangles around a point: a star-shaped chart without overlap."""
    angle = (np.arange(n) + rng.uniform(0.0, 0.4, n)) * 2 * np.pi / n  # no gap reaches pi
    rim = size / 2 + size / 2.1 * rng.uniform(0.2, 1.0, (n, 1)) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    centre = np.full((n, 2), size / 2)
    return np.stack([centre, rim, np.roll(rim, -1, axis=0)], axis=1)


def brute_moments(texels: TexelMap, entry: int, centre: np.ndarray, half: float, steps: int = 250) -> np.ndarray:
    """Moments of one entry by a fine grid of points, as the integrals of the triangles' densities."""
    line = (np.arange(steps) + 0.5) / steps
    point = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2) + texels.texel_xy[entry]
    weight = np.zeros(len(point))
    for tri, corner in enumerate(texels.tri_uv[:-1]):
        matrix = (corner[1:] - corner[0]).T
        uv = np.linalg.solve(matrix, (point - corner[0]).T)
        weight += texels.tri_density[tri] * ((uv >= 0).all(axis=0) & (uv.sum(axis=0) <= 1))
    s, t = ((point - centre) / half).T
    return np.array([(weight * s**i * t**j).mean() for i, j in monomial_exponents(4)])


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(3, 12), st.sampled_from([1.0, 7.9, 40.0]), st.booleans())
def test_areas_sum_to_the_mesh(seed: int, n: int, size: float, mirrored: bool) -> None:
    rng = np.random.default_rng(seed)
    uv, position = fan(rng, n, size), rng.normal(size=(n, 3, 3))
    texels = make_map(uv[:, ::-1] if mirrored else uv, position=position, size=40, chart=rng.integers(0, 3, n))
    np.testing.assert_allclose(texels.texel_area.sum(), world_areas(position).sum(), rtol=1e-12)
    assert (texels.texel_area > 0).all()
    key = (texels.texel_chart.astype(np.int64) << 32) | texels.texel_code
    assert (np.diff(key) > 0).all()


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_moments_match_supersampling(seed: int) -> None:
    rng = np.random.default_rng(seed)
    uv = fan(rng, 5, 4.0)
    texels = make_map(uv, position=rng.normal(size=(5, 3, 3)))
    n = len(texels.texel_area)
    centre, half = np.array([1.5, 2.0]), 2.5
    found = texels.range_moments(np.arange(n), np.arange(n) + 1, np.tile(centre, (n, 1)), np.full(n, half), 4)
    expected = np.array([brute_moments(texels, entry, centre, half) for entry in range(n)])
    np.testing.assert_allclose(found, expected, atol=6e-3 * texels.texel_area.max())
    np.testing.assert_allclose(found[:, 0], texels.texel_area, rtol=1e-14)


def test_asymmetric_page() -> None:
    """3 wide and 5 high, two triangles whose seam runs across: every texel is whole, rows run upwards."""
    quad = np.array([[1.0, 2.0], [4.0, 2.0], [4.0, 7.0], [1.0, 7.0]])
    texels = make_map(quad[[[0, 1, 2], [0, 2, 3]]])
    np.testing.assert_allclose(texels.texel_area, np.ones(15), rtol=1e-14)
    assert texels.chart_origin.tolist() == [[1, 2]]
    assert texels.chart_log2.tolist() == [3]
    assert {tuple(xy) for xy in texels.texel_xy.tolist()} == {(x, y) for x in (1, 2, 3) for y in (2, 3, 4, 5, 6)}
    relative = texels.texel_xy - texels.chart_origin[0]
    assert (texels.texel_code == interleave_bits(relative[:, 0], relative[:, 1])).all()
    entry = texels.entry_of(np.array([0, 1]), np.array([3.5, 1.5]), np.array([2.5, 6.5]))
    assert texels.texel_xy[entry].tolist() == [[3, 2], [1, 6]]


def test_two_charts_share_a_texel() -> None:
    lower, upper = [[1.0, 1.0], [2.0, 1.0], [1.0, 2.0]], [[2.0, 2.0], [1.0, 2.0], [2.0, 1.0]]
    texels = make_map([lower, upper], chart=[0, 1])
    assert texels.texel_xy.tolist() == [[1, 1], [1, 1]]
    assert texels.texel_chart.tolist() == [0, 1]
    assert texels.chart_start.tolist() == [0, 1, 2]
    np.testing.assert_allclose(texels.texel_area, 0.5)
    middle = np.full(2, 1.5)
    assert texels.entry_of(np.array([0, 1]), middle, middle).tolist() == [0, 1]


@pytest.mark.parametrize("side", [1e-7, 1e-3, 0.39])  # at 0.4 the centre lies on the edge
def test_chart_below_a_texel(side: float) -> None:
    uv = 3.3 + side * np.array([[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]])
    texels = make_map(uv, position=[[[0, 0, 0], [2, 0, 0], [0, 3, 0]]])
    assert texels.texel_xy.tolist() == [[3, 3]]
    np.testing.assert_allclose(texels.texel_area, [3.0], rtol=1e-12)
    np.testing.assert_allclose(texels.texel_bary[0], np.full(3, 1 / 3), atol=1e-6)


@pytest.mark.parametrize("width", [1e-11, 1e-6, 0.01])
def test_needle_keeps_its_area(width: float) -> None:
    uv = np.array([[[0.2, 0.1], [900.3, 899.7], [0.2, 0.1 + width]]])
    texels = make_map(uv, position=[[[0, 0, 0], [1, 0, 0], [0, 1, 0]]], size=1024)
    np.testing.assert_allclose(texels.texel_area.sum(), 0.5, rtol=1e-12)
    assert np.isfinite(texels.part_moments).all()


def test_a_texel_without_a_centre_is_read_where_most_of_its_surface_lies() -> None:
    """Less of the texel, but more of the world."""
    uv = 1.0 + np.array([[[0.0, 0.0], [0.3, 0.0], [0.0, 0.3]], [[1.0, 1.0], [0.6, 1.0], [1.0, 0.6]]])
    position = np.concatenate([uv * np.array([[[10.0]], [[1.0]]]), np.zeros((2, 3, 1))], axis=2)
    for order in ([0, 1], [1, 0]):
        texels = make_map(uv[order], position=position[order])
        assert [order[tri] for tri in texels.texel_tri] == [0]


def test_triangles_without_texels() -> None:
    """No chart, no area in UV, no area in the world: nothing of them is in the map, and hits on them find nothing."""
    good = [[1.0, 1.0], [5.0, 1.0], [1.0, 5.0]]
    uv = [good, good, [[1.0, 1.0], [2.0, 2.0], [5.0, 5.0]], good]
    position = np.concatenate([np.array(uv), np.zeros((4, 3, 1))], axis=2)
    position[3] = 0.0
    texels = make_map(uv, chart=[0, -1, 0, 0], position=position)
    np.testing.assert_allclose(texels.texel_area.sum(), 8.0)
    assert texels.entry_of(np.array([1, 2, 3, -1]), np.full(4, 2.0), np.full(4, 2.0)).tolist() == [-1] * 4
    assert texels.entry_of(np.array([0]), np.array([2.0]), np.array([2.0])) >= 0


def test_empty_map() -> None:
    texels = make_map(np.zeros((1, 3, 2)), chart=[-1])
    assert len(texels.texel_area) == 0
    assert texels.chart_start.tolist() == [0]
    assert texels.texel_bary.shape == (0, 3)
    assert texels.sub_points(np.empty(0, np.int64), centred_strata(4))[0].shape == (4, 0)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_hits_find_their_texel(seed: int) -> None:
    rng = np.random.default_rng(seed)
    uv = fan(rng, 6, 20.0)
    chart = np.array([0, 0, 1, 1, 2, 2])
    texels = make_map(uv, chart=chart, size=20)
    tri = rng.integers(0, 6, 500)
    u = rng.random(500)
    v = (1 - u) * rng.random(500)
    x, y = texels.hit_texel_xy(tri, u, v)
    expected = uv[tri, 0] + u[:, None] * (uv[tri, 1] - uv[tri, 0]) + v[:, None] * (uv[tri, 2] - uv[tri, 0])
    np.testing.assert_allclose(np.stack([x, y], axis=1), expected, atol=1e-12)
    entry = texels.entry_of(tri, x, y)
    assert (entry >= 0).all()
    assert (texels.texel_chart[entry] == chart[tri]).all()
    assert (texels.texel_xy[entry] == np.floor(expected)).all()
    # Rounding may carry a hit one texel too far: it still finds a texel of its chart next door.
    for step in ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1)):
        moved = texels.entry_of(tri, x + step[0], y + step[1])
        assert (moved >= 0).all()
        assert (texels.texel_chart[moved] == chart[tri]).all()
        away = np.abs(texels.texel_xy[moved] - np.floor(expected + step)).max(axis=1)
        assert away.max() <= 1


@pytest.mark.parametrize("mirrored", [False, True])
def test_representative_points_lie_inside(mirrored: bool) -> None:
    uv = fan(np.random.default_rng(5), 7, 12.0)
    texels = make_map(uv[:, ::-1] if mirrored else uv, size=12)
    bary = texels.texel_bary
    rows = np.arange(len(bary))
    np.testing.assert_array_equal(np.concatenate([texels.bary_at(part) for part in (rows[:5], rows[5:18], rows[18:])]), bary)
    points = texels.own_points(0, len(bary))
    np.testing.assert_allclose(points, texels.hit_texel_xy(texels.texel_tri, *bary[:, 1:].T), atol=1e-5)
    entry = np.random.default_rng(6).integers(len(bary), size=60)
    np.testing.assert_array_equal(texels.bary_at(entry), bary[entry])
    np.testing.assert_array_equal(texels.own_points_at(entry), points[:, entry])
    np.testing.assert_array_equal(texels.own_points(5, 18), points[:, 5:18])
    assert (bary >= 0).all()
    np.testing.assert_allclose(bary.sum(axis=1), 1.0, atol=1e-6)
    x, y = texels.hit_texel_xy(texels.texel_tri, bary[:, 1].astype(float), bary[:, 2].astype(float))
    assert (np.abs(np.stack([x, y], axis=1) - texels.texel_xy - 0.5) <= 0.5 + 1e-5).all()


def many_sub_points(texels: TexelMap, **options: float) -> np.ndarray:
    """(2500, n, 2) places from the texels' centres, texels."""
    n = len(texels.texel_area)
    lattice = (np.arange(2500)[:, None, None] + 0.5) * [1 / 2500, 0.6180339887498949] % 1.0
    tri, weight = texels.sub_points(np.arange(n), lattice, **options)
    x, y = texels.hit_texel_xy(tri.ravel(), weight[..., 0].ravel(), weight[..., 1].ravel())
    return np.stack([x, y], axis=1).reshape(2500, n, 2) - (texels.texel_xy + 0.5)


def test_sub_points_are_uniform_over_what_a_texel_looks_at() -> None:
    """The inner square on the centre's triangle, all that is covered where there is none."""
    rng = np.random.default_rng(6)
    uv = fan(rng, 7, 6.0)
    texels = make_map(uv, position=rng.normal(size=(7, 3, 3)))
    local, central = many_sub_points(texels), 0
    for entry in range(len(texels.texel_area)):
        centre = texels.texel_xy[entry] + 0.5
        if density_at(texels, uv, centre[None])[0] > 0:
            expected = polygon_moments(clip_to_square(uv[texels.texel_tri[entry]] - centre, 0.25))
            central += 1
        else:
            expected = sum(
                density * polygon_moments(clip_to_square(tri - centre, 0.5)) for tri, density in zip(uv, texels.tri_density, strict=False)
            )
        np.testing.assert_allclose(local[:, entry].mean(axis=0), expected[1:3] / expected[0], atol=1e-3)
        np.testing.assert_allclose((local[:, entry] ** 2).mean(axis=0), expected[3:] / expected[0], atol=1e-3)
    assert 0 < central < len(texels.texel_area)


def clip_to_square(polygon: np.ndarray, half: float) -> np.ndarray:
    """The part of a convex polygon (m, 2) within +-half of the origin. Source: Sutherland & Hodgman 1974."""
    for axis, sign in ((0, 1), (0, -1), (1, 1), (1, -1)):
        kept = []
        inside = half - sign * polygon[:, axis] if len(polygon) else ()
        for k, a in enumerate(polygon):
            b, here, there = polygon[k - 1], inside[k], inside[k - 1]
            if (here >= 0) != (there >= 0):
                kept.append(a + (b - a) * here / (here - there))
            if here >= 0:
                kept.append(a)
        polygon = np.array(kept)
    return polygon


def polygon_moments(polygon: np.ndarray) -> np.ndarray:
    """(5,) integrals of 1, x, y, x^2, y^2 over a convex polygon: by the middles of the edges of its fan, exact for squares."""
    total = np.zeros(5)
    for k in range(1, len(polygon) - 1):
        a, b, c = polygon[0], polygon[k], polygon[k + 1]
        area = abs((b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0]) / 2
        x, y = np.mean([[(p + q) / 2, ((p + q) / 2) ** 2] for p, q in ((a, b), (b, c), (c, a))], axis=0).T
        total += area * np.array([1, x[0], y[0], x[1], y[1]])
    return total


def density_at(texels: TexelMap, uv: np.ndarray, point: np.ndarray, only: int = -1) -> np.ndarray:
    """(m,) world area per texel^2 at points (m, 2), 0 outside of the triangles, or of one of them."""
    density = np.zeros(len(point))
    for tri, (a, b, c) in enumerate(uv):
        if only not in (-1, tri):
            continue
        u, v = np.linalg.solve(np.stack([b - a, c - a], axis=1), (point - a).T)
        density[(u > 0) & (v > 0) & (u + v < 1)] = texels.tri_density[tri]
    return density


def test_a_texel_is_read_at_its_centre_where_that_is_covered() -> None:
    uv = fan(np.random.default_rng(5), 7, 12.0)
    texels = make_map(uv, size=12)
    x, y = texels.hit_texel_xy(texels.texel_tri, texels.texel_bary[:, 1].astype(float), texels.texel_bary[:, 2].astype(float))
    central = density_at(texels, uv, texels.texel_xy + 0.5) > 0
    away = np.abs(np.stack([x, y], axis=1) - texels.texel_xy - 0.5).max(axis=1)
    assert away[central].max() < 1e-5
    assert away[~central].min() > 1e-3
    assert central.any()
    assert not central.all()


def test_each_place_of_each_page_has_the_entry_that_is_shown_there():
    quads = np.array([[[0, 0], [6, 0], [6, 6]], [[0, 0], [6, 6], [0, 6]]], float)
    # The first two share texels, of which each covers some centres alone; of the last two one covers less, but the centres.
    wide, narrow = quads * (2.45 / 6, 1.0), quads * (0.4 / 6, 1.0) + (2.4, 0.0)
    layers = np.concatenate([quads, quads + 1.7, quads + 2.0, wide, narrow])
    pages = np.array([0, 0, 1, 2, 2], np.int32)
    texels = dataclasses.replace(make_map(layers, np.repeat(np.arange(5), 2)), chart_page=pages, page_count=3)
    page, (x, y) = texels.chart_page[texels.texel_chart], texels.texel_xy.T
    shown = np.zeros(len(page), bool)
    for place in {*zip(page.tolist(), x.tolist(), y.tolist(), strict=True)}:
        there = np.flatnonzero((np.column_stack([page, x, y]) == place).all(axis=1))
        best = max(there, key=lambda entry: (texels.is_central[entry], texels.texel_area[entry], entry))
        shown[best] = True
        assert texels.entry_at[place[0], place[2], place[1]] == best
    assert texels.shown.tolist() == shown.tolist()
    assert not shown.all()
    assert texels.entry_at.shape == (3, 8, 8)
    assert (texels.entry_at >= 0).sum() == shown.sum()
