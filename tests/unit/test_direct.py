"""Direct irradiance: closed forms, known shadows, photons as a second opinion, honest errors; by texels, by tiles, and shot again."""

import copy
import math
from dataclasses import replace

import numpy as np
import pytest
from boxes import lamp_scene, prepare_folder
from closed_forms import from_polygon
from floors import assert_photons_agree, floor_footprints, floor_tiles, light_floor, lit_scene, morton_square, prepare, to_grid, trace_first
from leaflight.core.bake.direct_only import settle_direct
from leaflight.core.integrate import direct_shards
from leaflight.core.integrate.direct import DirectLight, direct_irradiance
from leaflight.core.integrate.direct_field import DirectField
from leaflight.core.integrate.direct_shards import NOTHING_AHEAD, ShotAhead
from leaflight.core.integrate.direct_tiles import sample_tiles
from leaflight.core.lights.direct_lights import make_lamps
from leaflight.core.lights.direct_points import TexelChunk
from leaflight.core.lights.irradiance import polygon_irradiance
from leaflight.core.parallel import executors, folders
from leaflight.core.scene.scene import Light, SceneSnapshot
from leaflight.core.texels.error_metric import BEST_TEXELS, DARK_FLOOR
from leaflight.core.texels.tiles import Tiles
from leaflight.core.util.geometry import UnitBox
from leaflight.core.util.settings import Settings
from scenes import box_mesh, make_scene, moved, quad_mesh

# Direct irradiance of a floor: closed forms, shadows with a known outline, photons as a second opinion, honest errors.
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


# First looks that texels of a tile share: found where tiles are whole, right where they are believed, blind to no shadow of a texel.
TILED_SIDE = 64
WHITE_SUN = Light("SUN", "Sun", power_rgb=(1.0, 1.0, 1.0))
HIGH_PANEL = Light("AREA", "Panel", position_m=(0.5, 0.5, 4.0), size_m=(1.0, 1.0), power_rgb=(2.0, 1.0, 0.0))
HIGH_BULB = Light("POINT", "Bulb", position_m=(0.3, 0.4, 4.0), power_rgb=(4.0, 2.0, 0.0))
SPOT = replace(HIGH_BULB, kind="SPOT", cone_angle_rad=0.15, blend=0.3)


def light_tiled(scene: SceneSnapshot, side: int = TILED_SIDE, seed: int = 1, tiles: Tiles | None = None, **options: float) -> DirectLight:
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
    return lit_scene([replace(strip, vertex=vertex)], [WHITE_SUN])


class TestTiles:
    @pytest.mark.parametrize(
        "light", [HIGH_PANEL, HIGH_BULB, replace(HIGH_BULB, radius_m=0.3), replace(HIGH_PANEL, shape="ELLIPSE"), WHITE_SUN]
    )
    def test_tiles_tell_what_each_texel_would(self, light):
        found = light_tiled(lit_scene(lights=[light]))
        alone = light_tiled(lit_scene(lights=[light]), tiles=Tiles.none())
        np.testing.assert_allclose(found.irradiance_rgb, alone.irradiance_rgb, rtol=2e-3, atol=1e-12)
        diagonal = TILED_SIDE * 8  # texels of tiles that both triangles share
        assert found.counters["shared"] == found.counters["pairs"] - diagonal
        assert found.counters["rays"] == TILED_SIDE**2 + 3 * diagonal

    def test_what_they_may_be_off_by_is_told(self):
        """Where all of the light is seen, and no ray tells of any noise."""
        scene = lit_scene(lights=[replace(HIGH_PANEL, position_m=(0.5, 0.5, 0.5))])
        found, exact = light_tiled(scene), light_tiled(scene, tiles=Tiles.none()).irradiance_rgb
        told = found.variance_rgb[:, 0] > 0
        assert told[floor_tiles(TILED_SIDE).texels()].mean() > 0.8
        off = (found.irradiance_rgb - exact)[told, 0]
        assert 0.2 < np.sqrt((off**2).mean() / found.variance_rgb[told, 0].mean()) < 2.0

    def test_near_a_light_they_tell_nothing(self):
        near = replace(HIGH_BULB, position_m=(0.3, 0.4, 0.02))
        scene, box = lit_scene(lights=[near]), UnitBox.from_points(lit_scene().vertex_position)
        prepared = prepare(scene)[0]
        chunk = TexelChunk(
            floor_footprints(TILED_SIDE)(np.arange(TILED_SIDE**2)), np.zeros((TILED_SIDE**2, 2), np.uint32), prepared.surfaces, False
        )
        tiles = floor_tiles(TILED_SIDE)
        look = sample_tiles(prepared.rays, chunk, tiles, make_lamps(scene.lights, box, ())[0], np.zeros((len(tiles), 2), np.uint32))
        column, row = morton_square(TILED_SIDE)
        distance = np.hypot(column / TILED_SIDE - 0.3, row / TILED_SIDE - 0.4)
        assert np.isnan(look.closed[distance < 0.2]).all()
        found = light_tiled(scene)
        np.testing.assert_allclose(found.irradiance_rgb, light_tiled(scene, tiles=Tiles.none()).irradiance_rgb, rtol=5e-3, atol=1e-12)

    def test_behind_a_light_there_is_no_ray(self):
        found = light_tiled(lit_scene(lights=[replace(HIGH_PANEL, position_m=(0.5, 0.5, -4.0))]))
        assert not found.irradiance_rgb.any()
        assert found.counters["rays"] == 0
        assert found.counters["out_of_reach"] == found.counters["pairs"] == TILED_SIDE**2


class TestShadowsOfTiles:
    @pytest.mark.parametrize("angle_rad", [0.0, 0.1, 0.7854, 1.2])
    @pytest.mark.parametrize("shift", [0.0, 0.25])
    def test_of_a_wire_one_texel_wide(self, angle_rad, shift):
        """No texel across is missed, and on average no shadow; shift in texels."""
        side, width = 128, 1 / 128
        scene = wire(width, angle_rad, shift / side)
        dark = sum(1 - to_grid(light_tiled(scene, side, seed).irradiance_rgb[:, 0], side) for seed in range(4)) / 4
        along = dark.sum(axis=0) if angle_rad < 0.7 else dark.sum(axis=1) if angle_rad > 0.8 else dark.ravel()
        alone = 1 - light_tiled(scene, side, tiles=Tiles.none(), tolerance=0.0).irradiance_rgb[:, 0]
        assert dark.sum() == pytest.approx(alone.sum(), rel=0.05)
        if angle_rad != 0.7854:
            assert along[2:-2].min() > 0.5

    def test_of_a_wire_half_a_texel_wide(self):
        """Each piece of eight texels is missed by one ray a texel in less than one of 200 cases."""
        side, width = 128, 0.5 / 128
        scene = wire(width, 0.05, 0.0)
        dark = np.mean([1 - light_tiled(scene, side, seed).irradiance_rgb[:, 0].mean() for seed in range(8)])
        alone = np.mean([1 - light_tiled(scene, side, seed, Tiles.none(), tolerance=0.0).irradiance_rgb[:, 0].mean() for seed in range(8)])
        assert dark == pytest.approx(alone, rel=0.04)

    @pytest.mark.parametrize("light", [WHITE_SUN, HIGH_BULB, HIGH_PANEL, SPOT, replace(HIGH_PANEL, spread_rad=1.5)])
    def test_of_a_block(self, light):
        scene = lit_scene([box_mesh("Block", (0.3, 0.3, 0.1), (0.5, 0.5, 0.3))], [light])
        found, alone = (light_tiled(scene, tiles=tiles).irradiance_rgb[:, 0] for tiles in (None, Tiles.none()))
        assert found.mean() == pytest.approx(alone.mean(), rel=5e-3)
        assert np.abs(found - alone).mean() < 0.01 * alone.mean()


# Shots add up to means, with the variance of means.
SETTINGS = Settings(size=24, padding=1, error=0.25)


@pytest.fixture
def shot(tmp_path):
    n_texel = len(prepare_folder(tmp_path, lamp_scene(), SETTINGS)[1].texel_area)
    field = DirectField.none(n_texel)
    field.shoot(tmp_path, SETTINGS, executors.InlineExecutor(), np.arange(n_texel))
    return tmp_path, field


def test_a_second_shot_is_averaged_in_and_told_so(shot):
    folder, field = shot
    noisy = np.argsort(field.variance[:, 0])[-20:]
    noisy.sort()
    rest = np.setdiff1d(np.arange(len(field.passes)), noisy)
    irradiance, variance = field.irradiance.copy(), field.variance.copy()
    field.shoot(folder, SETTINGS, executors.InlineExecutor(), noisy)
    assert field.passes[noisy].tolist() == [2] * 20
    assert (field.passes[rest] == 1).all()
    np.testing.assert_array_equal(field.irradiance[rest], irradiance[rest])
    assert (field.irradiance[noisy] != irradiance[noisy]).any()
    assert field.variance[noisy].mean() < 0.8 * variance[noisy].mean()


def test_a_shot_that_is_stopped_leaves_what_there_was(shot, monkeypatch):
    """And the next one is as if it had never been, as of a bake that goes on later."""
    folder, field = shot
    noisy = np.sort(np.argsort(field.variance[:, 0])[-200:])
    field.shoot(folder, SETTINGS, executors.InlineExecutor(), noisy[::2])
    other, asked = copy.deepcopy(field), []
    monkeypatch.setattr(direct_shards, "SHARD_TEXELS", 50)
    assert not field.shoot(folder, SETTINGS, executors.InlineExecutor(), noisy, should_stop=lambda: asked.append(True) or len(asked) > 2)
    assert len(asked) == 3
    for _ in range(2):
        for name in ("irradiance", "variance", "passes"):
            np.testing.assert_array_equal(getattr(field, name), getattr(other, name))
        assert (field.counters, field.turns) == (other.counters, other.turns)
        assert all(one.shoot(folder, SETTINGS, executors.InlineExecutor(), noisy) for one in (field, other))


def test_rare_light_is_right_on_average_however_often_texels_are_shot_again():
    """Each estimate counts rays that found it, three in the mean, and a texel is shot again while it errs too much."""

    def settle(choose):
        rng, field = np.random.default_rng(2), DirectField.none(1 << 14)
        field.by_openings[:] = True
        texels = np.arange(len(field.passes))
        while len(texels):
            found = rng.poisson(3.0, len(texels))[:, None] / np.full(3, 3.0)
            variance = np.maximum(found / 3, 1 / 24)
            field._add(
                texels, DirectLight(found.astype(np.float32), variance.astype(np.float32), {}, by_openings=np.ones(len(texels), bool))
            )
            error2 = (field.variance / (field.irradiance**2 + 0.01)).mean(axis=1)
            texels = np.flatnonzero((choose(field, error2) > 0.2**2) & (field.passes < 64))
        return field.irradiance[:, 0].mean(), np.sqrt(1 / 3 / len(field.passes) / field.passes.mean()), field.passes.mean()

    mean, noise, passes = settle(DirectField.share_error)
    assert passes > 4
    assert mean == pytest.approx(1.0, abs=4 * noise)
    assert abs(settle(lambda field, error2: error2)[0] - 1.0) > 10 * noise  # were each chosen by its own


# Bakes without photons: direct light until its own noise is small enough, stopped by the same rules.
def settle(folder, shoot=True, should_stop=lambda: False, **knobs):
    settings = Settings(size=32, padding=1, **knobs)
    _atlas, texels = prepare_folder(folder, lamp_scene(), settings)
    executor, count = executors.InlineExecutor(), len(texels.texel_area)
    direct = DirectField.none(count)
    if shoot:
        direct.shoot(folder, settings, executor, np.arange(count))
    return settle_direct(folder, texels, lamp_scene().tri_object, settings, executor, direct, lambda message: None, should_stop)


def test_worse_texels_are_shot_again(tmp_path, monkeypatch):
    monkeypatch.setattr("leaflight.core.integrate.direct_shards.TOLERANCE", 20.0)  # so that the first turn is too coarse
    first = settle(tmp_path / "a", error=1.0)
    light = settle(tmp_path / "b", error=first.error / 3)
    assert light.stopped_by == "error"
    assert light.error <= first.error / 3
    assert light.direct.passes.min() == 1 < light.direct.passes.max()


def test_of_objects_the_one_that_errs_most_is_to_come_to_the_error(tmp_path, monkeypatch):
    monkeypatch.setattr("leaflight.core.integrate.direct_shards.TOLERANCE", 20.0)
    whole = settle(tmp_path / "a", error=1.0)
    assert sorted(whole.object_error) == [0, 1]
    worst = max(whole.object_error.values())
    assert worst > whole.error > 0.0
    light = settle(tmp_path / "b", error=0.5 * worst, error_of="objects")
    assert light.stopped_by == "error"
    assert max(light.object_error.values()) == pytest.approx(light.error, rel=1e-3)
    assert light.error <= 0.5 * worst


@pytest.fixture
def below_hatch(tmp_path):
    """A floor of a square metre below a roof with a small opening, under a white sky: what settles it, its texels, and their light."""
    x0, x1, y0, y1, far = 0.5, 0.6, 0.5, 0.55, 60.0
    parts = ((-far, x0, -far, far), (x1, far, -far, far), (x0, x1, -far, y0), (x0, x1, y1, far))
    roof = [replace(moved(quad_mesh(f"Roof {i}", b - a, d - c), (a, c, 1.0)), receives=False) for i, (a, b, c, d) in enumerate(parts)]
    scene = replace(make_scene([quad_mesh("Floor"), *roof]), world_rgb=(1.0, 1.0, 1.0))
    _atlas, texels = prepare_folder(tmp_path, scene, Settings(size=64, padding=1))
    tri, weight = (of[0] for of in texels.footprints_at(np.arange(len(texels))).points(np.full((1, 1, 2), 0.5)))
    corner = scene.tri_position[tri]
    position = corner[:, 0] + (weight[..., None] * (corner[:, 1:] - corner[:, :1])).sum(axis=1)
    hole, edge = (
        np.array([[a, c, 1.0], [b, c, 1.0], [b, d, 1.0], [a, d, 1.0]]) for a, b, c, d in ((x0, x1, y0, y1), (-far, far, -far, far))
    )
    up = np.tile([0.0, 0.0, 1.0], (len(texels), 1))
    truth = np.abs(from_polygon(hole, position, up)) + np.pi - np.abs(from_polygon(edge, position, up))

    def settle_floor(**knobs):
        settings, executor, direct = Settings(size=64, padding=1, **knobs), executors.InlineExecutor(), DirectField.none(len(texels))
        direct.shoot(tmp_path, settings, executor, np.arange(len(texels)))
        light = settle_direct(tmp_path, texels, scene.tri_object, settings, executor, direct, lambda message: None, lambda: False)
        return light.error, direct.show(texels, True).irradiance[:, 0]

    return settle_floor, texels.shown & texels.is_central, truth


@pytest.mark.slow
def test_what_is_stated_below_an_opening_is_what_the_light_is_off(below_hatch, hold):
    """Texels there are shot again, and what their estimates differ by tells how sure they are."""
    settle_floor, judged, truth = below_hatch
    stated2, real2 = [], []
    for seed in range(4):
        error, found = settle_floor(seed=seed, error=0.1)
        off2 = (found - truth)[judged] ** 2 / (truth[judged] ** 2 + (DARK_FLOOR * truth[judged].mean()) ** 2)
        assert error <= 0.1
        stated2.append(error**2)
        real2.append(np.sort(off2)[: int(BEST_TEXELS * len(off2))].mean())
    hold("floor below a hatch, no indirect light: stated error / error", np.sqrt(np.mean(stated2) / np.mean(real2)), low=0.8, high=1.3)


@pytest.mark.parametrize(("options", "why"), [({"should_stop": lambda: True}, "interrupted"), ({"time_limit": 1e-9}, "time_limit")])
def test_it_can_be_stopped(tmp_path, monkeypatch, options, why):
    monkeypatch.setattr("leaflight.core.integrate.direct_shards.TOLERANCE", 20.0)
    light = settle(tmp_path, error=1e-3, **options)
    assert light.stopped_by == why
    assert light.error > 1e-3


SHARDED = Settings(size=64, padding=1, workers=1, error=0.2)


class Noting(executors.InlineExecutor):
    """Knows what it was asked for."""

    def __init__(self):
        super().__init__()
        self.shards = []

    def submit(self, fn, /, *args, **kwargs):
        self.shards += args
        return super().submit(fn, *args, **kwargs)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """With a scene of which direct light takes a dozen shards; its number of texels."""
    n_texel = len(prepare_folder(tmp_path, lamp_scene(), SHARDED)[1])
    monkeypatch.setattr(direct_shards, "SHARD_TEXELS", n_texel // 12)
    yield tmp_path, n_texel
    folders.forget_folders()


def shoot(folder, n_texel, ahead, executor):
    field = DirectField.none(n_texel)
    assert field.shoot(folder, SHARDED, executor, range(n_texel), ahead=ahead)
    return field


def test_shards_sent_ahead_are_not_sent_again_and_have_the_same_light_where_nothing_else_is_seen(folder):
    folder, n_texel = folder
    executor = Noting()
    whole = shoot(folder, n_texel, NOTHING_AHEAD, executor)
    every, executor.shards = executor.shards, []
    ahead = ShotAhead.send(folder, SHARDED, executor, n_texel)
    assert ahead.count == 1
    assert not executor.shards  # nobody has asked for them yet
    parted = shoot(folder, n_texel, ahead, executor)
    assert executor.shards == every[ahead.count :]
    np.testing.assert_array_equal(parted.irradiance, whole.irradiance)
    np.testing.assert_array_equal(parted.variance, whole.variance)
    assert parted.counters == whole.counters
    assert (parted.passes == 1).all()
