import numpy as np
import pytest
from leaflight.core.outlines import measure_outlines
from leaflight.core.packing import Page, find_greatest_density, fits_alone, place_charts, place_uv, shape_charts
from texel_gaps import check_gaps


def triangles(count, seed=1, box=(1.0, 1.0)):
    """Charts of one triangle each, at 0, of any shape."""
    uv = np.random.default_rng(seed).uniform(0.0, 1.0, (count, 3, 2)) * box
    uv -= uv.min(axis=1, keepdims=True)
    chart = np.arange(count)
    return uv, chart, measure_outlines(uv, chart, np.zeros((count, 3), bool), count)


def rectangles(sizes):
    """Charts of two triangles each."""
    corner = np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1.0]]])
    uv = (corner[None] * np.asarray(sizes, float)[:, None, None]).reshape(-1, 3, 2)
    chart = np.repeat(np.arange(len(sizes)), 2)
    shared = np.tile([[False, False, True], [True, False, False]], (len(sizes), 1))
    return uv, chart, measure_outlines(uv, chart, shared, len(sizes))


@pytest.mark.parametrize(("size", "padding"), [(128, 1), (256, 4), (2048, 5)])
def test_padding_is_kept(size, padding):
    """Also on a page that is searched in steps of two texels."""
    page = Page(size, padding)
    assert page.step == max(1, size // 1024)
    uv, chart, outlines = triangles(40)
    density, shapes, placement = find_greatest_density(outlines, page)
    placed = place_uv(uv, chart, density, shapes, placement)
    check_gaps(placed, chart, page.size, page.padding)
    assert set(placement.turn) == {0, 1, 2, 3}, "every turn is put to the test"


def test_charts_are_turned_and_moved_only():
    page = Page(256, 2)
    uv, chart, outlines = triangles(30)
    density, shapes, placement = find_greatest_density(outlines, page)
    placed = place_uv(uv, chart, density, shapes, placement)
    sides, placed_sides = (p - np.roll(p, 1, axis=1) for p in (uv * density, placed))
    turn = np.exp(0.5j * np.pi * placement.turn)[:, None]
    expected = (sides[..., 0] + 1j * sides[..., 1]) * turn
    np.testing.assert_allclose(placed_sides[..., 0] + 1j * placed_sides[..., 1], expected, atol=1e-9)


def test_one_square_fills_the_page_exactly():
    _, _, outlines = rectangles([(2.0, 2.0)])
    density, _, placement = find_greatest_density(outlines, Page(64, 4))
    assert density == 28.0
    assert placement.offset.tolist() == [[4, 4]]


@pytest.mark.parametrize(("count", "size", "least_share"), [(100, 1024, 0.75), (1000, 1024, 0.55), (100, 256, 0.35)])
def test_rectangles_fill_most_of_the_page(count, size, least_share):
    sizes = np.random.default_rng(2).uniform(0.05, 1.0, (count, 2))
    _, _, outlines = rectangles(sizes)
    density, *_ = find_greatest_density(outlines, Page(size, 4))
    assert sizes.prod(axis=1).sum() * density**2 / size**2 > least_share


@pytest.mark.parametrize("sizes", [[(1.0, 1.0)] * 6, [(5.0, 0.01)] * 3, [(1.0, 1.0), (1e-4, 1e-4)], [(3.0, 2.0)]])
def test_density_is_the_greatest_to_a_few_percent(sizes):
    page = Page(128, 3)
    _, _, outlines = rectangles(sizes)
    density, *_ = find_greatest_density(outlines, page)
    for factor in (1.05, 1.1, 1.2, 1.5):
        denser = density * factor
        assert not fits_alone(outlines, denser, page) or place_charts(shape_charts(outlines, denser, page), page.empty_horizon()) is None


def test_full_page_leaves_the_horizon():
    page = Page(32, 2)
    _, _, outlines = rectangles([(1.0, 1.0)] * 4)
    horizon = page.empty_horizon()
    assert place_charts(shape_charts(outlines, 20.0, page), horizon) is None
    np.testing.assert_array_equal(horizon, page.empty_horizon())
    assert place_charts(shape_charts(outlines, 10.0, page), horizon) is not None
    assert horizon.max() > 0


@pytest.mark.parametrize(("size", "padding", "count"), [(16, 4, 100), (8, 4, 1), (4, 64, 1)])
def test_too_many_charts_for_a_page(size, padding, count):
    assert find_greatest_density(triangles(count)[2], Page(size, padding)) is None


def test_lines_and_points_are_packed():
    uv, chart, outlines = triangles(5, box=(1.0, 1e-9))
    density, shapes, placement = find_greatest_density(outlines, Page(64, 2))
    check_gaps(place_uv(uv, chart, density, shapes, placement), chart, 64, 2)
