import numpy as np
import pytest
from leaflight.core.atlas import density_search
from leaflight.core.atlas.density_search import find_greatest_density
from leaflight.core.atlas.packing import Page, fits_alone, place_charts, shape_charts
from plain_charts import rectangles, triangles


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


@pytest.mark.parametrize(("size", "padding", "count"), [(16, 4, 100), (8, 4, 1), (4, 64, 1)])
def test_too_many_charts_for_a_page(size, padding, count):
    assert find_greatest_density(triangles(count)[2], Page(size, padding)) is None


def count_tries(monkeypatch):
    """The densities that are tried from now on."""
    densities, shape = [], density_search.shape_charts

    def note(outlines, density, page):
        densities.append(density)
        return shape(outlines, density, page)

    monkeypatch.setattr(density_search, "shape_charts", note)
    return densities


@pytest.mark.parametrize(("size", "padding"), [(512, 4), (1024, 2), (512, 8)])
def test_what_was_tried_tells_of_the_next(monkeypatch, size, padding):
    """Many charts fill the page at once, whether padding is much of them or little; bisection alone takes five to eight tries."""
    page, tries = Page(size, padding), count_tries(monkeypatch)
    density, _, placement = find_greatest_density(triangles(1200)[2], page)
    assert density in tries
    assert len(tries) <= 4
    assert 0.97 * page.inside <= placement.top <= page.inside


def test_top_is_where_the_highest_chart_ends():
    outlines, page = rectangles([(1.0, 2.0)] * 3)[2], Page(64, 3)
    _, shapes, placement = find_greatest_density(outlines, page)
    height = np.where(placement.turn % 2 == 0, shapes.side[:, 1], shapes.side[:, 0])
    assert placement.top == (placement.offset[:, 1] - page.padding + height).max()


def test_what_no_page_holds_is_no_try_that_tells():
    """What is laid out for a density may not be laid out at all: the search goes on below."""
    outlines, page = triangles(50)[2], Page(128, 2)
    free, *_ = find_greatest_density(outlines, page)
    bound, *_ = find_greatest_density(outlines, page, lambda density: outlines if density < 0.5 * free else None)
    assert 0.49 * free <= bound < 0.5 * free
    assert find_greatest_density(outlines, page, lambda density: None) is None


def test_a_first_guess_too_dense_tells_of_the_next_too(monkeypatch):
    """Lines leave no room between them for what the guess counts on."""
    page, tries = Page(512, 4), count_tries(monkeypatch)
    density, _, placement = find_greatest_density(triangles(1200, box=(1.0, 1e-9))[2], page)
    assert density < tries[0]
    assert len(tries) == 2
    assert placement.top > 0.97 * page.inside
