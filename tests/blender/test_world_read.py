"""The world as it is read, and its light that is kept beside the images."""

import math
import os

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from leaflight.addon.app import session
from leaflight.addon.app.arguments import BakeRequest
from leaflight.addon.read.world_cache import MapCache
from leaflight.addon.read.world_read import read_world
from leaflight.core.lights.environment import Environment
from leaflight.core.util.files import load_arrays, save_whole
from leaflight.core.util.settings import Settings

pytestmark = pytest.mark.usefixtures("empty_file")


# Blender's world as the core has it: uniform, or a map of what Cycles evaluates, and the suns in it.
NODES = {"background": "ShaderNodeBackground", "mix": "ShaderNodeMixShader", "path": "ShaderNodeLightPath"}


def read(warnings=None):
    return read_world(bpy.context.scene, [] if warnings is None else warnings)


def look(world, *directions):
    toward = np.array(directions, float)
    return Environment(world.map).look_up(toward / np.linalg.norm(toward, axis=1, keepdims=True))


def add_picture(tree, target, height=64, **properties):
    """An environment texture whose four quarters from -X by +Y, +X and -Y are red, green, blue and white above, and black below."""
    image = bpy.data.images.new("Picture", 2 * height, height, float_buffer=True)
    pixels = np.zeros((height, 2 * height, 4), np.float32)
    pixels[..., 3] = 1.0
    for quarter, rgb in enumerate(((1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1))):
        pixels[height // 2 :, quarter * height // 2 : (quarter + 1) * height // 2, :3] = rgb
    image.pixels.foreach_set(pixels.ravel())
    image.pack()
    texture = tree.nodes.new("ShaderNodeTexEnvironment")
    texture.image = image
    for name, value in properties.items():
        setattr(texture, name, value)
    tree.links.new(texture.outputs["Color"], target)
    return texture


def test_a_plain_world_is_colour_times_strength(sky):
    world, _, background = sky
    background.inputs["Color"].default_value = (0.1, 0.2, 0.4, 1.0)
    background.inputs["Strength"].default_value = 2.0
    warnings = []
    found = read(warnings)
    assert found.rgb == pytest.approx((0.2, 0.4, 0.8))
    assert found.map is None
    assert not warnings
    world.cycles_visibility.diffuse = False
    assert read().rgb == (0.0, 0.0, 0.0)


def test_no_world_is_black():
    assert read().rgb == (0.0, 0.0, 0.0)


def test_a_picture_keeps_its_place(sky):
    _, tree, background = sky
    add_picture(tree, background.inputs["Color"])
    background.inputs["Strength"].default_value = 2.0
    found = look(read(), (-1, 1, 1), (1, 1, 1), (1, -1, 1), (-1, -1, 1), (1, 1, -1))
    assert found == pytest.approx(2.0 * np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1], [0, 0, 0]]), abs=1e-3)


def test_a_picture_is_turned_by_a_mapping_in_a_group(sky):
    _, tree, background = sky
    group = bpy.data.node_groups.new("Picture", "ShaderNodeTree")
    group.interface.new_socket("Color", in_out="OUTPUT", socket_type="NodeSocketColor")
    end = group.nodes.new("NodeGroupOutput")
    texture = add_picture(group, end.inputs[0])
    place, turn = group.nodes.new("ShaderNodeTexCoord"), group.nodes.new("ShaderNodeMapping")
    turn.inputs["Rotation"].default_value = (0.0, 0.0, math.pi / 2)
    group.links.new(place.outputs["Generated"], turn.inputs["Vector"])
    group.links.new(turn.outputs["Vector"], texture.inputs["Vector"])
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree = group
    tree.links.new(node.outputs[0], background.inputs["Color"])
    found = look(read(), (-1, 1, 1), (1, 1, 1), (1, -1, 1), (-1, -1, 1))
    assert found == pytest.approx(np.array([[1, 1, 1], [1, 0, 0], [0, 1, 0], [0, 0, 1]]), abs=1e-3)


def test_a_mirror_ball_fills_the_sphere(sky):
    _, tree, background = sky
    add_picture(tree, background.inputs["Color"], projection="MIRROR_BALL")
    found = read().map
    assert 0.1 < (found.max(axis=2) > 0).mean() < 0.9


def test_eight_bits_are_read_through_their_colour_space(sky):
    _, tree, background = sky
    image = bpy.data.images.new("Grey", 4, 4)
    pixels = np.full((4, 4, 4), (0.5, 0.5, 0.5, 1.0), np.float32)
    pixels[2:, :, :3] = 0.25
    image.pixels.foreach_set(pixels.ravel())
    image.pack()
    texture = tree.nodes.new("ShaderNodeTexEnvironment")
    texture.image, texture.interpolation = image, "Closest"
    tree.links.new(texture.outputs["Color"], background.inputs["Color"])
    found = look(read(), (1, 0.1, -1), (1, 0.1, 1))
    assert found[:, 0] == pytest.approx([((x + 0.055) / 1.055) ** 2.4 for x in (0.5, 0.25)], rel=0.02)


@pytest.mark.parametrize(("output", "seen"), [("Is Camera Ray", 0.25), ("Is Diffuse Ray", 2.0), ("Is Shadow Ray", 0.25)])
def test_the_sky_is_that_of_diffuse_rays(sky, output, seen):
    """The switch may be in a group, and the sky behind it a picture or plain."""
    _, tree, background = sky
    group = bpy.data.node_groups.new("Switch", "ShaderNodeTree")
    group.interface.new_socket("Value", in_out="OUTPUT", socket_type="NodeSocketFloat")
    end, path = group.nodes.new("NodeGroupOutput"), group.nodes.new(NODES["path"])
    group.links.new(path.outputs[output], end.inputs[0])
    switch, mix, other = tree.nodes.new("ShaderNodeGroup"), tree.nodes.new(NODES["mix"]), tree.nodes.new(NODES["background"])
    switch.node_tree = group
    background.inputs["Color"].default_value = (0.25, 0.25, 0.25, 1.0)
    other.inputs["Color"].default_value = (2.0, 2.0, 2.0, 1.0)
    for source, target in ((switch.outputs[0], mix.inputs[0]), (background.outputs[0], mix.inputs[1]), (other.outputs[0], mix.inputs[2])):
        tree.links.new(source, target)
    surface = next(node for node in tree.nodes if node.type == "OUTPUT_WORLD").inputs["Surface"]
    tree.links.new(mix.outputs[0], surface)
    found = read()
    assert found.map is None
    assert found.rgb == pytest.approx((seen,) * 3, rel=1e-5)
    assert path.outputs[output].is_linked  # the user's own is as it was


def test_the_sun_of_a_sky_texture_is_a_sun_and_nothing_is_left_behind(sky):
    _, tree, background = sky
    texture = tree.nodes.new("ShaderNodeTexSky")
    texture.sun_elevation, texture.sun_rotation, texture.sun_size = 0.6, 1.0, math.radians(2.0)
    tree.links.new(texture.outputs["Color"], background.inputs["Color"])
    collections = [name for name in dir(bpy.data) if hasattr(getattr(bpy.data, name), "foreach_get")]
    before = {name: [block.name for block in getattr(bpy.data, name)] for name in collections}
    found = read()
    assert {name: [block.name for block in getattr(bpy.data, name)] for name in collections} == before
    (sun,) = found.suns
    expected = (math.cos(0.6) * math.sin(1.0), math.cos(0.6) * math.cos(1.0), math.sin(0.6))
    assert sun.rotation[2] == pytest.approx(expected, abs=2e-4)
    assert sun.angle_rad == pytest.approx(math.radians(2.0), rel=0.08)  # its rim is darker than its middle
    assert look(found, expected).mean() < 1e-3 * sun.power_rgb[0] / (math.pi * math.radians(1.0) ** 2)


def test_what_a_world_loses_is_told(sky):
    world, tree, _ = sky
    end = next(node for node in tree.nodes if node.type == "OUTPUT_WORLD")
    tree.links.new(tree.nodes.new("ShaderNodeVolumeScatter").outputs[0], end.inputs["Volume"])
    world.cycles.max_bounces = 2
    warnings = []
    read(warnings)
    assert [subject for subject, _ in warnings] == ["Sky", "Sky"]
    assert "volume" in warnings[0][1]
    assert "; add fog" in warnings[0][1]
    assert "Max Bounces (2)" in warnings[1][1]
    assert "; lower its strength" in warnings[1][1]


@pytest.mark.parametrize("turn", [None, -2.0])
def test_a_plain_picture_is_read_as_cycles_shows_it(sky, turn):
    """Straight from its pixels, where it is turned also through other nodes, and mixed with no noise at all, which Cycles evaluates."""
    _, tree, background = sky
    texture = add_picture(tree, background.inputs["Color"])
    background.inputs["Strength"].default_value = 1.5
    if turn is not None:
        place, mapping = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeMapping")
        mapping.inputs["Rotation"].default_value = (0.0, 0.0, turn)
        tree.links.new(place.outputs["Generated"], mapping.inputs["Vector"])
        tree.links.new(mapping.outputs["Vector"], texture.inputs["Vector"])
        grey, path, switch = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("HueSaturation", "LightPath", "MixShader"))
        grey.inputs["Saturation"].default_value = 0.6
        for source, target in (
            (texture.outputs["Color"], grey.inputs["Color"]),
            (grey.outputs["Color"], background.inputs["Color"]),
            (path.outputs["Is Camera Ray"], switch.inputs[0]),
            (background.outputs[0], switch.inputs[1]),
            (switch.outputs[0], next(node for node in tree.nodes if node.type == "OUTPUT_WORLD").inputs["Surface"]),
        ):
            tree.links.new(source, target)
    plain = read()
    assert plain.map.shape == (64, 128, 3)  # as it is
    noise, mix = tree.nodes.new("ShaderNodeTexNoise"), tree.nodes.new("ShaderNodeMixRGB")
    mix.inputs["Fac"].default_value = 0.0
    tree.links.new(background.inputs["Color"].links[0].from_socket, mix.inputs["Color1"])
    tree.links.new(noise.outputs["Color"], mix.inputs["Color2"])
    tree.links.new(mix.outputs[0], background.inputs["Color"])
    evaluated = read().map
    assert evaluated.shape == (512, 1024, 3)
    small = evaluated.reshape(64, 8, 128, 8, 3).mean(axis=(1, 3))
    assert np.abs(plain.map - small).mean() < 0.03 * small.mean()  # Cycles interpolates between pixels
    # Between two colours Cycles greys what it has interpolated.
    assert plain.map.mean(axis=(0, 1)) == pytest.approx(small.mean(axis=(0, 1)), rel=2e-3 if turn is None else 4e-3)


# What Cycles has evaluated of a world is kept beside the images, and counts for as long as the world is the same.
@pytest.fixture
def background(sky):
    """The background node of a world that shows a gradient, which only Cycles can evaluate."""
    _, tree, background = sky
    place, gradient = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeTexGradient")
    tree.links.new(place.outputs["Generated"], gradient.inputs["Vector"])
    tree.links.new(gradient.outputs["Color"], background.inputs["Color"])
    return background


def read_kept(file):
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
    first = read_kept(file)
    again = read_kept(file)
    assert np.array_equal(first.map, again.map)
    assert first.suns == again.suns
    brighten(file)
    assert np.array_equal(read_kept(file).map, 2 * first.map)
    background.inputs["Strength"].default_value = 3.0
    assert np.allclose(read_kept(file).map, 3 * first.map, rtol=1e-5)


def test_a_picture_counts_by_its_file(background, tmp_path):
    file = tmp_path / "kept"
    image = show_picture(background, tmp_path / "grey.png", 0.25)
    dark = read_kept(file).map
    brighten(file)
    assert np.array_equal(read_kept(file).map, 2 * dark)
    save_picture(tmp_path / "grey.png", 0.75)
    os.utime(tmp_path / "grey.png", (1, 1))
    image.reload()
    assert read_kept(file).map.mean() > dark.mean() + 0.2


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
    read_kept(tmp_path / "kept")
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
