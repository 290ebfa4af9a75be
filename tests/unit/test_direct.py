"""Direct irradiance of a floor: closed forms, shadows with a known outline, photons as a second opinion, honest errors."""

import math
from dataclasses import replace

import numpy as np
import pytest
from floors import assert_photons_agree, floor_footprints, floor_tiles, light_floor, lit_scene, prepare, to_grid, trace_first
from leaflight.core.integrate.direct import DirectLight, direct_irradiance
from leaflight.core.lights.irradiance import polygon_irradiance
from leaflight.core.scene.scene import Light, SceneSnapshot
from scenes import box_mesh, moved, quad_mesh

SIDE = 32
PLACE = (np.arange(SIDE) + 0.5) / SIDE  # m, texel centres along an edge of the floor
BLOCK = box_mesh("Block", (0.3, 0.3, 0.2), (0.5, 0.5, 0.4))
PANEL = Light("AREA", "Panel", position_m=(0.5, 0.5, 1.0), size_m=(0.4, 0.4), power_rgb=(2.0, 1.0, 0.0))
BULB = Light("POINT", "Bulb", position_m=(0.4, 0.6, 0.8), power_rgb=(4.0, 2.0, 0.0))
SUN = Light("SUN", "Sun", power_rgb=(3.0, 2.0, 0.0))


def red(light: DirectLight, side: int = SIDE) -> np.ndarray:
    """(side, side) of the red channel, row 0 at y = 0."""
    return to_grid(light.irradiance_rgb[:, 0], side)


def from_panel(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    corners = np.array([[0.3, 0.3, 1.0], [0.3, 0.7, 1.0], [0.7, 0.7, 1.0], [0.7, 0.3, 1.0]])
    position = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    radiance = 2.0 / (math.pi * 0.16)
    return radiance * polygon_irradiance(corners, position, np.tile([0.0, 0.0, 1.0], (x.size, 1))).reshape(x.shape)


class TestShadows:
    def test_sun_under_a_block(self):
        """Shadow from 0.35 to 0.65 m: its edges cut texels at 0.2 and 0.8 of their width, which the sub-points find."""
        found = red(light_floor(lit_scene([BLOCK], [SUN]), SIDE)) / 3
        inside = np.clip(np.minimum(PLACE + 0.5 / SIDE, 0.65) - np.maximum(PLACE - 0.5 / SIDE, 0.35), 0, None) * SIDE
        expected = 1 - inside[None, :] * inside[:, None]
        assert found == pytest.approx(expected, abs=0.05)
        assert found.mean() == pytest.approx(1 - 0.09, abs=5e-4)

    @pytest.mark.parametrize("light", [SUN, BULB, PANEL, replace(BULB, radius_m=0.05, soft_falloff=False)])
    def test_under_a_roof_it_is_dark(self, light):
        roof = moved(quad_mesh("Roof", 20, 20), (-9.5, -9.5, 0.1))
        assert not light_floor(lit_scene([roof], [light]), SIDE).irradiance_rgb.any()

    def test_a_panel_in_the_plane_of_the_ceiling(self):
        ceiling = moved(quad_mesh("Ceiling", 3, 3), (-1, -1, 1.0))
        found = red(light_floor(lit_scene([ceiling], [PANEL]), SIDE))
        assert found == pytest.approx(from_panel(*np.meshgrid(PLACE, PLACE)), rel=2e-3)

    def test_few_rays_where_they_agree(self):
        found = light_floor(lit_scene([box_mesh("Block", (0.1, 0.1, 0.02), (0.1, 0.1, 0.05))], [PANEL]), 64)
        assert found.counters["pairs"] == 64 * 64
        assert found.counters["settled"] > 0.8 * 64 * 64
        assert found.counters["rays"] < 12 * 64 * 64


class TestSides:
    def facing_down(self, two_sided: bool) -> SceneSnapshot:
        """The floor seen from below by a light under it."""
        scene = lit_scene(lights=[replace(BULB, position_m=(0.4, 0.6, -0.8)), replace(SUN, power_rgb=(1.0, 0.0, 0.0))])
        return replace(scene, objects=(replace(scene.objects[0], two_sided=two_sided),))

    def test_only_the_front_is_lit(self):
        found = light_floor(self.facing_down(False), SIDE)
        assert red(found) == pytest.approx(1, rel=1e-6)
        assert found.counters["out_of_reach"] == SIDE**2

    def test_two_sided_objects_sum_both(self):
        square = (PLACE[None, :] - 0.4) ** 2 + (PLACE[:, None] - 0.6) ** 2 + 0.64
        expected = 1 + 4 / (4 * math.pi) * 0.8 / square**1.5
        assert red(light_floor(self.facing_down(True), SIDE)) == pytest.approx(expected, rel=2e-3)


SECOND_OPINIONS = {
    "panel": lit_scene([BLOCK], [PANEL]),
    "ellipse": lit_scene([BLOCK], [replace(PANEL, shape="ELLIPSE", size_m=(0.6, 0.3))]),
    "sphere": lit_scene([BLOCK], [replace(BULB, radius_m=0.1, soft_falloff=False)]),
    "spot": lit_scene([BLOCK], [replace(BULB, kind="SPOT", cone_angle_rad=1.2, blend=0.5)]),
    "sun": lit_scene([BLOCK], [replace(SUN, angle_rad=0.3)]),
    "lamp": lit_scene([BLOCK], emission=[box_mesh("Lamp", (0.2, 0.2, 0.05), (0.4, 0.5, 0.9))], rgb=(5.0, 2.0, 0.0)),
    "world": replace(lit_scene([BLOCK]), world_rgb=(1.0, 0.5, 0.0)),
    "panel without shadow": lit_scene([BLOCK], [replace(PANEL, casts_shadow=False)]),
    "panel whose shadow the block does not cast": lit_scene([BLOCK], [replace(PANEL, blocked_by=(0,)), BULB]),
    "panel that lights the block alone": lit_scene([BLOCK], [replace(PANEL, lights=(1,)), BULB]),
    "sun whose shadow one of two blocks casts": lit_scene(
        [BLOCK, moved(BLOCK, (0.3, 0.3, 0.0))], [replace(SUN, angle_rad=0.1, lights=(0, 2), blocked_by=(0, 1))]
    ),
    "bulb that diffuse rays do not see": lit_scene([BLOCK], [replace(BULB, seen_by=(False, True, True)), PANEL]),
    "soft bulb without shadow": lit_scene([BLOCK], [replace(BULB, radius_m=0.1, casts_shadow=False)]),
}


# Nearer to a surface than their own radius; Cycles gives the same.
WALL = box_mesh("Wall", (0.2, 3.0, 3.0), (0.36, 0.5, 1.3))  # its face is 4 cm from the lamp's middle
DISK = Light("POINT", "Lamp", (0.5, 0.5, 0.04), power_rgb=(10.0, 10.0, 10.0), radius_m=0.2)
SPHERE = replace(DISK, soft_falloff=False)
NEAR_SURFACES = {
    "a disk through the floor": lit_scene([], [DISK]),
    "a disk near the floor": lit_scene([], [replace(DISK, position_m=(0.5, 0.5, 0.25))]),
    "a disk through a wall": lit_scene([WALL], [replace(DISK, position_m=(0.5, 0.5, 0.5))]),
    "a sphere through the floor": lit_scene([], [SPHERE]),
    "a sphere near the floor": lit_scene([], [replace(SPHERE, position_m=(0.5, 0.5, 0.25))]),
    "a sphere through a wall": lit_scene([WALL], [replace(SPHERE, position_m=(0.5, 0.5, 0.5))]),
    "a disk without shadow": lit_scene([], [replace(DISK, casts_shadow=False)]),
}
N_OPINION = len(SECOND_OPINIONS) + len(NEAR_SURFACES)


@pytest.mark.parametrize("name", SECOND_OPINIONS)
def test_photons_say_the_same(name):
    scene = SECOND_OPINIONS[name]
    assert_photons_agree(scene, light_floor(scene, SIDE), SIDE, N_OPINION)


@pytest.mark.parametrize("name", NEAR_SURFACES)
def test_photons_say_the_same_near_surfaces(name):
    scene = NEAR_SURFACES[name]
    light = light_floor(scene, SIDE, tolerance=0.002, tiles=floor_tiles(SIDE))
    assert_photons_agree(scene, light, SIDE, N_OPINION, parts=4, n_photon=150_000)


def test_a_lamp_in_the_open_needs_no_more_rays():
    """Only a lamp that a surface cuts into pays for the look behind its photons."""
    few, many = (replace(DISK, position_m=(0.5, 0.5, 0.5), radius_m=radius_m) for radius_m in (0.0, 0.2))
    assert len({trace_first(lit_scene([], [lamp]), 1000)[0].counters.rays for lamp in (few, many)}) == 1


@pytest.mark.parametrize("light", [PANEL, replace(SUN, angle_rad=0.3), BULB])
def test_errors_are_honest(light):
    runs = [light_floor(lit_scene([BLOCK], [light]), SIDE, seed=seed) for seed in range(12)]
    true = np.var([run.irradiance_rgb[:, 0] for run in runs], axis=0, ddof=1).mean()
    stated = np.mean([run.variance_rgb[:, 0].mean() for run in runs])
    assert 0.3 < true / stated < 1.8
    assert runs[0].variance_rgb[:, 0] == pytest.approx(runs[0].variance_rgb[:, 1] * (light.power_rgb[0] / light.power_rgb[1]) ** 2)


def test_no_texels_and_no_lights():
    scene, _, _ = prepare(lit_scene())
    assert direct_irradiance(scene, floor_footprints(2), np.arange(0), np.random.default_rng(1)).irradiance_rgb.shape == (0, 3)
    assert not direct_irradiance(scene, floor_footprints(2), np.arange(4), np.random.default_rng(1)).irradiance_rgb.any()
