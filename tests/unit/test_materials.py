"""Colours and normals out of constants, images and maps."""

import dataclasses
import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from boxes import bake_folder
from leaflight.core import solve
from leaflight.core.output.image_file import read_image
from leaflight.core.scene import materials
from leaflight.core.scene.normal_maps import NormalMaps
from leaflight.core.scene.scene import MAX_ALBEDO, Light, Material, SceneSnapshot, TextureImage
from leaflight.core.scene.sides import turn
from leaflight.core.scene.textures import Textures, clamp_colours, sample_texture
from leaflight.core.util.settings import Settings
from scenes import Mesh, make_scene, quad_mesh

# 3 texels wide, 5 high: a swapped axis cannot pass
PIXELS = np.random.default_rng(1).random((5, 3, 3)).astype(np.float32)
TEXTURE = TextureImage("Checks", PIXELS)
CENTRES = np.stack(np.meshgrid((np.arange(3) + 0.5) / 3, (np.arange(5) + 0.5) / 5), axis=-1).reshape(-1, 2)


def _scene(*surfaces: Material, images=(TEXTURE,), uv=((0, 0), (1, 0), (0, 1))) -> SceneSnapshot:
    """One triangle per material; texture UV equals barycentric (u, v)."""
    n = len(surfaces)
    tri_uv = np.tile(np.float32(uv), (n, 1, 1))
    scene = make_scene([Mesh("Object", np.tile(np.eye(3), (n, 1)), np.arange(3 * n).reshape(n, 3).tolist())])
    uvs = {"tri_albedo_uv": tri_uv, "tri_emission_uv": tri_uv[:, :, ::-1].copy()}
    return dataclasses.replace(scene, tri_material=np.arange(n, dtype=np.int32), materials=surfaces, images=images, **uvs)


def _at(scene, quantity, tri, u=0.2, v=0.3):
    tri = np.atleast_1d(tri)
    u, v = np.broadcast_to(np.float32(u), tri.shape), np.broadcast_to(np.float32(v), tri.shape)
    return getattr(materials.SurfaceMaterials(scene), quantity).at(tri, u, v)


def test_constant_materials():
    scene = _scene(Material("A", (0.1, 0.2, 0.3)), Material("B", (0.5, 0.6, 0.7), emission_rgb=(4, 50, 600)))
    albedo = _at(scene, "albedo", np.array([1, 0, 1]))
    assert albedo.dtype == np.float32
    assert albedo.T.flags.c_contiguous
    np.testing.assert_array_equal(albedo, np.float32([[0.5, 0.6, 0.7], [0.1, 0.2, 0.3], [0.5, 0.6, 0.7]]))
    np.testing.assert_array_equal(_at(scene, "emission", np.array([1, 0])), [[4, 50, 600], [0, 0, 0]])


def test_hits_of_constant_and_textured_materials_mix():
    scene = _scene(Material("A", (0.1, 0.2, 0.3)), Material("B", (0.5, 1, 0), albedo_image=0))
    u, v = CENTRES[:6].T.astype(np.float32)
    albedo = materials.SurfaceMaterials(scene).albedo.at(np.array([1, 0, 1, 1, 0, 1]), u, v)
    expected = PIXELS.reshape(-1, 3)[:6] * np.float32([0.5, 1, 0])
    expected[[1, 4]] = [0.1, 0.2, 0.3]
    np.testing.assert_allclose(albedo, expected, atol=1e-6)


def test_emission_has_its_own_uv_and_may_exceed_one():
    scene = _scene(Material("Lamp", emission_rgb=(10, 20, 30), emission_image=0))
    emission = _at(scene, "emission", 0, u=0.5 / 5, v=2.5 / 3)  # the UV is (v, u)
    np.testing.assert_allclose(emission[0], PIXELS[0, 2] * [10, 20, 30], rtol=1e-5)


@pytest.mark.parametrize("values", [(1.0, 3.0, -2.0), (np.nan, np.inf, -np.inf)])
@pytest.mark.parametrize("image", [-1, 0])
def test_values_beyond_physics_are_clamped(values, image):
    white = TextureImage("White", np.ones((1, 1, 3), np.float32))
    scene = _scene(Material("Odd", values, image, values, image), images=(white,))
    finite = np.nan_to_num(np.float64(values), nan=0, posinf=0, neginf=0)
    np.testing.assert_allclose(_at(scene, "albedo", 0)[0], finite.clip(0, MAX_ALBEDO), rtol=1e-6)
    np.testing.assert_allclose(_at(scene, "emission", 0)[0], finite.clip(0), rtol=1e-6)
    assert [name for name, _ in materials.clamp_warnings(scene)] == ["Odd", "Odd"]


@pytest.mark.parametrize("count", [1, 64, 200])
@pytest.mark.parametrize("value", [-0.5, 7.0, np.nan])
def test_a_single_odd_pixel_is_told_wherever_it_lies(count, value):
    for place in {0, count // 2, count - 1}:
        pixels = np.full((1, count, 3), 0.5, np.float32)
        pixels[0, place, 1] = value
        scene = _scene(Material("Odd", (1, 1, 1), 0), images=(TextureImage("Picture", pixels),))
        ((_, told),) = materials.clamp_warnings(scene)
        ends = (min(value, 0.5), max(value, 0.5))
        assert ("is not a finite number" if np.isnan(value) else "reaches from {:.4g} to {:.4g}".format(*ends)) in told


def test_no_warning_within_range():
    scene = _scene(Material("Grey"), Material("Bright", (1, 1, 1), 0), Material("Lamp", emission_rgb=(1e6, 0, 0)))
    assert materials.clamp_warnings(scene) == []


def test_colours_of_corners_are_linear_between_and_warned_of_for_themselves_alone():
    corner = np.float32([[0.9, 0.0, 0.0], [0.0, 0.9, 0.0], [0.2, 0.0, 0.9]])
    texel = np.stack([corner[0], corner[1], corner[2], corner[1] + corner[2] - corner[0]]).reshape(2, 2, 3)
    assert texel.min() < 0
    image = TextureImage("vertex colours", texel, "EXTEND", per_triangle=True)
    uv = ((0.25, 0.25), (0.75, 0.25), (0.25, 0.75))
    scene = _scene(Material("A", (1, 1, 1), 0), Material("B", (2, 1, 1), 0), images=(image,), uv=uv)
    np.testing.assert_allclose(_at(scene, "albedo", 0)[0], [0.5, 0.2, 0.3] @ corner, atol=1e-6)
    ((name, sentence),) = materials.clamp_warnings(scene)
    assert name == "B"
    assert sentence == "B: its albedo with vertex colours reaches from 0 to 1.8 and is clamped to 0 ... 0.999; choose values within."


def test_a_white_surface_is_no_matter_and_a_whiter_one_is_told():
    """Vertex colours, for one, are white until they are painted."""
    white = TextureImage("vertex colours", np.ones((2, 2, 3), np.float32), "EXTEND", per_triangle=True)
    scene = _scene(Material("Chalk", (1, 1, 1)), Material("Paint", (1, 1, 1), 0), Material("Glow", (1.01, 1, 1)), images=(white,))
    np.testing.assert_allclose([_at(scene, "albedo", 0)[0]], MAX_ALBEDO, rtol=1e-6)
    ((name, sentence),) = materials.clamp_warnings(scene)
    assert name == "Glow"
    assert sentence == "Glow: its albedo reaches from 1 to 1.01 and is clamped to 0 ... 0.999; choose values within."


EXTENSIONS = ("REPEAT", "EXTEND", "CLIP", "MIRROR")


def test_an_image_without_texels_is_black():
    assert not sample_texture(TextureImage("Empty", np.zeros((0, 0, 3), np.float32)), CENTRES).any()


def test_uv_that_is_not_finite_gives_finite_colours():
    uv = np.array([[np.nan, 0.5], [np.inf, -np.inf], [1e30, -1e30]])
    for extension in EXTENSIONS:
        for closest in (False, True):
            image = dataclasses.replace(TEXTURE, extension=extension, closest=closest)
            assert np.isfinite(sample_texture(image, uv)).all()


@pytest.mark.parametrize("closest", [False, True])
@pytest.mark.parametrize("extension", EXTENSIONS)
def test_texel_centres_give_texels(extension, closest):
    image = dataclasses.replace(TEXTURE, extension=extension, closest=closest)
    np.testing.assert_allclose(sample_texture(image, CENTRES), PIXELS.reshape(-1, 3), atol=1e-6)


def test_between_centres_is_bilinear_and_closest_is_not():
    between = np.array([[1.0 / 3, 1.75 / 5]])  # half way from column 0 to 1, a quarter of the way from row 1 to 2
    blended = 0.75 * (PIXELS[1, 0] + PIXELS[1, 1]) / 2 + 0.25 * (PIXELS[2, 0] + PIXELS[2, 1]) / 2
    np.testing.assert_allclose(sample_texture(TEXTURE, between)[0], blended, atol=1e-6)
    closest = dataclasses.replace(TEXTURE, closest=True)
    np.testing.assert_array_equal(sample_texture(closest, np.add(between, (0.01, 0)))[0], PIXELS[1, 1])


OUTSIDE = {  # texel (column, row) found at column -2 of row 1, and at column 4 of row 6
    "REPEAT": ((1, 1), (1, 1)),
    "EXTEND": ((0, 1), (2, 4)),
    "CLIP": (None, None),
    "MIRROR": ((1, 1), (1, 3)),
}


@pytest.mark.parametrize("closest", [False, True])
@pytest.mark.parametrize("extension", OUTSIDE)
def test_outside_the_image(extension, closest):
    image = dataclasses.replace(TEXTURE, extension=extension, closest=closest)
    found = sample_texture(image, np.array([[-1.5 / 3, 1.5 / 5], [4.5 / 3, 6.5 / 5]]))
    expected = [np.zeros(3) if place is None else PIXELS[place[1], place[0]] for place in OUTSIDE[extension]]
    np.testing.assert_allclose(found, expected, atol=1e-6)


EDGE = {"REPEAT": PIXELS[0, 2], "EXTEND": PIXELS[0, 0], "CLIP": np.zeros(3), "MIRROR": PIXELS[0, 0]}


@pytest.mark.parametrize("extension", EDGE)
def test_the_edge_blends_with_what_lies_beyond(extension):
    image = dataclasses.replace(TEXTURE, extension=extension)
    found = sample_texture(image, np.array([[0.0, 0.5 / 5]]))[0]
    np.testing.assert_allclose(found, (PIXELS[0, 0] + EDGE[extension]) / 2, atol=1e-6)


def _kinds(count):
    """So many images of each extension and interpolation, of many sizes, one of them without texels."""
    rng = np.random.default_rng(3)
    kinds = [kind for kind in itertools.product(EXTENSIONS, (False, True)) for _ in range(count)]
    shapes = [(0, 0, 3), *((*rng.integers(1, 40, 2), 3) for _ in kinds[1:])]
    return [
        TextureImage(f"Picture {k}", rng.random(shape).astype(np.float32), *kind)
        for k, (shape, kind) in enumerate(zip(shapes, kinds, strict=True))
    ]


@pytest.mark.parametrize("lie_together", [False, True])
@pytest.mark.parametrize("count", [1, 7])
def test_many_images_are_looked_up_as_each_alone(count, lie_together):
    images = _kinds(count)
    if lie_together:
        parts = np.split(
            np.concatenate([image.pixels.ravel() for image in images]), np.cumsum([image.pixels.size for image in images])[:-1]
        )
        images = [dataclasses.replace(image, pixels=part.reshape(image.pixels.shape)) for image, part in zip(images, parts, strict=True)]
    rng = np.random.default_rng(4)
    image = rng.integers(0, len(images), 5000)
    uv = (rng.standard_normal((5000, 2)) * rng.choice([0.5, 3, 1e3, 1e9], (5000, 1))).astype(np.float32)
    uv[::97, 0] = np.nan
    found = Textures(images).at(image, uv)
    assert found.dtype == np.float32
    assert found.T.flags.c_contiguous
    for number, own in enumerate(images):
        np.testing.assert_array_equal(found[image == number], sample_texture(own, uv[image == number]))


@pytest.mark.parametrize("closest", [False, True])
@pytest.mark.parametrize("extension", EXTENSIONS)
def test_the_edge_of_an_image_never_shows_the_next_one(extension, closest):
    """Where rounding gives a place past the last texel, too."""
    images = [TextureImage(str(value), np.full((300, 300, 3), value, np.float32), extension, closest) for value in (0.25, 0.75)]
    ends = (0.0, np.nextafter(np.float32(1), np.float32(0)), 1.0, -1e-9)
    uv = np.float32(list(itertools.product(ends, ends)))
    for number, value in enumerate((0.25, 0.75)):
        found = Textures(images).at(np.full(len(uv), number), uv)
        shown = found if extension != "CLIP" else found.max(axis=0)  # beyond the image that shows nothing
        np.testing.assert_allclose(shown, value if extension != "CLIP" or closest else value / 4, rtol=1e-3)


def test_colours_are_clamped_and_odd_ones_are_black():
    values = np.float32([[-1.0, 0.5, 2.0], [np.nan, np.inf, -np.inf]])
    np.testing.assert_array_equal(clamp_colours(values, 0.75), np.float32([[0, 0.5, 0.75], [0, 0, 0]]))
    np.testing.assert_array_equal(clamp_colours(values[:1], np.inf), np.float32([[0, 0.5, 2.0]]))
    assert np.isnan(values[1, 0])  # what was asked is left as it is


# Normals out of images, on the side of the surface that is asked for; and what steep bumps hide of each other.
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


@pytest.mark.usefixtures("open_image_io")
@pytest.mark.parametrize(("direct", "within"), [("rays", 2e-3), ("photons", 0.02)])
@pytest.mark.parametrize("lean", [0.7, 1.2])
def test_a_map_without_bumps_changes_no_smooth_surface(tmp_path, lean, direct, within):
    """However far normals between the corners lean from the face: bumps hide light by how far they lean from those."""
    normal = (math.sin(lean), 0.0, math.cos(lean))
    scene = tilted_scene((0.5, 0.5, 1.0), (0.5, 0.5, 1.0), lights=[SUN])
    smooth = replace(scene, tri_normal=np.broadcast_to(np.float32(normal), (2, 3, 3)).copy(), materials=(Material("Plain"),))
    frame = np.float32([(math.cos(lean), 0.0, -math.sin(lean)), (0.0, 1.0, 0.0), normal])
    material = Material("Bumpy", normal_image=0, normal_strength=1.0)
    bumpy = replace(smooth, materials=(material,), tri_tangents=np.broadcast_to(frame, (2, 3, 3, 3)).copy())
    plain, mapped = (bake_lighting(tmp_path / name, one, direct=direct).mean() for name, one in (("plain", smooth), ("mapped", bumpy)))
    assert mapped == pytest.approx(plain, rel=within)


def light_at_45_degrees(tilt):
    """Of light that comes at 45 degrees, on a normal that is tilted towards it."""
    roughness = min(math.tan(tilt) ** 2 / 8, 1.0)
    return math.cos(math.pi / 4 - tilt) * 2.0 / (1.0 + math.sqrt(1.0 + roughness))  # 45 degrees have a tangent of 1


@pytest.mark.parametrize("tilt", [0.0, 0.5, 1.2])
def test_photons_bring_what_the_normal_of_the_map_sees(tilt):
    """And leave with that, so that light which bumps hide is not reflected."""
    normal = (math.sin(tilt), 0.0, math.cos(tilt))
    maps, tri, where = NormalMaps.of(tilted_scene(normal, normal)), np.zeros(1, np.int32), np.float32([0.3])
    rows, worth = maps.weigh(tri, where, where, UP, UP, np.float32([[-math.sqrt(0.5)], [0.0], [-math.sqrt(0.5)]]))
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
    page = bake_lighting(tmp_path / "many", replace(scene, images=images, materials=(material,), **uv), error=0.008)
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
