"""Lamps over an open floor: a point, with and without a radius, a sun at an angle, a spot's cone.

Irradiance of a point of intensity I is I cos / d^2, of a sun E0 cos. The statistical tests of this file share floors.ALPHA.
"""

import math

import numpy as np
import pytest
from closed_forms import from_point
from known_light import bake_known, black_scene, floor_mesh
from leaflight.core.scene.scene import Light
from leaflight.core.util.settings import DIRECT_MODES
from stats import hold_bias_is_seen, hold_unbiased

POWER_W = 10.0
INTENSITY = POWER_W / (4 * math.pi)
PLACE = (0.3, 0.6, 0.8)
AXIS = np.array([0.3, 0.1, -1.0]) / np.linalg.norm([0.3, 0.1, -1.0])  # of the spot
HALF_CONE, BLEND = 0.5, 0.6
SUN = np.array([2.0, -1.0, 2.0]) / 3  # from the floor


def facing(direction):
    """A light's rotation that makes it shine along `direction`."""
    z = -np.asarray(direction, float)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    return tuple(map(tuple, np.array([x, np.cross(z, x), z])))


def lamp(kind, **options):
    return Light(kind, kind.title(), **{"position_m": PLACE, "power_rgb": (POWER_W, POWER_W / 2, POWER_W / 4), **options})


def spot_irradiance(position, normal):
    cosine = (position - PLACE) @ AXIS / np.linalg.norm(position - PLACE, axis=1)
    t = np.clip((cosine - math.cos(HALF_CONE)) / (BLEND * (1 - math.cos(HALF_CONE))), 0, 1)
    return INTENSITY * from_point(PLACE, position, normal) * t * t * (3 - 2 * t)


SCENES = {
    "point": (lamp("POINT"), lambda p, n: INTENSITY * from_point(PLACE, p, n)),
    "soft point": (lamp("POINT", radius_m=0.2), lambda p, n: INTENSITY * from_point(PLACE, p, n, radius=0.2)),
    "sphere light": (lamp("POINT", radius_m=0.2, soft_falloff=False), lambda p, n: INTENSITY * from_point(PLACE, p, n)),
    "sun": (lamp("SUN", rotation=facing(-SUN)), lambda p, n: POWER_W * (n @ SUN)),
    "wide sun": (lamp("SUN", rotation=facing(-SUN), angle_rad=0.6), lambda p, n: POWER_W * (n @ SUN)),
    "spot": (lamp("SPOT", rotation=facing(AXIS), cone_angle_rad=2 * HALF_CONE, blend=BLEND), spot_irradiance),
}
CASES = [(name, direct) for name in SCENES for direct in DIRECT_MODES]


@pytest.fixture(scope="module", params=CASES, ids="-".join)
def known(request, tmp_path_factory):
    name, direct = request.param
    light, irradiance = SCENES[name]
    return bake_known(tmp_path_factory.mktemp("plane"), black_scene([floor_mesh()], [light]), irradiance, direct)


def test_every_leaf_is_within_its_stated_error(known, scene_name, hold):
    hold_unbiased(hold, f"plane under a {scene_name}", known.on_leaves(), len(CASES), 0.2)


def test_a_planted_bias_is_rejected(known, hold):
    hold_bias_is_seen(hold, "lamps over a plane", known.on_leaves(), len(CASES))


def test_channels_differ_as_the_lamp_says(known):
    light = known.light.solution.flux[:, known.light.leaves].sum(1) + known.light.direct.irradiance.sum(0)
    assert light[1:] / light[0] == pytest.approx([0.5, 0.25], rel=1e-5)
