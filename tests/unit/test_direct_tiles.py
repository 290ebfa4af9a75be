"""First looks that texels of a tile share: found where tiles are whole, right where they are believed, blind to no shadow of a texel."""

import math
from dataclasses import replace

import numpy as np
import pytest
from floors import floor_footprints, floor_tiles, lit_scene, morton_square, prepare, to_grid
from leaflight.core.integrate.direct import DirectLight, direct_irradiance
from leaflight.core.integrate.direct_tiles import sample_tiles
from leaflight.core.lights.direct_lights import make_lamps
from leaflight.core.lights.direct_points import TexelChunk
from leaflight.core.scene.scene import Light, SceneSnapshot
from leaflight.core.texels.tiles import Tiles
from leaflight.core.util.geometry import UnitBox
from scenes import box_mesh, quad_mesh

SIDE = 64
SUN = Light("SUN", "Sun", power_rgb=(1.0, 1.0, 1.0))
PANEL = Light("AREA", "Panel", position_m=(0.5, 0.5, 4.0), size_m=(1.0, 1.0), power_rgb=(2.0, 1.0, 0.0))
BULB = Light("POINT", "Bulb", position_m=(0.3, 0.4, 4.0), power_rgb=(4.0, 2.0, 0.0))
SPOT = replace(BULB, kind="SPOT", cone_angle_rad=0.15, blend=0.3)


def light_floor(scene: SceneSnapshot, side: int = SIDE, seed: int = 1, tiles: Tiles | None = None, **options: float) -> DirectLight:
    rng = np.random.default_rng(seed)
    tiles = floor_tiles(side) if tiles is None else tiles
    return direct_irradiance(prepare(scene)[0], floor_footprints(side), np.arange(side * side), rng, tiles=tiles, **options)


def wire(width: float, angle_rad: float, shift: float) -> SceneSnapshot:
    """A sun above a strip over the middle of the floor; lengths in metres."""
    strip = quad_mesh("Wire", 4.0, width)
    along = np.array([math.cos(angle_rad), math.sin(angle_rad), 0.0])
    across = np.array([-along[1], along[0], 0.0])
    local = strip.vertex - np.array([2.0, width / 2, 0.0])
    vertex = np.array([0.5, 0.5, 0.2]) + local[:, :1] * along + (local[:, 1:2] + shift) * across
    return lit_scene([replace(strip, vertex=vertex)], [SUN])


class TestClosedForms:
    @pytest.mark.parametrize("light", [PANEL, BULB, replace(BULB, radius_m=0.3), replace(PANEL, shape="ELLIPSE"), SUN])
    def test_tiles_tell_what_each_texel_would(self, light):
        found = light_floor(lit_scene(lights=[light]))
        alone = light_floor(lit_scene(lights=[light]), tiles=Tiles.none())
        np.testing.assert_allclose(found.irradiance_rgb, alone.irradiance_rgb, rtol=2e-3, atol=1e-12)
        diagonal = SIDE * 8  # texels of tiles that both triangles share
        assert found.counters["shared"] == found.counters["pairs"] - diagonal
        assert found.counters["rays"] == SIDE**2 + 3 * diagonal

    def test_what_they_may_be_off_by_is_told(self):
        """Where all of the light is seen, and no ray tells of any noise."""
        scene = lit_scene(lights=[replace(PANEL, position_m=(0.5, 0.5, 0.5))])
        found, exact = light_floor(scene), light_floor(scene, tiles=Tiles.none()).irradiance_rgb
        told = found.variance_rgb[:, 0] > 0
        assert told[floor_tiles(SIDE).texels()].mean() > 0.8
        off = (found.irradiance_rgb - exact)[told, 0]
        assert 0.2 < np.sqrt((off**2).mean() / found.variance_rgb[told, 0].mean()) < 2.0

    def test_near_a_light_they_tell_nothing(self):
        near = replace(BULB, position_m=(0.3, 0.4, 0.02))
        scene, box = lit_scene(lights=[near]), UnitBox.from_points(lit_scene().vertex_position)
        prepared = prepare(scene)[0]
        chunk = TexelChunk(floor_footprints(SIDE)(np.arange(SIDE**2)), np.zeros((SIDE**2, 2), np.uint32), prepared.surfaces, False)
        tiles = floor_tiles(SIDE)
        look = sample_tiles(prepared.rays, chunk, tiles, make_lamps(scene.lights, box, ())[0], np.zeros((len(tiles), 2), np.uint32))
        column, row = morton_square(SIDE)
        distance = np.hypot(column / SIDE - 0.3, row / SIDE - 0.4)
        assert np.isnan(look.closed[distance < 0.2]).all()
        found = light_floor(scene)
        np.testing.assert_allclose(found.irradiance_rgb, light_floor(scene, tiles=Tiles.none()).irradiance_rgb, rtol=5e-3, atol=1e-12)

    def test_behind_a_light_there_is_no_ray(self):
        found = light_floor(lit_scene(lights=[replace(PANEL, position_m=(0.5, 0.5, -4.0))]))
        assert not found.irradiance_rgb.any()
        assert found.counters["rays"] == 0
        assert found.counters["out_of_reach"] == found.counters["pairs"] == SIDE**2


class TestShadows:
    @pytest.mark.parametrize("angle_rad", [0.0, 0.1, 0.7854, 1.2])
    @pytest.mark.parametrize("shift", [0.0, 0.25])
    def test_of_a_wire_one_texel_wide(self, angle_rad, shift):
        """No texel across is missed, and on average no shadow; shift in texels."""
        side, width = 128, 1 / 128
        scene = wire(width, angle_rad, shift / side)
        dark = sum(1 - to_grid(light_floor(scene, side, seed).irradiance_rgb[:, 0], side) for seed in range(4)) / 4
        along = dark.sum(axis=0) if angle_rad < 0.7 else dark.sum(axis=1) if angle_rad > 0.8 else dark.ravel()
        alone = 1 - light_floor(scene, side, tiles=Tiles.none(), tolerance=0.0).irradiance_rgb[:, 0]
        assert dark.sum() == pytest.approx(alone.sum(), rel=0.05)
        if angle_rad != 0.7854:
            assert along[2:-2].min() > 0.5

    def test_of_a_wire_half_a_texel_wide(self):
        """Each piece of eight texels is missed by one ray a texel in less than one of 200 cases."""
        side, width = 128, 0.5 / 128
        scene = wire(width, 0.05, 0.0)
        dark = np.mean([1 - light_floor(scene, side, seed).irradiance_rgb[:, 0].mean() for seed in range(8)])
        alone = np.mean([1 - light_floor(scene, side, seed, Tiles.none(), tolerance=0.0).irradiance_rgb[:, 0].mean() for seed in range(8)])
        assert dark == pytest.approx(alone, rel=0.04)

    @pytest.mark.parametrize("light", [SUN, BULB, PANEL, SPOT, replace(PANEL, spread_rad=1.5)])
    def test_of_a_block(self, light):
        scene = lit_scene([box_mesh("Block", (0.3, 0.3, 0.1), (0.5, 0.5, 0.3))], [light])
        found, alone = (light_floor(scene, tiles=tiles).irradiance_rgb[:, 0] for tiles in (None, Tiles.none()))
        assert found.mean() == pytest.approx(alone.mean(), rel=5e-3)
        assert np.abs(found - alone).mean() < 0.01 * alone.mean()
