import dataclasses

import numpy as np
import pytest
from leaflight.core.scene import materials
from leaflight.core.scene.scene import MAX_ALBEDO, Material, SceneSnapshot, TextureImage
from scenes import Mesh, make_scene

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
