"""Cells on sides without a lightmap: they tile each triangle evenly, and hold the irradiance of the photons that fall on them."""

import numpy as np
import pytest
from leaflight.core.radiosity.cell_tally import CellFlux, CellTally
from leaflight.core.scene.surface_cells import SurfaceCells
from leaflight.core.util.sampling import square_to_uniform_triangle

AREA_M2 = np.array([4.0, 0.01, 1.0, 0.0])
HAS_LIGHTMAP = np.array([False, False, True, False])


@pytest.fixture(scope="module")
def cells():
    return SurfaceCells.of(AREA_M2, HAS_LIGHTMAP)


def points(count, seed=1):
    u, v = square_to_uniform_triangle(np.random.default_rng(seed).random((count, 2), dtype=np.float32)).T
    return u, v


def test_each_side_has_its_own_cells_and_a_lightmap_s_front_one(cells):
    area = np.zeros((2, len(AREA_M2)))
    for side in (0, 1):
        for tri in range(len(AREA_M2)):
            first, count = cells.start[side, tri], cells.per_edge[side, tri] ** 2
            area[side, tri] = cells.area_m2[first : first + count].sum()
    np.testing.assert_allclose(area, [AREA_M2, AREA_M2], atol=1e-12)
    assert cells.per_edge[0, 2] == 1 < cells.per_edge[1, 2]
    assert len(np.unique(np.sort(cells.start.ravel()))) == 8
    assert len(cells) == (cells.per_edge.astype(int) ** 2).sum()


def test_points_that_are_spread_evenly_fall_evenly_into_the_cells(cells):
    u, v = points(400_000)
    tri = np.ones(len(u), int)
    cell = cells.find(tri, np.zeros(len(u), bool), u, v)
    first, count = cells.start[1, 1], cells.per_edge[1, 1] ** 2
    assert count > 10
    assert ((cell >= first) & (cell < first + count)).all()
    found = np.bincount(cell - first, minlength=count)
    expected = len(u) / count
    assert ((found - expected) ** 2 / expected).sum() / count == pytest.approx(1.0, abs=6 * np.sqrt(2 / count))


def test_light_is_flux_over_area_and_doubt_is_half_the_gap_of_the_halves(cells):
    tally = CellTally.empty(len(cells))
    u, v = points(50_000)
    cell = cells.find(np.full(len(u), 1), np.ones(len(u), bool), u, v)
    is_straight = np.arange(len(u)) % 4 == 0
    # Each photon of a shard carries its share of 3, 2 and 1 W, of which all fall on the triangle.
    for half, more in ((0, 1.0), (1, 1.5)):
        flux = np.float32([[3.0], [2.0], [1.0]]) * more * np.ones(len(u), np.float32)
        place = cell + len(cells) * is_straight
        parts = [CellFlux.of(place[part], flux[:, part], 2 * len(cells)) for part in (slice(0, 1000), slice(1000, None))]
        tally.add(half, CellFlux.join(parts), len(u))
    light, doubt = tally.irradiance(cells)
    mine = np.arange(cells.start[0, 1], cells.start[0, 1] + cells.per_edge[0, 1] ** 2)
    power = (light[:, :, mine] * cells.area_m2[mine]).sum(axis=2)
    np.testing.assert_allclose(power, np.outer([0.75, 0.25], [3.75, 2.5, 1.25]), rtol=1e-5)
    np.testing.assert_allclose((doubt[:, mine] * cells.area_m2[mine]).sum(axis=1), [-0.375, -0.125], rtol=1e-5)
    assert light.sum() == pytest.approx(light[:, :, mine].sum())
