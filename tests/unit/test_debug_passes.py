"""Debug passes: right numbers at right texels, and pictures that show them."""

from dataclasses import replace

import numpy as np
import pytest
from leaflight.core.bake import solve
from leaflight.core.integrate.direct_field import DirectField
from leaflight.core.output.debug_passes import DebugPages
from leaflight.core.radiosity import quadtree
from leaflight.core.util.settings import DEBUG_PASSES
from trees import SquareBake

SIDE = 16
NAMES = pytest.mark.parametrize("name", DEBUG_PASSES)


def make_pages(width=1.0, margin=0):
    """A square whose lower left quarter is split once more, into leaves of 4 texels; 1,000 photons fell into that quarter."""
    bake = SquareBake(side=SIDE, width=width, level=1, preview_depth=1)
    lower_left = np.flatnonzero(bake.tree.current & (bake.tree.origin == 0).all(1))
    bake.tree = quadtree.split(bake.tree, lower_left)
    bake.throw(*(0.5 * np.random.default_rng(1).random((2, 1000))))
    leaves = np.flatnonzero(bake.tree.current)
    n = bake.n_texel
    light = solve.LightField(
        bake.tree, bake.solution(), leaves, bake.totals().received, 1.0, DirectField.none(n), 0.0, 1000, 1, "error", solve.Ledger()
    )
    return DebugPages(light, bake.texels, margin)


def black():
    return np.zeros((SIDE, SIDE, 4), np.float32)


def test_level_counts_halvings_of_the_root():
    level = make_pages().page("level", 0)
    expected = np.ones((SIDE, SIDE))
    expected[:8, :8] = 2
    assert np.array_equal(level[..., 0], expected)
    assert (level[..., 3] == 1).all()


def test_photons_are_those_of_the_leaf():
    photons = make_pages().page("photons", 0)[..., 0]
    quarters = photons[[0, 0, 4, 4], [0, 4, 0, 4]]
    assert quarters.sum() == 1000
    assert (quarters > 200).all()
    assert (photons[:4, :4] == quarters[0]).all()
    assert photons[0, 8] == photons[8, 0] == 0


def test_edges_are_one_texel_wide_and_lie_between_leaves():
    edge = make_pages().page("leaf_edges", 0)[..., 0]
    expected = np.zeros((SIDE, SIDE))
    expected[8] = expected[:, 8] = 1
    expected[4, :8] = expected[:8, 4] = 1
    assert np.array_equal(edge, expected)


def test_a_charts_own_border_is_no_edge():
    """The page's lower left corner is given to another page: what is left begins in the middle of a leaf."""
    pages = make_pages()
    corner = (pages._texels.texel_xy < 6).any(1).astype(np.int32)
    pages._texels = replace(pages._texels, page_count=2, chart_page=np.arange(2, dtype=np.int32), texel_chart=corner)
    edge = pages.page("leaf_edges", 0)[..., 0]
    assert not edge[6, 6:8].any()
    assert not edge[6:8, 6].any()
    assert edge[8, 6:].all()


def test_charts_are_numbered_and_what_no_chart_covers_is_empty():
    pages = make_pages(width=0.5)
    assert not pages.page("charts", 0)[..., :3].any()
    assert pages.page("charts", 0)[..., 3].sum() == SIDE * SIDE / 2
    look = pages.look("charts", 0, black)
    assert (look[:, : SIDE // 2, :3] > 0).any(-1).all()
    assert not look[:, SIDE // 2 :].any()


@NAMES
def test_numbers_are_alike_in_all_channels_and_colours_are_within_1(name):
    pages = make_pages(width=0.5)
    page, look = pages.page(name, 0), pages.look(name, 0, black)
    assert np.array_equal(page[..., 0], page[..., 1])
    assert np.array_equal(page[..., 0], page[..., 2])
    assert np.array_equal(page[..., 3], look[..., 3])
    assert page.dtype == look.dtype == np.float32
    assert 0 <= look.min() <= look.max() <= 1


@NAMES
def test_margin_runs_on_in_colour_but_not_in_alpha(name):
    bare, wide = make_pages(width=0.5), make_pages(width=0.5, margin=2)
    for bare_page, page in ((bare.page(name, 0), wide.page(name, 0)), (bare.look(name, 0, black), wide.look(name, 0, black))):
        assert np.array_equal(page[..., 3], bare_page[..., 3])
        assert np.array_equal(page[:, :8], bare_page[:, :8])
        assert not page[:, 10:].any()
    assert wide.look("charts", 0, black)[:, 8:10, :3].any(-1).all()


@pytest.mark.parametrize("name", ["level", "photons"])
def test_more_is_brighter_and_the_most_is_the_end_of_the_map(name):
    pages = make_pages()
    value, look = pages.page(name, 0)[..., 0], pages.look(name, 0, black)[..., :3].mean(-1)
    order = np.argsort(value.ravel())
    assert (np.diff(look.ravel()[order]) >= 0).all()
    assert len(np.unique(look)) == len(np.unique(value))
    assert pages.look(name, 0, black)[value == value.max()][0, :3] == pytest.approx([0.982, 0.799, 0.019], abs=0.002)


def test_edges_are_drawn_over_the_light_in_a_grey_that_shows():
    pages = make_pages()
    edge = pages.page("leaf_edges", 0)[..., 0] == 1
    for light in (0.0, 0.9, 30.0):
        look = pages.look("leaf_edges", 0, lambda light=light: np.full((SIDE, SIDE, 4), light, np.float32))
        assert look[~edge][:, :3] == pytest.approx(min(light, 1.0))
        assert (np.abs(look[edge][:, :3] - min(light, 1.0)) > 0.3).all()


@pytest.mark.parametrize(("share", "owner"), [(2.0, 1), (0.5, 0)])
def test_a_texel_of_two_charts_at_its_centre_belongs_to_the_larger(share, owner):
    pages = make_pages()
    texels = pages._texels
    pages._texels = replace(
        texels,
        chart_page=np.zeros(2, np.int32),
        texel_chart=np.append(texels.texel_chart, np.int32(1)),
        texel_xy=np.append(texels.texel_xy, texels.texel_xy[:1], axis=0),
        texel_tri=np.append(texels.texel_tri, texels.texel_tri[:1]),
        texel_area=np.append(texels.texel_area, share * texels.texel_area[0]),
    )
    x, y = texels.texel_xy[0]
    assert pages.page("charts", 0)[y, x, 0] == owner


def test_another_page_is_empty_and_an_unknown_pass_is_named():
    assert not make_pages().page("level", 1).any()
    with pytest.raises(ValueError, match="'glossy'"):
        make_pages().page("glossy", 0)
