"""Environment maps: sampled as their pdf says, the light of known skies, and suns taken out of them."""

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from floors import assert_photons_agree, chi_square_sigmas, floor_tiles, light_floor, lit_scene, sigma_limit, trace_first
from leaflight.core.integrate.direct import DirectLight
from leaflight.core.lights.emitters import NO_LIGHT
from leaflight.core.lights.environment import Environment, EnvironmentTable
from leaflight.core.lights.environment_suns import Spot, take_suns_out
from leaflight.core.scene.scene import SceneSnapshot
from leaflight.core.util.brightness import weigh_channels
from leaflight.core.util.geometry import orthonormal_basis
from leaflight.core.util.sampling import square_to_uniform_cone
from leaflight.core.util.sphere_map import CellTable, find_cells, find_middles, find_solid_angles
from scenes import box_mesh

# An environment map: sampled as its pdf says, and the light of known skies by shadow rays and by photons.
SIDE = 32
LIMIT = sigma_limit(12)
BLOCK = box_mesh("Block", (0.3, 0.3, 0.2), (0.5, 0.5, 0.4))


def middles(height: int, width: int) -> np.ndarray:
    """(height * width, 3): directions to the cells' middles."""
    return find_middles((height, width))


def make_map(height: int, width: int, function) -> np.ndarray:
    values = np.asarray(function(middles(height, width).astype(float)))
    return np.broadcast_to(values.reshape(height, width, -1), (height, width, 3)).astype(np.float32)


def bumpy(height: int = 24, width: int = 50) -> np.ndarray:
    """A bright lobe over a coloured gradient; a tenth of the cells black."""
    rng = np.random.default_rng(4)
    toward = middles(height, width).astype(float)
    lobe = np.exp(20 * (toward @ np.array([0.48, -0.6, 0.64]) - 1))
    rgb = (1 + toward[:, 2:]) * np.array([0.2, 0.4, 0.7]) + lobe[:, None] * np.array([6.0, 5.0, 2.0])
    rgb[rng.random(len(rgb)) < 0.1] = 0
    return rgb.reshape(height, width, 3).astype(np.float32)


def under(world_map: np.ndarray, *others) -> SceneSnapshot:
    return replace(lit_scene(others), world_map=world_map)


def light_up(scene: SceneSnapshot) -> DirectLight:
    return light_floor(scene, SIDE, tiles=floor_tiles(SIDE))


class TestTable:
    def test_directions_come_as_the_pdf_says(self):
        shape, bins = (24, 50), (6, 10)
        table = CellTable(Environment(bumpy(*shape)).cell_power)
        toward, cell, chance = table.sample(np.random.default_rng(2).random((400_000, 2)))
        assert (find_cells(shape, toward) == cell).mean() > 0.9999  # rounding at edges
        dense = square_to_uniform_cone(np.random.default_rng(3).random((400_000, 2)), math.pi)
        expected = np.bincount(find_cells(bins, dense), table.pdf(dense), math.prod(bins)) * 4 * math.pi
        observed = np.bincount(find_cells(bins, toward), minlength=math.prod(bins))
        assert expected.sum() == pytest.approx(400_000, rel=0.01)
        assert observed / 400_000 == pytest.approx(expected / 400_000, rel=0.05, abs=8e-4)
        weights = np.bincount(cell, minlength=math.prod(shape)).astype(float)
        lit = table.weight.ravel() > 0
        assert weights[~lit].sum() == 0
        assert chi_square_sigmas(weights[lit], table.weight.ravel()[lit] / table.weight.sum() * len(cell)) < LIMIT
        np.testing.assert_allclose(chance, table.weight.ravel()[cell] / table.weight.sum(), rtol=1e-6)

    def test_places_in_a_cell_are_uniform(self):
        toward, _, _ = CellTable(np.ones((2, 1))).sample(np.random.default_rng(5).random((100_000, 2)))
        assert toward.mean(axis=0) == pytest.approx(0, abs=LIMIT * math.sqrt(1 / 3 / 100_000))
        assert (toward**2).mean(axis=0) == pytest.approx(1 / 3, rel=0.01)


class TestShadowRayTable:
    def test_irradiance_by_normal(self):
        world_map = bumpy()
        table = EnvironmentTable.of(Environment(world_map))
        normal = square_to_uniform_cone(np.random.default_rng(6).random((50, 2)), math.pi)
        fine = np.repeat(np.repeat(world_map, 8, axis=0), 8, axis=1)
        solid_angle = np.repeat(find_solid_angles(*fine.shape[:2]), fine.shape[1])
        expected = np.maximum(normal @ middles(*fine.shape[:2]).T.astype(float), 0) @ (fine.reshape(-1, 3) * solid_angle[:, None])
        assert table.find_irradiance(normal) == pytest.approx(expected, rel=5e-3, abs=2e-3 * expected.max())

    def test_directions_come_as_the_pdf_says(self):
        """The mean of f / pdf is the integral of f."""
        table = EnvironmentTable.of(Environment(bumpy()))
        rng = np.random.default_rng(7)
        chance = table.rate_by_normals(np.array([[[0.6, 0.0, 0.8]]]))[0] + 0.05 * table.power
        chance /= chance.sum()
        patch = rng.choice(len(chance), 200_000, p=chance)
        toward, _, density = table.choose(patch, rng.random((200_000, 2)))
        values = weigh_channels(table.environment.look_up(toward)) * np.maximum(toward[:, 2], 0) / (chance[patch] * density)
        expected = weigh_channels(table.find_irradiance(np.array([[0.0, 0.0, 1.0]])))[0]
        assert values.mean() == pytest.approx(expected, rel=1e-3, abs=LIMIT * values.std() / math.sqrt(200_000))


class TestKnownSkies:
    def test_a_constant_map_is_a_uniform_sky(self):
        rgb = (1.0, 0.5, 0.25)
        found = light_up(under(make_map(16, 32, lambda d: np.broadcast_to(rgb, d.shape)))).irradiance_rgb
        np.testing.assert_allclose(found, math.pi * np.broadcast_to(rgb, found.shape), rtol=5e-3, atol=1e-12)
        assert found.mean(axis=0) == pytest.approx(math.pi * np.array(rgb), rel=1e-3)

    def test_brighter_overhead(self):
        """L = max(0, cos theta): the integral of cos^2 over the hemisphere is 2 pi / 3."""
        found = light_up(under(make_map(256, 512, lambda d: np.maximum(d[:, 2], 0)))).irradiance_rgb
        assert found.mean() == pytest.approx(2 * math.pi / 3, rel=1e-3)
        assert found == pytest.approx(2 * math.pi / 3, rel=0.01)

    def test_what_lies_below_the_horizon_lights_nothing_from_above(self):
        assert light_up(under(make_map(16, 32, lambda d: d[:, 2] < 0))).irradiance_rgb.max() < 1e-3

    def test_a_black_map_is_no_light(self):
        with pytest.raises(ValueError, match=NO_LIGHT):
            trace_first(under(np.zeros((4, 8, 3), np.float32)), 10)

    def test_what_is_not_a_radiance_counts_as_none(self):
        bad = np.ones((4, 8, 3), np.float32)
        bad[3] = (np.nan, np.inf, -1)
        good = np.where(np.arange(4)[:, None, None] == 3, np.float32(0), np.float32(1)) * np.ones((4, 8, 3), np.float32)
        found, expected = (light_up(under(world)).irradiance_rgb for world in (bad, good))
        np.testing.assert_allclose(found, expected, rtol=0.02, atol=1e-12)


@pytest.mark.parametrize("shape", [(24, 50), (1, 1)])
def test_photons_say_the_same(shape):
    scene = under(bumpy(*shape), BLOCK)
    assert_photons_agree(scene, light_up(scene), SIDE, 2, n_photon=400_000)


# Suns taken out of environment maps: where they were, as bright, as large; and what is no sun stays.
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
