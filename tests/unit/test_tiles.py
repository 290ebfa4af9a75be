"""Tiles: squares of texels among those of charts, and light over them told by nine of their texels."""

from __future__ import annotations

import numpy as np
import pytest
from floors import floor_looks, floor_tiles, morton_square
from leaflight.core.texels import tiles as tiles_module
from leaflight.core.texels.tiles import NODE_WEIGHTS, TILE_CORNERS, TILE_NODES, TILE_SIDE, TILE_SURFACES, TILE_TEXELS, Tiles, find_calm


class TestTiles:
    @pytest.mark.parametrize("chunk", [1 << 16, 50])
    def test_whole_squares_are_found(self, monkeypatch, chunk):
        monkeypatch.setattr(tiles_module, "CHUNK_SIZE", chunk)
        code = np.concatenate([np.arange(3, 200), np.arange(64)])
        chart = np.concatenate([np.zeros(197, np.int32), np.ones(64, np.int32)])
        tiles = Tiles.of(chart, code)
        assert code[tiles.start].tolist() == [64, 128, 0]
        assert tiles.place.tolist() == [[0, 1, 0], [0, 0, 1], [1, 0, 0]]

    def test_a_hole_or_the_next_chart_breaks_them(self):
        assert not len(Tiles.of(np.zeros(66, np.int32), np.delete(np.arange(67), 20)))
        assert not len(Tiles.of(np.repeat([0, 1], 32), np.concatenate([np.arange(32), np.arange(32, 64)])))
        assert not len(Tiles.of(np.zeros(0, np.int32), np.zeros(0, np.int64)))

    def test_within_some_texels(self):
        tiles = floor_tiles(16)
        assert tiles.within(np.arange(64, 256)).start.tolist() == [0, 64, 128]
        assert tiles.within(np.delete(np.arange(256), 70)).start.tolist() == [0, 127, 191]
        assert not len(tiles.within(np.arange(0)))

    def test_of_one_triangle(self):
        tri = floor_looks(16)(np.arange(256)).tri
        assert floor_tiles(16).on_one_triangle(tri).place[:, 1:].tolist() == [[1, 0], [0, 1]]

    def test_near_is_the_ring_around(self):
        tiles = floor_tiles(64)
        marked = (tiles.place[:, 1] == 3) & (tiles.place[:, 2] == 0)
        near = tiles.near(marked)
        assert sorted(map(tuple, tiles.place[near, 1:])) == [(x, y) for x in (2, 3, 4) for y in (0, 1)]
        assert not tiles.near(np.zeros(64, bool)).any()

    def test_all_of_their_texels(self):
        assert floor_tiles(16).texels()[2].tolist() == list(range(2 * TILE_TEXELS, 3 * TILE_TEXELS))


class TestSurfaces:
    def test_nodes_tell_every_surface_of_degree_two(self):
        x, y = morton_square(8)
        value = 3.0 - x + 2 * y + 0.5 * x * x - x * y * y
        assert NODE_WEIGHTS @ value[TILE_NODES] == pytest.approx(value)

    def test_nothing_is_left_of_a_quadratic_surface(self):
        x, y = morton_square(8)
        value = 3.0 - x + 2 * y + 0.5 * x * x - x * y
        assert TILE_SURFACES @ (TILE_SURFACES.T @ value) == pytest.approx(value)
        assert np.abs(TILE_SURFACES @ (TILE_SURFACES.T @ x**3.0) - x**3.0).max() > 1

    def test_corners(self):
        x, y = morton_square(8)
        assert x[TILE_CORNERS].tolist() == [0, 7, 0]
        assert y[TILE_CORNERS].tolist() == [0, 0, 7]


def test_gentle_light_is_calm_and_an_edge_is_not():
    """A bent ramp, a ramp with noise, and a hard edge of the same height as the noise."""
    x, y = morton_square(8)
    ramp = 1.0 + 0.1 * x + 0.05 * y - 0.01 * x * y
    noisy = ramp + np.random.default_rng(1).normal(scale=0.1, size=TILE_TEXELS)
    edge = ramp + 1.0 * (x > 3)
    value = np.stack([ramp, noisy, edge])
    assert find_calm(value, np.full(3, 1e-5)).tolist() == [True, False, False]
    assert find_calm(value, np.full(3, 0.03)).tolist() == [True, True, False]


def test_noise_beyond_the_change_of_light_may_be_twice_as_large():
    """Noise of 0.15, on even light and on ramps that rise across a tile by a tenth of it, as much, and ten times as much."""
    x, _ = morton_square(8)
    noise = np.random.default_rng(1).normal(scale=0.15, size=TILE_TEXELS)
    value = np.stack([1.0 + rise * 0.15 * x / 7 + noise for rise in (0.0, 0.1, 1.0, 10.0)])
    off2 = (value**2).sum(axis=1) - ((value @ TILE_SURFACES) ** 2).sum(axis=1)
    assert off2 == pytest.approx(off2[0])
    sigma = np.sqrt(off2[0] / (TILE_TEXELS - 6))

    def most(by_slope):
        """Of each tile: its noise over what is allowed, up to which it is calm."""
        return [
            max(times for times in np.arange(1.0, 10.0, 0.1) if find_calm(value, np.full(4, sigma / times), by_slope)[k]) for k in range(4)
        ]

    assert most(False) == pytest.approx([4.0] * 4, abs=0.11)
    assert most(True) == pytest.approx([8.0, 8.0, 8.0, 4.0], abs=0.11)
    steep = 1.0 + 3.0 * 0.15 * x / 7 + noise
    between = [find_calm(steep[None], np.array([sigma / times]), True).item() for times in (4.5, 7.5)]
    assert between == [True, False]


def test_tiles_that_are_off_by_more_than_they_show_are_not_calm():
    value, allowed = np.ones((3, TILE_TEXELS)), np.full(3, 0.1)
    assert find_calm(value, allowed, least=np.array([0.0, 0.39, 0.41]) ** 2).tolist() == [True, True, False]


def test_even_light_without_noise_is_calm():
    assert find_calm(np.zeros((1, TILE_TEXELS)), np.zeros(1), True).all()


def test_tiles_without_some_texels_are_those_that_have_none_of_them():
    column, row = morton_square(4 * TILE_SIDE)
    tiles = Tiles.of(np.zeros(len(column), np.int64), np.arange(len(column)))
    marked = (column == TILE_SIDE) & (row > 2 * TILE_SIDE)
    found = tiles.without(marked)
    assert len(found) == 16 - 2
    assert not marked[found.texels()].any()
    for kept, given in ((found.start, tiles.start), (found.place, tiles.place)):
        np.testing.assert_array_equal(kept, given[~marked[tiles.texels()].any(axis=1)])
    assert len(tiles.without(np.zeros(len(column), bool))) == 16
