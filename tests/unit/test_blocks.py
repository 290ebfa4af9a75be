"""Charts that are laid side by side to be moved and scaled as one."""

import numpy as np
import pytest
from leaflight.core.atlas.blocks import join_outlines, lay_block, outline_block
from leaflight.core.atlas.outlines import measure_outlines
from leaflight.core.atlas.packing import Page, place_charts, shape_charts
from texel_gaps import check_gaps


def triangles(count, seed=1):
    """Charts of one triangle each, at 0."""
    uv = np.random.default_rng(seed).uniform(0.0, 1.0, (count, 3, 2))
    uv -= uv.min(axis=1, keepdims=True)
    chart = np.arange(count)
    return uv, chart, measure_outlines(uv, chart, np.zeros((count, 3), bool), count)


@pytest.mark.parametrize(("size", "padding"), [(256, 1), (256, 4), (2048, 4)])
@pytest.mark.parametrize("scale", [1.0, 1.37, 2.5])
def test_gaps_hold_wherever_a_block_is_put_and_however_it_is_enlarged(size, padding, scale):
    uv, chart, outlines = triangles(20)
    layout = lay_block(outlines, 25.0, Page(size, padding))
    placed = layout.place(uv, chart)
    assert placed.min() == 0.0
    np.testing.assert_allclose(placed.max(axis=(0, 1)), layout.side)
    for shift in (0.3, 0.99):
        check_gaps(placed * scale + padding + shift, chart, 400, padding)


def test_a_block_is_nearly_square_and_mostly_full():
    _, _, outlines = triangles(60)
    layout = lay_block(outlines, 100.0, Page(2047, 1))
    assert outlines.area.sum() * 100.0**2 > 0.4 * layout.side.prod()
    assert 0.4 < layout.side[0] / layout.side[1] < 2.5


def test_outline_is_rigid_and_in_the_metres_of_its_object():
    _, _, outlines = triangles(5)
    page = Page(256, 4)
    layout = lay_block(outlines, 20.0, page)
    one = outline_block(outlines, layout).scale(3.0)
    assert (len(one.extent), one.rigid.tolist(), len(one.edge)) == (1, [True], 15)
    np.testing.assert_allclose(one.extent[0] * 20.0, layout.side * 3.0)
    np.testing.assert_allclose(one.area, outlines.area.sum() * 9.0)
    np.testing.assert_allclose(one.edge.max(axis=(0, 1)), one.extent[0])
    assert shape_charts(one, 20.0, page).turns.tolist() == [1]


def test_what_no_page_holds_is_none():
    _, _, outlines = triangles(5)
    assert lay_block(outlines, 1e4, Page(64, 4)) is None
    assert lay_block(outlines, 50.0, Page(8, 4)) is None


def test_joined_outlines_are_those_of_the_parts():
    (*_, one), (*_, other) = triangles(3), triangles(4, seed=2)
    both = join_outlines([one, other])
    for chart in range(7):
        part, k = (one, chart) if chart < 3 else (other, chart - 3)
        np.testing.assert_array_equal(both.select(np.array([chart])).edge, part.select(np.array([k])).edge)
        np.testing.assert_array_equal(both.extent[chart], part.extent[k])
    page = Page(256, 2)
    assert place_charts(shape_charts(both, 20.0, page), page.empty_horizon()) is not None
