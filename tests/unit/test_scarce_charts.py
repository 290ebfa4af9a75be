"""Charts that hardly any photon meets share their light with those beside them, and no others do."""

from dataclasses import replace

import numpy as np
import pytest
from boxes import make_solver
from leaflight.core.radiosity import tally
from leaflight.core.radiosity.scarce_charts import share_light
from leaflight.core.scene.scene import Light, Material
from leaflight.core.util.settings import Settings
from scenes import join_meshes, make_scene, moved, quad_mesh


@pytest.fixture
def solver(tmp_path):
    """Of a floor and of two objects of 40 scraps each."""
    scraps = [moved(quad_mesh(f"Scrap {k}", 0.02, 0.02), (0.04 * (k % 8), 0.04 * (k // 8), 0.1)) for k in range(40)]
    near, far = join_meshes("Near", *scraps), moved(join_meshes("Far", *scraps), (0.5, 0.5, 0.0))
    lamp = Light("POINT", "Lamp", (0.5, 0.5, 0.8), power_rgb=(1.0, 1.0, 1.0))
    scene = make_scene([quad_mesh("Floor"), near, far], [lamp], [Material("Grey", (0.5,) * 3)])
    return make_solver(tmp_path, scene, Settings(even_out=False, size=128, padding=1), begun=False)


@pytest.fixture
def solved(solver):
    """Its tree, with one photon on a scrap and many on the floor."""
    tree, owner = solver.tree, solver._chart_order.owner
    leaves = np.flatnonzero(tree.parent < 0)
    counted, scrap = tally.Tally.empty(len(tree), tree.degree), leaves[owner[tree.chart[leaves]] == 1][7]
    floor = leaves[owner[tree.chart[leaves]] == 0][0]
    counted.photons[:] = 500.0
    for node, count in ((scrap, 1), (floor, 900)):
        counted.count[node], counted.weight2[:, node] = count, count
        counted.raw[0, 1, :, 0, node] = count
    solver.tally, totals = counted, tally.accumulate(tree, counted)
    return tree, totals, leaves, tally.solve_tallies(tree, totals, leaves), solver._chart_order, scrap, floor


def test_one_photon_lights_the_scraps_of_its_object_and_no_other(solved):
    tree, totals, leaves, before, order, scrap, floor = solved
    after, scarce = share_light(tree, totals.received, leaves, before, order)
    owner = order.owner[tree.chart]
    scraps, others = leaves[owner[leaves] == 1], leaves[owner[leaves] != 1]
    assert set(scarce) == set(leaves) - {floor}
    assert len(scraps) == 40
    light = after.flux[0] / tree.area
    assert light[scraps] == pytest.approx(np.full(40, before.flux[0, scrap] / tree.area[scraps].sum()))
    assert light[scraps].max() < 0.05 * before.flux[0, scrap] / tree.area[scrap]
    np.testing.assert_array_equal(after.flux[:, others], before.flux[:, others])
    np.testing.assert_array_equal(after.coefficient[..., floor], before.coefficient[..., floor])
    for both in ((after.flux, before.flux), (after.flux_half, before.flux_half)):
        np.testing.assert_allclose(both[0].sum(axis=-1), both[1].sum(axis=-1))
    shown = (after.coefficient[1, 0] * tree.moment[:, : after.coefficient.shape[2]].T).sum(axis=0)
    np.testing.assert_allclose(shown[leaves], after.flux[0, leaves])
    # The sum of the group's errors is that of one photon on the area of them all.
    mean2 = (after.variance[0, scraps] * tree.area[scraps]).sum() * tree.area[scraps].sum()
    assert mean2 == pytest.approx(before.variance[0, scrap] * tree.area[scrap] ** 2)


def test_charts_of_enough_photons_keep_their_own_light(solved):
    tree, totals, leaves, before, order, scrap, _ = solved
    received = totals.received.copy()
    received[scrap] = 16
    after, scarce = share_light(tree, received, leaves, before, order)
    assert scrap not in scarce
    np.testing.assert_array_equal(after.flux, before.flux)


def test_a_part_of_a_chart_keeps_its_own_light(solved):
    """A tree may start with many nodes of a chart, which have each other."""
    tree, totals, leaves, before, order, scrap, _ = solved
    chart = tree.chart.copy()
    chart[leaves[order.owner[chart[leaves]] == 1]] = chart[scrap]
    after, scarce = share_light(replace(tree, chart=chart), totals.received, leaves, before, order)
    assert scrap not in scarce
    np.testing.assert_array_equal(after.flux, before.flux)


def test_a_bake_by_rays_shares_it_and_the_published_method_does_not(solver, solved):
    tree, _, leaves, before, order, scrap, _ = solved
    scraps = leaves[order.owner[tree.chart[leaves]] == 1]
    shared = solver._read_tallies()
    assert shared.solution.flux[0, scraps] / tree.area[scraps] == pytest.approx(before.flux[0, scrap] / tree.area[scraps].sum())
    solver.settings = replace(solver.settings, direct="photons")
    assert np.count_nonzero(solver._read_tallies().solution.flux[0, scraps]) == 1
