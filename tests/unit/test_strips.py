"""Strips of a page: all that is wanted lies in one of them, with its surroundings."""

import numpy as np
import pytest
from leaflight.core import strips
from leaflight.core.strips import Strips
from trees import make_square_map

SIDE, RADIUS, HALO = 48, 4, 6


@pytest.fixture(scope="module")
def texels():
    return make_square_map(SIDE, 1)


def cut(texels, chosen):
    return Strips.of(np.flatnonzero(chosen), texels.entry_at[0], texels, RADIUS, HALO)


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
