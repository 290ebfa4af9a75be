"""Normals out of images, on the side of the surface that is asked for; and what steep bumps hide of each other."""

import math
from dataclasses import replace

import numpy as np
import pytest
from boxes import bake_folder
from leaflight.core import solve
from leaflight.core.output.image_file import read_image
from leaflight.core.scene.normal_maps import NormalMaps
from leaflight.core.scene.scene import Light, Material, TextureImage
from leaflight.core.scene.sides import turn
from leaflight.core.util.settings import Settings
from scenes import make_scene, quad_mesh

_FROM_45_DEGREES = ((math.sqrt(0.5), 0.0, -math.sqrt(0.5)), (0.0, 1.0, 0.0), (math.sqrt(0.5), 0.0, math.sqrt(0.5)))
SUN = Light("SUN", "Sun", rotation=_FROM_45_DEGREES, power_rgb=(2.0,) * 3, angle_rad=0.01)
UP = np.float32([[0.0], [0.0], [1.0]])


def tilted_scene(*normals, lights=()):
    """A level square of 1 m whose map has these normals in columns from left to right."""
    pixels = np.float32(normals)[None]
    scene = make_scene([quad_mesh(uv=np.array([[0, 0], [1, 0], [1, 1], [0, 1]]))], lights)
    image = TextureImage("normals", pixels, "EXTEND", closest=True)
    return replace(scene, images=(image,), materials=(Material("Bumpy", normal_image=0),), tri_normal_uv=scene.tri_uv.astype(np.float32))


def test_normals_are_found_unit_and_on_the_side_asked_for():
    maps = NormalMaps.of(tilted_scene((3.0, 0.0, 4.0), (0.0, 0.0, 0.0)))
    tri = np.zeros(3, np.int32)
    u, v = np.float32([0.1, 0.9, 0.1]), np.zeros(3, np.float32)  # the second lies where the map has no direction
    rows, normal = maps.look_up(tri, u, v, np.repeat(UP, 3, axis=1) * np.float32([1, 1, -1]))
    assert rows.tolist() == [0, 2]
    assert pytest.approx(np.array([(0.6, 0.0, 0.8), (-0.6, 0.0, -0.8)])) == normal.T


@pytest.mark.parametrize("strength", [0.0, 0.5, 1.0, 1.7])
def test_a_map_in_tangent_space_leans_along_its_tangents(strength):
    """Which differ between the corners: the square's tangents turn from +X on the left to +Y on the right, its bitangents from +Y to -X."""
    scene = tilted_scene((0.8, 0.6, 0.9))
    turned = np.zeros((2, 3, 3, 3), np.float32)
    is_right = scene.tri_position[..., 0] > 0.5
    turned[~is_right], turned[is_right] = np.eye(3), [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]
    scene = replace(scene, materials=(Material("Bumpy", normal_image=0, normal_strength=strength),), tri_tangents=turned)
    places = np.float32([(0.0, 0.0), (1.0, 0.0), (0.25, 0.25)])  # weights of the right corners of the first triangle
    rows, normal = NormalMaps.of(scene).look_up(np.zeros(3, np.int32), *places.T, np.repeat(UP, 3, axis=1))
    assert rows.tolist() == [0, 1, 2]
    x, y, z = 0.6 * strength, 0.2 * strength, 1.0 - 0.2 * min(strength, 1.0)
    right = places.sum(axis=1)
    expected = np.stack([(1 - right) * x - right * y, right * x + (1 - right) * y, np.full(3, z)])
    assert normal == pytest.approx(expected / np.linalg.norm(expected, axis=0), abs=1e-6)


def test_maps_in_tangent_space_and_in_the_world_can_be_on_one_scene():
    scene = tilted_scene((0.8, 0.6, 0.9))
    frames = np.broadcast_to(np.eye(3, dtype=np.float32), (2, 3, 3, 3))
    materials = Material("World", normal_image=0), Material("Tangent", normal_image=0, normal_strength=1.0)
    scene = replace(scene, materials=materials, tri_material=np.array([0, 1], np.int32), tri_tangents=frames)
    tri = np.array([1, 0, 1], np.int32)
    _, normal = NormalMaps.of(scene).look_up(tri, *np.full((2, 3), 0.2, np.float32), np.repeat(UP, 3, axis=1))
    world, tangent = (np.array(one) / np.linalg.norm(one) for one in ((0.8, 0.6, 0.9), (0.6, 0.2, 0.8)))
    assert pytest.approx(np.array([tangent, world, tangent]), abs=1e-6) == normal.T


def test_a_map_in_tangent_space_needs_tangents():
    scene = tilted_scene((0.8, 0.6, 0.9))
    with pytest.raises(ValueError, match="tri_tangents"):
        replace(scene, materials=(Material("Bumpy", normal_image=0, normal_strength=1.0),))


def test_turned_surfaces_keep_the_tangents_of_their_corners():
    scene = tilted_scene((0.8, 0.6, 0.9))
    frames = np.random.default_rng(1).random((2, 3, 3, 3)).astype(np.float32)
    scene = replace(scene, materials=(Material("Bumpy", normal_image=0, normal_strength=1.0),), tri_tangents=frames)
    turned = turn(scene, np.array([True, False]))
    at, side = np.float32([[0.2], [0.3]]), UP
    _, before = NormalMaps.of(scene).look_up(np.zeros(1, np.int32), *at, side)
    _, after = NormalMaps.of(turned).look_up(np.zeros(1, np.int32), *at[::-1], side)
    assert after == pytest.approx(before)


def bake_lighting(folder, scene, **settings):
    """(h, w) of a page that the square fills but for its rim."""
    settings = {"error": 0.05, **settings}
    chosen = Settings(size=16, padding=1, workers=1, max_photons=20_000, passes=("lighting",), sides="front", **settings)
    bake_folder(folder, scene, chosen)
    [path] = (folder / "images").glob("*.exr")
    return read_image(path)[0][4:-4, 4:-4, 0]


@pytest.mark.usefixtures("open_image_io")
@pytest.mark.parametrize(("direct", "within"), [("rays", 2e-3), ("photons", 0.02)])
@pytest.mark.parametrize("tilt", [0.5, 1.2])
def test_direct_light_is_that_on_the_normal_of_the_map(tmp_path, tilt, direct, within):
    normal = (math.sin(tilt), 0.0, math.cos(tilt))
    page = bake_lighting(tmp_path / "tilted", tilted_scene(normal, normal, lights=[SUN]), direct=direct)
    assert page.mean() == pytest.approx(2.0 * light_at_45_degrees(tilt) / math.pi, rel=within)


def light_at_45_degrees(tilt):
    """Of light that comes at 45 degrees, on a normal that is tilted towards it."""
    roughness = min(math.tan(tilt) ** 2 / 8, 1.0)
    return math.cos(math.pi / 4 - tilt) * 2.0 / (1.0 + math.sqrt(1.0 + roughness))  # 45 degrees have a tangent of 1


@pytest.mark.parametrize("tilt", [0.0, 0.5, 1.2])
def test_photons_bring_what_the_normal_of_the_map_sees(tilt):
    """And leave with that, so that light which bumps hide is not reflected."""
    normal = (math.sin(tilt), 0.0, math.cos(tilt))
    maps, tri, where = NormalMaps.of(tilted_scene(normal, normal)), np.zeros(1, np.int32), np.float32([0.3])
    rows, worth = maps.weigh(tri, where, where, UP, np.float32([[-math.sqrt(0.5)], [0.0], [-math.sqrt(0.5)]]))
    assert rows.tolist() == [0]
    assert worth * math.sqrt(0.5) == pytest.approx(light_at_45_degrees(tilt), rel=1e-4)


@pytest.mark.parametrize("tilt", [0.5, 1.2])
def test_a_surface_reflects_the_light_on_the_normals_of_its_map(tilt):
    """Also where they see more of it than the surface: then one photon brings the light of more."""
    normal = (math.sin(tilt), 0.0, math.cos(tilt))
    scene = tilted_scene(normal, normal, lights=[SUN])
    albedo = 0.8

    def escape(reflectance):
        snapshot = replace(scene, materials=(replace(scene.materials[0], albedo_rgb=(reflectance,) * 3),))
        settings = Settings(size=16, padding=1, workers=1, error=0.01, max_photons=60_000, direct="photons", sides="front")
        energy = solve(snapshot, settings).report["energy_audit_w"]
        return energy["escaped"][0] / energy["emitted"][0]

    missed = escape(0.0)
    worth = light_at_45_degrees(tilt) / math.sqrt(0.5)
    assert escape(albedo) - missed == pytest.approx(albedo * worth * (1.0 - missed), rel=0.02)


@pytest.mark.usefixtures("open_image_io")
def test_texels_of_many_bumps_have_the_mean_of_their_light(tmp_path):
    """Not the light on their mean normal, here a fifth more."""
    bumps = [(math.sin(tilt), 0.0, math.cos(tilt)) for tilt in (0.0, 1.2)] * 40
    page = bake_lighting(tmp_path / "many", tilted_scene(*bumps, lights=[Light("SUN", "Sun", power_rgb=(math.pi,) * 3)]))
    mean = (1.0 + math.cos(1.2)) / 2.0
    assert page.mean() == pytest.approx(mean, rel=0.04)


@pytest.mark.usefixtures("open_image_io")
@pytest.mark.parametrize("kind", ["albedo", "metal"])
def test_a_texel_counts_its_bumps_by_what_they_reflect(tmp_path, kind):
    """A dark groove that leans away from the light, or one of metal, takes less part in what is seen of the texel."""
    tilts, shares = (0.0, 1.2), (0.8, 0.2)
    bumps = [(math.sin(tilt), 0.0, math.cos(tilt)) for tilt in tilts] * 40
    scene = tilted_scene(*bumps, lights=[Light("SUN", "Sun", power_rgb=(math.pi,) * 3)])
    pattern = np.repeat(np.float32(shares if kind == "albedo" else (0.2, 0.8)), 3).reshape(1, 2, 3).repeat(40, axis=0).reshape(1, 80, 3)
    images = (*scene.images, TextureImage("pattern", pattern, "EXTEND", closest=True))
    material = replace(scene.materials[0], **{"albedo_rgb": (1.0,) * 3, f"{kind}_image": 1, f"{kind}_rgb": (1.0,) * 3})
    uv = {"tri_albedo_uv": scene.tri_normal_uv, "tri_metal_uv": scene.tri_normal_uv}
    page = bake_lighting(tmp_path / "many", replace(scene, images=images, materials=(material,), **uv), error=0.003)
    assert page.mean() == pytest.approx(np.average(np.cos(tilts), weights=shares), rel=0.01)


def bake_texels(tilts, error=0.01, denoise=True):
    """Light (16, 16) from straight above on a map of columns that are tilted so, and its stated error; a layer fills the page."""
    bumps = list(zip(np.sin(tilts), np.zeros(len(tilts)), np.cos(tilts), strict=True))
    scene = tilted_scene(*bumps, lights=[Light("SUN", "Sun", power_rgb=(math.pi,) * 3)])
    scene = replace(scene, objects=(replace(scene.objects[0], has_layer=True),))
    light = solve(scene, Settings(size=16, workers=1, error=error, passes=("lighting",), sides="front", denoise=denoise))
    return light.pages["lighting"][0, :, :, 0], light.error


@pytest.mark.parametrize(("error", "denoise"), [(0.05, False), (0.01, False), (0.005, True)])
def test_light_of_texels_with_many_bumps_is_as_noisy_as_is_stated(error, denoise):
    """Also where the few first rays of a texel meet normals that are alike by chance."""
    tilts = np.random.default_rng(2).uniform(0.0, 1.2, (16, 100))
    page, stated = bake_texels(tilts.ravel(), error, denoise)
    light = np.cos(tilts[:, 25:75]).mean(axis=1)  # of the middle half, which is a texel's footprint
    off = (page / light - 1)[2:-2, 2:-2]
    assert np.abs(off.mean()) < 0.005
    assert 0.5 < np.sqrt((off**2).mean()) / stated < 1.5


def test_what_is_regular_in_a_map_is_not_missed():
    """Of four columns within each texel's footprint two lean, all of which points of a regular grid would meet."""
    page, _ = bake_texels(np.where(np.isin(np.arange(16 * 8) % 8, (2, 5)), 1.0, 0.0))
    assert page[2:-2, 2:-2].mean() == pytest.approx((1.0 + math.cos(1.0)) / 2.0, rel=0.02)
