"""Image files are read without Blender to the same pixels, and no finer than is asked for."""

import sys
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blend_rooms import add_mesh, make_material
from leaflight.addon.app.job import library_paths
from leaflight.addon.nodes import image_files, socket_bake
from leaflight.addon.nodes.images_read import ImageTable, read_pixels
from leaflight.addon.read.export_scene import export_scene
from leaflight.core.output import image_file


@pytest.fixture(autouse=True)
def open_image_io(monkeypatch):
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    monkeypatch.setattr(sys, "path", [*sys.path, *library_paths()])
    image_file.load_ahead()


def write_file(path, height=6, width=10, channels=3, seed=1):
    """A file of noise, as Blender loads it later: not loaded yet."""
    rng = np.random.default_rng(seed)
    image = bpy.data.images.new("noise", width, height, alpha=channels == 4)
    pixels = np.ones((height, width, 4), np.float32)
    pixels[..., : max(channels, 3)] = rng.integers(0, 256, (height, width, max(channels, 3))) / np.float32(255)
    image.pixels.foreach_set(pixels.ravel())
    image.filepath_raw, image.file_format = str(path), "JPEG" if path.suffix == ".jpg" else "PNG"
    image.save()
    bpy.data.images.remove(image)
    return bpy.data.images.load(str(path))


def wear(image, name="Base Color"):
    material = make_material("Worn")
    tree = material.node_tree
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image = image
    tree.links.new(tree.nodes["Principled BSDF"].inputs[name], node.outputs["Color"])
    return material


@pytest.mark.parametrize("space", ["sRGB", "Non-Color", "Linear Rec.709"])
@pytest.mark.parametrize(("name", "channels"), [("a.png", 3), ("a.png", 4), ("a.jpg", 3)])
@pytest.mark.parametrize("most", [4096, 5])
def test_a_file_has_the_pixels_that_blender_has(tmp_path, space, name, channels, most):
    image = write_file(tmp_path / name, channels=channels)
    image.colorspace_settings.name = space
    table = ImageTable(most)
    table.files.begin([wear(image)])
    mine = table.read(image, 0)
    assert not image.has_data  # Blender has not read it
    assert len(image.pixels) > 0
    theirs = read_pixels(image, most)
    np.testing.assert_allclose(mine.pixels, theirs.pixels, atol=2 / 255 if name.endswith("jpg") else 1e-6)
    assert mine.pixels.shape == ((6, 10, 3) if most > 10 else (3, 5, 3))
    np.testing.assert_allclose(mine.mean, theirs.mean, atol=5e-3)
    assert (mine.alpha is None) == (channels == 3)
    if channels == 4:
        np.testing.assert_allclose(mine.alpha, theirs.alpha, atol=1e-6)


def test_bytes_are_averaged_as_light(tmp_path):
    """Black and white texels of sRGB come out as half the light, which is 0.735 in sRGB, not 0.5."""
    board = np.indices((4, 8)).sum(axis=0) % 2 * 255
    color, alpha = image_files.convert_bytes(board[..., None].repeat(3, axis=2).astype(np.uint8), True, True, 4)
    np.testing.assert_allclose(color, 0.5, atol=1e-6)
    assert color.shape == (4, 4, 3)
    assert alpha is None


@pytest.mark.parametrize("channels", [1, 3, 4])
@pytest.mark.parametrize(
    ("height", "width", "most"), [(7, 5, 3), (9, 16, 4), (1, 3, 2), (64, 64, 16), (12, 10, 6), (11, 2, 6), (30, 1000, 500)]
)
def test_incomplete_blocks_are_averages_of_what_they_have(height, width, most, channels):
    stored = np.random.default_rng(3).integers(0, 256, (height, width, channels)).astype(np.uint8)
    table = np.arange(256, dtype=np.float32)
    found = image_files.reduce_bytes(stored, table, most)
    tall, wide = -(-height // most), -(-width // most)
    ends = [range(0, length, step) for length, step in ((height, tall), (width, wide))]
    sums = np.add.reduceat(np.add.reduceat(stored.astype(float), ends[0], axis=0), ends[1], axis=1)
    texels = [np.diff([*steps, length]) for steps, length in zip(ends, (height, width), strict=True)]
    np.testing.assert_allclose(found, sums / np.multiply.outer(*texels)[..., None], rtol=1e-5)


def test_only_what_colours_a_material_is_read_ahead(tmp_path):
    color, rough = write_file(tmp_path / "color.png"), write_file(tmp_path / "rough.png", seed=2)
    material = wear(color)
    tree = material.node_tree
    node, gamma = tree.nodes.new("ShaderNodeTexImage"), tree.nodes.new("ShaderNodeGamma")
    node.image = rough
    tree.links.new(tree.nodes["Principled BSDF"].inputs["Roughness"], node.outputs["Color"])
    tree.links.new(gamma.inputs["Color"], tree.nodes["Principled BSDF"].inputs["Base Color"].links[0].from_socket)
    tree.links.new(tree.nodes["Principled BSDF"].inputs["Base Color"], gamma.outputs["Color"])
    assert image_files.list_images([material, None]) == [color]


@pytest.mark.parametrize("name", ["a.png", "a.jpg"])
def test_a_packed_file_has_the_pixels_that_blender_has(tmp_path, name):
    image = write_file(tmp_path / name)
    image.pack()
    (tmp_path / name).unlink()
    table = ImageTable(5)
    mine = table.read(image, 0)
    assert not image.has_data
    np.testing.assert_allclose(mine.pixels, read_pixels(image, 5).pixels, atol=2 / 255 if name.endswith("jpg") else 1e-6)


def test_a_file_is_read_where_blender_has_it_already(tmp_path):
    image = write_file(tmp_path / "a.png")
    assert len(image.pixels)
    assert image_files.find_source(image) == str(tmp_path / "a.png")


@pytest.mark.parametrize("case", ["painted", "painted and packed", "gone", "premultiplied", "another space"])
def test_what_blender_alone_knows_is_left_to_it(tmp_path, case):
    image = write_file(tmp_path / "a.png", channels=4)
    if case.startswith("painted"):
        if case.endswith("packed"):
            image.pack()
        image.pixels[0] = 0.25
    elif case == "gone":
        (tmp_path / "a.png").unlink()
    elif case == "premultiplied":
        image.alpha_mode = "PREMUL"
    else:
        image.colorspace_settings.name = "Linear Rec.2020"
    assert image_files.find_source(image) == ""


def test_no_image_is_read_while_cycles_bakes(tmp_path, monkeypatch):
    """Blender crashes now and then where Python's threads run meanwhile; what was not read yet is read afterwards."""
    read, finished, beside = image_files.read_file, [], []

    def read_slowly(source, *how):
        time.sleep(0.3)
        finished.append(source)
        return read(source, *how)

    monkeypatch.setattr(image_files, "read_file", read_slowly)
    monkeypatch.setattr(image_files, "_MOST_THREADS", 1)
    floor = add_mesh("A floor", [(0, 0, -1), (1, 0, -1), (1, 1, -1)], [(0, 1, 2)])  # made first, it is read first
    glow = make_material("Glow")
    checker = glow.node_tree.nodes.new("ShaderNodeTexChecker")
    glow.node_tree.links.new(checker.outputs["Color"], glow.node_tree.nodes["Principled BSDF"].inputs["Base Color"])
    floor.data.materials.append(glow)
    for number in range(8):
        square = add_mesh(f"Square {number}", [(0, 0, number), (1, 0, number), (1, 1, number)], [(0, 1, 2)])
        square.data.materials.append(wear(write_file(tmp_path / f"{number}.png", seed=number)))
        square.data.uv_layers.new(name="UVMap")

    def bake(**what):
        beside.append(([thread.name for thread in threading.enumerate() if "PoolExecutor" in thread.name], len(finished)))
        return bpy.ops.object.bake(**what)

    operators = SimpleNamespace(object=SimpleNamespace(bake=bake))
    monkeypatch.setattr(socket_bake, "bpy", SimpleNamespace(context=bpy.context, data=bpy.data, types=bpy.types, ops=operators))
    export_scene(bpy.context)
    assert beside
    assert beside[0][1] < 8, "all were read before, so this shows nothing"
    assert not any(names for names, _ in beside)
    assert len(finished) == 8
