"""Runs of emitting cells, and chances by what they may give."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from leaflight.core.lights.direct_points import Receivers
from leaflight.core.lights.emitter_clusters import EmitterClusters, cut_by_spread, order_cells

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


def test_heavy_cells_are_parted_from_light_ones_that_are_elsewhere():
    weight = np.array([1.0, 1, 1e-6, 1e-6, 1e-6])
    place = np.array([[0.0], [1], [5], [6], [7]])
    assert cut_by_spread(weight, place, 2, 0.0).tolist() == [0, 1]


def test_solids_come_by_themselves():
    centre, normal = np.random.default_rng(3).random((2, 50, 3))
    sealed = np.arange(50) % 2 == 0
    order = order_cells(centre, normal, sealed)
    assert sorted(order.tolist()) == list(range(50))
    assert not sealed[order][:25].any()
    clusters = EmitterClusters.of(np.ones(50), centre[order], normal[order], np.zeros(50), sealed[order])
    of_cell = np.repeat(np.arange(len(clusters)), clusters.runs.count)
    assert np.array_equal(clusters.sealed[: len(clusters)], [sealed[order][of_cell == run].all() for run in range(len(clusters))])


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


def test_what_is_below_the_horizon_of_a_middle_counts_where_others_may_see_it():
    lamp, looking = row_of(1, -0.1, UP), receivers_at((-0.45, 0, 0))
    near, wide = (lamp.estimate(looking, np.array([reach], np.float32))[0, 0] for reach in (0.0, 0.3))
    assert wide > 20 * near


def cells_of(clusters: EmitterClusters) -> np.ndarray:
    """Nodes of single cells, in the cells' order."""
    single = np.flatnonzero(clusters.last - clusters.first == 1)
    return single[np.unique(clusters.first[single], return_index=True)[1]]


def test_nodes_are_parts_of_each_other_down_to_single_cells():
    """2,000 cells of 50 places and as many ways: more than two levels, as runs are of up to 40."""
    rng = np.random.default_rng(4)
    centre, normal = np.repeat(rng.uniform(-0.5, 0.5, (50, 3)), 40, axis=0), np.repeat(rng.normal(size=(50, 3)), 40, axis=0)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    clusters = clusters_of(centre, normal)
    assert (clusters.runs.count > 32).any()
    for node in range(len(clusters.first)):
        parts = np.arange(clusters.below[node], clusters.below[node] + clusters.count[node])
        first, last = clusters.first[node], clusters.last[node]
        if last - first == 1:
            assert not len(parts)
            continue
        assert clusters.first[parts].tolist() == [first, *clusters.last[parts][:-1]]
        assert clusters.last[parts[-1]] == last
        assert clusters.weight[parts].sum() == pytest.approx(clusters.weight[node], rel=1e-5)
        assert len(parts) == (8 if last - first > 32 else last - first)
    assert len(cells_of(clusters)) == 2000


def test_a_near_run_is_judged_by_its_cells():
    """One beside the receiver gives most, which the middles of runs do not tell."""
    row = row_of(1000, 0.01)
    assert len(row) < 256
    looking, reach = receivers_at((0.2, 0, 0)), np.zeros(1, np.float32)
    cells = cells_of(row)
    square = ((row.centre[cells] - looking.position) ** 2).sum(axis=1)
    exact = 0.01**2 / (square * (square + row.square[cells]))
    run = np.repeat(np.arange(len(row)), row.runs.count)
    expected = np.bincount(run, exact)
    found = row.estimate(looking, reach)[0]
    assert found.sum() == pytest.approx(expected.sum(), rel=0.02)
    assert found.argmax() == expected.argmax()
    together = replace(row, count=np.zeros_like(row.count))  # as if runs had no parts
    assert abs(together.estimate(looking, reach)[0].sum() / expected.sum() - 1) > 0.05


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


def test_nothing_to_choose_among():
    row = row_of(3, 0.1)
    cell, chance = row.choose(receivers_at((0, 0, 0)), np.array([2]), np.array([0.5]))
    assert (cell.tolist(), chance.tolist()) == ([2], [1.0])


def test_a_strip_close_by_is_found_among_others_in_the_same_run():
    """Twelve strips 4 cm apart, and places 1 mm off cells of one of them: what rays bring that choose by this differs little."""
    x, y = np.meshgrid(np.linspace(-0.4, 0.4, 80), np.linspace(-0.22, 0.22, 12))
    centre = np.column_stack([x.ravel(), y.ravel(), np.full(960, 0.001)])
    centre = centre[order_cells(centre, np.tile(DOWN, (960, 1)), np.zeros(960, bool))]
    clusters = clusters_of(centre, np.tile(DOWN, (960, 1)), size=2e-3)
    rng = np.random.default_rng(4)
    spreads = []
    for cell in rng.integers(0, 960, 40):
        place = centre[cell] * [1, 1, 0]
        looking = receivers_at(*[place] * 2000)
        run = np.full(2000, np.searchsorted(clusters.runs.start, cell, side="right") - 1)
        chosen, chance = clusters.choose(looking, run, rng.random(2000))
        away = centre[chosen] - place
        brought = (away[:, 2] / ((away**2).sum(axis=1) + 2e-3**2)) ** 2 / chance
        spreads.append(brought.std() / brought.mean())
    assert np.median(spreads) < 1
