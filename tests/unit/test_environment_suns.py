"""Suns taken out of environment maps: where they were, as bright, as large; and what is no sun stays."""

import math
from functools import lru_cache

import numpy as np
import pytest
from leaflight.core.lights.environment_suns import Spot, take_suns_out
from leaflight.core.util.geometry import orthonormal_basis
from leaflight.core.util.sphere_map import find_middles, find_solid_angles

TOWARD = np.array([0.48, -0.6, 0.64])
HEIGHT, FINE = 256, 4


@lru_cache(maxsize=1)
def place_fine(shape: tuple[int, int]) -> np.ndarray:
    """(n, 3): directions of the middles of cells."""
    return find_middles(shape).astype(float)


def sky(half_angle_rad: float, radiance: tuple[float, float, float] = (1e4, 8e3, 5e3), toward=TOWARD, height: int = HEIGHT) -> np.ndarray:
    """A blue sky that is brighter above, with an even disk in it; cells that its rim cuts have a part of it."""
    shape = (height * FINE, 2 * height * FINE)
    direction = place_fine(shape)
    rgb = (1.5 + direction[:, 2:]) * np.array([0.2, 0.3, 0.5])
    rgb[direction @ toward > math.cos(half_angle_rad)] += radiance
    rgb *= np.repeat(find_solid_angles(*shape), shape[1])[:, None]
    power = rgb.reshape(height, FINE, 2 * height, FINE, 3).sum(axis=(1, 3))
    return (power / find_solid_angles(height, 2 * height)[:, None, None]).astype(np.float32)


def flux(world_map: np.ndarray) -> np.ndarray:
    """(3,): radiance times solid angle of all cells."""
    return (world_map * find_solid_angles(*world_map.shape[:2])[:, None, None]).sum(axis=(0, 1), dtype=float)


@pytest.mark.parametrize(
    "toward", [TOWARD, np.array([-1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])], ids=["aside", "at the seam", "at the pole"]
)
def test_a_bright_disk_becomes_a_sun_of_its_size(toward):
    half = math.radians(1.5)
    before = sky(half, toward=toward)
    rest, (sun,) = take_suns_out(before)
    assert sun.kind == "SUN"
    assert sun.rotation[2] == pytest.approx(toward, abs=1e-3)
    assert sun.angle_rad == pytest.approx(2 * half, rel=0.15)  # two cells to its radius
    assert flux(rest) + np.array(sun.power_rgb) == pytest.approx(flux(before), rel=5e-3)
    assert rest.max() < 2  # as around it
    assert np.array(sun.power_rgb) == pytest.approx(flux(before) - flux(sky(half, (0.0, 0.0, 0.0))), rel=5e-3)


def test_a_closer_look_tells_the_size_of_one_smaller_than_a_cell():
    half = math.radians(0.27)
    seen = []

    def look_closer(direction, half_angle_rad):
        seen.append(half_angle_rad)
        step = 2 * math.tan(half_angle_rad) / 200
        y, x = (grid.ravel() for grid in (np.mgrid[0:200, 0:200] + 0.5) * step - math.tan(half_angle_rad))
        tangent, bitangent = (axis[0] for axis in orthonormal_basis(direction[None]))
        toward = direction + x[:, None] * tangent + y[:, None] * bitangent
        length = np.linalg.norm(toward, axis=1)
        toward /= length[:, None]
        inside = toward @ TOWARD > math.cos(half)
        return Spot(toward, step**2 / length**3, np.where(inside[:, None], (1e5, 8e4, 5e4), (0.4, 0.6, 1.0)), step)

    _, (sun,) = take_suns_out(sky(half, (1e5, 8e4, 5e4)), look_closer)
    assert len(seen) == 1
    assert sun.rotation[2] == pytest.approx(TOWARD, abs=1e-4)
    assert sun.angle_rad == pytest.approx(2 * half, rel=0.01)
    assert np.array(sun.power_rgb) == pytest.approx(math.pi * math.sin(half) ** 2 * np.array([1e5, 8e4, 5e4]), rel=0.01)


@pytest.mark.parametrize(
    ("half_angle_rad", "radiance"), [(math.radians(20), (50.0, 50.0, 50.0)), (math.radians(1.0), (5.0, 5.0, 5.0))], ids=["wide", "weak"]
)
def test_what_is_wide_or_weak_stays(half_angle_rad, radiance):
    before = sky(half_angle_rad, radiance)
    rest, suns = take_suns_out(before)
    assert suns == ()
    assert np.array_equal(rest, before)


def test_two_suns():
    before = np.maximum(sky(math.radians(1.0)), sky(math.radians(1.5), (5e3, 5e3, 9e3), np.array([0.0, 0.6, 0.8])))
    rest, suns = take_suns_out(before)
    assert len(suns) == 2
    assert len({sun.name for sun in suns}) == 2
    assert flux(rest) + sum(np.array(sun.power_rgb) for sun in suns) == pytest.approx(flux(before), rel=5e-3)


def test_a_black_map_has_none():
    assert take_suns_out(np.zeros((8, 16, 3), np.float32))[1] == ()
