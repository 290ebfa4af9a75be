import numpy as np
import pytest
from leaflight.core.atlas.density_search import find_greatest_density
from leaflight.core.atlas.packing import Page, place_charts, shape_charts
from plain_charts import rectangles, triangles


def test_one_square_fills_the_page_exactly():
    _, _, outlines = rectangles([(2.0, 2.0)])
    layout = find_greatest_density(outlines, Page(64, 4))
    assert layout.density == 28.0
    assert layout.offset.tolist() == [[4, 4]]


@pytest.mark.parametrize(("count", "size", "least_share"), [(100, 1024, 0.75), (1000, 1024, 0.55), (100, 256, 0.35)])
def test_rectangles_fill_most_of_the_page(count, size, least_share):
    sizes = np.random.default_rng(2).uniform(0.05, 1.0, (count, 2))
    _, _, outlines = rectangles(sizes)
    density = find_greatest_density(outlines, Page(size, 4)).density
    assert sizes.prod(axis=1).sum() * density**2 / size**2 > least_share


@pytest.mark.parametrize("sizes", [[(1.0, 1.0)] * 6, [(5.0, 0.01)] * 3, [(1.0, 1.0), (1e-4, 1e-4)], [(3.0, 2.0)]])
def test_density_is_the_greatest_to_a_few_percent(sizes):
    page = Page(128, 3)
    _, _, outlines = rectangles(sizes)
    density = find_greatest_density(outlines, page).density
    for factor in (1.05, 1.1, 1.2, 1.5):
        shapes = shape_charts(outlines, density * factor, page)
        assert shapes is None or place_charts(shapes, page.empty_horizon()) is None


@pytest.mark.parametrize(("size", "padding", "count"), [(16, 4, 100), (8, 4, 1), (4, 64, 1)])
def test_too_many_charts_for_a_page(size, padding, count):
    assert find_greatest_density(triangles(count)[2], Page(size, padding)) is None
