"""Light between the pixels of coarse 8 bit images is that of Cycles, which takes the mean of sRGB bytes."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blend_nodes import add_glow, bake_emission
from leaflight.addon.nodes.images_read import ImageTable
from leaflight.addon.nodes.srgb_filtering import refine_srgb
from leaflight.addon.read.export_scene import export_scene
from leaflight.core.scene.textures import sample_texture

pytestmark = pytest.mark.usefixtures("empty_file")

SIDE = 64


def show_image(width=5, height=3, space="sRGB", floating=False, is_packed=True, alpha=0, uses_alpha=False, alpha_mode="STRAIGHT", **looks):
    """A plane that emits an image of random colours, three times as often; its node.

    alpha   1 for random alpha, 2 for an alpha of 0 and 1
    """
    bpy.ops.mesh.primitive_plane_add()
    layer = bpy.context.object.data.uv_layers.active.uv
    layer.foreach_set("vector", np.float32([[0, 0], [1.5, 0], [1.5, 1.5], [0, 1.5]]).ravel())
    image = bpy.data.images.new("Colours", width, height, alpha=bool(alpha), float_buffer=floating)
    image.colorspace_settings.name = space
    pixels = np.ones((height, width, 4), np.float32)
    rng = np.random.default_rng(3)
    pixels[..., :3] = rng.random((height, width, 3))
    if alpha:
        pixels[..., 3] = rng.random((height, width)) if alpha == 1 else rng.integers(0, 2, (height, width))
    image.pixels.foreach_set(pixels.ravel())
    if is_packed:
        image.pack()
    image.alpha_mode = alpha_mode
    tree, color = add_glow(bpy.context.object.data)
    texture = tree.nodes.new("ShaderNodeTexImage")
    texture.image = image
    for name, value in looks.items():
        setattr(texture, name, value)
    tree.links.new(texture.outputs["Color"], color)
    if uses_alpha:
        strength = color.node.inputs["Strength"]
        tree.links.new(texture.outputs["Alpha"], strength if uses_alpha != "nowhere" else tree.nodes.new("ShaderNodeMath").inputs[0])
    return texture


def bake_page(tree):
    """(SIDE, SIDE, 3): the plane's emission by Cycles, at the middles of texels."""
    layers = bpy.context.object.data.uv_layers
    layers.new(name="Page").uv.foreach_set("vector", np.float32([0, 0, 1, 0, 1, 1, 0, 1]))
    layers["Page"].active = True
    return bake_emission(bpy.context.object, tree, SIDE)[..., :3]


@pytest.mark.parametrize(
    "image",
    [
        {},
        {"extension": "EXTEND"},
        {"extension": "MIRROR"},
        {"interpolation": "Closest"},
        {"floating": True},
        {"space": "Non-Color"},
        {"width": 1},
        {"is_packed": False},  # painted, and in no file
        {"alpha": 1},
        {"alpha": 1, "interpolation": "Closest"},
        {"alpha": 1, "alpha_mode": "CHANNEL_PACKED"},
        {"alpha": 1, "alpha_mode": "NONE"},
        {"alpha": 1, "space": "Non-Color"},
        {"alpha": 1, "floating": True, "alpha_mode": "PREMUL"},
        {"alpha": 1, "uses_alpha": True},
        {"alpha": 2, "uses_alpha": True},
        {"alpha": 1, "uses_alpha": "nowhere"},
        {"alpha": 1, "uses_alpha": True, "floating": True, "alpha_mode": "PREMUL"},
    ],
    ids=str,
)
def test_light_between_pixels_is_that_of_cycles(image):
    texture = show_image(**image)
    scene = export_scene(bpy.context).snapshot
    place = 1.5 * (np.mgrid[0:SIDE, 0:SIDE] + 0.5) / SIDE
    found = sample_texture(scene.images[scene.materials[0].emission_image], place[::-1].reshape(2, -1).T).reshape(SIDE, SIDE, 3)
    off = np.abs(found - bake_page(texture.id_data))
    assert np.quantile(off, 0.98) < 0.01  # 0.3 where light is interpolated; beside that, on the edges of pixels


def test_an_image_that_gains_nothing_stays_as_it_is():
    rng = np.random.default_rng(1)
    gentle, large = 0.5 + 0.02 * rng.random((8, 8, 3), np.float32), rng.random((4, 600, 3), np.float32)
    harsh = np.repeat(np.indices((8, 8)).sum(axis=0)[..., None] % 2, 3, axis=2).astype(np.float32)
    assert refine_srgb(gentle, "REPEAT") is gentle
    assert refine_srgb(large, "REPEAT") is large
    assert refine_srgb(harsh, "CLIP") is harsh
    assert refine_srgb(harsh, "REPEAT").shape == (72, 72, 3)


@pytest.mark.parametrize("most", [4096, 256])
def test_a_large_image_has_the_mean_light_of_cycles(most):
    texture = show_image(600, 600)
    pixels = np.float32(bake_page(texture.id_data))  # 9 of its texels in one
    table = ImageTable(most)
    table.read(texture.image, 0)
    shown = table.images[table.index(texture.image, 0, "REPEAT", False)].pixels
    assert shown.mean(axis=(0, 1)) == pytest.approx(pixels.mean(axis=(0, 1)), rel=0.02)  # 0.17 more between pixels of linear light
