"""Strips of a page: all that is wanted lies in one of them, with its surroundings."""

import numpy as np
import pytest
from leaflight.core.texels import strips
from leaflight.core.texels.strips import Strips
from trees import make_square_map

SIDE, RADIUS, HALO = 48, 4, 6


@pytest.fixture(scope="module")
def texels():
    return make_square_map(SIDE, 1)


def cut(texels, chosen, may=None):
    return Strips.of(np.flatnonzero(chosen), texels.texel_xy[chosen], texels.entry_at[0], RADIUS, HALO, may)


def near(texels, chosen):
    """Entries within the window of a chosen one."""
    offset = np.abs(texels.texel_xy[:, None].astype(int) - texels.texel_xy[chosen].astype(int))
    return np.flatnonzero((offset.max(axis=2) <= RADIUS).any(axis=1))


@pytest.mark.parametrize(("width", "height", "together"), [(None, None, None), (16, 8, 1000), (64, 128, 500)])
def test_what_is_wanted_lies_in_one_strip_each_with_a_halo(texels, monkeypatch, width, height, together):
    x, y = texels.texel_xy.T
    chosen = ((x < 3) & (y % 17 < 2)) | ((x - 30) ** 2 + (y - 12) ** 2 < 50) | (y == SIDE - 1)
    if width:
        monkeypatch.setattr(strips, "_WIDTHS", (width,))
        monkeypatch.setattr(strips, "_HEIGHT", height)
        monkeypatch.setattr(strips, "_TOGETHER", together)
    of_page, found = cut(texels, chosen), []
    for some in of_page.groups():
        entry, wanted = of_page.stack(some)
        assert entry.shape == (wanted.shape[0] + 2 * HALO, wanted.shape[1] + 2 * HALO)
        for row, column in np.argwhere(wanted)[::7]:
            around = entry[row : row + 2 * HALO + 1, column : column + 2 * HALO + 1]
            middle = texels.texel_xy[around[HALO, HALO]].astype(int)
            for corner, step in ((around[0, 0], -HALO), (around[-1, -1], HALO)):
                place = middle + step
                expected = texels.entry_at[0][place[1], place[0]] if (place >= 0).all() and (place < SIDE).all() else -1
                assert corner == expected
        found.append(entry[HALO:-HALO, HALO:-HALO][wanted])
    np.testing.assert_array_equal(np.sort(np.concatenate(found)), near(texels, chosen))


def test_a_group_is_no_larger_than_it_should_be(texels, monkeypatch):
    monkeypatch.setattr(strips, "_WIDTHS", (16,))
    monkeypatch.setattr(strips, "_HEIGHT", 8)
    monkeypatch.setattr(strips, "_TOGETHER", 2000)
    of_page = cut(texels, np.ones(len(texels), bool))
    groups = of_page.groups()
    np.testing.assert_array_equal(np.concatenate(groups), np.arange(len(of_page.height)))
    largest = int(of_page.height.max()) * of_page.width
    assert len(groups) > 3
    assert max(int(of_page.height[group].sum()) * of_page.width for group in groups) <= 2000 + largest


def test_nothing_wanted_is_no_strip(texels):
    assert cut(texels, np.zeros(len(texels), bool)).groups() == []


def test_who_may_not_be_worked_on_is_not_but_tells_of_others(texels):
    x, _ = texels.texel_xy.T
    chosen, may = (x > 10) & (x < 20), x % 3 > 0
    found, around = [], []
    of_page = cut(texels, chosen, may)
    for some in of_page.groups():
        entry, wanted = of_page.stack(some)
        found.append(entry[HALO:-HALO, HALO:-HALO][wanted])
        around.append(entry[entry >= 0])
    np.testing.assert_array_equal(np.sort(np.concatenate(found)), np.intersect1d(near(texels, chosen), np.flatnonzero(may)))
    assert not may[np.concatenate(around)].all()


def test_a_page_need_not_be_a_square(texels):
    """As one of every second texel of an odd one."""
    entry_at = texels.entry_at[0][:40, :20]
    x, y = texels.texel_xy.T
    chosen = (x < 20) & (y < 40)
    of_page, found = Strips.of(np.flatnonzero(chosen), texels.texel_xy[chosen], entry_at, RADIUS, HALO), []
    for some in of_page.groups():
        entry, wanted = of_page.stack(some)
        found.append(entry[HALO:-HALO, HALO:-HALO][wanted])
    np.testing.assert_array_equal(np.sort(np.concatenate(found)), np.flatnonzero(chosen))
