"""Grain is smoothed on all texels, but on one texel of each quad."""

import numpy as np
import pytest
from leaflight.core.texels.lattices import list_lattices
from trees import make_map, make_square_map

SIDE = 32


@pytest.fixture(scope="module")
def texels():
    return make_square_map(SIDE, 1)


def test_without_quads_there_is_one_of_all_texels(texels):
    grainy = texels.texel_xy[:, 0] < 5
    (lattice,) = list_lattices(grainy, texels)
    np.testing.assert_array_equal(lattice.grainy, np.flatnonzero(grainy))
    np.testing.assert_array_equal(lattice.xy, texels.texel_xy[grainy])
    np.testing.assert_array_equal(lattice.entry_at, texels.entry_at[0])
    assert lattice.may is None
    assert not lattice.of_quads
    assert not list(list_lattices(np.zeros(len(texels), bool), texels))


def test_quads_stand_on_their_first_texels(texels):
    x, y = texels.texel_xy.T
    by_quads, grainy = x < 16, (y < 8) | (x > 20)
    plain, quads = list_lattices(grainy, texels, by_quads)
    np.testing.assert_array_equal(plain.grainy, np.flatnonzero(grainy))
    np.testing.assert_array_equal(plain.may, ~by_quads)
    assert quads.of_quads
    np.testing.assert_array_equal(quads.may, by_quads & (x % 2 == 0) & (y % 2 == 0))
    np.testing.assert_array_equal(quads.grainy, np.flatnonzero(quads.may & (y < 8)))
    assert quads.entry_at.shape == (SIDE // 2, SIDE // 2)
    np.testing.assert_array_equal(quads.entry_at[quads.xy[:, 1], quads.xy[:, 0]], quads.grainy)


@pytest.mark.parametrize(("column", "row"), [(0, 0), (1, 0), (0, 1), (1, 1)])
def test_they_do_so_wherever_their_chart_begins(column, row):
    left, low = 4 + column, 6 + row
    texels = make_map(np.array([[left, low], [left + 20, low], [left, low + 20]])[None], size=SIDE)
    code = texels.texel_code
    first = np.flatnonzero((code & 3 == 0) & np.isin(code + 1, code) & np.isin(code + 2, code) & np.isin(code + 3, code))
    by_quads = np.zeros(len(texels), bool)
    by_quads[(first[:, None] + np.arange(4)).ravel()] = True
    (_, *quads) = list_lattices(np.ones(len(texels), bool), texels, by_quads)
    assert len(quads) == 1
    np.testing.assert_array_equal(quads[0].grainy, first)
    np.testing.assert_array_equal(quads[0].entry_at[quads[0].xy[:, 1], quads[0].xy[:, 0]], first)


def test_every_page_has_its_own(texels):
    """The square twice, on pages of their own."""
    n = len(texels)

    class Pages:
        texel_xy, texel_code = np.tile(texels.texel_xy, (2, 1)), np.tile(texels.texel_code, 2)
        entry_at = np.stack([texels.entry_at[0], texels.entry_at[0] + n])

        def __len__(self):
            return 2 * n

        def page_of(self, entry):
            return entry // n

    x, y = Pages.texel_xy.T
    grainy, by_quads = (np.arange(2 * n) >= n) | (y < 5), x < 16
    found = list(list_lattices(grainy, Pages(), by_quads))
    assert [lattice.of_quads for lattice in found] == [False, True, False, True]
    for page, (plain, quads) in enumerate((found[:2], found[2:])):
        for lattice in (plain, quads):
            assert (lattice.grainy // n == page).all()
            np.testing.assert_array_equal(lattice.entry_at[lattice.xy[:, 1], lattice.xy[:, 0]], lattice.grainy)
        assert len(plain.grainy) == (grainy.reshape(2, n)[page]).sum()
        assert len(quads.grainy) == (grainy & quads.may).reshape(2, n)[page].sum() > 0
