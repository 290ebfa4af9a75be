import numpy as np
import pytest
from leaflight.core.atlas.density_search import find_greatest_density
from leaflight.core.atlas.packing import Page, place_uv
from plain_charts import triangles
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


def test_lines_and_points_are_packed():
    uv, chart, outlines = triangles(5, box=(1.0, 1e-9))
    density, shapes, placement = find_greatest_density(outlines, Page(64, 2))
    check_gaps(place_uv(uv, chart, density, shapes, placement), chart, 64, 2)
