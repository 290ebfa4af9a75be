"""A bake that finds no light ends soon, and says which objects are dark and why."""

import math
from dataclasses import replace

import pytest
from boxes import bake_folder, room_mesh
from leaflight.core.scene.dark_places import describe_dark
from leaflight.core.scene.light_probe import LightProbe
from leaflight.core.scene.scene import Light, Material
from leaflight.core.util.messages import Warning_
from leaflight.core.util.settings import Settings
from scenes import box_mesh, make_scene, moved, quad_mesh

FLOOR = moved(quad_mesh("Floor", 2.0, 2.0), (-1.0, -1.0, 0.0))
SHADE = box_mesh("Shade", (0.4, 0.4, 0.4), (0.0, 0.0, 1.0))
BULB = Light("POINT", "Bulb", (0.0, 0.0, 1.0), power_rgb=(100.0,) * 3, radius_m=0.02)
SUN = Light("SUN", "Sun", power_rgb=(3.0,) * 3)


def bake(folder, scene, **settings):
    """Warnings and result."""
    chosen = Settings(size=16, padding=1, workers=1, error=0.02, passes=("lighting",), sides="front", **settings)
    messages, result = bake_folder(folder, scene, chosen)
    return [(message.subject, message.text) for message in messages if isinstance(message, Warning_)], result


def describe(scene):
    return describe_dark(LightProbe(scene), range(len(scene.objects)))


@pytest.mark.usefixtures("open_image_io")
def test_a_floor_whose_only_lamp_is_enclosed_ends_the_bake(tmp_path):
    scene = make_scene([FLOOR, replace(SHADE, receives=False)], [BULB])
    told, result = bake(tmp_path, scene)
    assert ("Floor", "is reached by no light: Bulb is enclosed by Shade") in told
    assert result["photons"] < 1_000_000


@pytest.mark.usefixtures("open_image_io")
def test_what_is_lit_is_not_named(tmp_path):
    told, result = bake(tmp_path, make_scene([FLOOR, SHADE], [replace(BULB, position_m=(0.5, 0.5, 0.5))]), max_photons=100_000)
    assert told == []
    assert result["photons"] > 0


def test_lamps_and_what_glows_are_enclosed():
    filament = box_mesh("Filament", (0.1, 0.1, 0.1), (0.0, 0.0, 1.0))
    grey, hot = Material("Grey"), Material("Hot", emission_rgb=(9.0,) * 3)
    lit = replace(make_scene([FLOOR, SHADE, filament]), materials=(grey, hot))
    scene = replace(lit, tri_material=(lit.tri_object == 2).astype("int32"))
    assert describe(scene)[0] == ("Floor", "is reached by no light: Filament is enclosed by Shade")
    spot = Light("SPOT", "Spot", (0.0, 0.0, 3.0), power_rgb=(100.0,) * 3, cone_angle_rad=0.1)
    lid = box_mesh("Lid", (2.0, 2.0, 0.1), (0.0, 0.0, 2.0))
    assert ("Floor", "is reached by no light: Spot is enclosed by Lid") in describe(make_scene([FLOOR, lid], [spot]))


def test_a_closed_room_with_the_sun_outside_is_named():
    room = room_mesh("Room", (4.0, 4.0, 3.0))
    said = dict(describe(make_scene([room, FLOOR], [SUN])))
    assert said["Floor"] == "is reached by no light: it is enclosed by Room, and the light is outside"
    assert said["Room"] == "is reached by no light: it is closed in by its surroundings, and the light is outside"
    sky = replace(make_scene([room, FLOOR]), world_rgb=(1.0,) * 3)
    assert dict(describe(sky)) == said


def test_a_surface_that_faces_away_has_no_reason():
    away = replace(SUN, rotation=((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)))
    assert describe(make_scene([FLOOR], [away])) == [("Floor", "is reached by no light")]


def test_light_through_a_small_opening_is_light():
    slot = [moved(quad_mesh(name, 2.0, 0.95), (-1.0, y, 0.5)) for name, y in (("Left", -1.0), ("Right", 0.05))]
    assert "Floor" not in dict(describe(make_scene([FLOOR, *slot], [replace(SUN, angle_rad=math.radians(1.0))])))
