"""Photon birth of every light kind: powers by thought, and irradiance counted on patches against closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest
from floors import Patch, chi_square_sigmas, sigma_limit
from leaflight.core.lights.lights import (
    SpotCone,
    make_light_emitter,
    sample_spot_drop,
    sample_spread_angle,
    spot_attenuation,
    spread_attenuation,
)
from leaflight.core.scene.scene import Light
from leaflight.core.scene.scene_cover import SceneCover
from leaflight.core.util.geometry import UnitBox
from scenes import box_mesh

UNIT_BOX = UnitBox(np.array([1.0, 2.0, 3.0]), 0.25)  # 4 m wide
COVER = SceneCover.around(UNIT_BOX.to_unit(box_mesh(size_m=(4, 3, 2), centre_m=(1, 2, 3)).vertex))
N_STATISTICS = 40
LIMIT = sigma_limit(N_STATISTICS)
N_PHOTON = 400_000
TILT = 0.4
# Rows: the light's axes, turned about x, so that -z is not an axis of the world.
AXES = ((1.0, 0.0, 0.0), (0.0, math.cos(TILT), math.sin(TILT)), (0.0, -math.sin(TILT), math.cos(TILT)))
DOWN = -np.array(AXES[2])


def unit_place(metres_along: float, sideways: float = 0.0) -> np.ndarray:
    """A place in front of a light that stands at the centre of the unit box, unit box."""
    return (DOWN * metres_along + np.array([sideways, 0, 0])) * UNIT_BOX.scale


class LightContract:
    """What holds for every kind; subclasses give the light, its power in W, and irradiance at a patch."""

    light: Light
    power_w: float
    patch = Patch(unit_place(1.5), AXES[2], 0.25)

    def emitter(self):
        return make_light_emitter(self.light, np.array(self.light.power_rgb), UNIT_BOX, COVER)

    def irradiance(self, position: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """W/m^2 of the red channel, by a formula of the test's own."""
        raise NotImplementedError

    def test_power_is_what_the_light_emits(self):
        assert self.emitter().power_rgb == pytest.approx(np.array(self.light.power_rgb) * self.power_w, rel=1e-4)

    def test_births_are_finite_unit_and_of_mean_one(self):
        births = self.emitter().emit(np.random.default_rng(1).random((N_PHOTON, 4), np.float32))
        assert births.origin.dtype == births.direction.dtype == births.relative_rgb.dtype == births.soft_radius.dtype == np.float32
        assert births.origin.shape == births.direction.shape == (N_PHOTON, 3)
        assert births.soft_radius.shape == births.soft_offset.shape == (N_PHOTON,)
        assert np.isfinite(births.origin).all()
        assert np.abs(np.linalg.norm(births.direction, axis=1) - 1).max() < 1e-5
        assert births.relative_rgb.min() >= 0
        spread = births.relative_rgb.std() / math.sqrt(N_PHOTON)
        assert abs(births.relative_rgb.mean(dtype=np.float64) - 1) <= LIMIT * spread + 1e-5

    def test_counted_irradiance(self):
        counted, error = self.patch.count(self.emitter(), N_PHOTON, 2, UNIT_BOX.scale)
        expected = self.patch.mean(self.irradiance)
        assert error[0] < 0.02 * expected, "the patch sees too few photons to tell"
        assert abs(counted[0] - expected) < LIMIT * error[0]
        assert abs(1.12 * counted[0] - expected) > LIMIT * 1.12 * error[0], "a wrong light would be seen"


def from_point(position: np.ndarray, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distance^2 in m^2, the receiver's cosine, and the cosine to the light's axis, of a light at the unit box's centre."""
    square = (position**2).sum(axis=1)
    direction = position / np.sqrt(square)[:, None]
    return square / UNIT_BOX.scale**2, -(direction * normal).sum(axis=1), direction @ DOWN


class TestPoint(LightContract):
    light = Light("POINT", "P", position_m=(1, 2, 3), rotation=AXES, power_rgb=(8.0, 4.0, 0.0))
    power_w = 1.0

    def irradiance(self, position, normal):
        square, cosine, _ = from_point(position, normal)
        return 8 / (4 * math.pi) * cosine / square


class TestSoftPoint(TestPoint):
    light = replace(TestPoint.light, radius_m=0.8)

    def irradiance(self, position, normal):
        square, cosine, _ = from_point(position, normal)
        return 8 / (4 * math.pi) * cosine / (square + 0.8**2)

    def test_within_the_radius_too(self):
        patch = Patch(unit_place(0.4), AXES[2], 0.03)
        counted, error = patch.count(self.emitter(), N_PHOTON, 3, UNIT_BOX.scale)
        assert error[0] < 0.05 * counted[0]
        assert abs(counted[0] - 8 / (4 * math.pi) / (0.4**2 + 0.8**2)) < LIMIT * error[0]


class TestSpherePoint(TestPoint):
    light = replace(TestPoint.light, radius_m=0.8, soft_falloff=False)

    def test_photons_start_on_the_sphere_and_leave_it(self):
        births = self.emitter().emit(np.random.default_rng(1).random((1000, 4), np.float32))
        assert np.linalg.norm(births.origin, axis=1) == pytest.approx(0.8 * UNIT_BOX.scale, rel=1e-5)
        assert ((births.origin * births.direction).sum(axis=1) >= -1e-7).all()


class TestHardSpot(LightContract):
    light = Light("SPOT", "S", position_m=(1, 2, 3), rotation=AXES, power_rgb=(8.0, 4.0, 0.0), cone_angle_rad=1.0)
    power_w = (1 - math.cos(0.5)) / 2  # the cone's share of the sphere

    def attenuation(self, cosine):
        return cosine > math.cos(0.5)

    def irradiance(self, position, normal):
        square, cosine, axis = from_point(position, normal)
        return 8 / (4 * math.pi) * cosine / square * self.attenuation(axis)

    def test_nothing_is_born_outside_the_cone(self):
        births = self.emitter().emit(np.random.default_rng(1).random((100_000, 4), np.float32))
        assert (births.direction @ DOWN).min() > math.cos(0.5) - 1e-6


class TestBlendedSpot(TestHardSpot):
    light = replace(TestHardSpot.light, blend=0.7)
    power_w = (1 - math.cos(0.5)) * (1 - 0.7 / 2) / 2  # smoothstep is half of its width
    patch = Patch(unit_place(1.5, 0.45), AXES[2], 0.1)  # in the rim

    def attenuation(self, cosine):
        t = np.clip((cosine - math.cos(0.5)) / ((1 - math.cos(0.5)) * 0.7), 0, 1)  # Cycles: spot_smooth
        return t * t * (3 - 2 * t)


class TestSphereSpot(TestHardSpot):
    """Inside the cone by more than the sphere is wide, a sphere shines as its centre does."""

    light = replace(TestHardSpot.light, radius_m=0.1, soft_falloff=False)
    patch = Patch(unit_place(1.5), AXES[2], 0.1)


class TestSun(LightContract):
    light = Light("SUN", "Sun", rotation=AXES, power_rgb=(3.0, 2.0, 0.0))
    # The outline of a 4 x 3 x 2 m box with the cover's padding of 4 mm, seen along DOWN, which has no x.
    power_w = 4.008 * (2.008 * math.sin(TILT) + 3.008 * math.cos(TILT))
    patch = Patch((0, 0, 0), (0, 0, 1), 0.4)

    def irradiance(self, position, normal):
        return np.full(len(position), 3 * math.cos(TILT))

    def test_every_ray_enters_the_box(self):
        births = self.emitter().emit(np.random.default_rng(1).random((10_000, 4), np.float32))
        inner = births.origin + 1e-4 * births.direction
        assert ((inner > COVER.low) & (inner < COVER.high)).all(axis=1).mean() > 0.99


class TestSunDisk(TestSun):
    light = replace(TestSun.light, angle_rad=0.8)

    @property
    def power_w(self):
        """Radiance E / (pi sin^2 h) times the outline, integrated over the disk on a grid."""
        cosine = 1 - (1 - math.cos(0.4)) * (np.arange(400) + 0.5)[:, None] / 400
        phi = 2 * math.pi * (np.arange(400) + 0.5) / 400
        sine = np.sqrt(1 - cosine**2)
        local = np.stack([sine * np.cos(phi), sine * np.sin(phi), cosine + 0 * phi], axis=-1)
        direction = local @ np.array(AXES)
        outline = np.abs(direction) @ np.array([3.008 * 2.008, 4.008 * 2.008, 4.008 * 3.008])
        return outline.mean() * 2 * math.pi * (1 - math.cos(0.4)) / (math.pi * math.sin(0.4) ** 2)


class TestArea(LightContract):
    light = Light("AREA", "A", position_m=(1, 2, 3), rotation=AXES, power_rgb=(8.0, 4.0, 0.0), size_m=(0.8, 0.5))
    power_w = 1.0
    area_m2 = 0.8 * 0.5

    def inside(self, x, y):
        return (np.abs(x) < 0.4) & (np.abs(y) < 0.25)

    def attenuation(self, cosine):
        return 1.0

    def irradiance(self, position, normal):
        """The sum over a grid of points of the light."""
        line = (np.arange(30) + 0.5) / 30 - 0.5
        x, y = (grid.ravel() for grid in np.meshgrid(0.8 * line, 0.5 * line))
        keep = self.inside(x, y)
        source = (x[keep, None] * np.array(AXES[0]) + y[keep, None] * np.array(AXES[1]))[:, None] * UNIT_BOX.scale
        to_light = source - position
        square = (to_light**2).sum(axis=2)
        light_cosine = np.maximum(-(to_light @ DOWN) / np.sqrt(square), 0)
        cosines = (to_light * normal).sum(axis=2) / np.sqrt(square) * light_cosine
        radiance = 8 / (math.pi * self.area_m2) * self.attenuation(light_cosine)
        return (radiance * cosines / square).mean(axis=0) * self.area_m2 * UNIT_BOX.scale**2

    def test_nothing_goes_backwards(self):
        births = self.emitter().emit(np.random.default_rng(1).random((100_000, 4), np.float32))
        assert (births.direction @ DOWN).min() > 0


class TestEllipse(TestArea):
    light = replace(TestArea.light, shape="ELLIPSE")
    area_m2 = math.pi / 4 * 0.8 * 0.5

    def inside(self, x, y):
        return (x / 0.4) ** 2 + (y / 0.25) ** 2 < 1


class TestSpreadArea(TestArea):
    light = replace(TestArea.light, spread_rad=1.4)
    patch = Patch(unit_place(1.5, 0.4), AXES[2], 0.2)

    def attenuation(self, cosine):
        return np.maximum(math.tan(0.7) - np.tan(np.arccos(cosine)), 0) / (math.tan(0.7) - 0.7)  # Cycles: normalize_spread


def hold_angles(hold, values, greatest, find_density):
    """The histogram of values up to the greatest; and a density that is tilted by 3 % either way is seen."""
    counts, _ = np.histogram(values, bins=40, range=(0, greatest))
    density = find_density((np.arange(40 * 200) + 0.5) * greatest / 8000).reshape(40, 200).sum(axis=1)
    used = density > 1e-3 * density.max()
    counts, expected, tilt = counts[used], (N_PHOTON * density / density.sum())[used], np.linspace(0.97, 1.03, 40)[used]
    name = "angles of spots and spreads: chi-square"
    hold(f"{name} against the attenuation", abs(chi_square_sigmas(counts, expected)), high=LIMIT, unit="sigmas")
    hold(f"{name} with one that is 3 % off", chi_square_sigmas(counts, expected * tilt), low=LIMIT, unit="sigmas")


@pytest.mark.parametrize("blend", [0.0, 0.3, 1.0])
def test_spot_angles_follow_the_attenuation(blend, hold):
    cone = SpotCone(0.4, blend)
    u = np.random.default_rng(4).random(N_PHOTON)
    found = sample_spot_drop(u, cone.drop, cone.blend)
    hold_angles(hold, found, 0.4, lambda drop: spot_attenuation(1 - drop, cone.drop, cone.blend))


@pytest.mark.parametrize("spread", [0.01, 1.0, 3.0])
def test_spread_angles_follow_the_attenuation(spread, hold):
    theta = sample_spread_angle(np.random.default_rng(5).random(N_PHOTON), spread)
    hold_angles(hold, theta, spread / 2, lambda angle: spread_attenuation(np.cos(angle), spread) * np.cos(angle) * np.sin(angle))


def test_light_without_size_still_shines_its_power():
    light = replace(TestArea.light, size_m=(0.0, 0.0))
    emitter = make_light_emitter(light, np.array(light.power_rgb), UNIT_BOX, COVER)
    assert emitter.power_rgb == pytest.approx(light.power_rgb)
    assert np.isfinite(emitter.emit(np.random.default_rng(1).random((100, 4), np.float32)).origin).all()
