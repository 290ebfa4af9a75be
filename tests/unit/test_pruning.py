"""Pruned scenes bake alike: what is left out reaches nothing, and what is folded was the same everywhere."""

from dataclasses import replace

import numpy as np
import pytest
from boxes import lamp_scene
from leaflight.core.lights.emitters import SceneCover
from leaflight.core.lights.lights import make_light_emitter
from leaflight.core.scene.materials import SurfaceMaterials
from leaflight.core.scene.pruning import can_reach, prune_scene
from leaflight.core.scene.rays import RayScene
from leaflight.core.scene.scene import Light, Material, TextureImage
from leaflight.core.util.geometry import UnitBox

SCENE = lamp_scene()
POINTS = SCENE.vertex_position


def random_light(kind, rng):
    """A light somewhere around the scene, turned somewhere."""
    axes, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return Light(
        kind,
        kind,
        tuple(rng.uniform(-2, 2, 3)),
        tuple(map(tuple, axes)),
        (1.0, 1.0, 1.0),
        radius_m=float(rng.choice([0.0, 0.3])),
        soft_falloff=bool(rng.integers(2)),
        cone_angle_rad=float(rng.uniform(0.05, np.pi)),
        blend=0.5,
        size_m=(0.5, 0.2),
    )


def count_hits(light, rng):
    """How many of 500 photons of a light meet the scene."""
    box = UnitBox.from_points(np.concatenate([POINTS, [light.position_m]]))
    emitter = make_light_emitter(light, np.ones(3), box, SceneCover.around(box.to_unit(POINTS)))
    births = emitter.emit(rng.random((500, 4), np.float32))
    return int((RayScene(box.to_unit(SCENE.tri_position)).closest(births.origin, births.direction).tri >= 0).sum())


@pytest.mark.parametrize("kind", ["SPOT", "AREA"])
def test_lights_out_of_reach_send_no_photon_to_the_scene(kind):
    rng = np.random.default_rng(5)
    lights = [random_light(kind, rng) for _ in range(300)]
    reach = np.array([can_reach(light, POINTS) for light in lights])
    hits = np.array([count_hits(light, rng) for light in lights])
    assert not hits[~reach].any()
    assert (~reach).sum() > 0.6 * (hits == 0).sum() > 20  # and few that send none are kept


def test_a_wide_lamp_reaches_beside_its_cone():
    """A spot whose cone passes the scene, but not the rim of whose sphere."""
    beside = Light("SPOT", "Beside", (1.2, 0.0, 2.0), power_rgb=(1.0,) * 3, cone_angle_rad=0.02, radius_m=0.8, soft_falloff=False)
    assert can_reach(beside, POINTS)
    assert count_hits(beside, np.random.default_rng(8)) > 0
    assert not can_reach(replace(beside, radius_m=0.0), POINTS)


@pytest.mark.parametrize("kind", ["POINT", "SUN"])
def test_lights_that_shine_everywhere_are_kept(kind):
    rng = np.random.default_rng(6)
    assert all(can_reach(random_light(kind, rng), POINTS) for _ in range(20))


@pytest.mark.parametrize(
    "change", [{"position_m": (np.nan, 0.0, 0.0)}, {"cone_angle_rad": np.inf}, {"rotation": ((1, 0, 0), (0, 1, 0), (0, 0, np.nan))}]
)
def test_where_in_doubt_a_light_is_kept(change):
    away = Light("SPOT", "Away", (0.0, 0.0, 9.0), ((1, 0, 0), (0, 1, 0), (0, 0, -1)), (1.0, 1.0, 1.0), cone_angle_rad=0.1)
    assert not can_reach(away, POINTS)
    assert can_reach(replace(away, **change), POINTS)


def test_idle_lights_are_left_out_and_counted():
    lamp = SCENE.lights[0]
    off = replace(lamp, name="Off", power_rgb=(0.0, 0.0, 0.0))
    away = Light("AREA", "Away", (0.0, 0.0, 9.0), ((1, 0, 0), (0, 1, 0), (0, 0, -1)), (1.0, 1.0, 1.0))
    pruned, counts = prune_scene(replace(SCENE, lights=(off, lamp, away)))
    assert pruned.lights == (lamp,)
    assert (counts["lights_without_power"], counts["lights_out_of_reach"]) == (1, 1)
    assert prune_scene(replace(SCENE, lights=(away,)))[0].lights == (away,)  # it has light, though nothing sees it


def picture(pixels, extension="REPEAT"):
    return TextureImage("Picture", np.asarray(pixels, np.float32), extension)


ONE_COLOUR = np.broadcast_to(np.float32([0.5, 0.25, 1.0]), (4, 3, 3))
TWO_COLOURS = ONE_COLOUR * np.float32([[[1.0]], [[1.0]], [[0.5]], [[1.0]]])


@pytest.mark.parametrize(
    ("pixels", "extension", "rgb", "folded"),
    [
        (ONE_COLOUR, "REPEAT", (0.8, 0.8, 0.8), True),
        (ONE_COLOUR, "MIRROR", (3.0, 0.8, 0.8), True),  # clamped alike
        (ONE_COLOUR, "CLIP", (0.8, 0.8, 0.8), False),  # black around it
        (TWO_COLOURS, "REPEAT", (0.8, 0.8, 0.8), False),
        (TWO_COLOURS, "REPEAT", (0.0, 0.0, 0.0), True),
        (ONE_COLOUR * np.nan, "REPEAT", (0.8, 0.8, 0.8), False),
        (np.zeros((0, 0, 3)), "REPEAT", (0.8, 0.8, 0.8), False),
    ],
)
def test_a_texture_of_one_colour_is_no_texture(pixels, extension, rgb, folded):
    material = Material("Painted", rgb, 0, rgb, 0)
    scene = replace(SCENE, materials=(material,), images=(picture(pixels, extension),))
    pruned, counts = prune_scene(scene)
    assert counts["textures_of_one_colour"] == (2 if folded else 0)
    before, after = SurfaceMaterials(scene), SurfaceMaterials(pruned)
    assert before.albedo.has_images
    assert after.albedo.has_images is after.emission.has_images is not folded
    rng = np.random.default_rng(7)
    tri, (u, v) = rng.integers(0, scene.n_tri, 50), rng.random((2, 50), np.float32) / 2
    assert after.albedo.at(tri, u, v) == pytest.approx(before.albedo.at(tri, u, v), rel=1e-6)
    assert after.emission.at(tri, u, v) == pytest.approx(before.emission.at(tri, u, v), rel=1e-6)
