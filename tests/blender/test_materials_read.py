"""Materials as diffuse reflectance and emission; one warning for each that had to be simplified."""

from dataclasses import replace

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blend_rooms import make_material
from leaflight.addon.nodes.images_read import read_pixels
from leaflight.addon.read.materials_read import MaterialTable
from leaflight.core.output.image_file import srgb_to_linear
from leaflight.core.scene.gloss import average_fresnel

pytestmark = pytest.mark.usefixtures("empty_file")


class Tree:
    """A material's node tree, wired in one line each."""

    def __init__(self, name="Paint"):
        self.material = make_material(name)
        self.tree = self.material.node_tree
        self.tree.nodes.clear()
        self.output = self.add("OutputMaterial")

    def add(self, kind, *, tree=None, **inputs):
        node = (tree or self.tree).nodes.new(f"ShaderNode{kind}")
        for name, value in inputs.items():
            self.feed(node, name.replace("_", " "), value)
        return node

    def feed(self, node, name, value):
        socket = name if not isinstance(name, str) else node.inputs[name]
        if isinstance(value, bpy.types.NodeSocket):
            node.id_data.links.new(value, socket)
        else:
            socket.default_value = (*value, 1.0) if isinstance(value, tuple) and socket.type == "RGBA" else value

    def show(self, node):
        self.tree.links.new(node.outputs[0], self.output.inputs["Surface"])
        return self

    def read(self):
        warnings = []
        table = MaterialTable(warnings)
        reading = table.readings[table.index(self.material)]
        assert len(warnings) <= 1
        assert all(subject == self.material.name for subject, _ in warnings)
        return reading, table, warnings[0][1] if warnings else ""


def make_image(name="Karo", width=5, height=3, *, floating=False, value=None):
    image = bpy.data.images.new(name, width, height, float_buffer=floating)
    pixels = np.random.default_rng(1).random((height, width, 4)).astype(np.float32)
    pixels[..., 3] = 1.0
    if value is not None:
        pixels[..., :3] = value
    image.pixels.foreach_set(pixels.ravel())
    return image, pixels[..., :3]


def add_image(tree, image, vector=None, **properties):
    node = tree.add("TexImage")
    node.image = image
    for name, value in properties.items():
        setattr(node, name, value)
    if vector is not None:
        tree.feed(node, "Vector", vector)
    return node


def test_principled_constant():
    tree = Tree()
    tree.show(tree.add("BsdfPrincipled", Base_Color=(0.1, 0.2, 0.3), Emission_Color=(1.0, 0.5, 0.0), Emission_Strength=4.0))
    reading, _, warning = tree.read()
    assert reading.material.name == "Paint"
    assert reading.material.albedo_rgb == pytest.approx((0.1, 0.2, 0.3))
    assert reading.material.emission_rgb == pytest.approx((4.0, 2.0, 0.0))
    assert (reading.material.albedo_image, reading.material.emission_image, reading.material.passing_rgb) == (-1, -1, (0, 0, 0))
    assert warning == ""


def test_empty_slot_is_grey_and_each_material_is_read_once():
    tree = Tree()
    tree.show(tree.add("BsdfToon"))
    warnings = []
    table = MaterialTable(warnings)
    assert [table.index(None), table.index(tree.material), table.index(None), table.index(tree.material)] == [0, 1, 0, 1]
    assert table.readings[0].material.albedo_rgb == pytest.approx((0.8, 0.8, 0.8))
    assert [reading.material.name for reading in table.readings] == ["", tree.material.name]
    assert len(warnings) == 1


def test_image_is_linear_and_shared():
    image, stored = make_image()
    tree = Tree()
    texture = add_image(tree, image, extension="CLIP", interpolation="Closest")
    other = add_image(tree, image, extension="CLIP", interpolation="Closest")
    shader = tree.add("BsdfPrincipled", Base_Color=texture.outputs[0], Emission_Color=other.outputs[0], Emission_Strength=2.0)
    reading, table, warning = tree.show(shader).read()
    assert warning == ""
    assert (reading.material.albedo_image, reading.material.emission_image) == (0, 0)
    assert reading.material.albedo_rgb == pytest.approx((1.0, 1.0, 1.0))
    assert reading.material.emission_rgb == pytest.approx((2.0, 2.0, 2.0))
    texture_image = table.images.images[0]
    assert (texture_image.extension, texture_image.closest) == ("CLIP", True)
    expected = srgb_to_linear(np.float32(np.round(stored * 255) / 255))
    assert texture_image.pixels.shape == (3, 5, 3)
    assert texture_image.pixels == pytest.approx(expected, abs=2e-3)


@pytest.mark.parametrize(("floating", "space"), [(True, "sRGB"), (False, "Non-Color"), (False, "Linear Rec.709")])
def test_linear_pixels_are_taken_as_they_are(floating, space):
    image = bpy.data.images.new("Plain", 5, 3, float_buffer=floating)
    image.colorspace_settings.name = space
    image.pixels.foreach_set(np.full(60, 0.5, np.float32))
    assert read_pixels(image).pixels == pytest.approx(0.5, abs=3e-3)


@pytest.mark.parametrize(
    ("space", "told"), [("sRGB", ""), ("Linear Rec.709", ""), ("Non-Color", ""), ("Linear Rec.2020", "Linear Rec.709")]
)
def test_a_colour_space_that_is_read_as_another_is_told(space, told):
    image = bpy.data.images.new("Wide", 2, 2)
    image.colorspace_settings.name = space
    assert read_pixels(image).note == (told and f"colour space {space} of image Wide is read as {told}")


def test_very_large_image_is_averaged(monkeypatch):
    monkeypatch.setattr("leaflight.addon.nodes.images_read.MAX_TEXTURE_SIDE_TEXELS", 4)
    image, stored = make_image(width=7, height=3, floating=True)
    pixels = read_pixels(image).pixels
    assert pixels.shape == (3, 4, 3)
    assert pixels[:, 0] == pytest.approx(stored[:, :2].mean(axis=1), rel=1e-5)
    assert pixels[:, 3] == pytest.approx(stored[:, 6], rel=1e-5)


def test_missing_image_takes_the_value_behind_the_link():
    image = bpy.data.images.new("wood", 4, 4)
    image.source, image.filepath = "FILE", "//not/there/wood.png"
    image.reload()
    tree = Tree()
    shader = tree.add("BsdfPrincipled", Base_Color=(0.3, 0.2, 0.1))
    tree.feed(shader, "Base Color", add_image(tree, image).outputs[0])
    reading, table, warning = tree.show(shader).read()
    assert reading.material.albedo_rgb == pytest.approx((0.3, 0.2, 0.1))
    assert table.images.images == []
    assert "image wood is missing" in warning


def make_files(folder, colors):
    """PNG files of one colour each, by the end of their names."""
    for end, rgb in colors.items():
        image = bpy.data.images.new("part", 2, 2)
        image.pixels.foreach_set(np.tile(np.array([*rgb, 1.0], np.float32), 4))
        image.filepath_raw, image.file_format = str(folder / f"part{end}.png"), "PNG"
        image.save()
        bpy.data.images.remove(image)


@pytest.fixture
def udim(tmp_path):
    """Red, and green on its right, and blue two rows above."""
    make_files(tmp_path, {".1002": (1, 0, 0), ".1003": (0, 1, 0), ".1022": (0, 0, 1)})
    image = bpy.data.images.load(str(tmp_path / "part.1002.png"))
    image.source = "TILED"
    image.filepath = str(tmp_path / "part.<UDIM>.png")
    image.tiles[0].number = 1002
    image.tiles.new(1003)
    image.tiles.new(1022)
    return image


def shown(image, uv, **node_properties):
    """Material's reading, its warning and the texture's colour at each place of the UV layer."""
    tree = Tree()
    shader = tree.add("BsdfDiffuse", Color=add_image(tree, image, **node_properties).outputs[0])
    reading, table, warning = tree.show(shader).read()
    pixels = table.images.images[reading.material.albedo_image].pixels
    height, width = pixels.shape[:2]
    place = reading.albedo_mapping.apply(np.array(uv, np.float64)) * (width, height)
    return warning, [pixels[int(y), int(x)].tolist() for x, y in place]


@pytest.mark.parametrize("packed", [False, True])
def test_each_udim_tile_shows_its_own_file(udim, tmp_path, packed):
    if packed:
        udim.pack()
        for file in tmp_path.iterdir():
            file.unlink()
    before = len(bpy.data.images)
    warning, colors = shown(udim, [(1.5, 0.5), (2.3, 0.7), (1.7, 2.3)])
    assert warning == ""
    assert np.array(colors) == pytest.approx(np.eye(3), abs=1e-4)
    assert len(bpy.data.images) == before
    assert [tile.number for tile in udim.tiles] == [1002, 1003, 1022]


def test_a_udim_tile_without_a_file_is_named_and_has_the_others_mean(udim, tmp_path):
    (tmp_path / "part.1003.png").unlink()
    warning, colors = shown(udim, [(1.5, 0.5), (2.5, 0.5)])
    assert "tile 1003 of image part.1002.png is missing" in warning
    assert np.array(colors) == pytest.approx(np.array([[1, 0, 0], [0.5, 0, 0.5]]), abs=1e-4)


@pytest.mark.parametrize(
    ("scene_frame", "user", "expected"),
    [
        (2, {}, 1),
        (1, {"frame_offset": 1}, 1),
        (9, {}, 2),
        (12, {"frame_start": 11}, 1),
        (5, {"use_cyclic": True}, 1),
        (6, {"use_cyclic": True}, 2),
    ],
)
def test_a_sequence_shows_the_scenes_frame(tmp_path, scene_frame, user, expected):
    rgb = [(1, 0, 0), (0, 1, 0), (0, 0, 1)]
    make_files(tmp_path, {f"_{n + 1:04d}": rgb[n] for n in range(3)})
    image = bpy.data.images.load(str(tmp_path / "part_0001.png"))
    image.source = "SEQUENCE"
    bpy.context.scene.frame_set(scene_frame)
    tree = Tree()
    texture = add_image(tree, image)
    for name, value in {"frame_duration": 3, **user}.items():
        setattr(texture.image_user, name, value)
    reading, table, warning = tree.show(tree.add("BsdfDiffuse", Color=texture.outputs[0])).read()
    assert warning == ""
    assert table.images.images[reading.material.albedo_image].pixels[0, 0].tolist() == list(rgb[expected])


def test_a_frame_that_is_no_file_is_named(tmp_path):
    make_files(tmp_path, {"_1": (1, 0, 0)})
    image = bpy.data.images.load(str(tmp_path / "part_1.png"))
    image.source = "SEQUENCE"
    tree = Tree()
    texture = add_image(tree, image)
    texture.image_user.frame_duration, texture.image_user.frame_offset = 3, 6
    _, _, warning = tree.show(tree.add("BsdfDiffuse", Color=texture.outputs[0])).read()
    assert "frame 7 of image part_1.png is missing (File > External Data finds it)" in warning


@pytest.mark.parametrize(
    ("vector_type", "expected"),
    [
        ("POINT", [[0.0, -3.0, 0.5], [2.0, 0.0, 0.25]]),
        ("TEXTURE", [[0.0, 0.5, -0.125], [-1 / 3, 0.0, 0.5 / 3]]),
        ("VECTOR", [[0.0, -3.0, 0.0], [2.0, 0.0, 0.0]]),
    ],
)
def test_mapping_node(vector_type, expected):
    image, _ = make_image()
    tree = Tree()
    uv_map = tree.add("UVMap")
    uv_map.uv_map = "Second"
    mapping = tree.add("Mapping", Vector=uv_map.outputs[0])
    mapping.vector_type = vector_type
    if "Location" in mapping.inputs and vector_type != "VECTOR":
        mapping.inputs["Location"].default_value = (0.5, 0.25, 0.0)
    mapping.inputs["Rotation"].default_value = (0.0, 0.0, np.pi / 2)
    mapping.inputs["Scale"].default_value = (2.0, 3.0, 1.0)
    shader = tree.add("BsdfDiffuse", Color=add_image(tree, image, mapping.outputs[0]).outputs[0])
    reading, _, warning = tree.show(shader).read()
    assert warning == ""
    assert reading.albedo_mapping.layer == "Second"
    uv = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.3, 0.7]])
    expected = np.array(expected)
    assert reading.albedo_mapping.apply(uv) == pytest.approx(uv @ expected[:, :2].T + expected[:, 2], abs=1e-6)


def test_texture_coordinates_of_the_mesh_are_exact_and_those_of_the_window_are_replaced_by_the_mean():
    image, _ = make_image(floating=True, value=(0.25, 0.5, 0.75))
    for output, exact in (("UV", True), ("Generated", True), ("Object", True), ("Window", False)):
        tree = Tree()
        coordinate = tree.add("TexCoord")
        shader = tree.add("BsdfDiffuse", Color=add_image(tree, image, coordinate.outputs[output]).outputs[0])
        reading, _, warning = tree.show(shader).read()
        assert (reading.material.albedo_image == 0) == exact == (warning == "")
        if not exact:
            assert reading.material.albedo_rgb == pytest.approx((0.25, 0.5, 0.75))


def test_metal_and_transmission_leave_their_diffuse_part():
    tree = Tree()
    tree.show(tree.add("BsdfPrincipled", Base_Color=(0.8, 0.4, 0.2), Metallic=0.25, Transmission_Weight=0.5))
    reading, _, warning = tree.read()
    assert reading.material.metal_rgb == pytest.approx((0.2, 0.1, 0.05))
    assert np.subtract(reading.material.albedo_rgb, reading.material.metal_rgb) == pytest.approx((0.3, 0.15, 0.075))
    assert (reading.material.metal, reading.material.layer) == pytest.approx((0.25, 0.375))
    assert reading.material.glass_rgb == pytest.approx(0.375 * np.sqrt((0.8, 0.4, 0.2)))
    assert reading.material.glass_mirror_rgb == pytest.approx((0.375,) * 3)
    assert not any(reading.material.passing_rgb)
    assert warning == ""


@pytest.mark.parametrize("shader", ["BsdfGlass", "BsdfRefraction"])
def test_glass_bends_light(shader):
    tree = Tree()
    reading, _, warning = tree.show(tree.add(shader, Color=(0.5, 0.25, 1.0), Roughness=0.3, IOR=1.3)).read()
    assert reading.is_clear
    material = reading.material
    assert not any(material.passing_rgb)
    assert material.glass_rgb == pytest.approx((0.5, 0.25, 1.0))
    assert material.glass_mirror_rgb == pytest.approx((0.5, 0.25, 1.0) if shader == "BsdfGlass" else (0, 0, 0))
    assert (material.glass_roughness, material.glass_ior) == pytest.approx((0.3, 1.3))
    assert material.glass_fresnel == (shader == "BsdfGlass")
    assert warning == ""


def mix_shaders(tree, fraction, first, second):
    mix = tree.add("MixShader")
    for socket, value in zip(mix.inputs, (fraction, first.outputs[0], second.outputs[0]), strict=True):
        tree.feed(mix, socket, value)
    return mix


def test_a_translucent_shader_sends_light_on_to_its_other_side():
    tree = Tree()
    leaf, paint = tree.add("BsdfTranslucent", Color=(0.5, 0.25, 1.0)), tree.add("BsdfDiffuse", Color=(0.4, 0.4, 0.4))
    reading, _, warning = tree.show(mix_shaders(tree, 0.25, leaf, paint)).read()
    assert reading.material.through_rgb == pytest.approx((0.375, 0.1875, 0.75))
    assert reading.material.albedo_rgb == pytest.approx((0.475, 0.2875, 0.85))
    assert warning == ""


def test_glass_in_a_mix_is_glass_in_part():
    tree = Tree()
    glass, paint = tree.add("BsdfGlass", Color=(1.0, 0.5, 0.5), Roughness=0.2), tree.add("BsdfDiffuse", Color=(0.6, 0.6, 0.6))
    reading, _, warning = tree.show(mix_shaders(tree, 0.25, glass, paint)).read()
    assert reading.material.glass_rgb == pytest.approx((0.75, 0.375, 0.375))
    assert reading.material.albedo_rgb == pytest.approx((0.15,) * 3)
    assert reading.material.glass_roughness == pytest.approx(0.2)
    assert not reading.is_clear
    assert warning == ""


def test_mix_and_add_shader():
    tree = Tree()
    diffuse, other = tree.add("BsdfDiffuse", Color=(1.0, 0.0, 0.0)), tree.add("BsdfDiffuse", Color=(0.0, 1.0, 0.0))
    glow = tree.add("Emission", Color=(1.0, 1.0, 0.5), Strength=3.0)
    add = tree.add("AddShader")
    tree.feed(add, add.inputs[0], mix_shaders(tree, 0.25, diffuse, other).outputs[0])
    tree.feed(add, add.inputs[1], glow.outputs[0])
    reading, _, warning = tree.show(add).read()
    assert warning == ""
    assert reading.material.albedo_rgb == pytest.approx((0.75, 0.25, 0.0))
    assert reading.material.emission_rgb == pytest.approx((3.0, 3.0, 1.5))


def make_group(tree):
    """A group that hands its Tint through to a diffuse shader."""
    group = bpy.data.node_groups.new("Coat", "ShaderNodeTree")
    group.interface.new_socket("Tint", in_out="INPUT", socket_type="NodeSocketColor")
    group.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    inside, outside = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    diffuse = group.nodes.new("ShaderNodeBsdfDiffuse")
    group.links.new(inside.outputs["Tint"], diffuse.inputs["Color"])
    group.links.new(diffuse.outputs[0], outside.inputs["Shader"])
    node = tree.tree.nodes.new("ShaderNodeGroup")
    node.node_tree = group
    return node


def test_groups_reroutes_and_muted_nodes():
    tree = Tree()
    node = make_group(tree)
    node.inputs["Tint"].default_value = (0.3, 0.2, 0.1, 1.0)
    reading, _, warning = tree.show(node).read()
    assert (reading.material.albedo_rgb, warning) == (pytest.approx((0.3, 0.2, 0.1)), "")
    color = tree.add("RGB")
    color.outputs[0].default_value = (0.6, 0.5, 0.4, 1.0)
    gamma = tree.add("Gamma", Color=color.outputs[0], Gamma=3.0)
    gamma.mute = True
    reroute = tree.tree.nodes.new("NodeReroute")
    tree.tree.links.new(gamma.outputs[0], reroute.inputs[0])
    tree.tree.links.new(reroute.outputs[0], node.inputs["Tint"])
    reading, _, warning = tree.read()
    assert (reading.material.albedo_rgb, warning) == (pytest.approx((0.6, 0.5, 0.4)), "")


def test_unknown_nodes_and_shaders_give_one_warning():
    tree = Tree()
    noise = tree.add("TexNoise")
    checker = tree.add("TexChecker", Color1=(1.0, 0.0, 0.0), Color2=(0.0, 0.0, 1.0))
    bump = tree.add("Bump", Height=noise.outputs[0])
    shader = tree.add("BsdfPrincipled", Base_Color=checker.outputs[0], Normal=bump.outputs[0], Roughness=noise.outputs[0])
    reading, _, warning = tree.show(shader).read()
    assert reading.material.albedo_rgb == pytest.approx((0.5, 0.0, 0.5))
    assert "Checker" in warning
    assert "bump" in warning
    toon = tree.add("BsdfToon", Color=(0.9, 0.8, 0.7))
    reading, _, warning = tree.show(toon).read()
    assert reading.material.albedo_rgb == pytest.approx((0.9, 0.8, 0.7))
    assert "Toon" in warning


def test_a_glossy_shader_is_all_metal():
    tree = Tree()
    reading, _, warning = tree.show(tree.add("BsdfGlossy", Color=(0.9, 0.8, 0.7), Roughness=0.1)).read()
    assert reading.material.metal_rgb == reading.material.albedo_rgb == pytest.approx((0.9, 0.8, 0.7))
    assert reading.material.roughness == pytest.approx(0.1)
    assert reading.material.layer == 0.0
    assert (reading.material.metal, reading.material.metal_flat) == (1.0, True)
    assert warning == ""


def test_a_principled_shader_has_a_layer_by_its_specular_level():
    tree = Tree()
    plain = tree.show(tree.add("BsdfPrincipled", Roughness=0.3)).read()[0].material
    assert (plain.layer, plain.roughness, plain.ior) == pytest.approx((1.0, 0.3, 1.5), abs=1e-6)
    assert not any(plain.metal_rgb)
    without = tree.show(tree.add("BsdfPrincipled", Specular_IOR_Level=0.0)).read()[0].material
    assert without.layer == 0.0
    tinted = tree.show(tree.add("BsdfPrincipled", Specular_Tint=(0.0, 0.3, 0.6))).read()[0].material
    assert (plain.layer_tint, tinted.layer_tint) == pytest.approx((1.0, 0.3))


@pytest.mark.parametrize("shader", ["BsdfPrincipled", "BsdfGlossy", "BsdfGlass", "BsdfRefraction"])
def test_only_multiscatter_ggx_gives_back_what_rough_facets_lose(shader):
    tree, found = Tree(), []
    node = tree.add(shader)
    for distribution in ("GGX", "MULTI_GGX") if shader != "BsdfRefraction" else ("GGX", "BECKMANN"):
        node.distribution = distribution
        material = tree.show(node).read()[0].material
        found.append(material.glass_multiscatter if shader in ("BsdfGlass", "BsdfRefraction") else material.multiscatter)
    assert found == [False, shader != "BsdfRefraction"]


def test_values_that_are_not_numbers_are_mended_and_named():
    plain, tree = Tree("Plain"), Tree()
    expected = plain.show(plain.add("BsdfPrincipled")).read()[0].material
    names = ("Roughness", "IOR", "Alpha", "Specular_IOR_Level")
    shader = tree.add("BsdfPrincipled", Base_Color=(0.5, np.nan, 0.5), **dict.fromkeys(names, np.nan))
    reading, _, warning = tree.show(shader).read()
    assert reading.material.albedo_rgb == pytest.approx((0.8, 0.8, 0.8))
    assert replace(reading.material, name="Plain", albedo_rgb=expected.albedo_rgb) == expected
    for told in ("Base Color of node Principled BSDF is not a number, 0.8 is used; type one", "Roughness of node", "Alpha of node"):
        assert told in warning


def test_a_coat_lies_above_all_else():
    tree = Tree()
    tint = (0.5, 1.0, 1.0)
    coated = tree.add("BsdfPrincipled", Base_Color=(0.6, 0.6, 0.6), Coat_Weight=0.5, Coat_Roughness=0.2, Coat_IOR=1.6, Coat_Tint=tint)
    reading, _, warning = tree.show(coated).read()
    material = reading.material
    assert (material.coat, material.coat_roughness, material.coat_ior) == pytest.approx((0.5, 0.2, 1.6))
    assert material.coat_tint_rgb == pytest.approx(tint)
    assert 0.3 + 0.3 * 0.5**1.3 < material.albedo_rgb[0] < 0.3 + 0.3 * 0.5  # the way through the coat is slanted
    assert material.albedo_rgb[1:] == pytest.approx((0.6, 0.6))
    assert warning == ""


def test_sheen_takes_from_what_is_below():
    tree = Tree()
    sheen = {"Sheen_Weight": 1.0, "Sheen_Roughness": 1.0, "Sheen_Tint": (1.0, 0.5, 0.0)}
    reading, _, warning = tree.show(tree.add("BsdfPrincipled", Base_Color=(0.5, 0.5, 0.5), **sheen)).read()
    share = 0.4475
    assert reading.material.albedo_rgb == pytest.approx([0.5 * (1 - share) + share * tint for tint in (1.0, 0.5, 0.0)], abs=1e-3)
    assert reading.material.sheen_rgb == pytest.approx((1.0, 0.5, 0.0))
    cloth, _, _ = tree.show(tree.add("BsdfSheen", Color=(1.0, 0.5, 0.0), Roughness=1.0)).read()
    assert cloth.material.albedo_rgb == pytest.approx((share, share / 2, 0.0), abs=1e-3)
    assert warning == ""


@pytest.mark.parametrize("shader", ["BsdfPrincipled", "SubsurfaceScattering"])
def test_subsurface_light_is_diffuse_and_one_warning_says_so(shader):
    tree = Tree()
    inputs = {"Base_Color": (0.6, 0.4, 0.2), "Subsurface_Weight": 1.0} if shader == "BsdfPrincipled" else {"Color": (0.6, 0.4, 0.2)}
    reading, _, warning = tree.show(tree.add(shader, **inputs)).read()
    assert reading.material.albedo_rgb == pytest.approx((0.6, 0.4, 0.2))
    assert "below the surface" in warning


def test_a_holdout_is_black():
    reading, _, warning = (tree := Tree()).show(tree.add("Holdout")).read()
    assert (reading.material.albedo_rgb, reading.material.passing_rgb, warning) == ((0.0,) * 3, (0.0,) * 3, "")


def test_a_muted_node_that_nothing_feeds_leaves_the_value_where_it_leads():
    """As Cycles bakes it under 5.0."""
    tree = Tree()
    invert = tree.add("Invert", Color=(0.1, 0.9, 0.1))
    invert.mute = True
    diffuse = tree.add("BsdfDiffuse", Color=(0.3, 0.2, 0.1))
    tree.feed(diffuse, "Color", invert.outputs[0])
    reading, _, _ = tree.show(diffuse).read()
    assert reading.material.albedo_rgb == pytest.approx((0.3, 0.2, 0.1))


@pytest.mark.parametrize(("shader", "color", "roughness"), [("BsdfDiffuse", "Color", "Roughness"), ("BsdfPrincipled", "Base Color", "")])
def test_a_rough_diffuse_surface_reflects_less(shader, color, roughness):
    tree = Tree()
    node = tree.add(shader)
    node.inputs[color].default_value = (0.8, 1.0, 0.0, 1.0)
    node.inputs[roughness or "Diffuse Roughness"].default_value = 1.0
    reading, _, warning = tree.show(node).read()
    # E = 0.8328 (1 at white) of Oren-Nayar at roughness 1, plus what facets pass to each other, 0.8^3 E (1 - E) / (1 - 0.8 (1 - E))
    assert reading.material.albedo_rgb == pytest.approx((0.7486, 1.0, 0.0), abs=1e-3)
    assert "its rough diffuse reflection is baked as alike in all directions" in warning


def test_reflections_that_are_not_round_are_named():
    tree = Tree()
    _, _, warning = tree.show(tree.add("BsdfPrincipled", Metallic=1.0, Anisotropic=0.5)).read()
    assert "no Anisotropic" in warning


def facing(tree, output="Facing", blend=0.5):
    return tree.add("LayerWeight", Blend=blend).outputs[output]


def test_what_differs_by_view_counts_by_its_mean_over_the_hemisphere():
    tree = Tree()
    mix = mix_shaders(tree, facing(tree), *(tree.add("BsdfDiffuse", Color=(grey,) * 3) for grey in (0.9, 0.3)))
    reading, _, warning = tree.show(mix).read()
    assert reading.material.albedo_rgb == pytest.approx((0.7,) * 3, abs=2e-3)  # 1 - cos has a mean of 1/3
    assert warning == ""
    ramp = tree.add("ValToRGB", Fac=facing(tree))
    ramp.color_ramp.interpolation = "CONSTANT"
    ramp.color_ramp.elements[1].position = 0.5
    reading, _, _ = tree.show(tree.add("BsdfDiffuse", Color=ramp.outputs[0])).read()
    assert reading.material.albedo_rgb == pytest.approx((0.25,) * 3, abs=0.02)  # cosines below 1/2
    reading, _, _ = tree.show(tree.add("BsdfDiffuse", Color=tree.add("Fresnel", IOR=1.5).outputs[0])).read()
    assert reading.material.albedo_rgb == pytest.approx((0.0918,) * 3, abs=2e-3)


@pytest.mark.parametrize("by", ["Fresnel", "LayerWeight"])
def test_gloss_over_paint_by_fresnel_is_a_dielectric_layer(by):
    tree = Tree()
    fresnel = tree.add("Fresnel", IOR=2.0) if by == "Fresnel" else tree.add("LayerWeight", Blend=0.5)
    paint, gloss = tree.add("BsdfDiffuse", Color=(0.6, 0.3, 0.2)), tree.add("BsdfGlossy", Roughness=0.4, Color=(1.0, 1.0, 1.0))
    mix = mix_shaders(tree, fresnel.outputs["Fac" if by == "Fresnel" else "Fresnel"], paint, gloss)
    material = tree.show(mix).read()[0].material
    assert (material.layer, material.ior, material.roughness) == (1.0, pytest.approx(2.0), pytest.approx(0.4))
    assert (material.albedo_rgb, material.metal_rgb) == (pytest.approx((0.6, 0.3, 0.2)), (0.0, 0.0, 0.0))
    gloss.inputs["Color"].default_value = (0.5, 0.5, 0.5, 1.0)
    half = tree.read()[0].material
    mean = average_fresnel(2.0)
    assert half.layer == pytest.approx(0.5)
    assert np.array(half.albedo_rgb) * (1 - 0.5 * mean) == pytest.approx(np.array([0.6, 0.3, 0.2]) * (1 - mean), rel=1e-5)
    tree.feed(mix, mix.inputs[1], tree.add("BsdfTransparent").outputs[0])
    assert tree.read()[0].material.layer == 0.0, "a window has none"


def test_a_glow_is_known_to_leave_the_front_alone():
    tree = Tree()
    front = tree.add("Invert", Color=tree.add("NewGeometry").outputs["Backfacing"])
    reading, _, warning = tree.show(tree.add("Emission", Strength=front.outputs[0])).read()
    assert (reading.material.emission_rgb, reading.material.dark_back, warning) == ((1.0,) * 3, True, "")
    back = tree.add("NewGeometry").outputs["Backfacing"]
    reading, _, warning = tree.show(tree.add("Emission", Strength=back)).read()
    dark = reading.material.dark_front, reading.material.dark_back
    assert (reading.material.emission_rgb, dark, warning) == ((1.0,) * 3, (True, False), "")
    reading, _, warning = tree.show(tree.add("Emission", Strength=facing(tree))).read()
    assert not reading.material.dark_back
    assert "glows more in some directions than in others" in warning


def test_a_back_of_the_pattern_of_its_front_is_not_named():
    tree = Tree()
    picture = tree.add("BsdfDiffuse", Color=add_image(tree, make_image()[0]).outputs[0])
    mixed, grey = tree.add("MixShader", Fac=tree.add("Fresnel").outputs[0]), tree.add("BsdfDiffuse")
    tree.tree.links.new(picture.outputs[0], mixed.inputs[1])
    assert "pattern" not in tree.show(mixed).read()[2]
    tree.tree.links.new(grey.outputs[0], mixed.inputs[2])
    assert "its back shows the pattern of its front" in tree.read()[2]


def test_a_ray_portal_that_leads_nowhere_is_transparent():
    tree = Tree()
    portal = tree.add("BsdfRayPortal", Color=(0.9, 0.8, 0.7))
    reading, _, warning = tree.show(portal).read()
    assert (reading.material.passing_rgb, reading.material.albedo_rgb, warning) == (pytest.approx((0.9, 0.8, 0.7)), (0.0,) * 3, "")
    tree.feed(portal, "Position", tree.add("NewGeometry").outputs["Position"])
    assert "elsewhere" in tree.read()[2]


def test_a_volume_below_a_surface_is_named_and_sides_are_told_apart():
    tree = Tree()
    side = tree.add("NewGeometry").outputs["Backfacing"]
    mixed = mix_shaders(tree, side, *(tree.add("BsdfDiffuse", Color=rgb) for rgb in ((0.9, 0.1, 0.1), (0.1, 0.1, 0.9))))
    tree.tree.links.new(tree.add("VolumeAbsorption").outputs[0], tree.output.inputs["Volume"])
    reading, _, warning = tree.show(mixed).read()
    assert reading.material.albedo_rgb == pytest.approx((0.9, 0.1, 0.1))
    assert reading.material.back_rgb == pytest.approx((1 / 9, 1.0, 9.0))
    assert "its volume is left out" in warning


def test_no_output_and_nothing_connected_are_black():
    tree = Tree()
    reading, _, warning = tree.read()
    assert (reading.material.albedo_rgb, warning != "") == ((0.0, 0.0, 0.0), True)
    tree.tree.nodes.clear()
    reading, _, warning = tree.read()
    assert (reading.material.albedo_rgb, warning != "") == ((0.0, 0.0, 0.0), True)


def test_the_output_for_cycles_is_taken():
    tree = Tree()
    tree.show(tree.add("BsdfDiffuse", Color=(1.0, 0.0, 0.0)))
    tree.output.target = "EEVEE"
    second = tree.add("OutputMaterial")
    second.target = "CYCLES"
    tree.tree.links.new(tree.add("BsdfDiffuse", Color=(0.0, 1.0, 0.0)).outputs[0], second.inputs["Surface"])
    reading, _, _ = tree.read()
    assert reading.material.albedo_rgb == pytest.approx((0.0, 1.0, 0.0))
