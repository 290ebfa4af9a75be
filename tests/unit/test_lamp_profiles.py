"""Lamps whose intensity differs by direction: closed forms, and photons beside shadow rays."""

import math
from dataclasses import replace

import numpy as np
import pytest
from floors import assert_photons_agree, floor_tiles, light_floor, lit_scene, to_grid
from leaflight.core.scene.scene import Light, SceneSnapshot
from leaflight.core.util.sphere_map import find_middles, find_solid_angles

SIDE, SHAPE, HEIGHT_M = 32, (128, 256), 0.8


def directions() -> np.ndarray:
    return find_middles(SHAPE).astype(float)


def make_profile(values: np.ndarray) -> np.ndarray:
    """Values by cell, with a mean of 1 over the sphere."""
    profile = values.reshape(SHAPE)
    return (profile / ((profile * find_solid_angles(*SHAPE)[:, None]).sum() / (4 * math.pi))).astype(np.float32)


DOWN = make_profile(np.maximum(-directions()[:, 2], 0.0))  # 4 cos: the mean of max(cos, 0) is 1 / 4
EVEN = make_profile(np.ones(math.prod(SHAPE)))
LOBED = make_profile((1.0 + directions()[:, 0]) ** 4 * (directions()[:, 1] > -0.3))  # to the side of +x, with an edge


def lamp_scene(values: np.ndarray, **options: object) -> SceneSnapshot:
    lamp = Light("POINT", "Lamp", (0.4, 0.6, HEIGHT_M), power_rgb=(10.0, 5.0, 0.0), profile=0)
    return replace(lit_scene(), lights=(replace(lamp, **options),), profiles=(values,))


def by_rays(scene: SceneSnapshot) -> np.ndarray:
    """(SIDE, SIDE, 3)"""
    return to_grid(light_floor(scene, SIDE, tolerance=0.002, tiles=floor_tiles(SIDE)).irradiance_rgb, SIDE)


def square_of_distance() -> np.ndarray:
    place = (np.arange(SIDE) + 0.5) / SIDE
    return (place[None, :] - 0.4) ** 2 + (place[:, None] - 0.6) ** 2 + HEIGHT_M**2


def test_an_even_profile_is_a_plain_lamp():
    plain = by_rays(lamp_scene(EVEN, profile=-1))
    assert by_rays(lamp_scene(EVEN)) == pytest.approx(plain, rel=2e-3)


def test_light_by_the_cosine_downwards():
    """I = P / (4 pi) 4 cos, so E = P / pi h^2 / d^4."""
    found = by_rays(lamp_scene(DOWN))
    expected = 10.0 / math.pi * HEIGHT_M**2 / square_of_distance() ** 2
    assert found[..., 0] == pytest.approx(expected, rel=0.02)
    assert found[..., 0].mean() == pytest.approx(expected.mean(), rel=2e-3)
    assert found[..., 1] == pytest.approx(found[..., 0] / 2, rel=1e-5)


def test_a_lamp_that_is_turned_turns_its_profile():
    """Upside down, its light goes up."""
    turned = lamp_scene(DOWN, rotation=((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)))
    assert by_rays(turned).max() == 0
    aside = by_rays(lamp_scene(LOBED, rotation=((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0))))
    assert aside[SIDE // 4 * 3 :].mean() > 3 * aside[: SIDE // 4].mean()  # to the side of +y


@pytest.mark.parametrize("options", [{}, {"radius_m": 0.1}, {"radius_m": 0.1, "soft_falloff": False}], ids=["sharp", "soft", "sphere"])
def test_photons_bring_what_shadow_rays_find(options):
    scene = lamp_scene(LOBED, rotation=((0.8, 0.0, -0.6), (0.0, 1.0, 0.0), (0.6, 0.0, 0.8)), **options)
    assert_photons_agree(scene, light_floor(scene, SIDE, tolerance=0.002, tiles=floor_tiles(SIDE)), SIDE, 3, parts=4)


def test_many_lamps_keep_their_profiles():
    """More than are looked at one by one."""
    lamps = [Light("POINT", f"Lamp {k}", (0.4, 0.6, HEIGHT_M), power_rgb=(0.25, 0.0, 0.0), profile=k % 2) for k in range(40)]
    scene = replace(lit_scene(), lights=tuple(lamps), profiles=(DOWN, EVEN))
    expected = (by_rays(lamp_scene(DOWN)) + by_rays(lamp_scene(EVEN)))[..., 0] / 2
    assert by_rays(scene)[..., 0].mean() == pytest.approx(expected.mean(), rel=0.01)


def test_a_profile_that_is_not_there_is_refused():
    with pytest.raises(ValueError, match="Lamp: names a profile"):
        replace(lamp_scene(EVEN), profiles=())
