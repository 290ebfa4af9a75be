"""Where photons are born: cells are cut where it tells, and shares of them go as the root of noise over rays, half of the photons apart."""

import numpy as np
import pytest
from leaflight.core.transport.emission_cells import DIMENSIONS, SLICES
from leaflight.core.transport.emission_guide import EVEN_SHARE, BirthTally, EmissionGuide

ONE = np.ones(1)
EVERYWHERE = np.ones(SLICES)


def tell(guide, births, noise, rays=1.0):
    """A round of so many births in each cell, of so much noise and so many rays each: (c,) or a number.

    noise may be (c, 4, SLICES) too: by axis and slice, each a product of what it is along every axis
    """
    shape = guide.births.shape
    births = np.broadcast_to(np.reshape(births, (-1, 1, 1)) / SLICES, shape)
    rays = births * np.reshape(rays, (-1, 1, 1))
    noise = births * (np.reshape(noise, (-1, 1, 1)) if np.ndim(noise) < 2 else noise)
    guide.add_round([BirthTally(births, rays, noise)])
    return guide


def along_each(*profiles):
    """(1, 4, SLICES): noise of a birth by axis and slice, where that at a point is a product of profiles (SLICES,) along the first axes."""
    profiles = [np.asarray(one, float) for one in (*profiles, *[EVERYWHERE] * DIMENSIONS)][:DIMENSIONS]
    means = [one.mean() for one in profiles]
    return np.array([[one / mean * np.prod(means) for one, mean in zip(profiles, means, strict=True)]])


def guided_part(cells):
    return (cells.share - EVEN_SHARE * cells.natural) / (1 - EVEN_SHARE)


def test_a_cell_is_cut_where_parts_differ_and_the_better_part_has_more():
    guide = tell(EmissionGuide.of(ONE), 1e7, along_each(EVERYWHERE, [9, 9, 1, 1, 1, 1, 1, 1]))
    cells = guide.plan()
    assert cells.low.tolist() == [[0, 0, 0, 0], [0, 0.25, 0, 0]]
    assert cells.side.tolist() == [[1, 0.25, 1, 1], [1, 0.75, 1, 1]]
    assert cells.natural.tolist() == [0.25, 0.75]
    np.testing.assert_allclose(guided_part(cells), [0.5, 0.5], rtol=1e-3)


def test_cells_tile_the_numbers_however_often_they_are_cut():
    guide = EmissionGuide.of(np.array([0.2, 0.8]))
    rng = np.random.default_rng(1)
    for _ in range(4):
        tell(guide, 1e5, np.concatenate([along_each(*rng.pareto(1.0, (DIMENSIONS, SLICES))) for _ in guide.births]))
        cells = guide.plan()
    assert len(cells) > 50
    assert (np.diff(cells.emitter) >= 0).all()
    volume = cells.side.prod(1, dtype=float)
    np.testing.assert_allclose(np.bincount(cells.emitter, volume), [1, 1], rtol=1e-6)
    np.testing.assert_allclose(cells.natural, volume * np.array([0.2, 0.8])[cells.emitter], rtol=1e-6)
    assert cells.share.sum() == pytest.approx(1, rel=1e-12)
    assert (cells.share >= EVEN_SHARE * cells.natural).all()
    points = rng.random((200, DIMENSIONS))
    inside = ((points[:, None] >= cells.low) & (points[:, None] < cells.low + cells.side)).all(2)
    for emitter in (0, 1):
        assert (inside[:, cells.emitter == emitter].sum(1) == 1).all()


def test_few_births_tell_little():
    for births, least, most in ((10.0, 1.0, 1.3), (1e7, 2.9, 3.1)):
        share = guided_part(tell(EmissionGuide.of(np.array([0.5, 0.5])), births, [9.0, 1.0]).plan())
        assert least < share[0] / share[1] < most
        share = guided_part(tell(EmissionGuide.of(np.array([0.5, 0.5])), births, 1.0, rays=[1.0, 9.0]).plan())
        assert least < share[0] / share[1] < most
    assert len(tell(EmissionGuide.of(ONE), 1000.0, along_each([9, 9, 1, 1, 1, 1, 1, 1])).plan()) == 1  # too few to cut by
