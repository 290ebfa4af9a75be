"""Files that went through a scene's colour management."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blend_rooms import bake, list_files, open_room, read_pixels, read_report, save_scene
from leaflight.addon.show import image_views

HALF_STEP = 0.51 / 255


@pytest.fixture
def room(tmp_path):
    open_room()
    view = bpy.context.scene.view_settings
    view.view_transform, view.exposure = "Standard", 1.0
    return save_scene(tmp_path / "room.blend")


def stored(path):
    """What stands in a PNG file, in [0, 1]."""
    image = bpy.data.images.load(str(path))
    image.alpha_mode = "CHANNEL_PACKED"
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    return pixels.reshape(image.size[1], image.size[0], -1)


def to_srgb(linear):
    linear = np.clip(linear, 0.0, 1.0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def test_exposure_and_curve_are_those_of_the_scene(room):
    """A stop up, in the margin too, where alpha is 0; no dithering. The plain PNG beside it is not."""
    assert bake(room, "--format", "png", "exr", "--png-view", "scene", "--pass", "combined", "level") == 0
    folder = room.parent / "maps"
    names = [f"room_0.{name}.{end}" for name in ("combined", "level") for end in ("exr", "png")]
    assert list_files(folder) == names
    light = read_pixels(folder / "room_0.combined.exr")
    picture = stored(folder / "room_0.combined.png")
    margin = (light[..., 3] == 0) & (light[..., 0] > 0)
    assert margin.any()
    assert picture.shape == (32, 32, 4)
    np.testing.assert_allclose(picture[..., :3], to_srgb(2 * light[..., :3]), atol=HALF_STEP)
    np.testing.assert_array_equal(picture[..., 3], light[..., 3])
    rows = {(file["pass_name"], file["kind"]): file for file in read_report(room)["files"]}
    assert rows["combined", "png"]["encoding"] == "the scene's view transform"
    assert rows["level", "png"]["encoding"] == "a picture, sRGB"
    assert all("linear" not in row for row in rows.values())


def test_the_scene_and_its_output_settings_stay(room, tmp_path):
    scene = bpy.context.scene
    scene.render.image_settings.file_format, scene.render.dither_intensity = "JPEG", 2.0
    image = bpy.data.images.new("a", 2, 2, float_buffer=True)
    image_views.save_view(image, tmp_path / "a.png", scene)
    assert (scene.render.image_settings.file_format, scene.render.dither_intensity) == ("JPEG", 2.0)
    assert list(bpy.data.scenes) == [scene]
    assert list_files(tmp_path) == ["a.png", "room.blend"]


def test_curves_are_applied(room, tmp_path):
    view = bpy.context.scene.view_settings
    view.exposure, view.use_curve_mapping = 0.0, True
    view.curve_mapping.curves[3].points[1].location = (1.0, 0.5)  # of all channels
    view.curve_mapping.update()
    image = bpy.data.images.new("a", 2, 2, float_buffer=True)
    image.colorspace_settings.name = "Linear Rec.709"
    image.pixels.foreach_set(np.tile(np.float32([0.8, 0.8, 0.8, 1.0]), 4))
    image_views.save_view(image, tmp_path / "a.png", bpy.context.scene)
    np.testing.assert_allclose(stored(tmp_path / "a.png")[..., :3], to_srgb(0.4), atol=0.01)


def test_what_is_no_folder_is_a_sentence(room, tmp_path):
    image = bpy.data.images.new("a", 2, 2, float_buffer=True)
    with pytest.raises(OSError, match=r"a\.png: cannot be written \(.+\); choose a folder that can be written to\."):
        image_views.save_view(image, room / "a.png", bpy.context.scene)
    assert len(bpy.data.scenes) == 1
