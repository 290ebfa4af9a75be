"""Debug passes: right numbers at right texels, and pictures that show them."""

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
        bake.tree, bake.solution(), leaves, bake.totals().received, DirectField.none(n), 0.0, 1000, 1, "error", solve.Ledger()
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


@NAMES
def test_numbers_are_alike_in_all_channels_and_colours_are_within_1(name):
    pages = make_pages(width=0.5)
    page, look = pages.page(name, 0), pages.look(name, 0, black)
    assert np.array_equal(page[..., 0], page[..., 1])
    assert np.array_equal(page[..., 0], page[..., 2])
    assert np.array_equal(page[..., 3], look[..., 3])
    assert page.dtype == look.dtype == np.float32
    assert 0 <= look.min() <= look.max() <= 1


def test_edges_are_drawn_over_the_light_in_a_grey_that_shows():
    pages = make_pages()
    edge = pages.page("leaf_edges", 0)[..., 0] == 1
    for light in (0.0, 0.9, 30.0):
        look = pages.look("leaf_edges", 0, lambda light=light: np.full((SIDE, SIDE, 4), light, np.float32))
        assert look[~edge][:, :3] == pytest.approx(min(light, 1.0))
        assert (np.abs(look[edge][:, :3] - min(light, 1.0)) > 0.3).all()


def test_another_page_is_empty_and_an_unknown_pass_is_named():
    assert not make_pages().page("level", 1).any()
    with pytest.raises(ValueError, match="'glossy'"):
        make_pages().page("glossy", 0)
