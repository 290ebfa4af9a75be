"""Quads are found where texels make them up, and tell of their texels what they know."""

import numpy as np
import pytest
from floors import floor_tiles, morton_square
from leaflight.core.texels.quads import Quads, find_misfit, find_whole_quads, spread_over_texels
from leaflight.core.texels.tiles import Tiles

SIDE = 64
COUNT = SIDE * SIDE


def find_quads(tri=None, alone=(), tiles=None):
    tri = np.zeros(COUNT, np.int32) if tri is None else tri
    return Quads.of(floor_tiles(SIDE) if tiles is None else tiles, tri, np.isin(np.arange(len(tri)), alone))


def test_four_tiles_make_up_a_large_one():
    quads = find_quads()
    np.testing.assert_array_equal(quads.start, np.arange(0, COUNT, 256))
    column, row = morton_square(SIDE)
    np.testing.assert_array_equal(quads.place[:, 1:], np.stack([column[quads.start], row[quads.start]], axis=1) // 16)
    first = quads.first
    assert len(first) == COUNT // 4
    assert (column[first] % 2 == 0).all()
    assert (row[first] % 2 == 0).all()
    tiles = quads.tiles()
    np.testing.assert_array_equal(tiles.start, np.arange(0, COUNT // 4, 64))
    np.testing.assert_array_equal(tiles.place, quads.place)
    some = np.arange(len(quads)) == 3
    np.testing.assert_array_equal(quads.texels(some), np.arange(3 * 256, 4 * 256))


def test_nothing_else_does():
    """Neither around a texel that is like no other, nor where triangles meet, nor where a tile is missing or begins in the middle."""
    every = set(find_quads().start)
    assert set(find_quads(alone=[5 * 256 + 77]).start) == every - {5 * 256}
    assert set(find_quads(alone=[5 * 256, 6 * 256 + 255]).start) == every - {5 * 256, 6 * 256}
    tri = np.where(np.arange(COUNT) < 3 * 256 + 100, 0, 1)
    assert set(find_quads(tri).start) == every - {3 * 256}
    assert set(find_quads(np.where(np.arange(COUNT) < 3 * 256, 0, 1)).start) == every
    tiles = floor_tiles(SIDE)
    kept = np.arange(len(tiles)) != 4 * 4 + 2
    assert set(find_quads(tiles=Tiles(tiles.start[kept], tiles.place[kept])).start) == every - {4 * 256}
    shifted = find_quads(tiles=Tiles(tiles.start, tiles.place + np.array([0, 1, 0])))
    assert not len(shifted)
    assert not len(find_quads(np.zeros(0, np.int32), tiles=Tiles.none()))


def test_texels_of_charts_that_follow_each_other_are_told_apart():
    code = np.concatenate([np.arange(128), np.arange(128, 256)])
    chart = np.repeat([0, 1], 128)
    assert not len(Quads.of(Tiles.of(chart, code), np.zeros(256, np.int32), np.zeros(256, bool)))


@pytest.mark.parametrize("power", [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)])
def test_a_surface_of_the_second_degree_is_told_at_every_texel(power):
    x, y = (at[:256] for at in morton_square(16))
    truth = (x / 16.0) ** power[0] * (y / 16.0) ** power[1]
    value = np.stack([truth, 2 * truth, -truth], axis=1)
    value = np.concatenate([value, value + 1.0])
    quads = value.reshape(-1, 4, 3).mean(axis=1)
    assert spread_over_texels(quads) == pytest.approx(value, abs=1e-12)
    assert find_misfit(quads[:, 0], np.zeros(len(quads))) == pytest.approx(0, abs=1e-12)


def test_what_no_surface_tells_stays_with_its_quad():
    """So that no light is lost, and noise of one quad is not another's."""
    rng = np.random.default_rng(1)
    quads = rng.random((128, 3))
    texels = spread_over_texels(quads)
    assert texels.reshape(-1, 4, 3).mean(axis=1) == pytest.approx(quads)
    assert np.abs(texels.reshape(-1, 4, 3) - quads[:, None]).max() < 0.1


def test_misfit_is_what_is_more_than_noise():
    rng = np.random.default_rng(2)
    x, _ = morton_square(8)
    sigma = 0.1
    smooth = 1 + x / 8 + sigma * rng.standard_normal((200, 64))
    edge = np.where(x < 3, 0.0, 1.0) + sigma * rng.standard_normal((200, 64))
    noise = np.full(200 * 64, sigma**2)
    misfit = [find_misfit(value.ravel(), noise) for value in (smooth, edge)]
    assert len(misfit[0]) == 200
    assert misfit[0].mean() < 0.15 * sigma**2
    plain = find_misfit(np.where(x < 3, 0.0, 1.0), np.zeros(64))
    assert misfit[1].mean() == pytest.approx(plain[0], rel=0.1)


def test_a_quad_is_whole_where_all_of_its_texels_are():
    code = np.array([2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12])
    marked = np.ones(len(code), bool)
    assert find_whole_quads(marked[:10], code[:10]).tolist() == [2, 6]
    marked[4] = False
    assert find_whole_quads(marked[:10], code[:10]).tolist() == [6]
    assert not len(find_whole_quads(~marked, code))
