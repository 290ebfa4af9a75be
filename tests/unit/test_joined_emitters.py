"""Emitters joined: what is born is what each gives alone, to the bit."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from leaflight.core.lights.emitters import WorldEmitter
from leaflight.core.lights.joined_emitters import JoinedEmitters
from leaflight.core.lights.lights import make_light_emitter
from leaflight.core.scene.scene import Light
from leaflight.core.scene.scene_cover import SceneCover
from leaflight.core.util.geometry import UnitBox

UNIT_BOX = UnitBox(np.array([1.0, 2.0, 3.0]), 0.25)
COVER = SceneCover.around(np.array([[-0.5, -0.4, -0.3], [0.5, 0.4, 0.3]]))
FIELDS = ("origin", "direction", "soft_radius", "soft_offset")

POINT = Light("POINT", "Point", radius_m=0.3)
SPOT = Light("SPOT", "Spot", radius_m=0.2, cone_angle_rad=1.0, blend=0.4)
AREA = Light("AREA", "Area", size_m=(0.8, 0.5))
KINDS = {
    "soft points": POINT,
    "spheres": replace(POINT, soft_falloff=False),
    "sharp points": replace(POINT, radius_m=0.0),
    "hard spots": replace(SPOT, blend=0.0),
    "blended spots": SPOT,
    "rectangles": AREA,
    "ellipses": replace(AREA, shape="ELLIPSE"),
    "rectangles of a spread": replace(AREA, spread_rad=1.2),
}
SUN = Light("SUN", "Sun", angle_rad=0.1)


def vary(light: Light, count: int) -> list[Light]:
    """As many lights of its kind, no two alike in what may differ."""
    rng = np.random.default_rng(3)
    lights = []
    for number in range(count):
        axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        some = rng.uniform(0.5, 1.5)
        lights.append(
            replace(
                light,
                name=f"{light.name} {number}",
                position_m=tuple(rng.uniform(0.0, 3.0, 3)),
                rotation=tuple(map(tuple, axes)),
                power_rgb=(some, 2.0, 3.0),
                casts_shadow=bool(number % 2),
                radius_m=light.radius_m * some,
                cone_angle_rad=light.cone_angle_rad * some,
                blend=light.blend * some,
                size_m=tuple(np.multiply(light.size_m, rng.uniform(0.5, 1.5, 2))),
            )
        )
    return lights


def make(lights):
    return [make_light_emitter(light, np.array(light.power_rgb), UNIT_BOX, COVER) for light in lights]


def hold_births_of_each_alone(emitters, counts):
    """Asked for all together, with `counts` photons each, and for each alone."""
    counts = np.asarray(counts)
    u = np.random.default_rng(4).random((4, counts.sum()), np.float32).T
    emitter = np.repeat(np.arange(len(emitters)), counts)
    births = JoinedEmitters.of(emitters).emit(emitter, u)
    for number in np.flatnonzero(counts):
        own = emitter == number
        alone = emitters[number].emit(np.ascontiguousarray(u[own].T).T)
        for name in FIELDS:
            assert getattr(births, name)[own].tobytes() == getattr(alone, name).tobytes(), (emitters[number].name, name)
        relative = np.broadcast_to(births.relative_rgb, (len(u), 3))[own]
        np.testing.assert_array_equal(relative, np.broadcast_to(alone.relative_rgb, relative.shape))


@pytest.mark.parametrize("kind", KINDS)
def test_lights_of_a_kind_are_one_and_bear_as_each_alone(kind):
    emitters = make(vary(KINDS[kind], 30))
    joined = JoinedEmitters.of(emitters)
    assert len(joined.kinds) == 1
    assert joined.light.tolist() == list(range(30))
    hold_births_of_each_alone(emitters, np.arange(30) * 7 % 31)  # one bears none
    hold_births_of_each_alone(emitters, np.where(np.arange(30) == 7, 100, 0))


def test_all_kinds_together_and_in_turn():
    lights = [light for turn in zip(*(vary(kind, 5) for kind in (*KINDS.values(), SUN)), strict=True) for light in turn]
    emitters = [*make(lights), WorldEmitter("World", np.ones(3), COVER)]
    joined = JoinedEmitters.of(emitters)
    # Points and spots differ in numbers alone: all that are soft are one. Suns and the world bear alone.
    assert len(joined.kinds) == 2 + 3 + 5 + 1
    hold_births_of_each_alone(emitters, 1 + np.arange(len(emitters)) * 11 % 40)


def test_all_kinds_one_after_the_other():
    lights = [light for kind in (SPOT, AREA, replace(AREA, shape="ELLIPSE"), SUN) for light in vary(kind, 3)]
    hold_births_of_each_alone(make(lights), 1 + np.arange(len(lights)) * 7 % 30)


def test_lights_that_differ_by_more_than_numbers_of_each_are_apart():
    lights = [AREA, replace(AREA, spread_rad=1.2), replace(AREA, spread_rad=1.3), replace(AREA, shape="ELLIPSE"), POINT, SUN, SUN]
    assert JoinedEmitters.of(make(lights)).kind.tolist() == [0, 1, 2, 3, 4, 5, 6]


def test_power_and_shadow_are_of_each():
    lights = [replace(POINT, power_rgb=(1.0, 2.0, 3.0)), replace(POINT, power_rgb=(4.0, 5.0, 6.0), casts_shadow=False)]
    joined = JoinedEmitters.of(make(lights))
    assert len(joined) == 2
    assert joined.power_rgb.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert joined.casts_shadow.tolist() == [True, False]


def test_a_spot_as_wide_as_all_directions_may_be_joined_with_points():
    """Of lights without a rim beside some with one, angles are as they were."""
    lights = [POINT, SPOT, replace(SPOT, cone_angle_rad=2 * math.pi, blend=0.0)]
    hold_births_of_each_alone(make(lights), [200, 300, 200])


def test_no_emitters_are_none():
    joined = JoinedEmitters.of([])
    assert len(joined) == 0
    assert joined.power_rgb.shape == (0, 3)
