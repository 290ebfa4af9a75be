"""Texel areas, moments and lookups against supersampling, totals and hand-made charts."""

import dataclasses
from math import factorial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from leaflight.core.texels.margin import add_margin
from leaflight.core.texels.split_texels import OPPOSITE, WAYS, TexelBorders, whole_texel
from leaflight.core.texels.texel_footprint import centred_strata
from leaflight.core.texels.texel_grid import interleave_bits
from leaflight.core.texels.texel_moments import EvenSquares
from leaflight.core.texels.texels import TexelMap
from leaflight.core.util.coverage import Pieces, chunk_ranges, clip_to_texels, expand_ranges, monomial_exponents, piece_moments
from trees import make_map, make_square_map


# Texel areas, moments and lookups against supersampling, totals and hand-made charts.
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


# Squares of even texels have the moments of their texels.
SIDE = 64


def squares_of(texels, area=None):
    return EvenSquares.of(
        texels.texel_chart, texels.texel_code, texels.texel_xy, texels.texel_area if area is None else area, texels.part_entry
    )


@pytest.mark.parametrize("degree", [0, 2, 4])
def test_squares_have_the_moments_of_their_texels(degree):
    """In ranges that end with squares and in such that end within; the square's diagonal cuts some, and so does its right end."""
    texels = make_square_map(SIDE, 2, width=0.7)
    n, squares = len(texels.texel_area), squares_of(texels)
    whole = squares.first[squares.side == 16]
    assert len(whole) > 2
    start, end = np.array([0, whole[0], whole[1] + 5, 100, whole[2], 5]), np.array([n, whole[1], n, whole[2] + 9, whole[2] + 256, 5])
    centre, half = np.random.default_rng(1).uniform(0, SIDE, (6, 2)), np.array([32.0, 8.0, 16.0, 8.0, 4.0, 8.0])
    by_itself = EvenSquares(texels.texel_xy, texels.texel_area, np.arange(n), np.ones(n, np.int32))
    expected = by_itself.range_moments(start, end, centre, half, degree)
    found = squares.range_moments(start, end, centre, half, degree)
    np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-13 * np.abs(expected).max())


# Clipping and moments against polygons whose answer is known.
RANGES = st.lists(st.tuples(st.integers(0, 50), st.integers(-3, 20)), max_size=12)


@pytest.mark.parametrize("degree", [0, 2, 4])
def test_rules_are_exact_on_the_unit_triangle(degree: int) -> None:
    """The integral of x^i y^j over (0,0) (1,0) (0,1) is i! j! / (i + j + 2)!."""
    unit = Pieces(np.zeros(1, np.int64), np.array([[0.0], [1.0], [0.0]]), np.array([[0.0], [0.0], [1.0]]), np.array([0.5]))
    expected = [factorial(i) * factorial(j) / factorial(i + j + 2) for i, j in monomial_exponents(degree)]
    np.testing.assert_allclose(piece_moments(unit, degree)[:, 0], expected, rtol=1e-14)


@given(RANGES, st.integers(1, 9))
def test_ranges_are_cut_without_loss(ranges: list[tuple[int, int]], size: int) -> None:
    start = np.array([low for low, _ in ranges], dtype=np.int64)
    end = start + np.array([length for _, length in ranges], dtype=np.int64)
    expected = [(row, value) for row in range(len(start)) for value in range(start[row], end[row])]
    owner, value = expand_ranges(start, end)
    assert list(zip(owner.tolist(), value.tolist(), strict=True)) == expected
    found = []
    for rows, first, last in chunk_ranges(start, end, size):
        assert (last > first).all()
        assert (last - first).sum() <= size
        part, value = expand_ranges(first, last)
        found += zip(rows[part].tolist(), value.tolist(), strict=True)
    assert found == expected


@pytest.mark.parametrize("mirrored", [False, True])
def test_corner_cut_off_a_texel(mirrored: bool) -> None:
    """x + y < 3 in texel (1, 1): the triangle (1,1) (2,1) (1,2), whose moments about the centre are those of half a square."""
    uv = np.array([[[0.0, 0.0], [3.0, 0.0], [0.0, 3.0]]])
    pieces = clip_to_texels(uv[:, ::-1] if mirrored else uv, np.array([[1, 1]]))
    moments = piece_moments(pieces, 2).sum(axis=1)
    # About the corner (1/2, 1/6, 1/6, 1/12, 1/24, 1/12), moved to the centre.
    np.testing.assert_allclose(moments, [1 / 2, -1 / 12, -1 / 12, 1 / 24, 0, 1 / 24], atol=1e-15)


@pytest.mark.parametrize("mirrored", [False, True])
def test_squares_smaller_than_a_texel(mirrored: bool) -> None:
    """x < 1.4 in the middle half of texel (1, 1), and all of the middle tenth of texel (0, 0); pieces are in texels all the same."""
    uv = np.tile([[1.4, -20.0], [1.4, 20.0], [-30.0, 0.0]], (2, 1, 1))
    pieces = clip_to_texels(uv[:, ::-1] if mirrored else uv, np.array([[1, 1], [0, 0]]), np.array([0.5, 0.1]))
    np.testing.assert_allclose(np.bincount(pieces.pair, pieces.area), [0.15 * 0.5, 0.01], rtol=1e-12)
    first = pieces.x[:, pieces.pair == 0]
    np.testing.assert_allclose([first.min(), first.max()], [-0.25, -0.1], rtol=1e-12)


# What lies beyond a wall's foot within a texel is the next texel's: hits, area and moments agree on it.
COLUMNS = 3  # of a block of whole texels, entries by rows


def borders_of(*walls, n_texel=COLUMNS**2):
    """Each wall: entry, way, how far the entry goes, and the one beyond towards it."""
    rows = []
    for entry, way, reach, back in walls:
        x, y = WAYS[way]
        beyond = entry + x + y * COLUMNS
        rows += [(way, entry, beyond, reach), (OPPOSITE[way], beyond, entry, back)]
    way, entry, beyond, reach = zip(*rows, strict=True)
    return TexelBorders.of(n_texel, np.array(way), np.array(entry), np.array(beyond), np.array(reach))


def count(borders, degree, n=400_000):
    """(M, b) moments of what places over the whole block count for, and a standard error, where the walls' inside is lit too."""
    x, y = np.random.default_rng(1).random((2, n)) * COLUMNS
    entry = (np.floor(y) * COLUMNS + np.floor(x)).astype(np.int32)
    row, column = np.divmod(entry, COLUMNS)
    owner = borders.find_owners(entry, x - column - 0.5, y - row - 0.5)
    row, column = np.divmod(owner, COLUMNS)
    slot = np.searchsorted(borders.entry, owner.clip(0, borders.entry[-1]))
    own = np.flatnonzero(borders.entry[slot] == owner)
    s, t = (x - column - 0.5)[own], (y - row - 0.5)[own]
    area = COLUMNS**2 / n
    return np.stack([np.bincount(slot[own], s**i * t**j, len(borders.entry)) * area for i, j in monomial_exponents(degree)])


@pytest.mark.parametrize(
    "walls",
    [
        [(4, 0, 0.2, 0.8)],
        [(4, 0, 0.7, 0.3)],
        [(4, 1, 0.1, 0.9)],
        [(4, 3, 0.9, 0.1)],
        [(4, 0, 0.2, 0.8), (3, 0, 0.4, 0.6)],  # on both sides of a texel
        [(4, 0, 0.3, 0.7), (4, 1, 0.8, 0.2)],  # at a corner
        [(4, 0, 0.3, 0.7), (4, 1, 0.2, 0.8)],
        [(4, 1, 0.2, 0.8), (3, 0, 0.9, 0.1)],  # who takes from the left takes all of a texel, also what lies above the other wall
    ],
)
def test_moments_are_those_of_what_counts_for_a_texel(walls):
    borders = borders_of(*walls)
    found, measured = count(borders, 2), borders.measure(2)
    assert measured.shape == (6, len(borders.entry))
    np.testing.assert_allclose(found, measured, atol=4 * np.sqrt(COLUMNS**2 / 400_000))
    assert measured[0].sum() == pytest.approx(len(borders.entry), rel=1e-6)  # thin walls take no area from anybody
    assert np.abs(measured - whole_texel(2)).max() > 0.1


@pytest.mark.parametrize(
    ("quadrant", "walls", "entry", "diagonal"),
    [(0, [(1, 1, 0.2, 0.8), (3, 0, 0.3, 0.7)], 0, 4), (2, [(7, 3, 0.1, 0.9), (5, 2, 0.4, 0.6)], 8, 4)],
)
def test_a_corner_takes_what_lies_within_both_walls(quadrant, walls, entry, diagonal):
    borders = borders_of(*walls)

    def beside(entries, step):
        row, column = np.divmod(entries, COLUMNS)
        column, row = column + step[0], row + step[1]
        return np.where((np.minimum(row, column) >= 0) & (np.maximum(row, column) < COLUMNS), row * COLUMNS + column, -1)

    corners = borders.find_corners(beside)
    assert [corners[0].tolist(), corners[1].tolist(), corners[3].tolist()] == [[quadrant], [entry], [diagonal]]
    borders = borders.with_corners(*corners)
    found, measured = count(borders, 2), borders.measure(2)
    np.testing.assert_allclose(found, measured, atol=4 * np.sqrt(COLUMNS**2 / 400_000))
    assert measured[0].sum() < len(borders.entry) + 1e-6
    own = np.searchsorted(borders.entry, entry)
    lost = (0.5 - corners[2]).prod()
    assert measured[0, own] == pytest.approx(1 - lost, rel=1e-6)
    assert borders.see_beyond(np.array([entry]), 1.0).tolist() == [True]
    place = np.random.default_rng(1).permutation(COLUMNS**2).astype(np.int32)
    turned = borders.renumber(place)
    own = np.searchsorted(turned.entry, place[entry])
    assert turned.diagonal[quadrant, own] == place[diagonal]
    np.testing.assert_array_equal(turned.corner[quadrant, :, own], corners[2][:, 0].astype(np.float32))


def test_what_lies_below_a_thick_wall_is_nobody_s_area():
    """Its light is the next texel's, where a photon gets there."""
    borders = borders_of((4, 0, 0.2, 0.5))
    assert borders.measure(0)[0] == pytest.approx([0.7, 1.0])
    borders = borders_of((4, 0, 0.2, 0.6))
    assert borders.measure(0)[0] == pytest.approx([0.7, 1.1])


def test_texels_that_nothing_crosses_keep_their_hits():
    borders = borders_of((4, 0, 0.2, 0.8))
    every = np.arange(COLUMNS**2, dtype=np.int32)
    assert borders.find_owners(every, np.full(9, 0.4), np.zeros(9)).tolist() == [0, 1, 2, 3, 5, 5, 6, 7, 8]
    assert borders.find_owners(every, np.full(9, 0.1), np.full(9, 0.49)).tolist() == every.tolist()
    assert borders.find_owners(every[:3], np.full(3, 0.4), np.zeros(3)).tolist() == [0, 1, 2]
    none = TexelBorders.none()
    assert none.find_owners(every, np.full(9, 0.4), np.zeros(9)) is every


# Margins on pages small enough to know every texel.
def fill_margin(page: np.ndarray, covered: np.ndarray, texels: int) -> np.ndarray:
    add_margin(out := page.copy(), covered, texels)
    return out


def test_between_two_charts_is_their_mean() -> None:
    page = np.zeros((5, 3, 1), np.float32)
    page[:, 0], page[:, 2] = 1.0, 5.0
    covered = np.array([[True, False, True]] * 5)
    np.testing.assert_array_equal(fill_margin(page, covered, 4)[:, 1, 0], np.full(5, 3.0))


@pytest.mark.parametrize(("texels", "height"), [(0, 17), (1, 17), (3, 17), (8, 17), (2, 400)])
def test_reach_is_the_number_of_steps(texels: int, height: int) -> None:
    rng = np.random.default_rng(texels)
    covered = rng.random((height, 23)) < 0.01
    covered[5, 6] = True
    page = np.where(covered[..., None], rng.uniform(1.0, 2.0, (height, 23, 3)), -1.0).astype(np.float32)
    filled = fill_margin(page, covered, texels)
    y, x = np.nonzero(covered)
    rows, columns = np.indices(covered.shape)
    distance = np.maximum(abs(rows[..., None] - y), abs(columns[..., None] - x)).min(axis=-1)
    np.testing.assert_array_equal(filled[..., 0] > 0.0, distance <= texels)
    np.testing.assert_array_equal(filled[covered], page[covered])
    assert filled[distance <= texels].max() <= page.max()
    assert filled.dtype == np.float32


def test_empty_and_full_pages_stay() -> None:
    page = np.arange(30, dtype=np.float32).reshape(3, 5, 2)
    for covered in (np.zeros((3, 5), bool), np.ones((3, 5), bool)):
        np.testing.assert_array_equal(fill_margin(page, covered, 4), page)


def test_a_colour_field_stays_smooth() -> None:
    """The first ring off a straight edge takes the mean of three neighbours along it, so a ramp along the edge goes on."""
    page, covered = np.zeros((9, 6, 1), np.float32), np.zeros((9, 6), bool)
    covered[:, :3] = True
    page[:, :3, 0] = np.arange(9)[:, None]
    np.testing.assert_allclose(fill_margin(page, covered, 1)[1:-1, 3, 0], np.arange(1, 8), rtol=1e-6)


def test_a_page_that_cannot_be_filled_in_place_is_told() -> None:
    with pytest.raises(ValueError, match="rows do not follow each other"):
        add_margin(np.zeros((4, 6, 3), np.float32).transpose(1, 0, 2), np.zeros((6, 4), bool), 1)


def test_a_part_of_a_page_is_filled_in_place() -> None:
    """Three of four channels: the fourth stays."""
    page, covered = np.zeros((4, 6, 4), np.float32), np.zeros((4, 6), bool)
    page[2, 3], covered[2, 3] = (1.0, 2.0, 3.0, 4.0), True
    add_margin(page[..., :3], covered, 1)
    np.testing.assert_array_equal(page[1:4, 2:5, :3], np.broadcast_to(np.float32([1.0, 2.0, 3.0]), (3, 3, 3)))
    assert page.sum() == 9 * 6.0 + 4.0


def test_squares_are_where_all_texels_are_alike():
    texels = make_square_map(SIDE, 1)
    squares = squares_of(texels)
    assert set(squares.side) == {1, 16}
    assert (squares.side.astype(int) ** 2).sum() == len(texels.texel_area)
    whole = squares.first[squares.side == 16]
    assert not np.isin(texels.part_entry, whole[:, None] + np.arange(256)).any()
    assert len(whole) == 12  # of 16, four are on the diagonal
    area = texels.texel_area.copy()
    area[whole[3] + 77] *= 2  # as where a layer overlaps itself
    np.testing.assert_array_equal(squares_of(texels, area).first[squares_of(texels, area).side == 16], np.delete(whole, 3))
