"""The light of photons on leaves: how much of it comes from lamps, and how much from surfaces."""

import numpy as np
import pytest
from leaflight.core.radiosity import refine
from leaflight.core.radiosity.radiosity_solution import RadiositySolution
from trees import SquareBake


@pytest.mark.parametrize("degree", [0, 1, 2])
@pytest.mark.parametrize("width", [1.0, 0.3])
def test_the_direct_share_of_a_leafs_light_is_that_of_its_photons(degree, width):
    """Direct light falls on one half of a chart, and as much indirect light everywhere; the node may reach far beyond the chart."""
    rng = np.random.default_rng(1)
    bake = SquareBake(side=16, degree=degree, width=width, preview_depth=1)
    bake.throw(width * (1 - rng.random(4000) ** 2 / 2), rng.random(4000))
    bake.throw(width * rng.random(4000), rng.random(4000), half=1, is_first=False)
    reading = RadiositySolution.of(bake.tree, bake.tally, refine.Rule("significance", 0.0, 1 << 20, 1), False)
    direct = (reading.direct_share * reading.mean)[reading.leaves] * bake.tree.area[reading.leaves, None]
    np.testing.assert_allclose(direct.sum(axis=0), reading.solution.flux[:, reading.leaves].sum(axis=1) / 2, rtol=1e-6)
