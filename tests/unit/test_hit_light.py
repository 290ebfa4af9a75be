"""Direct light by one ray from a point to a light of each kind, beside what texels find by many."""

import math
from dataclasses import replace

import numpy as np
import pytest
from floors import floor_footprints, lit_scene, morton_square, prepare, sigma_limit
from leaflight.core.integrate.direct import direct_irradiance
from leaflight.core.integrate.hit_light import HitLight
from leaflight.core.lights.direct_points import Receivers
from leaflight.core.lights.lamp_crowd import LampCrowd
from leaflight.core.scene.scene import Light
from scenes import box_mesh, moved

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
