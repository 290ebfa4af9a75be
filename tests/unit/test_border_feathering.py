"""Steps of light where a piece of a chart was cut become ramps; others stay."""

import dataclasses
from types import SimpleNamespace

import numpy as np
from leaflight.core.filter.border_feathering import close_cuts
from leaflight.core.texels.split_texels import OPPOSITE, TexelBorders
from trees import make_square_map

SIDE = 32


def halves(pieces, borders=None):
    """A page of two charts side by side, of light 1 and 3, and what becomes of it: (SIDE, SIDE)."""
    texels = make_square_map(SIDE, 0)
    is_right = (texels.texel_xy[:, 0] >= SIDE // 2).astype(np.int32)
    texels = dataclasses.replace(texels, texel_chart=is_right, chart_page=np.zeros(2, np.int32), chart_piece=np.array(pieces, np.int32))
    entry_at = texels.entry_at
    if borders:
        one, other = entry_at[0, borders, 15].astype(np.int64), entry_at[0, borders, 16].astype(np.int64)
        way, reach = np.repeat([0, 2], len(one)), np.full(2 * len(one), 0.5)
        both = np.concatenate([one, other]), np.concatenate([other, one])
        texels = dataclasses.replace(texels, borders=TexelBorders.of(SIDE * SIDE, way, *both, reach))
    light = np.broadcast_to(1.0 + 2.0 * is_right[:, None], (1, SIDE * SIDE, 3)).astype(np.float32)
    close_cuts(light, texels, np.full(SIDE * SIDE, 16, np.int32))
    assert (np.ptp(light[0], axis=1) == 0.0).all()
    return light[0, entry_at[0], 0]


def test_a_step_becomes_a_ramp_of_the_same_mean():
    page = halves([0, 0])
    np.testing.assert_allclose(page, np.broadcast_to(page[0], page.shape))
    np.testing.assert_allclose(np.diff(page[0, 8:24]), np.where(np.arange(15) == 7, 0.125, 0.125), atol=1e-6)
    assert (page[:, :8] == 1.0).all()
    assert (page[:, 24:] == 3.0).all()


def test_between_other_pieces_and_where_something_stands_steps_stay():
    assert set(halves([0, 1]).ravel().tolist()) == {1.0, 3.0}
    page = halves([0, 0], slice(0, 20))
    assert set(page[:20].ravel().tolist()) == {1.0, 3.0}
    assert page[25, 15] > 1.5


def draw_charts(rng):
    """Two pages of blocks of three charts each, some of one piece, with holes, and sheets between some texels; and their leaves' sides."""
    block = np.repeat(np.arange(5), [1, 3, 4, 3, 1])  # to the page's edges
    chart = np.stack([rng.integers(0, 3, (5, 5))[block[:, None], block] + 3 * page for page in (0, 1)])
    chart[rng.random(chart.shape) < 0.06] = -1
    place = np.argwhere(chart >= 0)[rng.permutation((chart >= 0).sum())]
    count = len(place)
    entry_at = np.full(chart.shape, -1, np.int32)
    entry_at[tuple(place.T)] = np.arange(count)
    ways, ones, others = [], [], []
    for way, one, other in ((0, entry_at[:, :, :-1], entry_at[:, :, 1:]), (1, entry_at[:, :-1], entry_at[:, 1:])):
        walled = (one >= 0) & (other >= 0) & (rng.random(one.shape) < 0.05)
        ways += [np.full(walled.sum(), way), np.full(walled.sum(), OPPOSITE[way])]
        ones += [one[walled], other[walled]]
        others += [other[walled], one[walled]]
    way, one, other = (np.concatenate(part).astype(np.int64) for part in (ways, ones, others))
    texels = SimpleNamespace(
        entry_at=entry_at,
        page_of=lambda entry: chart[tuple(place.T)][entry] // 3,
        chart_page=np.repeat([0, 1], 3).astype(np.int32),
        chart_piece=np.array([1, 1, 2, 5, 5, 5], np.int32),
        texel_chart=chart[tuple(place.T)].astype(np.int32),
        texel_xy=place[:, :0:-1].astype(np.int32),
        borders=TexelBorders.of(count, way, one, other, np.full(len(way), 0.5)),
    )
    return texels, rng.choice([1, 2, 4, 8, 16, 32, 64], count).astype(np.int32)


def ramp_one_by_one(light, texels, side):
    """What close_cuts does, one place after the other."""
    out, entry_at = light.copy(), texels.entry_at
    size = entry_at.shape[1]
    piece = texels.chart_piece[texels.texel_chart]
    for axis in (0, 1):
        for page in entry_at if axis == 0 else entry_at.transpose(0, 2, 1):
            is_cut = np.zeros((size, size), bool)
            for row, column in np.ndindex(size, size - 1):
                one, other = page[row, column : column + 2]
                if min(one, other) >= 0 and texels.texel_chart[one] != texels.texel_chart[other] and piece[one] == piece[other]:
                    is_cut[row, column] = not texels.borders.are_between(axis, np.array([one]), np.array([other]))[0]
            for row, column in np.argwhere(is_cut):
                ends = [np.flatnonzero(~part) for part in (is_cut[row::-1, column], is_cut[row:, column])]
                run = sum(end[0] if len(end) else length for end, length in zip(ends, (row + 1, size - row), strict=True)) - 1
                sides = page[row, column : column + 2]
                reach = min(run, side[sides].min() // 2, 8)
                for entry, first, way in zip(sides, (column, column + 1), (-1, 1), strict=True):
                    change = 0.5 * (light[:, sides.sum() - entry] - light[:, entry])
                    for distance in range(reach):
                        at = first + way * distance
                        if not 0 <= at < size or page[row, at] < 0 or texels.texel_chart[page[row, at]] != texels.texel_chart[entry]:
                            break
                        out[:, page[row, at]] += change * (1.0 - (distance + 0.5) / reach)
    return out


def test_no_light_falls_below_none():
    """Bright at the cut alone, and dark behind it."""
    texels, side = draw_charts(np.random.default_rng(0))
    light = (np.random.default_rng(2).random((1, len(side), 3)) < 0.3).astype(np.float32)
    expected = ramp_one_by_one(light, texels, side)
    assert expected.min() < 0.0
    close_cuts(light, texels, side)
    np.testing.assert_allclose(light, np.maximum(expected, 0.0), rtol=1e-5, atol=1e-6)
