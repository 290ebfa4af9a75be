"""What Cycles has evaluated of a world is kept beside the images, and counts for as long as the world is the same."""

import os

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from leaflight.addon.app import session
from leaflight.addon.app.arguments import BakeRequest
from leaflight.addon.read.world_cache import MapCache
from leaflight.addon.read.world_read import read_world
from leaflight.core.util.files import load_arrays, save_whole
from leaflight.core.util.settings import Settings

pytestmark = pytest.mark.usefixtures("empty_file")


@pytest.fixture
def background(sky):
    """The background node of a world that shows a gradient, which only Cycles can evaluate."""
    _, tree, background = sky
    place, gradient = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeTexGradient")
    tree.links.new(place.outputs["Generated"], gradient.inputs["Vector"])
    tree.links.new(gradient.outputs["Color"], background.inputs["Color"])
    return background


def read(file):
    """The world with what `file` keeps, and what is to be kept then."""
    kept = MapCache(file)
    found = read_world(bpy.context.scene, [], kept=kept)
    kept.save()
    return found


def show_picture(background, path, value):
    """Mix a picture of one grey, from a file, into the world's colour."""
    tree = background.id_data
    save_picture(path, value)
    texture, mix = tree.nodes.new("ShaderNodeTexEnvironment"), tree.nodes.new("ShaderNodeMixRGB")
    texture.image = bpy.data.images.load(str(path))
    tree.links.new(background.inputs["Color"].links[0].from_socket, mix.inputs["Color1"])
    tree.links.new(texture.outputs["Color"], mix.inputs["Color2"])
    tree.links.new(mix.outputs[0], background.inputs["Color"])
    return texture.image


def save_picture(path, value):
    image = bpy.data.images.new("Grey", 8, 4)
    image.pixels = [value, value, value, 1.0] * 32
    image.filepath_raw, image.file_format = str(path), "PNG"
    image.save()
    bpy.data.images.remove(image)


def brighten(file):
    """Make what is kept twice as bright, by which a world that was not evaluated again is known."""
    save_whole(file, {key: 2 * one for key, one in load_arrays(file).items()})


def test_the_same_world_is_evaluated_once(background, tmp_path):
    file = tmp_path / "kept"
    first = read(file)
    again = read(file)
    assert np.array_equal(first.map, again.map)
    assert first.suns == again.suns
    brighten(file)
    assert np.array_equal(read(file).map, 2 * first.map)
    background.inputs["Strength"].default_value = 3.0
    assert np.allclose(read(file).map, 3 * first.map, rtol=1e-5)


def test_a_picture_counts_by_its_file(background, tmp_path):
    file = tmp_path / "kept"
    image = show_picture(background, tmp_path / "grey.png", 0.25)
    dark = read(file).map
    brighten(file)
    assert np.array_equal(read(file).map, 2 * dark)
    save_picture(tmp_path / "grey.png", 0.75)
    os.utime(tmp_path / "grey.png", (1, 1))
    image.reload()
    assert read(file).map.mean() > dark.mean() + 0.2


@pytest.mark.parametrize("change", ["painted", "missing", "driven", "object"])
def test_light_that_depends_on_more_is_not_kept(background, tmp_path, change):
    image = show_picture(background, tmp_path / "grey.png", 0.25)
    tree = background.id_data
    if change == "painted":
        image.pixels[0] = 1.0
    elif change == "missing":
        (tmp_path / "grey.png").unlink()
    elif change == "driven":
        background.inputs["Strength"].driver_add("default_value")
    else:
        place, gradient = (next(node for node in tree.nodes if node.type == kind) for kind in ("TEX_COORD", "TEX_GRADIENT"))
        tree.links.new(place.outputs["Object"], gradient.inputs["Vector"])
    read(tmp_path / "kept")
    assert not (tmp_path / "kept").exists()


@pytest.mark.parametrize("damage", ["cut off", "shape", "negative", "not a number", "double", "pickle", "large"])
def test_a_file_that_is_damaged_does_not_count(tmp_path, damage):
    file, sound = tmp_path / "kept", np.ones((4, 8, 3), np.float32)
    kept = MapCache(file)
    kept.add("key", sound)
    kept.save()
    assert np.array_equal(MapCache(file).find("key", sound.shape), sound)
    if damage == "cut off":
        file.write_bytes(file.read_bytes()[:-9])
    elif damage == "pickle":
        with open(file, "wb") as out:
            np.savez(out, key=np.array([{}], object))
    elif damage == "large":
        with open(file, "r+b") as out:
            out.truncate(1 << 40)
    else:
        change = {"shape": sound[1:], "negative": sound - 2, "not a number": np.full_like(sound, np.nan), "double": sound.astype(float)}
        save_whole(file, {"key": change[damage]})
    assert MapCache(file).find("key", sound.shape) is None


def test_a_bake_keeps_it_beside_its_images_and_says_that_it_reads_the_world(background, tmp_path):
    bpy.ops.mesh.primitive_plane_add()
    maps, told = [], []
    for number, force in enumerate((False, False, True)):
        told.clear()
        (tmp_path / f"job {number}").mkdir()
        request = BakeRequest(Settings(size=64, force=force), output=tmp_path / "maps", name="room")
        maps.append(session.prepare(bpy.context, request, tmp_path / f"job {number}", told.append).export.snapshot.world_map)
        assert [message.text for message in told] == ["Reading the world's light"]
        brighten(tmp_path / "maps" / ".leaflight_room.world")
    assert np.array_equal(maps[1], 2 * maps[0])
    assert np.array_equal(maps[2], maps[0])
