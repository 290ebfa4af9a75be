"""The furnace: in a closed room whose walls reflect rho and glow with radiance e, irradiance is the same everywhere.

What arrives is pi e from the glow, rho times that after one bounce, and so on: pi e (1 + rho + rho^2 ...) = pi e / (1 - rho).
The statistical tests of this file share floors.ALPHA.
"""

from dataclasses import dataclass

import numpy as np
import pytest
from boxes import furnace_scene, make_solver, solve_scene
from floors import sigma_limit
from leaflight.core import resolve
from leaflight.core.settings import BASES, DIRECT_MODES, Settings

RHOS = (0.0, 0.5, 0.9)
ALL_CASES = [(rho, direct, basis) for rho in RHOS for direct in DIRECT_MODES for basis in BASES]
QUICK_CASES = [(0.0, "photons", "linear"), (0.5, "rays", "linear"), (0.5, "photons", "constant"), (0.9, "photons", "quadratic")]
CASES = [pytest.param(case, id="-".join(map(str, case)), marks=() if case in QUICK_CASES else pytest.mark.slow) for case in ALL_CASES]
N_TEST = 2 * len(CASES)  # two statistical tests a case

LEAF_TEXELS = 4


@dataclass(frozen=True)
class Furnace:
    """A solved furnace on a mesh of equal leaves, and what it should be.

    mean, stderr    (m,) float64, W/m^2: irradiance of each leaf and its stated error, first channel
    area            (m,) float64, m^2
    texel           all channels at the texels
    indirect        whether photons bring any of it
    """

    truth: float
    mean: np.ndarray
    stderr: np.ndarray
    area: np.ndarray
    texel: resolve.TexelLight
    indirect: bool

    def leaf_sigmas(self, truth):
        """(m,) float64: how many stated errors the leaves are off; where nothing is random, rounding is what is stated."""
        return (self.mean - truth) / np.maximum(self.stderr, 1e-6 * self.truth)


@pytest.fixture(scope="module")
def furnace(tmp_path_factory):
    """Solves each case once."""
    known = {}

    def solve(case):
        if case not in known:
            known[case] = solve_case(tmp_path_factory.mktemp("furnace"), *case)
        return known[case]

    return solve


def solve_case(folder, rho, direct, basis):
    settings = Settings(
        size=64, direct=direct, basis=basis, hierarchical=False, finest_texels=LEAF_TEXELS, max_photons=1_000_000, error=0.005, seed=3
    )
    solver = make_solver(folder, furnace_scene(rho), settings)
    light = solver.run(lambda message: None, lambda: False)
    tree, leaves = light.tree, light.leaves[np.argsort(light.tree.start[light.leaves])]
    texels = tree.end[leaves] - tree.start[leaves]
    by_rays, rays_variance = (
        np.add.reduceat(values[:, 0].astype(float), tree.start[leaves]) for values in (light.direct.irradiance, light.direct.variance)
    )
    area = tree.area[leaves]
    return Furnace(
        np.pi / (1 - rho),
        light.solution.flux[0, leaves] / area + by_rays / texels,
        np.sqrt(light.solution.variance[0, leaves] * light.correction + rays_variance / texels**2),
        area,
        resolve.light_at_texels(light, solver.blender, smooth_grain=False),
        rho > 0 or direct == "photons",
    )


@pytest.mark.parametrize("case", CASES)
def test_mean_irradiance_is_the_geometric_series(furnace, case):
    found = furnace(case)
    assert (found.mean * found.area).sum() / found.area.sum() == pytest.approx(found.truth, rel=0.002)


@pytest.mark.parametrize("case", CASES)
def test_every_leaf_is_within_its_stated_error(furnace, case):
    found = furnace(case)
    assert np.abs(found.leaf_sigmas(found.truth)).max() < sigma_limit(N_TEST * len(found.mean))


def chi_square_band(found):
    """Where the mean of n squared sigmas lies; n of them vary by 2 / n. Light without chance may be better than stated."""
    width = sigma_limit(N_TEST) * np.sqrt(2 / len(found.mean))
    return (1 - width if found.indirect else 0.0), 1 + width


@pytest.mark.parametrize("case", CASES)
def test_stated_errors_of_leaves_are_honest(furnace, case):
    lowest, highest = chi_square_band(furnace(case))
    assert lowest < np.mean(furnace(case).leaf_sigmas(furnace(case).truth) ** 2) < highest


@pytest.mark.parametrize("case", CASES)
def test_a_planted_bias_of_3_percent_is_rejected(furnace, case):
    biased = furnace(case).truth * 1.03
    assert np.mean(furnace(case).leaf_sigmas(biased) ** 2) > chi_square_band(furnace(case))[1]


@pytest.mark.parametrize("case", CASES)
def test_stated_errors_of_texels_are_honest(furnace, case):
    """Also away from the middle of a leaf, where the higher functions have their say."""
    texel, truth = furnace(case).texel, furnace(case).truth
    real = np.sqrt(np.mean((texel.direct + texel.indirect - truth) ** 2))
    stated = np.sqrt(np.mean(texel.stderr**2))
    assert real < 1.25 * stated
    assert not furnace(case).indirect or stated < 1.25 * real


def test_even_light_needs_no_leaf_but_the_six_walls(tmp_path):
    light = solve_scene(tmp_path, furnace_scene(0.5), Settings(size=64, direct="photons", max_photons=400_000, error=1e-4))
    assert len(light.leaves) == 6
    assert light.error < 0.02
