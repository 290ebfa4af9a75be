"""The sky through openings: right on average, of less noise than plain rays, and left alone where these will do."""

import math
from dataclasses import replace

import numpy as np
import pytest
from closed_forms import from_polygon
from floors import floor_footprints, floor_tiles, lit_scene, prepare, sigma_limit
from leaflight.core.integrate.direct import DirectLight, direct_irradiance
from leaflight.core.scene.scene import SceneSnapshot
from leaflight.core.texels.texel_grid import part_bits
from leaflight.core.texels.tiles import Tiles
from leaflight.core.util import ablation
from scenes import box_mesh, moved, quad_mesh

SIDE, FAR, HEIGHT = 64, 60.0, 1.0
HATCH = (0.3, 0.7, 0.35, 0.5)  # x, x, y, y, metres: an opening of the roof


def roofed(hatch: tuple[float, float, float, float], *others: object) -> SceneSnapshot:
    """A floor of a square metre below a roof without end, under a white sky; no more light than through the hatch."""
    x0, x1, y0, y1 = hatch
    parts = ((-FAR, x0, -FAR, FAR), (x1, FAR, -FAR, FAR), (x0, x1, -FAR, y0), (x0, x1, y1, FAR))
    roof = [moved(quad_mesh(f"Roof {i}", b - a, d - c), (a, c, HEIGHT)) for i, (a, b, c, d) in enumerate(parts)]
    return replace(lit_scene([*roof, *others]), world_rgb=(1.0, 1.0, 1.0))


def light_floor(scene: SceneSnapshot, seed: int = 1, tiles: Tiles | None = None, **options: object) -> DirectLight:
    tiles = floor_tiles(SIDE) if tiles is None else tiles
    return direct_irradiance(
        prepare(scene)[0], floor_footprints(SIDE), np.arange(SIDE**2), np.random.default_rng(seed), tiles=tiles, **options
    )


def through(hatch: tuple[float, float, float, float]) -> np.ndarray:
    """(SIDE**2,) irradiance at the middles of the floor's texels; a little comes from beyond the roof's edge."""
    x0, x1, y0, y1 = hatch
    column, row = middles()
    position = np.column_stack([column, row, np.zeros(SIDE**2)])
    up = np.tile([0.0, 0.0, 1.0], (SIDE**2, 1))
    hole = np.array([[x0, y0, HEIGHT], [x1, y0, HEIGHT], [x1, y1, HEIGHT], [x0, y1, HEIGHT]])
    whole = np.array([[-FAR, -FAR, HEIGHT], [FAR, -FAR, HEIGHT], [FAR, FAR, HEIGHT], [-FAR, FAR, HEIGHT]])
    return np.abs(from_polygon(hole, position, up)) + math.pi - np.abs(from_polygon(whole, position, up))


def middles() -> tuple[np.ndarray, np.ndarray]:
    x, y = part_bits(np.arange(SIDE**2))
    return (x + 0.5) / SIDE, (y + 0.5) / SIDE


def error_of(found: DirectLight, truth: np.ndarray) -> float:
    return float(np.sqrt(((found.irradiance_rgb[:, 0] / truth - 1) ** 2).mean()))


@pytest.fixture
def plain(monkeypatch):
    """Gives light by plain rays alone."""

    def light(*args: object, **options: object) -> DirectLight:
        with monkeypatch.context() as patch:
            patch.setenv(ablation.VARIABLE, "openings")
            return light_floor(*args, **options)

    return light


class TestLight:
    @pytest.mark.parametrize("tiles", [None, Tiles.none()])
    def test_of_a_small_hatch_is_right_with_half_the_noise_of_plain_rays(self, plain, tiles):
        scene, truth = roofed(HATCH), through(HATCH)
        assert 0.01 < truth.mean() / math.pi < 0.02
        found, by_plain = ([light(scene, seed, tiles) for seed in range(4)] for light in (light_floor, plain))
        for lights in (found, by_plain):
            assert np.mean([one.irradiance_rgb for one in lights]) == pytest.approx(truth.mean(), rel=0.025)
        error, plain_error = (np.mean([error_of(one, truth) for one in lights]) for lights in (found, by_plain))
        assert error < 0.45
        assert plain_error > 1.6 * error
        stated = np.mean([np.sqrt((one.variance_rgb[:, 0] / truth**2).mean()) for one in found])
        assert 0.9 < stated / error < 1.2

    @pytest.mark.slow
    def test_is_right_on_average_where_hardly_a_ray_finds_it(self):
        hatch = (0.5, 0.6, 0.5, 0.55)
        scene, truth = roofed(hatch), through(hatch)
        assert truth.mean() / math.pi < 2e-3
        found = np.array([light_floor(scene, seed, tolerance=0.025).irradiance_rgb[:, 0].mean() for seed in range(40)])
        noise = found.std() / math.sqrt(len(found))
        assert noise < 0.05 * truth.mean()
        assert abs(found.mean() - truth.mean()) < sigma_limit(1) * noise

    def test_whole_tiles_that_saw_little_by_chance_do_not_stop_by_that(self):
        """Many saw nothing at all, and seem to be even."""
        hatch = (0.1, 0.3, 0.9, 1.0)
        scene, truth = roofed(hatch), through(hatch)
        dim = truth < np.quantile(truth, 0.25)
        found = np.array([light_floor(scene, seed, tolerance=0.025).irradiance_rgb[:, 0] for seed in range(16)])
        for part, most in ((np.ones(SIDE**2, bool), 0.006), (dim, 0.021)):
            mean = found[:, part].mean(axis=1) / truth[part].mean()
            noise = mean.std() / math.sqrt(len(mean))
            assert noise < most
            assert abs(mean.mean() - 1) < sigma_limit(2) * noise

    def test_who_saw_nothing_by_chance_is_not_sure_of_it(self):
        found = light_floor(roofed((0.5, 0.6, 0.5, 0.55)), seed=3)
        dark, variance = found.irradiance_rgb[:, 0] == 0, found.variance_rgb[:, 0].reshape(-1, 64)
        assert dark.any()
        beside = np.repeat(variance.mean(axis=1), 64)
        assert (found.variance_rgb[dark & (beside > 0), 0] >= beside[dark & (beside > 0)] / 16).all()

    def test_blocks_of_which_no_ray_found_it_are_not_sure_either(self):
        cover = box_mesh("Cover", (0.6, 0.6, 0.4))
        found = light_floor(replace(roofed(HATCH, cover), world_rgb=(1.0, 2.0, 0.0)), seed=1)
        unlit = found.by_openings & np.repeat(~found.irradiance_rgb.reshape(-1, 64 * 3).any(axis=1), 64)
        assert unlit.any()
        red, green, blue = found.variance_rgb[unlit].T
        assert (red > 0).all()
        assert green == pytest.approx(4 * red)
        assert not blue.any()

    def test_each_channel_has_its_sky(self):
        scene = replace(roofed(HATCH), world_rgb=(2.0, 1.0, 0.0))
        red, green, blue = light_floor(scene).irradiance_rgb.T
        assert red == pytest.approx(2 * green, rel=1e-6)
        assert not blue.any()

    def test_rays_are_aimed_below_a_small_hatch_alone(self):
        assert light_floor(roofed(HATCH)).by_openings.all()
        assert not light_floor(roofed((-2.0, 3.0, -2.0, 3.0))).by_openings.any()
