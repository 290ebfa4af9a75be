"""Runs of emitting cells, and chances by what they may give."""

from __future__ import annotations

import numpy as np
import pytest
from leaflight.core.lights.direct_points import Receivers
from leaflight.core.lights.emitter_clusters import EmitterClusters, cut_by_spread

UP, DOWN = (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)


def receivers_at(*places: tuple[float, float, float], normal: tuple[float, float, float] = UP) -> Receivers:
    position = np.array(places, np.float32)
    normals = np.tile(np.array(normal, np.float32), (len(places), 1))
    return Receivers(position, normals, normals)


def clusters_of(centre: np.ndarray, normal: np.ndarray, sealed: bool = False, size: float = 1e-3) -> EmitterClusters:
    """Of cells that are in order, of the same weight and size."""
    count = len(centre)
    return EmitterClusters.of(np.ones(count), centre, normal, np.full(count, size**2), np.full(count, sealed))


def row_of(count: int, z: float, normal: tuple[float, float, float] = DOWN, sealed: bool = False) -> EmitterClusters:
    """Cells along x, from -0.45 to 0.45."""
    centre = np.column_stack([np.linspace(-0.45, 0.45, count), np.zeros(count), np.full(count, z)])
    return clusters_of(centre, np.tile(normal, (count, 1)), sealed)


def test_cells_of_a_few_places_are_cut_between_them():
    """Three lamps of many cells, one of them twice as large: no run is of two of them, which one of equal weights would be."""
    rng = np.random.default_rng(1)
    lamp = np.repeat([0, 1, 2], [40, 80, 40])
    place = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0]])[lamp] + rng.normal(0, 0.01, (160, 3))
    start = cut_by_spread(np.ones(160), place, 3, 0.0)
    assert start.tolist() == [0, 40, 120]
    assert cut_by_spread(np.ones(160), place, 256, 0.01).tolist() == [0, 40, 120]


def test_runs_are_not_more_than_are_wanted_nor_than_there_are_cells():
    place = np.random.default_rng(2).random((300, 3))
    assert len(cut_by_spread(np.ones(300), place, 50, 0.0)) == 50
    assert cut_by_spread(np.ones(5), place[:5], 50, 0.0).tolist() == [0, 1, 2, 3, 4]
    assert cut_by_spread(np.ones(1), place[:1], 50, 0.0).tolist() == [0]
    assert cut_by_spread(np.zeros(5), place[:5], 50, 10.0).tolist() == [0]
    assert cut_by_spread(np.ones(7), np.zeros((7, 3)), 50, 0.0).tolist() == [0]


def test_judged_by_distance_horizon_and_facing():
    """Of a small lamp that faces the receiver: its cosines over the squared distance."""
    lamp = clusters_of(np.array([[0.3, 0.0, 0.4]]), np.array([DOWN]))
    found = lamp.estimate(receivers_at((0, 0, 0), (0.3, 0, 0)), np.zeros(2, np.float32))[:, 0]
    assert found == pytest.approx([0.8 * 0.8 / 0.25, 1 / 0.16], rel=1e-3)


def test_what_is_below_the_horizon_or_looks_away_is_hardly_chosen_but_can_be():
    nobody = np.zeros(1, np.float32)
    above = row_of(1, 0.4).estimate(receivers_at((-0.45, 0, 0)), nobody)[0, 0]
    for hidden in (row_of(1, -0.4, UP), row_of(1, 0.4, UP, sealed=True)):
        found = hidden.estimate(receivers_at((-0.45, 0, 0)), nobody)[0, 0]
        assert 0 < found < 0.01 * above
    assert row_of(1, 0.4, UP).estimate(receivers_at((-0.45, 0, 0)), nobody)[0, 0] == pytest.approx(above)  # one sees its back too
    wide = np.array([0.5], np.float32)  # who may be up there sees it from its front
    assert row_of(1, 0.4, UP, sealed=True).estimate(receivers_at((-0.45, 0, 0)), wide)[0, 0] > 10 * found


@pytest.mark.parametrize(("height", "is_near"), [(0.0005, True), (2.0, False)])
def test_cells_are_chosen_by_the_chances_they_are_told_with(height, is_near):
    """In a run that has parts of its own: near ones by what they give this receiver, far ones by importance."""
    place = np.linspace(-0.45, 0.45, 10_000)
    row = clusters_of(np.column_stack([place, np.zeros((10_000, 2))]), np.tile(UP, (10_000, 1)), size=1e-4)
    rng, count = np.random.default_rng(5), 40_000
    run = int(np.argmax(row.runs.start > 5000)) - 1
    first = row.runs.start[run]
    n_cell = row.runs.start[run + 1] - first
    assert n_cell > 32
    looking = receivers_at(*[(place[first + 3], 0.0, height)] * count, normal=DOWN)
    cell, chance = row.choose(looking, np.full(count, run), rng.random(count))
    expected = np.zeros(n_cell)
    expected[cell - first] = chance
    seen = np.bincount(cell - first, minlength=n_cell) / count
    assert seen == pytest.approx(expected, abs=5 * np.sqrt(expected.max() / count))
    assert expected.sum() == pytest.approx(1, abs=0.01)
    uneven = chance.max() / chance.min()
    assert uneven > 4 if is_near else uneven == pytest.approx(1)
