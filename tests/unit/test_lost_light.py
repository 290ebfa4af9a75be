"""Light that photons had not lost yet when they had met as many surfaces as they may."""

import math
from dataclasses import fields

import pytest
from boxes import make_solver, room_mesh
from leaflight.core.bake.lost_light import state_lost
from leaflight.core.scene.scene import Light, Material
from leaflight.core.util.settings import Settings
from scenes import make_scene

LAMP = Light("POINT", "Lamp", (0.2, 0.1, 0.0), power_rgb=(10.0, 10.0, 10.0), radius_m=0.02)


def bake(folder, albedo, max_depth):
    settings = Settings(size=32, padding=1, max_photons=4000, max_depth=max_depth, direct="photons")
    scene = make_scene([room_mesh()], [LAMP], [Material("Paint", (albedo,) * 3)])
    light = make_solver(folder, scene, settings).run(lambda message: None, lambda: False)
    return light, *state_lost(light, settings)


def test_what_is_under_way_still_is_stated_and_told(tmp_path):
    light, stated, warnings = bake(tmp_path, 0.99, 200)
    lost = 0.99**200  # of what has met as many surfaces
    assert light.ledger.find_lost() == pytest.approx(lost, rel=0.1)
    assert stated.error == math.hypot(light.error, light.ledger.find_lost())
    assert [subject for subject, _ in warnings] == [""]
    assert warnings[0][1].startswith(f"{light.ledger.find_lost():.0%} of the light was still under way after 200 surfaces")


def test_rooms_that_keep_little_of_it_lose_nothing(tmp_path):
    light, stated, warnings = bake(tmp_path, 0.8, 200)
    assert (stated, warnings) == (light, [])


def test_who_asks_for_few_surfaces_wants_no_more(tmp_path):
    light, stated, warnings = bake(tmp_path, 0.8, 3)
    assert light.ledger.find_lost() > 0.3
    assert (stated, warnings) == (light, [])


def test_a_little_of_it_is_stated_without_a_word(tmp_path):
    light, stated, warnings = bake(tmp_path, 0.96, 150)
    assert 0.0 < light.ledger.find_lost() < 0.01
    assert stated.error > light.error
    assert not warnings
    assert all(getattr(stated, field.name) is getattr(light, field.name) for field in fields(light) if field.name != "error")
