"""Steps of light where a piece of a chart was cut become ramps; others stay."""

import dataclasses

import numpy as np
import pytest
from leaflight.core.filter.border_feathering import close_cuts
from leaflight.core.texels.split_texels import TexelBorders
from trees import make_square_map

SIDE = 32
STEP = np.where(np.arange(SIDE) < SIDE // 2, 1.0, 3.0)


def halves(pieces, borders=None, light=STEP, axis=0, cut=SIDE // 2, sides=(16, 16)):
    """Two charts beside or above each other on the second page, of this light across, and what becomes of it: (SIDE, SIDE), across last."""
    texels = make_square_map(SIDE, 0)
    is_right = (texels.texel_xy[:, axis] >= cut).astype(np.int32)
    pages = {"chart_page": np.ones(2, np.int32), "page_count": 2}
    texels = dataclasses.replace(texels, texel_chart=is_right, chart_piece=np.array(pieces, np.int32), **pages)
    entry_at = texels.entry_at[1:]
    if borders is not None:
        one, other = entry_at[0, borders, 15].astype(np.int64), entry_at[0, borders, 16].astype(np.int64)
        way, reach = np.repeat([0, 2], len(one)), np.full(2 * len(one), 0.5)
        both = np.concatenate([one, other]), np.concatenate([other, one])
        texels = dataclasses.replace(texels, borders=TexelBorders.of(SIDE * SIDE, way, *both, reach))
    light = np.broadcast_to(light[texels.texel_xy[:, axis, None]], (1, SIDE * SIDE, 3)).astype(np.float32)
    close_cuts(light, texels, np.array(sides, np.int32)[is_right])
    assert (np.ptp(light[0], axis=1) == 0.0).all()
    page = light[0, entry_at[0], 0]
    return page if axis == 0 else page.T


@pytest.mark.parametrize("axis", [0, 1])
def test_a_step_becomes_a_ramp_of_the_same_mean(axis):
    page = halves([0, 0], axis=axis)
    np.testing.assert_allclose(page, np.broadcast_to(page[0], page.shape))
    np.testing.assert_allclose(np.diff(page[0, 8:24]), np.where(np.arange(15) == 7, 0.125, 0.125), atol=1e-6)
    assert (page[:, :8] == 1.0).all()
    assert (page[:, 24:] == 3.0).all()


@pytest.mark.parametrize(
    ("cut", "sides", "changed"), [(16, (16, 4), range(14, 18)), (16, (4, 16), range(14, 18)), (4, (16, 16), range(12))]
)
def test_a_ramp_is_as_long_as_the_smaller_leaf_and_the_page_let_it_be(cut, sides, changed):
    step = np.where(np.arange(SIDE) < cut, 1.0, 3.0)
    page = halves([0, 0], light=step, cut=cut, sides=sides)
    assert np.flatnonzero((page != step).all(axis=0)).tolist() == list(changed)


def test_between_other_pieces_and_where_something_stands_steps_stay():
    assert set(halves([0, 1]).ravel().tolist()) == {1.0, 3.0}
    page = halves([0, 0], slice(0, 20))
    assert set(page[:20].ravel().tolist()) == {1.0, 3.0}
    assert page[25, 15] > 1.5
    page = halves([0, 0], np.delete(np.arange(SIDE), [10, 11, 12]))  # a ramp is no longer than the cut is high
    assert np.argwhere(page != STEP).min(axis=0).tolist() == [10, 13]
    assert np.argwhere(page != STEP).max(axis=0).tolist() == [12, 18]


def test_no_light_falls_below_none():
    """Bright at the cut alone, and dark behind it."""
    row = np.where(np.arange(SIDE) == SIDE // 2, 3.0, 0.0)
    page = halves([0, 0], light=row)
    assert page.min() == 0.0
    assert (page[:, 8:16] > 0.0).all()
    assert (page[:, 16] < 3.0).all()
    assert not page[:, 17:].any()
