"""Sources of a scene's lights, and the joining of those of a kind."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from floors import lit_scene
from leaflight.core.lights.direct_lights import AreaSource, PointSource, SunSource
from leaflight.core.lights.direct_sources import join_sources, make_lamps, make_suns, make_world
from leaflight.core.scene.scene import Light
from leaflight.core.util.geometry import UnitBox

UNIT_BOX = UnitBox(np.array([1.0, 2.0, 3.0]), 0.25)
BULB = Light("POINT", "Bulb", (1, 2, 3), power_rgb=(8.0, 4.0, 0.0))


SUN = Light("SUN", "Sun", power_rgb=(1.0, 0.0, 0.0))


def test_lights_are_those_with_power_and_the_world_if_it_shines():
    scene = replace(lit_scene(), lights=(BULB, SUN, replace(SUN, power_rgb=(0.0,) * 3), replace(BULB, power_rgb=(math.nan, 0, 0))))
    assert [type(source) for source in make_lamps(scene, UNIT_BOX)] == [PointSource]
    assert [type(source) for source in make_suns(scene)] == [SunSource]
    assert make_world(lit_scene()) == []
    (world,) = make_world(replace(lit_scene(), world_rgb=(1.0, -1.0, 0.0)))
    assert world.rgb.tolist() == [[1, 0, 0]]


def test_lights_are_joined_with_those_that_are_computed_alike():
    spot = replace(BULB, kind="SPOT", cone_angle_rad=1.0)
    lights = (BULB, replace(BULB, radius_m=0.1), replace(BULB, power_rgb=(16.0, 4.0, 0.0)), spot)
    scene = replace(lit_scene(), lights=(*lights, replace(BULB, kind="AREA"), replace(BULB, casts_shadow=False)))
    joined = join_sources(make_lamps(scene, UNIT_BOX))
    assert [type(source) for source, _ in joined] == [PointSource, PointSource, PointSource, AreaSource, PointSource]
    assert [of.tolist() for _, of in joined] == [[0, 2], [1], [3], [4], [5]]
    twice = joined[0][0]
    assert twice.rgb[1] == pytest.approx(twice.rgb[0] * [2, 1, 0])
    assert twice.centre.shape == (2, 3)
