"""Baked files as Blender images."""

from types import SimpleNamespace

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from leaflight.addon.show import images
from leaflight.core.util.settings import Settings

pytestmark = pytest.mark.usefixtures("empty_file")


PAGE = np.arange(3 * 5 * 4, dtype=np.float32).reshape(3, 5, 4) / 7.0  # 3 rows of 5: a swap of the two is seen


def read(image):
    values = np.empty(len(image.pixels), dtype=np.float32)
    image.pixels.foreach_get(values)
    return values.reshape(image.size[1], image.size[0], 4)


def write_file(path, file_format, page=PAGE):
    """A file by Blender's own writer, with values above 1 kept where the format holds them."""
    image = bpy.data.images.new("writer", page.shape[1], page.shape[0], float_buffer=True, is_data=True)
    image.pixels.foreach_set(page.ravel())
    scene = bpy.data.scenes.new("writer")
    scene.view_settings.view_transform = "Raw"
    scene.render.image_settings.file_format = file_format
    scene.render.image_settings.color_mode = "RGB"
    if file_format == "OPEN_EXR":
        scene.render.image_settings.color_depth = "32"
    image.save_render(str(path), scene=scene)
    bpy.data.images.remove(image)
    bpy.data.scenes.remove(scene)
    return path


def test_exr_is_linear_and_keeps_values_above_one(tmp_path):
    image = images.load_image(write_file(tmp_path / "a.exr", "OPEN_EXR"))
    assert (image.colorspace_settings.name, image.is_float, tuple(image.size)) == ("Linear Rec.709", True, (5, 3))
    assert image.alpha_mode == "CHANNEL_PACKED"
    np.testing.assert_allclose(read(image)[..., :3], PAGE[..., :3], rtol=1e-6)


@pytest.mark.parametrize(("suffix", "file_format", "color_space"), [(".png", "PNG", "sRGB"), (".hdr", "HDR", "Linear Rec.709")])
def test_color_space_of_each_format(tmp_path, suffix, file_format, color_space):
    image = images.load_image(write_file(tmp_path / f"a{suffix}", file_format), "Room light")
    assert (image.colorspace_settings.name, image.name) == (color_space, "Room light")


def test_second_load_reads_the_file_again(tmp_path):
    path = write_file(tmp_path / "a.exr", "OPEN_EXR")
    first = images.load_image(path)
    read(first)
    write_file(path, "OPEN_EXR", PAGE * 2)
    assert images.load_image(path) == first
    np.testing.assert_allclose(read(first)[..., :3], 2 * PAGE[..., :3], rtol=1e-6)
    assert len(bpy.data.images) == 1


def test_packed_images_live_without_their_file_and_are_read_again_from_it(tmp_path):
    path = write_file(tmp_path / "a.exr", "OPEN_EXR")
    image = images.load_image(path, pack=True)
    assert image.packed_file
    write_file(path, "OPEN_EXR", PAGE * 2)
    assert images.load_image(path, pack=True) == image
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "room.blend"))
    path.unlink()
    bpy.context.scene["keeps"] = image
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "room.blend"))
    np.testing.assert_allclose(read(bpy.data.images["a"])[..., :3], 2 * PAGE[..., :3], rtol=1e-6)


def test_an_image_that_was_packed_is_linked_again(tmp_path):
    path = write_file(tmp_path / "a.exr", "OPEN_EXR")
    images.load_image(path, pack=True)
    image = images.load_image(path)
    assert not image.packed_file
    np.testing.assert_allclose(read(image)[..., :3], PAGE[..., :3], rtol=1e-6)


@pytest.mark.parametrize(
    ("pass_name", "formats", "view", "shown"),
    [
        ("combined", ("exr",), "standard", "exr"),
        ("combined", ("rgbm", "png", "exr"), "standard", "png"),
        ("combined", ("png", "hdr"), "scene", "hdr"),
        ("combined", ("rgbm", "logluv"), "standard", ""),
        ("combined", ("png",), "scene", ""),
        ("level", ("exr", "png"), "scene", "png"),
        ("level", ("exr",), "scene", "exr"),
    ],
)
def test_what_materials_can_show(pass_name, formats, view, shown):
    settings = Settings(passes=(pass_name,), formats=formats, view_transform=view)
    assert images.find_shown_format(settings) == shown
    if shown:
        images.check_shown(settings)
    else:
        with pytest.raises(ValueError, match=r"formats: Blender's materials cannot show .* as light; add EXR to the formats"):
            images.check_shown(settings)


def test_an_image_the_user_loaded_from_the_same_file_is_not_taken(tmp_path):
    path = write_file(tmp_path / "a.exr", "OPEN_EXR")
    theirs = bpy.data.images.load(str(path))
    assert images.load_image(path) != theirs
    images.remove_unused_images()
    assert list(bpy.data.images) == [theirs]


def test_path_is_relative_in_a_saved_file(tmp_path):
    path = write_file(tmp_path / "a.exr", "OPEN_EXR")
    assert images.load_image(path).filepath == str(path.resolve())
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "room.blend"))
    assert images.load_image(path).filepath == "//a.exr"
    assert len(bpy.data.images) == 1


def test_missing_and_unknown_files_are_refused_with_a_sentence(tmp_path):
    with pytest.raises(ValueError, match=r"none\.exr: the baked image is missing"):
        images.load_image(tmp_path / "none.exr")
    with pytest.raises(ValueError, match=r"a\.gif: is not an EXR, HDR or PNG file"):
        images.load_image(tmp_path / "a.gif")


def test_set_pixels_shows_linear_light_right_side_up():
    image = images.preview_image("live", 5, 3)
    images.set_pixels(image, PAGE)
    np.testing.assert_array_equal(read(image), PAGE)
    assert (image.colorspace_settings.name, image.alpha_mode) == ("Linear Rec.709", "CHANNEL_PACKED")
    images.set_pixels(image, PAGE[..., :3].astype(np.float16))
    np.testing.assert_array_equal(read(image)[..., 3], 1.0)
    with pytest.raises(ValueError, match=r"expected pixels of shape \(3, 5, 4\), got \(5, 3, 4\)"):
        images.set_pixels(image, PAGE.transpose(1, 0, 2))


def window(*shadings, engine="BLENDER_EEVEE"):
    spaces = [SimpleNamespace(shading=SimpleNamespace(type=shading)) for shading in shadings]
    areas = [SimpleNamespace(type="VIEW_3D", spaces=SimpleNamespace(active=space)) for space in spaces]
    scene = SimpleNamespace(render=SimpleNamespace(engine=engine))
    return SimpleNamespace(scene=scene, screen=SimpleNamespace(areas=[*areas, SimpleNamespace(type="OUTLINER")]))


@pytest.mark.skipif(bpy.app.version < (5, 2, 0), reason="its EEVEE waits for a tag")
def test_only_views_of_eevee_follow_images_untold():
    assert images.follows_images([window("MATERIAL", "RENDERED"), window()])
    for other in (window("MATERIAL", "SOLID"), window("RENDERED", engine="CYCLES"), window("WIREFRAME")):
        assert not images.follows_images([window("MATERIAL"), other])


def test_only_unused_images_of_ours_are_removed():
    theirs, unused, kept = bpy.data.images.new("theirs", 1, 1), images.preview_image("unused", 1, 1), images.preview_image("kept", 1, 1)
    bpy.context.scene["keeps"] = kept
    assert unused.users == 0
    images.remove_unused_images()
    assert list(bpy.data.images) == sorted([theirs, kept], key=lambda image: image.name)


def test_a_link_to_itself_is_a_path_like_any_other(tmp_path):
    ring = tmp_path / "ring.exr"
    ring.symlink_to(ring)
    image = bpy.data.images.new("ring", 4, 4)
    image.source, image.filepath = "FILE", str(ring)
    assert images.find_path(image) == tmp_path.resolve() / "ring.exr"
