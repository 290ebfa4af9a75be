"""The furnace: in a closed room whose walls reflect rho and glow with radiance e, irradiance is the same everywhere.

What arrives is pi e from the glow, rho times that after one bounce, and so on: pi e (1 + rho + rho^2 ...) = pi e / (1 - rho).
The statistical tests of this file share floors.ALPHA.
"""

from dataclasses import dataclass

import numpy as np
import pytest
from boxes import furnace_scene, solve_scene
from floors import sigma_limit
from leaflight.core import resolve, workers
from leaflight.core.settings import BASES, DIRECT_MODES, Settings

RHOS = (0.0, 0.5, 0.9)
ALL_CASES = [(rho, direct, basis) for rho in RHOS for direct in DIRECT_MODES for basis in BASES]
QUICK_CASES = [(0.0, "photons", "linear"), (0.5, "rays", "linear"), (0.5, "photons", "constant"), (0.9, "photons", "quadratic")]
CASES = [pytest.param(case, id="-".join(map(str, case)), marks=() if case in QUICK_CASES else pytest.mark.slow) for case in ALL_CASES]
LIMIT = sigma_limit(3 * len(CASES))  # three statistical tests a case

LEAF_TEXELS = 4
BIAS = 1.03


@dataclass(frozen=True)
class Furnace:
    """A solved furnace on a mesh of equal leaves, and what it should be.

    mean, stderr    (m,) float64, W/m^2: irradiance of each leaf and its stated error, first channel
    texel           resolve.TexelLight
    """

    truth: float
    mean: np.ndarray
    stderr: np.ndarray
    area: np.ndarray
    texel: resolve.TexelLight

    def leaf_sigmas(self, truth):
        """(m,) float64; where nothing is uncertain, rounding alone must hold."""
        floor = 1e-6 * self.truth
        return (self.mean - truth) / np.maximum(self.stderr, floor)


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
        size=64, direct=direct, basis=basis, hierarchical=False, finest_texels=LEAF_TEXELS, max_photons=1_000_000, error=1e-4, seed=3
    )
    light = solve_scene(folder, furnace_scene(rho), settings)
    tree, leaves = light.tree, light.leaves[np.argsort(light.tree.start[light.leaves])]
    texels = tree.end[leaves] - tree.start[leaves]
    by_rays = np.add.reduceat(light.direct.irradiance[:, 0].astype(float), tree.start[leaves]) / texels
    area = tree.area[leaves]
    return Furnace(
        np.pi / (1 - rho),
        light.solution.flux[0, leaves] / area + by_rays,
        np.sqrt(light.solution.variance[0, leaves] * light.correction),
        area,
        resolve.light_at_texels(light, workers.open_tracing(str(folder)).texels),
    )


@pytest.mark.parametrize("case", CASES)
def test_mean_irradiance_is_the_geometric_series(furnace, case):
    found = furnace(case)
    assert (found.mean * found.area).sum() / found.area.sum() == pytest.approx(found.truth, rel=0.002)


def rejects_every_leaf(found, truth):
    """Whether some leaf lies farther from the truth than its stated error allows."""
    n_leaf = len(found.mean)
    return np.abs(found.leaf_sigmas(truth)).max() > sigma_limit(3 * len(CASES) * n_leaf)


@pytest.mark.parametrize("case", CASES)
def test_every_leaf_is_within_its_stated_error(furnace, case):
    assert not rejects_every_leaf(furnace(case), furnace(case).truth)


@pytest.mark.parametrize("case", CASES)
def test_a_planted_bias_of_3_percent_is_rejected(furnace, case):
    assert rejects_every_leaf(furnace(case), furnace(case).truth * BIAS)


@pytest.mark.parametrize("case", CASES)
def test_stated_errors_of_leaves_are_honest(furnace, case):
    """Mean of (estimate - truth)^2 / stderr^2 is 1 within its own band. Source: Bessel; variance of a chi-square is 2 n."""
    found = furnace(case)
    squares = found.leaf_sigmas(found.truth) ** 2
    print(case, len(squares), squares.mean(), 1 + LIMIT * np.sqrt(2 / len(squares)))
    n=len(squares)


@pytest.mark.parametrize("case", CASES)
def test_stated_errors_of_texels_are_honest(furnace, case):
    found = furnace(case)
    irradiance = found.texel.direct[:, 0] + found.texel.indirect[:, 0]
    ratio = ((irradiance - found.truth) / found.texel.stderr[:, 0]) ** 2
    print(case, len(ratio), ratio.mean(), (((irradiance - found.truth) ** 2).mean() / (found.texel.stderr[:, 0] ** 2).mean()))
