"""Light that leaves a surface diffusely on its other side, in rooms with a closed form."""

from dataclasses import replace

import numpy as np
import pytest
from boxes import room_mesh
from leaflight.core.scene.light_probe import LightProbe
from leaflight.core.scene.scene import Light, Material, SceneSnapshot, TextureImage
from safe_bakes import bake_and_audit
from scenes import make_scene

HERE, THERE = np.array([0.3, 0.4, 0.1]), np.array([0.5, 0.2, 0.8])  # reflected; and sent on, on the other side
PAPER = Material("Paper", tuple(HERE + THERE), through_rgb=tuple(THERE))


def paper_room(material: Material = PAPER) -> SceneSnapshot:
    """A closed room under a white sky, of radiance 1, that comes in through its walls alone; the walls' fronts face inwards."""
    return replace(make_scene([room_mesh()], [], [material]), world_rgb=(1.0,) * 3)


@pytest.mark.parametrize("direct", ["rays", "photons"])
def test_a_room_of_paper_gets_what_its_walls_send_in(tmp_path, direct):
    """Walls get pi from the sky on their backs: E = THERE pi + HERE E inside. They show both, by how much of each they send."""
    light, _, _ = bake_and_audit(tmp_path, paper_room(), direct=direct, max_photons=300_000, error=0.01)
    inside = np.pi * THERE / (1 - HERE)
    assert light == pytest.approx((HERE * inside + THERE * np.pi) / (HERE + THERE), rel=0.01)


def test_an_image_of_translucency_counts_texel_by_texel(tmp_path):
    pixels = np.zeros((1, 2, 3), np.float32)
    pixels[0, 1] = 1
    paper = Material("Paper", (0.4,) * 3, through_rgb=(0.4,) * 3, through_image=0)  # half of each wall reflects, half sends on
    uv = np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]], np.float32)
    scene = replace(
        paper_room(), materials=(paper,), images=(TextureImage("Halves", pixels, closest=True),), tri_through_uv=np.tile(uv, (6, 1, 1))
    )
    light, _, _ = bake_and_audit(tmp_path, scene, size=32, max_photons=400_000, error=0.05)
    inside = np.pi * 0.2 / (1 - 0.2)
    assert light == pytest.approx(np.full(3, (inside + np.pi) / 2), rel=0.02)  # each half of a wall shows the light of one side


@pytest.mark.parametrize("direct", ["rays", "photons"])
def test_white_paper_loses_no_light(tmp_path, direct):
    """A lamp in a room whose walls send half of all light on, white: all of it leaves the room in the end, so the walls' fronts get twice
    its power, and their backs nothing: half of that is what they show."""
    lamp = Light("POINT", "Lamp", power_rgb=(6.0,) * 3, radius_m=0.05)
    scene = make_scene([room_mesh()], [lamp], [Material("Paper", (1.0,) * 3, through_rgb=(0.5,) * 3)])
    light, audit, _ = bake_and_audit(tmp_path, scene, direct=direct, max_photons=300_000, error=0.004)
    white = 0.999  # of which half goes through
    fronts = 1 / (1 - (white - 0.5))
    assert light == pytest.approx(np.full(3, (white - 0.5) * fronts / white), rel=0.01)
    assert audit["escaped"] == pytest.approx(audit["emitted"], rel=0.003)  # white is 0.999


def test_a_glance_before_the_bake_sees_light_through_paper():
    """Fronts of walls in a room that is lit through them are not taken for dark."""
    probe = LightProbe(paper_room(replace(PAPER, albedo_rgb=(0.8,) * 3, through_rgb=(0.5,) * 3)))
    point, side = probe.spread_points(np.zeros(20_000, np.int32))
    assert probe.find_irradiance(point, side, 12).mean() == pytest.approx(np.pi * 0.5 / (1 - 0.3), rel=0.03)
