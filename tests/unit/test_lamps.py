"""Lamps: one ray to each, many at once, by direction, and linked to objects."""

import math
from dataclasses import replace

import numpy as np
import pytest
from floors import (
    assert_photons_agree,
    floor_footprints,
    floor_tiles,
    light_floor,
    lit_scene,
    morton_square,
    prepare,
    sigma_limit,
    to_grid,
    trace_first,
)
from leaflight.core.integrate import direct
from leaflight.core.integrate.direct import DirectScene, direct_irradiance
from leaflight.core.integrate.hit_light import HitLight
from leaflight.core.lights.direct_points import Receivers
from leaflight.core.lights.lamp_crowd import LampCrowd
from leaflight.core.scene.scene import Light, Material, SceneSnapshot
from leaflight.core.transport.photon_log import ShardHits
from leaflight.core.util import ablation
from leaflight.core.util.sphere_map import find_middles, find_solid_angles
from scenes import box_mesh, moved, quad_mesh

# Direct light by one ray from a point to a light of each kind, beside what texels find by many.
SIDE, REGIONS, POINTS = 16, 2, 60_000
BLOCK = box_mesh("Block", (0.3, 0.3, 0.2), (0.5, 0.5, 0.4))
BULB = Light("POINT", "Bulb", position_m=(0.4, 0.6, 0.8), power_rgb=(4.0, 2.0, 1.0), radius_m=0.05)
PANEL = Light("AREA", "Panel", position_m=(0.2, 0.5, 0.9), size_m=(0.2, 0.2), power_rgb=(2.0, 1.0, 3.0))
SPOT = replace(BULB, kind="SPOT", name="Spot", cone_angle_rad=1.2, blend=0.5)
SUN = Light("SUN", "Sun", power_rgb=(3.0, 2.0, 1.0), angle_rad=0.2)
CROWD = [replace(BULB, name=f"Bulb {i}", position_m=(0.05 * i, 0.9 - 0.04 * i, 0.4 + 0.02 * i)) for i in range(20)]
GLOW = [moved(box_mesh(f"Glow {i}", (0.1, 0.1, 0.1)), (0.2 * i, 0.9, 0.5)) for i in range(4)]
SKY = np.ones((8, 16, 3), np.float32) * np.linspace(0.2, 2.0, 16, dtype=np.float32)[:, None]


def light_points(scene, rounds=8, seed=1):
    """(POINTS, 3) light at random points of a floor, by rays of which the earlier ones tell the later which lights are seen; and its
    column and row of REGIONS."""
    prepared, unit_box, _ = prepare(scene)
    rng = np.random.default_rng(seed)
    point = np.column_stack([rng.random((POINTS, 2)), np.full(POINTS, 1e-5)])
    up = np.tile(np.float32([0.0, 0.0, 1.0]), (POINTS, 1))
    lit, found = HitLight(prepared, rng), np.empty((POINTS, 3))
    for rows in np.array_split(np.arange(POINTS), rounds):
        receivers = Receivers(unit_box.to_unit(point[rows]), up[rows], up[rows])
        found[rows], traced = lit.find_light(receivers, np.where(point[rows, 0] > point[rows, 1], 0, 1))
        assert traced <= 4 * len(rows)
    return found, (point[:, :2] * REGIONS).astype(int) @ [1, REGIONS]


@pytest.mark.parametrize(
    ("lights", "glow", "world"),
    [([BULB, PANEL, SPOT], [], None), ([SUN], [], np.full(3, 0.5)), (CROWD, [], None), ([BULB], GLOW, None), ([], [], SKY)],
    ids=["lamps", "sun and sky", "crowd", "glowing boxes", "environment"],
)
def test_points_get_the_light_that_texels_get(lights, glow, world):
    scene = lit_scene([BLOCK], lights, glow, rgb=(3.0, 2.0, 1.0))
    if world is not None:
        scene = replace(scene, **({"world_map": world} if world.ndim == 3 else {"world_rgb": tuple(world)}))
    prepared = prepare(scene)[0]
    assert (prepared.crowd is not None, len(prepared.pools) > 0) == (len(lights) > 16, bool(glow))
    found, region = light_points(scene)
    texel = np.arange(SIDE * SIDE)
    expected = direct_irradiance(prepared, floor_footprints(SIDE), texel, np.random.default_rng(2), tolerance=0.0)
    x, y = morton_square(SIDE)
    of_texel = x * REGIONS // SIDE + y * REGIONS // SIDE * REGIONS
    for number in range(REGIONS**2):
        mine, truth = found[region == number], expected.irradiance_rgb[of_texel == number]
        chance = mine.std(axis=0) / math.sqrt(len(mine)) + np.sqrt(expected.variance_rgb[of_texel == number].sum(axis=0)) / len(truth)
        allowed = sigma_limit(3 * 5 * REGIONS**2) * chance + 0.01 * truth.mean()  # penumbrae are biased by a little, see HitLight
        assert (np.abs(mine.mean(axis=0) - truth.mean(axis=0)) < allowed).all(), number
        assert (allowed < 0.15 * expected.irradiance_rgb.mean()).all()  # or the test would say little


def test_points_get_no_light_of_what_is_linked_to_others_and_no_shadow_of_what_blocks_others():
    """On the floor, of a lamp and of boxes that light the block alone, and of a panel that the block does not hide."""
    scene = lit_scene([BLOCK], [replace(BULB, lights=(1,)), replace(PANEL, blocked_by=(0,))], GLOW)
    floor, block, *glows = scene.objects
    found, _ = light_points(replace(scene, objects=(floor, block, *(replace(glow, lights=(1,)) for glow in glows))))
    alone, _ = light_points(lit_scene(lights=[PANEL]))
    assert found.mean(axis=0) == pytest.approx(alone.mean(axis=0), rel=0.02)
    scene = lit_scene([BLOCK], emission=GLOW)
    floor, block, *glows = scene.objects
    found, _ = light_points(replace(scene, objects=(floor, block, *(replace(glow, blocked_by=(0, 2, 3, 4, 5)) for glow in glows))))
    alone, _ = light_points(lit_scene(emission=GLOW))
    assert found.mean() == pytest.approx(alone.mean(), rel=0.02)


def test_a_light_that_no_ray_finds_gets_few_of_them():
    """A bright lamp in a closed box, and a dim one outside: after some rays the dim one gets most."""
    boxed = replace(BULB, name="Boxed", position_m=(0.5, 0.5, 0.5), power_rgb=(400.0,) * 3, radius_m=0.01)
    scene = lit_scene([moved(box_mesh("Box", (0.2, 0.2, 0.2)), (0.5, 0.5, 0.5))], [boxed, BULB])
    found, _ = light_points(scene)
    first, last = (part.std(axis=0)[0] / part.mean(axis=0)[0] for part in (found[: POINTS // 8], found[-POINTS // 8 :]))
    assert last < 0.5 * first


def test_lamps_of_a_crowd_are_chosen_by_what_they_bring():
    crowd = prepare(lit_scene(lights=CROWD))[0].crowd
    assert isinstance(crowd, LampCrowd)
    at = np.tile(np.float32([[0.0, 0.0, -0.5]]), (40_000, 1))
    up = np.tile(np.float32([[0.0, 0.0, 1.0]]), (len(at), 1))
    lamp, chance = crowd.choose(Receivers(at, up, up), np.random.default_rng(3))
    share = np.bincount(lamp, minlength=len(CROWD)) / len(at)
    each = np.array([chance[lamp == number][0] for number in range(len(CROWD))])
    assert each.sum() == pytest.approx(1.0, rel=1e-6)
    assert share == pytest.approx(each, abs=5 * math.sqrt(0.25 / len(at)))


def test_a_lamp_that_nearly_touches_the_surface_sends_no_fireflies():
    near = replace(PANEL, position_m=(0.5, 0.5, 1e-3), size_m=(0.3, 0.3))
    found, _ = light_points(lit_scene(lights=[near]))
    radiance = 2.0 / (math.pi * 0.09)
    assert found[:, 0].max() < 1.001 * math.pi * radiance


# Many lamps of all kinds: the same light as from each by itself, with honest errors, and none that is never looked at.
CROWD_SIDE = 16
TEXELS = np.arange(CROWD_SIDE * CROWD_SIDE)
LOW_BLOCK = box_mesh("Block", (0.2, 0.3, 0.3), (0.5, 0.5, 0.15))
DOWNWARDS = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
ASIDE = ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0))


def make_lamps(count: int, seed: int = 1) -> list[Light]:
    """Points, spots, areas and a sun, over the floor, beyond its sides and below it."""
    rng, lamps = np.random.default_rng(seed), []
    for k in range(count):
        kind = ("POINT", "SPOT", "AREA", "POINT", "AREA", "POINT", "SPOT")[k % 7]
        place = tuple(rng.uniform((-0.3, -0.3, 0.25), (1.3, 1.3, 0.8)) * (1, 1, -0.3 if k % 6 == 1 else 1))
        lamps.append(
            Light(
                kind,
                f"Lamp {k}",
                place,
                rotation=ASIDE if k % 5 == 0 else DOWNWARDS,
                power_rgb=tuple(rng.uniform(0.2, 2.0, 3)),
                radius_m=0.02 * (k % 3),
                soft_falloff=k % 2 == 0,
                size_m=(0.1, 0.05),
                shape="ELLIPSE" if k % 7 == 4 else "RECTANGLE",
                spread_rad=math.pi if k % 4 else 1.5,
                cone_angle_rad=1.3,
                blend=0.3,
                casts_shadow=k % 11 != 0,
            )
        )
    return [*lamps, Light("SUN", "Sun", rotation=DOWNWARDS, power_rgb=(0.2, 0.3, 0.1), angle_rad=0.1)]


def light_crowd(scene: DirectScene, seed: int = 1, **options: float) -> direct.DirectLight:
    return direct_irradiance(scene, floor_footprints(CROWD_SIDE), TEXELS, np.random.default_rng(seed), **options)


def one_by_one(monkeypatch, scene) -> DirectScene:
    with monkeypatch.context() as patch:
        patch.setenv(ablation.VARIABLE, "lamp_crowd")
        return prepare(scene)[0]


@pytest.fixture(scope="module")
def many():
    return lit_scene([LOW_BLOCK], make_lamps(60))


def test_the_same_light_as_from_each_by_itself(many, monkeypatch):
    """Means over 4 x 4 parts of the floor, of 12 bakes, within the noise of both."""
    crowd, alone = prepare(many)[0], one_by_one(monkeypatch, many)
    assert crowd.crowd is not None
    assert alone.crowd is None
    runs = np.stack([light_crowd(crowd, seed).irradiance_rgb.mean(axis=1) for seed in range(12)])
    exact = [light_crowd(alone, seed, tolerance=0.0) for seed in (50, 51)]
    expected = np.mean([one.irradiance_rgb.mean(axis=1) for one in exact], axis=0)
    parts = (runs.mean(axis=0) - expected).reshape(16, -1).mean(axis=1)
    noise = np.sqrt((runs.var(axis=0, ddof=1) / 12 + exact[0].variance_rgb.mean(axis=1) / 2).reshape(16, -1).sum(axis=1)) / 16
    assert (np.abs(parts) < sigma_limit(16) * noise + 0.005 * expected.reshape(16, -1).mean(axis=1)).all()
    assert runs.mean() == pytest.approx(expected.mean(), rel=0.003)
    assert np.sqrt(((runs[0] / expected - 1) ** 2).mean()) < 0.06


def test_errors_hold_the_noise_of_the_choice(many):
    """What neighbouring strata differ by is a little more than their noise."""
    scene = prepare(many)[0]
    runs = [light_crowd(scene, seed) for seed in range(12)]
    true = np.var([run.irradiance_rgb.mean(axis=1) for run in runs], axis=0, ddof=1).mean()
    assert 0.3 < true / np.mean([run.variance_rgb.mean() for run in runs]) < 1.2


def test_far_lamps_are_sampled_together_and_near_ones_are_not(many):
    found = light_crowd(prepare(many)[0])
    assert found.counters["sampled"] + found.counters["pairs"] == (60 + 1) * CROWD_SIDE**2  # the sun is always a pair
    assert CROWD_SIDE**2 < found.counters["pairs"] < 16 * CROWD_SIDE**2
    assert found.counters["rays"] < 160 * CROWD_SIDE**2


def test_rays_do_not_grow_with_the_lamps():
    few, lots = (light_crowd(prepare(lit_scene([LOW_BLOCK], make_lamps(count)))[0]).counters["rays"] for count in (40, 400))
    assert lots < 1.5 * few


class TestJudging:
    def receivers(self, n: int = 400) -> Receivers:
        rng = np.random.default_rng(2)
        normal = rng.normal(size=(n, 3)).astype(np.float32)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        return Receivers(rng.uniform(-0.5, 0.5, (n, 3)).astype(np.float32), normal, normal)

    def test_no_lamp_that_lights_a_place_has_hardly_a_chance(self):
        """Light over what it was estimated by, relative to the place's whole: what one ray may be too bright by."""
        scene = lit_scene([LOW_BLOCK], make_lamps(50))
        crowd, receivers = prepare(scene)[0].crowd, self.receivers()
        estimated = crowd.estimate(receivers, np.full(400, 0.01, np.float32))
        assert (estimated > 0).all()
        given = np.zeros_like(estimated)
        for place in range(estimated.shape[1]):
            lamp = crowd.kinds[crowd.kind[place]].rows(np.array([crowd.number[place]]))
            given[:, place] = lamp.aim(receivers.position, receivers.normal, np.full((400, 2), 0.5, np.float32)).weight * lamp.rgb.mean()
        worst = (given / estimated * estimated.sum(axis=1, keepdims=True)).max(axis=1) / np.maximum(given.sum(axis=1), 1e-9)
        assert np.quantile(worst[given.sum(axis=1) > 1e-3 * given.sum(axis=1).max()], 0.95) < 4


def test_chances_turn_to_the_lamps_that_are_seen():
    """20 lamps over the floor, 60 more and brighter behind a roof: without learning the error is 0.49."""
    roof = moved(quad_mesh("Roof", 20, 20), (-9.5, -9.5, 0.4))
    rng = np.random.default_rng(4)
    near = [Light("POINT", f"In {k}", (*rng.uniform(-1, 2, 2), 0.3), power_rgb=(0.1,) * 3) for k in range(20)]
    behind = [Light("POINT", f"Out {k}", (*rng.uniform(-1, 2, 2), 0.5), power_rgb=(1.0,) * 3) for k in range(60)]
    found = light_crowd(prepare(lit_scene([roof], [*near, *behind]))[0])
    alone = light_crowd(prepare(lit_scene([roof], near))[0])
    assert found.irradiance_rgb.mean() == pytest.approx(alone.irradiance_rgb.mean(), rel=0.01)
    relative = np.sqrt(found.variance_rgb.mean()) / found.irradiance_rgb.mean()
    assert relative < 0.25


# Lamps whose intensity differs by direction: closed forms, and photons beside shadow rays.
LIT_SIDE, SHAPE, HEIGHT_M = 32, (128, 256), 0.8


def directions() -> np.ndarray:
    return find_middles(SHAPE).astype(float)


def make_profile(values: np.ndarray) -> np.ndarray:
    """Values by cell, with a mean of 1 over the sphere."""
    profile = values.reshape(SHAPE)
    return (profile / ((profile * find_solid_angles(*SHAPE)[:, None]).sum() / (4 * math.pi))).astype(np.float32)


DOWN = make_profile(np.maximum(-directions()[:, 2], 0.0))  # 4 cos: the mean of max(cos, 0) is 1 / 4
EVEN = make_profile(np.ones(math.prod(SHAPE)))
LOBED = make_profile((1.0 + directions()[:, 0]) ** 4 * (directions()[:, 1] > -0.3))  # to the side of +x, with an edge


def profile_scene(values: np.ndarray, **options: object) -> SceneSnapshot:
    lamp = Light("POINT", "Lamp", (0.4, 0.6, HEIGHT_M), power_rgb=(10.0, 5.0, 0.0), profile=0)
    return replace(lit_scene(), lights=(replace(lamp, **options),), profiles=(values,))


def by_rays(scene: SceneSnapshot) -> np.ndarray:
    """(SIDE, SIDE, 3)"""
    return to_grid(light_floor(scene, LIT_SIDE, tolerance=0.002, tiles=floor_tiles(LIT_SIDE)).irradiance_rgb, LIT_SIDE)


def square_of_distance() -> np.ndarray:
    place = (np.arange(LIT_SIDE) + 0.5) / LIT_SIDE
    return (place[None, :] - 0.4) ** 2 + (place[:, None] - 0.6) ** 2 + HEIGHT_M**2


def test_an_even_profile_is_a_plain_lamp():
    plain = by_rays(profile_scene(EVEN, profile=-1))
    assert by_rays(profile_scene(EVEN)) == pytest.approx(plain, rel=2e-3)


def test_light_by_the_cosine_downwards():
    """I = P / (4 pi) 4 cos, so E = P / pi h^2 / d^4."""
    found = by_rays(profile_scene(DOWN))
    expected = 10.0 / math.pi * HEIGHT_M**2 / square_of_distance() ** 2
    assert found[..., 0] == pytest.approx(expected, rel=0.02)
    assert found[..., 0].mean() == pytest.approx(expected.mean(), rel=2e-3)
    assert found[..., 1] == pytest.approx(found[..., 0] / 2, rel=1e-5)


def test_a_lamp_that_is_turned_turns_its_profile():
    """Upside down, its light goes up."""
    turned = profile_scene(DOWN, rotation=((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)))
    assert by_rays(turned).max() == 0
    aside = by_rays(profile_scene(LOBED, rotation=((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0))))
    assert aside[LIT_SIDE // 4 * 3 :].mean() > 3 * aside[: LIT_SIDE // 4].mean()  # to the side of +y


@pytest.mark.parametrize("options", [{}, {"radius_m": 0.1}, {"radius_m": 0.1, "soft_falloff": False}], ids=["sharp", "soft", "sphere"])
def test_photons_bring_what_shadow_rays_find(options):
    scene = profile_scene(LOBED, rotation=((0.8, 0.0, -0.6), (0.0, 1.0, 0.0), (0.6, 0.0, 0.8)), **options)
    assert_photons_agree(scene, light_floor(scene, LIT_SIDE, tolerance=0.002, tiles=floor_tiles(LIT_SIDE)), LIT_SIDE, 3, parts=4)


def test_many_lamps_keep_their_profiles():
    """More than are looked at one by one."""
    lamps = [Light("POINT", f"Lamp {k}", (0.4, 0.6, HEIGHT_M), power_rgb=(0.25, 0.0, 0.0), profile=k % 2) for k in range(40)]
    scene = replace(lit_scene(), lights=tuple(lamps), profiles=(DOWN, EVEN))
    expected = (by_rays(profile_scene(DOWN)) + by_rays(profile_scene(EVEN)))[..., 0] / 2
    assert by_rays(scene)[..., 0].mean() == pytest.approx(expected.mean(), rel=0.01)


def test_a_profile_that_is_not_there_is_refused():
    with pytest.raises(ValueError, match="Lamp: names a profile"):
        replace(profile_scene(EVEN), profiles=())


# Photons of lamps that some rays do not see, or that are linked to objects.
METAL = Material("Metal", albedo_rgb=(0.8,) * 3, metal_rgb=(0.8,) * 3, roughness=0.3)
GLASS = Material("Glass", albedo_rgb=(0.0,) * 3, glass_rgb=(1.0,) * 3, glass_mirror_rgb=(1.0,) * 3)


def trace(material: Material, **choices) -> ShardHits:
    """10,000 photons of a sun that shines on a floor and a block, up to the first surface."""
    sun = Light("SUN", "Sun", power_rgb=(3.0,) * 3, angle_rad=0.1, **choices)
    scene = replace(lit_scene([BLOCK], [sun]), materials=(material, material))
    return trace_first(scene, 10_000)[0]


def test_metal_sees_what_glossy_rays_see():
    alike, unseen = trace(METAL), trace(METAL, seen_by=(True, False, True))
    assert alike.audit.mirrored.sum() > 0
    assert unseen.audit.mirrored.sum() == 0
    assert unseen.flux_rgb.sum() == pytest.approx(alike.flux_rgb.sum())
    assert trace(METAL, seen_by=(False, True, False)).audit.mirrored == pytest.approx(alike.audit.mirrored, rel=0.05)


def test_glass_reflects_and_refracts_what_rays_of_each_kind_see():
    alike, unreflected, unbent = (trace(GLASS, seen_by=(True, *kinds)) for kinds in ((True, True), (False, True), (True, False)))
    assert unreflected.audit.mirrored.sum() == unbent.audit.refracted.sum() == 0
    assert unreflected.audit.refracted == pytest.approx(alike.audit.refracted, rel=0.05)
    assert unbent.audit.mirrored == pytest.approx(alike.audit.mirrored, rel=0.2)


def test_what_a_lamp_does_not_light_stops_its_photons_where_it_casts_its_shadows():
    plain, unlit, clear = trace(Material("Grey")), trace(Material("Grey"), lights=(0,)), trace(Material("Grey"), blocked_by=(0,))
    on_floor = [one.flux_rgb[:, one.tri < 2].sum(dtype=float) for one in (plain, unlit, clear)]
    on_block = [one.flux_rgb[:, one.tri >= 2].sum(dtype=float) for one in (plain, unlit, clear)]
    assert on_block[1] == 0
    assert on_block[0] > 0
    assert on_block[2] == pytest.approx(on_block[0], rel=0.3)  # its lower side, too
    assert on_floor[1] == pytest.approx(on_floor[0])
    assert on_floor[2] == pytest.approx(on_floor[0] + on_block[0], rel=0.02)


def test_what_glows_is_linked_as_a_lamp_is():
    """A glowing square above a floor and a block: as shadow rays and as photons find its light on the floor."""
    scene = lit_scene([BLOCK], emission=[moved(quad_mesh("Glow"), (0.0, 0.0, 1.0))])
    *others, glow = scene.objects

    def light(**choices) -> tuple[float, float, float]:
        linked = replace(scene, objects=(*others, replace(glow, **choices)))
        prepared = prepare(linked)[0]
        direct = direct_irradiance(prepared, floor_footprints(16), np.arange(256), np.random.default_rng(1)).irradiance_rgb[:, 0].mean()
        hits, _ = trace_first(linked, 40_000)
        on_floor = hits.tri < 2
        return float(direct), float(hits.flux_rgb[0, on_floor].sum()), float(hits.flux_rgb[0, ~on_floor].sum())

    plain, unlit, clear, whole = light(), light(lights=(1,)), light(blocked_by=(0,)), light(blocked_by=(0, 1, 2))
    assert unlit == (0, 0, plain[2])
    assert clear[0] > 1.05 * plain[0]
    assert clear[:2] == pytest.approx((clear[1], clear[1]), rel=0.03)  # on a floor of 1 m^2
    assert whole[:2] == pytest.approx(plain[:2], rel=0.02)
