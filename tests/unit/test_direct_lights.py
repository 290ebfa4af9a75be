"""Every source: its rays, weighted by their shares, sum up to its closed form; and it agrees with photon birth."""

import math
from dataclasses import replace

import numpy as np
import pytest
from leaflight.core.lights.direct_lights import TriangleSource, WorldSource, join_sources, make_lamps, make_suns
from leaflight.core.scene.scene import Light
from leaflight.core.util.geometry import UnitBox

UNIT_BOX = UnitBox(np.array([1.0, 2.0, 3.0]), 0.25)
AXES = ((1.0, 0.0, 0.0), (0.0, math.cos(0.4), math.sin(0.4)), (0.0, -math.sin(0.4), math.cos(0.4)))
DOWN = -np.array(AXES[2])
AT = {"position_m": (1.0, 2.0, 3.0), "rotation": AXES, "power_rgb": (8.0, 4.0, 0.0)}
LIGHTS = {
    "point": Light("POINT", "L", **AT),
    "soft": Light("POINT", "L", radius_m=0.5, **AT),
    "sphere": Light("POINT", "L", radius_m=0.5, soft_falloff=False, **AT),
    "spot": Light("SPOT", "L", cone_angle_rad=1.6, blend=0.8, **AT),
    "soft_spot": Light("SPOT", "L", cone_angle_rad=1.6, blend=0.8, radius_m=0.2, **AT),
    "sun": Light("SUN", "L", rotation=AXES, power_rgb=(8.0, 4.0, 0.0)),
    "sun_disk": Light("SUN", "L", angle_rad=0.6, rotation=AXES, power_rgb=(8.0, 4.0, 0.0)),
    "rectangle": Light("AREA", "L", size_m=(0.8, 0.5), **AT),
    "ellipse": Light("AREA", "L", shape="ELLIPSE", size_m=(0.8, 0.5), **AT),
    "spread": Light("AREA", "L", size_m=(0.8, 0.5), spread_rad=1.6, **AT),
}


def source_of(light: Light):
    return (make_lamps([light], UNIT_BOX, ()) + make_suns([light]))[0]


def grid_numbers(side: int) -> np.ndarray:
    line = (np.arange(side, dtype=np.float32) + 0.5) / side
    return np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2).astype(np.float32)


@pytest.mark.parametrize("kind", LIGHTS)
def test_mean_shares_are_the_closed_form_beyond_the_horizon_too(kind):
    """Two receivers, one of them tilted so that its horizon cuts the light."""
    source = source_of(LIGHTS[kind])
    away = -DOWN
    position = np.tile((DOWN * 0.3).astype(np.float32), (1, 1))
    across = np.array(AXES[0])
    normals = [away, 0.15 * away + math.sqrt(1 - 0.15**2) * across]
    u = grid_numbers(128)
    shares = [source.aim(np.tile(position, (len(u), 1)), np.tile(n.astype(np.float32), (len(u), 1)), u).share.mean() for n in normals]
    closed = [source.irradiance(position, n[None].astype(np.float32))[0] for n in normals]
    assert shares == pytest.approx(closed, rel=0.02)


def make_triangle(front_only):
    corners, up = np.array([[[0, 0, 0], [0.2, 0, 0], [0, 0.2, 0]]], np.float32), np.array([[0, 0, 1]], np.float32)
    return TriangleSource(np.ones((1, 3)), True, corners, up, np.array([0.02], np.float32), np.array([front_only]))


def test_triangles_shine_both_ways():
    source = make_triangle(False)
    for height in (0.3, -0.3):
        position, normal = np.array([[0.05, 0.05, height]], np.float32), np.array([[0, 0, -np.sign(height)]], np.float32)
        assert source.irradiance(position, normal)[0] == pytest.approx(0.02 / 0.3**2, rel=0.1)
        aim = source.aim(np.tile(position, (256, 1)), np.tile(normal, (256, 1)), grid_numbers(16))
        end_height = (np.tile(position, (256, 1)) + aim.direction)[:, 2]
        assert (end_height * np.sign(height) > 0).all(), "rays end before the triangle, not behind it"
        assert aim.share.mean() == pytest.approx(source.irradiance(position, normal)[0], rel=0.01)


def test_world():
    source = WorldSource(np.ones((1, 3)))
    normal = np.tile(np.array([0, 0, 1], np.float32), (256, 1))
    assert source.irradiance(normal, normal) == pytest.approx(math.pi)
    aim = source.aim(normal, normal, grid_numbers(16))
    assert aim.share == pytest.approx(math.pi)
    assert aim.direction[:, 2].mean() == pytest.approx(2 / 3, rel=0.02)
    assert aim.distance.min() > 1e20


@pytest.mark.parametrize("kind", LIGHTS)
def test_a_row_for_each_receiver_is_the_light_by_itself(kind):
    """Two lights in turn, of one source, at the receivers of each."""
    light = LIGHTS[kind]
    sizes = {"radius_m": 1.5 * light.radius_m, "angle_rad": 1.5 * light.angle_rad, "size_m": (0.5, 0.4), "blend": 0.5 * light.blend}
    other = replace(light, position_m=(1.2, 1.9, 3.3), rotation=np.eye(3).tolist(), **sizes)
    here, there = source_of(light), source_of(other)
    ((both, _),) = join_sources([here, there])
    which = np.arange(40) % 2
    rng = np.random.default_rng(3)
    position = rng.uniform(-0.5, 0.1, (40, 3)).astype(np.float32)
    normal = np.tile(np.array([[0, 0.6, 0.8]], np.float32), (40, 1))
    u = rng.random((40, 2), np.float32)
    mixed = both.rows(which)
    for lamp, source in enumerate((here, there)):
        own = which == lamp
        assert (mixed.rgb[own] == source.rgb).all()
        assert mixed.irradiance(position, normal)[own] == pytest.approx(source.irradiance(position[own], normal[own]), rel=1e-5)
        aim, alone = mixed.aim(position, normal, u), source.aim(position[own], normal[own], u[own])
        for name in ("direction", "distance", "share", "weight"):
            assert getattr(aim, name)[own] == pytest.approx(getattr(alone, name), rel=1e-4, abs=1e-6), name
