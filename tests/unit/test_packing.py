import numpy as np
import pytest
from leaflight.core.atlas.density_search import find_greatest_density
from leaflight.core.atlas.packing import Page, place_charts, place_uv, shape_charts
from plain_charts import rectangles, triangles
from texel_gaps import check_gaps


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


def test_full_page_leaves_the_horizon():
    page = Page(32, 2)
    _, _, outlines = rectangles([(1.0, 1.0)] * 4)
    horizon = page.empty_horizon()
    assert place_charts(shape_charts(outlines, 20.0, page), horizon) is None
    np.testing.assert_array_equal(horizon, page.empty_horizon())
    assert place_charts(shape_charts(outlines, 10.0, page), horizon) is not None
    assert horizon.max() > 0


def test_lines_and_points_are_packed():
    uv, chart, outlines = triangles(5, box=(1.0, 1e-9))
    density, shapes, placement = find_greatest_density(outlines, Page(64, 2))
    check_gaps(place_uv(uv, chart, density, shapes, placement), chart, 64, 2)


@pytest.mark.parametrize(("size", "padding"), [(64, 2), (96, 0), (2048, 5)])
def test_many_charts_of_one_texel_lie_as_one_by_one(size, padding):
    """Above and beside charts of any shape."""
    page = Page(size, padding)
    large = triangles(6)[2]
    density = 0.25 * size
    points = rectangles([(0.5 / density, 0.2 / density)] * 60)[2]
    together, apart = page.empty_horizon(), page.empty_horizon()
    for horizon in (together, apart):
        assert place_charts(shape_charts(large, density, page), horizon) is not None
    all_at_once = place_charts(shape_charts(points, density, page), together)
    one = rectangles([(0.5 / density, 0.2 / density)])[2]
    in_turn = [place_charts(shape_charts(one, density, page), apart) for _ in range(60)]
    np.testing.assert_array_equal(all_at_once.offset, np.concatenate([placed.offset for placed in in_turn]))
    np.testing.assert_array_equal(together, apart)
    assert all_at_once.top == max(placed.top for placed in in_turn)


def test_points_that_find_no_room_are_told():
    page = Page(8, 1)
    points = rectangles([(0.01, 0.01)] * 40)[2]
    horizon = page.empty_horizon()
    assert place_charts(shape_charts(points, 1.0, page), horizon) is None
    np.testing.assert_array_equal(horizon, page.empty_horizon())
    few = place_charts(shape_charts(rectangles([(0.01, 0.01)] * 9)[2], 1.0, page), horizon)
    assert sorted(map(tuple, few.offset.tolist())) == [(x, y) for x in (1, 3, 5) for y in (1, 3, 5)]
    assert few.top == 5
    for size, padding in ((2, 1), (0, 0)):  # no inside
        page = Page(size, padding)
        assert place_charts(shape_charts(rectangles([(0.01, 0.01)])[2], 1.0, page), page.empty_horizon()) is None
