"""Steps of light where a piece of a chart was cut become ramps; others stay."""

import dataclasses

import numpy as np
from leaflight.core.filter.border_feathering import close_cuts
from leaflight.core.texels.split_texels import TexelBorders
from trees import make_square_map

SIDE = 32
STEP = np.where(np.arange(SIDE) < SIDE // 2, 1.0, 3.0)


def halves(pieces, borders=None, light=STEP):
    """A page of two charts side by side, of this light in each row, and what becomes of it: (SIDE, SIDE)."""
    texels = make_square_map(SIDE, 0)
    is_right = (texels.texel_xy[:, 0] >= SIDE // 2).astype(np.int32)
    texels = dataclasses.replace(texels, texel_chart=is_right, chart_page=np.zeros(2, np.int32), chart_piece=np.array(pieces, np.int32))
    entry_at = texels.entry_at
    if borders:
        one, other = entry_at[0, borders, 15].astype(np.int64), entry_at[0, borders, 16].astype(np.int64)
        way, reach = np.repeat([0, 2], len(one)), np.full(2 * len(one), 0.5)
        both = np.concatenate([one, other]), np.concatenate([other, one])
        texels = dataclasses.replace(texels, borders=TexelBorders.of(SIDE * SIDE, way, *both, reach))
    light = np.broadcast_to(light[texels.texel_xy[:, :1]], (1, SIDE * SIDE, 3)).astype(np.float32)
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


def test_no_light_falls_below_none():
    """Bright at the cut alone, and dark behind it."""
    row = np.where(np.arange(SIDE) == SIDE // 2, 3.0, 0.0)
    page = halves([0, 0], light=row)
    assert page.min() == 0.0
    assert (page[:, 8:16] > 0.0).all()
    assert (page[:, 16] < 3.0).all()
    assert not page[:, 17:].any()
