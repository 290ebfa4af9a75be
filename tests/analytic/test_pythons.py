"""The same light on every Python and numpy: what one of them found is committed, and each other finds it again within the errors.

The committed bake has another seed, so the z-test is one of independent bakes wherever it runs. To renew it:
PYTHONPATH=tests python tests/analytic/test_pythons.py
"""

import json
import platform
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
from boxes import room_mesh, solve_scene
from floors import sigma_limit
from leaflight.core.scene.scene import Light, Material
from leaflight.core.util.settings import DIRECT_MODES, Settings
from scenes import box_mesh, make_scene
from stats import PLANTED_BIAS

KNOWN = Path(__file__).with_name("known_light.json")
KNOWN_SEED, SEED = 1, 2
PHOTONS = 400_000


def room_scene():
    lamp = Light("POINT", "Lamp", (0.2, -0.1, 0.3), power_rgb=(12.0, 9.0, 6.0), radius_m=0.05)
    block = box_mesh("Block", (0.3, 0.4, 0.3), (-0.1, 0.1, -0.3))
    return make_scene([room_mesh(), block], [lamp], [Material("Clay", (0.7, 0.5, 0.3))])


def find_light(folder, direct, seed):
    """Of each chart: irradiance and its standard error, W/m^2, three channels each."""
    light = solve_scene(folder, room_scene(), Settings(size=48, direct=direct, max_photons=PHOTONS, error=0.01, seed=seed, even_out=False))
    tree = light.tree
    roots = np.flatnonzero(tree.parent < 0)
    area, texels = tree.area[roots], tree.end[roots] - tree.start[roots]
    rays, noise = (np.add.reduceat(values, tree.start[roots]).T for values in (light.direct.irradiance, light.direct.variance))
    mean = light.solution.flux[:, roots] / area + rays / texels
    return mean, np.sqrt(light.solution.variance[:, roots] + noise / texels**2)


@pytest.fixture(scope="module", params=DIRECT_MODES)
def sigmas(request, tmp_path_factory):
    """sigmas(bias): how many errors each chart and channel is off the committed bake."""
    known = json.loads(KNOWN.read_text(encoding="utf-8"))["light"][request.param]
    mean, stderr = find_light(tmp_path_factory.mktemp("python"), request.param, SEED)
    return lambda bias: (mean * bias - known["mean"]) / np.hypot(stderr, known["stderr"])


def limit(sigmas):
    return sigma_limit(len(DIRECT_MODES) * sigmas(1.0).size)


def test_light_is_that_of_another_python(sigmas, hold):
    versions = json.loads(KNOWN.read_text(encoding="utf-8"))["versions"]
    hold(f"Pythons: farthest chart off what {versions} found", np.abs(sigmas(1.0)).max(), high=limit(sigmas), unit="stated errors")


def test_a_planted_bias_is_rejected(sigmas, hold):
    hold("Pythons: farthest with a planted bias of 3 %", np.abs(sigmas(PLANTED_BIAS)).max(), low=limit(sigmas), unit="stated errors")


def write_known():
    found = {"versions": f"Python {platform.python_version()}, numpy {np.__version__}", "light": {}}
    for direct in DIRECT_MODES:
        with tempfile.TemporaryDirectory() as name:
            mean, stderr = (np.round(values, 6).tolist() for values in find_light(Path(name), direct, KNOWN_SEED))
            found["light"][direct] = {"mean": mean, "stderr": stderr}
    KNOWN.write_text(json.dumps(found) + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(write_known())
