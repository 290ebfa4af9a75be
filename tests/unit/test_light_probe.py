"""Rough light at points, beside closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest
from leaflight.core.scene.light_probe import MOST_LAMPS, LightProbe
from leaflight.core.scene.scene import Light, Material
from scenes import box_mesh, make_scene, moved, quad_mesh

GREY = Material("Grey", (0.5, 0.5, 0.5))


def measure(meshes, lights=(), *, world=(0.0, 0.0, 0.0), materials=(GREY,), count=20000):
    """Mean irradiance on the first mesh's first triangle, a small quad around the origin that faces up."""
    probe = LightProbe(replace(make_scene(meshes, lights, materials), world_rgb=world))
    point, side = probe.spread_points(np.zeros(count, np.int32))
    return float(probe.find_irradiance(point, side).mean()), probe, point, side


PATCH = moved(quad_mesh("Patch", 0.002, 0.002), (-0.001, -0.001, 0.0))
DOWN = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@pytest.mark.parametrize(
    ("light", "expected"),
    [
        (Light("SUN", "Sun", power_rgb=(3.0,) * 3), 3.0),
        (Light("POINT", "Point", (0.0, 0.0, 2.0), power_rgb=(10.0,) * 3), 10.0 / (4 * math.pi * 4.0)),
        (Light("SPOT", "Spot", (0.0, 0.0, 2.0), power_rgb=(10.0,) * 3, cone_angle_rad=0.5), 10.0 / (4 * math.pi * 4.0)),
        (Light("SPOT", "Aside", (2.0, 0.0, 2.0), power_rgb=(10.0,) * 3, cone_angle_rad=0.5), 0.0),
        (Light("AREA", "Area", (0.0, 0.0, 2.0), DOWN, (10.0,) * 3, size_m=(0.01, 0.01)), 10.0 / (math.pi * 4.0)),
    ],
)
def test_lamps_have_their_irradiance(light, expected):
    assert measure([PATCH, moved(PATCH, (50.0, 0.0, 0.0))], [light], count=200)[0] == pytest.approx(expected, rel=1e-3)


def test_many_lamps_count_together():
    lamps = [Light("POINT", f"{i}", (0.0, 0.0, 2.0), power_rgb=(0.1,) * 3) for i in range(4 * MOST_LAMPS)]
    assert measure([PATCH], lamps, count=200)[0] == pytest.approx(4 * MOST_LAMPS * 0.1 / (4 * math.pi * 4.0), rel=1e-3)


def test_sky_and_glow_and_one_bounce():
    assert measure([PATCH], world=(1.0, 2.0, 3.0))[0] == pytest.approx(2.0 * math.pi)
    ceiling = moved(box_mesh("Ceiling", (4.0, 4.0, 0.1)), (0.0, 0.0, 1.05))
    covered = measure([PATCH, ceiling], world=(1.0,) * 3, materials=[Material("Black", (0.0,) * 3)])[0]
    form = sum(_form_factor(2.0, 2.0) for _ in range(4))  # four corners of a quad of 4 m, 1 m above
    assert covered == pytest.approx(math.pi * (1.0 - form), rel=0.05)
    glowing = measure([PATCH, ceiling], materials=[Material("Glow", (0.0,) * 3, emission_rgb=(1.0, 1.0, 1.0))])[0]
    assert glowing == pytest.approx(math.pi * form, rel=0.05)
    below = Light("SUN", "From below", rotation=((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)), power_rgb=(2.0,) * 3)
    assert measure([PATCH, ceiling], [below])[0] == pytest.approx(0.5 * 2.0 * form, rel=0.05)


def _form_factor(a, b):
    """Of a point to a rectangle above it, one corner straight over it: sides a and b by the height. Source: Howell, B-3."""
    p, q = math.hypot(1.0, a), math.hypot(1.0, b)
    return (a / p * math.atan(b / p) + b / q * math.atan(a / q)) / (2 * math.pi)


def test_shadows_fall_where_the_lamp_and_the_object_cast_them():
    roof = box_mesh("Roof", (2.0, 2.0, 0.1), (0.0, 0.0, 1.0))
    sun = Light("SUN", "Sun", power_rgb=(3.0,) * 3)
    assert measure([PATCH, roof], [sun], count=500)[0] == 0.0
    assert measure([PATCH, roof], [replace(sun, casts_shadow=False)], count=500)[0] == pytest.approx(3.0)
    scene = make_scene([PATCH, roof], [sun], [GREY])
    probe = LightProbe(replace(scene, objects=(scene.objects[0], replace(scene.objects[1], casts_shadow=False))))
    assert probe.find_irradiance(*probe.spread_points(np.zeros(500, np.int32))).mean() == pytest.approx(3.0)
