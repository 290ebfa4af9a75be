"""Nodes between an image, or constants, and a shader: read as Cycles shows them."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blend_nodes import add_glow, bake_emission
from leaflight.addon.nodes import derived_images
from leaflight.addon.nodes.derived_images import AT_CORNERS, MIXED
from leaflight.addon.nodes.node_colors import Color
from leaflight.addon.nodes.node_ports import Port, find_source
from leaflight.addon.nodes.socket_bake import SocketBaker
from leaflight.addon.read.export_scene import export_scene
from leaflight.addon.read.materials_read import MaterialTable
from leaflight.core.scene.scene import TextureImage

SIDE = 16  # of the texture, and of what Cycles bakes: their texels are the same
BLENDS = (
    *("MIX", "DARKEN", "MULTIPLY", "BURN", "LIGHTEN", "SCREEN", "DODGE", "ADD", "OVERLAY", "SOFT_LIGHT", "LINEAR_LIGHT", "DIFFERENCE"),
    *("EXCLUSION", "SUBTRACT", "DIVIDE", "HUE", "SATURATION", "COLOR", "VALUE"),
)
UNARY = ("SQRT", "INVERSE_SQRT", "ABSOLUTE", "EXPONENT", "SIGN", "ROUND", "FLOOR", "CEIL", "TRUNC", "FRACT", "SINE", "COSINE", "TANGENT")
BINARY = (
    *("ADD", "SUBTRACT", "MULTIPLY", "DIVIDE", "POWER", "LOGARITHM", "MINIMUM", "MAXIMUM", "LESS_THAN", "GREATER_THAN"),
    "MODULO",
    "SNAP",
)


class Paint:
    """A square of one metre whose material emits what a tree of nodes makes of an image."""

    def __init__(self, seed=1):
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
        bpy.ops.mesh.primitive_plane_add(size=1.0)
        self.obj = bpy.context.object
        self.tree, color = add_glow(self.obj.data, "Paint")
        self.emission, self.material = color.node, self.obj.data.materials[0]
        self.random = np.random.default_rng(seed)

    def add(self, kind, **properties):
        node = self.tree.nodes.new(f"ShaderNode{kind}")
        for name, value in properties.items():
            setattr(node, name, value)
        return node

    def image(self, side=SIDE, alpha=False):
        image = bpy.data.images.new("Picture", side, side, alpha=alpha, float_buffer=True)
        pixels = self.random.random((side, side, 4)).astype(np.float32)
        pixels[..., 3] = self.random.random((side, side)) if alpha else 1.0
        image.pixels.foreach_set(pixels.ravel())
        image.pack()
        return self.add("TexImage", image=image, interpolation="Closest")

    def feed(self, node, **inputs):
        """Links or values of a node's enabled inputs, by name."""
        for name, value in inputs.items():
            socket = next(one for one in node.inputs if one.enabled and one.name in (name.replace("_", " "), {"Fac": "Factor"}.get(name)))
            if isinstance(value, bpy.types.NodeSocket):
                self.tree.links.new(value, socket)
            else:
                socket.default_value = (*value, 1.0) if isinstance(value, tuple) else value
        return next(one for one in node.outputs if one.enabled)

    def read(self):
        """(SIDE, SIDE, 3) emission as a bake has it, the snapshot's images, and what was told."""
        warnings = []
        table = MaterialTable(warnings)
        table.index(self.material)
        table.finish({"tri_material": np.zeros(2, np.int64)})
        material = table.readings[0].material
        pixels = table.images.images[material.emission_image].pixels if material.emission_image >= 0 else np.ones((SIDE, SIDE, 3))
        return pixels * np.array(material.emission_rgb), table.images.images, [text for _, text in warnings]

    def check(self, output):
        self.feed(self.emission, Color=output)
        found, images, told = self.read()
        assert not told
        np.testing.assert_allclose(found, bake_emission(self.obj, self.tree, SIDE)[..., :3], rtol=2e-3, atol=2e-3)
        return images


@pytest.fixture
def _by_itself(monkeypatch):
    """What is read where Blender cannot evaluate the nodes."""
    monkeypatch.setattr(SocketBaker, "bake", lambda *_, **__: None)


def use_curve(node):
    node.mapping.curves[3].points[1].location = (1.0, 0.4)
    node.mapping.curves[0].points[0].location = (0.0, 0.3)
    node.mapping.update()


def color_ramp(node, interpolation):
    node.color_ramp.interpolation = interpolation
    first, second = node.color_ramp.elements
    first.color, second.color, second.position = (0.8, 0.1, 0.1, 1.0), (0.1, 0.2, 0.8, 1.0), 0.59  # between two entries of Cycles' table


@pytest.mark.parametrize("textured", [True, False])
@pytest.mark.parametrize(
    ("kind", "values"),
    [
        ("HueSaturation", {"Hue": 0.7, "Saturation": 0.4, "Value": 0.8, "Fac": 0.9}),
        ("Gamma", {"Gamma": 2.2}),
        ("Invert", {"Fac": 0.8}),
        ("RGBToBW", {}),
        ("RGBCurve", {"Fac": 0.75}),
    ],
)
def test_a_node_of_one_color(kind, values, textured):
    paint = Paint()
    node = paint.add(kind)
    if kind == "RGBCurve":
        use_curve(node)
    images = paint.check(paint.feed(node, Color=paint.image().outputs[0] if textured else (0.6, 0.3, 0.1), **values))
    assert len(images) == textured  # and not the one below the node


@pytest.mark.parametrize("kind", ["HueSaturation", "NormalMap", "Reroute"])
def test_a_node_that_is_linked_to_itself_is_as_one_that_is_not_linked(kind):
    """Blender draws such a link and does not call it invalid."""
    tree = Paint().tree
    node = tree.nodes.new("NodeReroute" if kind == "Reroute" else f"ShaderNode{kind}")
    socket = node.inputs[0] if kind == "Reroute" else node.inputs["Color"]
    tree.links.new(node.outputs[0], socket)
    assert find_source(Port(socket)).socket == socket


def test_brightness_and_contrast():
    paint = Paint()
    node = paint.add("BrightContrast")
    node.inputs[1].default_value, node.inputs[2].default_value = -0.2, 0.3
    paint.check(paint.feed(node, Color=paint.image().outputs[0]))


@pytest.mark.parametrize("interpolation", ["LINEAR", "CONSTANT", "EASE"])
def test_a_ramp_over_an_image(interpolation):
    paint = Paint()
    node = paint.add("ValToRGB")
    color_ramp(node, interpolation)
    paint.check(paint.feed(node, Fac=paint.image().outputs[0]))


@pytest.mark.parametrize("blend", BLENDS)
def test_a_mix_of_two_images_by_a_third(blend):
    paint = Paint()
    node = paint.add("Mix", data_type="RGBA", blend_type=blend)
    pictures = [paint.image().outputs[0] for _ in range(3)]
    paint.check(paint.feed(node, Factor=pictures[0], A=pictures[1], B=pictures[2]))


@pytest.mark.parametrize("blend", ["MIX", "MULTIPLY", "SUBTRACT"])
@pytest.mark.parametrize("textured", ["A", "B", ""])
def test_a_mix_with_a_constant(blend, textured):
    paint = Paint()
    node = paint.add("Mix", data_type="RGBA", blend_type=blend)
    inputs = {"A": (0.9, 0.5, 0.3), "B": (0.2, 0.4, 0.1)} | ({textured: paint.image().outputs[0]} if textured else {})
    paint.check(paint.feed(node, Factor=0.3, **inputs))


@pytest.mark.parametrize("operation", [*UNARY, *BINARY, "MULTIPLY_ADD"])
def test_math(operation):
    paint = Paint()
    node = paint.add("Math", operation=operation)
    values = [paint.image().outputs[0], 0.37, 0.25]
    for socket, value in zip(node.inputs, values[: 3 if operation == "MULTIPLY_ADD" else 2 if operation in BINARY else 1], strict=False):
        if isinstance(value, float):
            socket.default_value = value
        else:
            paint.tree.links.new(value, socket)
    paint.check(node.outputs[0])


@pytest.mark.parametrize(
    "operation", ["SCALE", "ADD", "SUBTRACT", "MULTIPLY", "DIVIDE", "MULTIPLY_ADD", "MINIMUM", "MODULO", "ABSOLUTE", "FLOOR"]
)
def test_vector_math(operation):
    paint = Paint()
    node = paint.add("VectorMath", operation=operation)
    used = [socket for socket in node.inputs if socket.enabled]
    paint.tree.links.new(paint.image().outputs[0], used[0])
    for socket in used[1:]:
        socket.default_value = (0.7, 0.4, 0.2) if socket.type == "VECTOR" else 0.3
    paint.check(node.outputs["Vector"])


def test_float_curve():
    paint = Paint()
    node = paint.add("FloatCurve")
    node.mapping.curves[0].points[1].location = (1.0, 0.4)
    node.mapping.update()
    node.inputs[0].default_value = 0.8
    paint.tree.links.new(paint.image().outputs[0], node.inputs[1])
    paint.check(node.outputs[0])


def test_numbers_of_an_image_mapped_clamped_mixed_parted_and_joined():
    paint = Paint()
    parted = paint.add("SeparateColor")
    paint.feed(parted, Color=paint.image().outputs[0])
    ranged, clamped = paint.add("MapRange"), paint.add("Clamp")
    mixed, joined = paint.add("Mix", data_type="FLOAT"), paint.add("CombineColor", mode="HSV")
    paint.feed(ranged, Value=parted.outputs[0], From_Min=0.2, From_Max=0.7, To_Min=0.1, To_Max=0.9)
    paint.feed(clamped, Value=parted.outputs[1], Min=0.3, Max=0.6)
    paint.feed(mixed, Factor=0.25, A=parted.outputs[2], B=0.5)
    for socket, node in zip(joined.inputs, (ranged, clamped, mixed), strict=True):
        paint.tree.links.new(next(one for one in node.outputs if one.enabled), socket)
    paint.check(joined.outputs[0])


def test_a_math_node_that_clamps():
    paint = Paint()
    grey = paint.feed(paint.add("RGBToBW"), Color=paint.image().outputs[0])
    node = paint.add("Math", operation="MULTIPLY_ADD", use_clamp=True)
    for socket, value in zip(node.inputs, (grey, 3.0, -0.8), strict=True):
        if isinstance(value, float):
            socket.default_value = value
        else:
            paint.tree.links.new(value, socket)
    paint.check(node.outputs[0])


@pytest.mark.parametrize("kelvin", [500.0, 1300.0, 2700.0, 9000.0])
def test_blackbody(kelvin):
    paint = Paint()
    paint.check(paint.feed(paint.add("Blackbody"), Temperature=kelvin))


def test_the_alpha_of_an_image_and_a_strength_that_differs_over_the_surface():
    paint = Paint()
    paint.feed(paint.emission, Strength=paint.image(alpha=True).outputs["Alpha"])
    paint.check(paint.image().outputs[0])


def test_a_coarser_image_lies_on_a_finer_one():
    paint = Paint()
    node = paint.add("Mix", data_type="RGBA", blend_type="MULTIPLY")
    paint.check(paint.feed(node, Factor=1.0, A=paint.image().outputs[0], B=paint.image(SIDE // 4).outputs[0]))


def test_what_is_mapped_in_another_way_counts_by_its_mean():
    paint = Paint()
    node, other = paint.add("Mix", data_type="RGBA", blend_type="SUBTRACT"), paint.image()
    mapping = paint.add("Mapping")
    mapping.inputs["Scale"].default_value = (2.0, 2.0, 1.0)
    paint.tree.links.new(paint.add("UVMap").outputs[0], mapping.inputs["Vector"])
    paint.tree.links.new(mapping.outputs[0], other.inputs["Vector"])
    picture = paint.image()
    paint.feed(paint.emission, Color=paint.feed(node, Factor=1.0, A=picture.outputs[0], B=other.outputs[0]))
    found, _, told = paint.read()
    assert len(told) == 1
    assert MIXED in told[0]
    pixels = [np.array(node.image.pixels).reshape(SIDE, SIDE, 4)[..., :3] for node in (picture, other)]
    np.testing.assert_allclose(found, pixels[0] - pixels[1].mean(axis=(0, 1)), atol=1e-5)


def test_masked_metal_and_masked_shaders_keep_their_masks():
    paint = Paint()
    mask = paint.image()
    principled, diffuse, mix = paint.add("BsdfPrincipled"), paint.add("BsdfDiffuse"), paint.add("MixShader")
    paint.feed(principled, Base_Color=(0.8, 0.6, 0.4), Metallic=mask.outputs[0])
    paint.feed(diffuse, Color=(0.1, 0.2, 0.3))
    for socket, output in zip(mix.inputs, (mask.outputs[0], principled.outputs[0], diffuse.outputs[0]), strict=True):
        paint.tree.links.new(output, socket)
    paint.tree.links.new(mix.outputs[0], next(node for node in paint.tree.nodes if node.type == "OUTPUT_MATERIAL").inputs["Surface"])
    table = MaterialTable([])
    material = table.readings[table.index(paint.material)].material
    part = np.array(mask.image.pixels).reshape(SIDE, SIDE, 4)[..., :3] @ (0.2126, 0.7152, 0.0722)
    # All that is reflected, and what metal reflects of it.
    expected = (1.0 - part[..., None]) * (0.8, 0.6, 0.4) + part[..., None] * (0.1, 0.2, 0.3)
    np.testing.assert_allclose(table.images.images[material.albedo_image].pixels, expected, atol=1e-4)
    metal = (1.0 - part[..., None]) * part[..., None] * (0.8, 0.6, 0.4)
    np.testing.assert_allclose(table.images.images[material.metal_image].pixels, metal, atol=1e-4)
    # As rough as the principled shader, and where how much of the surface is metal, or has a layer.
    lobes = np.stack([np.full_like(part, 0.5), (1.0 - part) * part, (1.0 - part) ** 2], axis=-1)
    np.testing.assert_allclose(table.images.images[material.lobe_image].pixels, lobes, atol=1e-4)


def test_metals_are_as_rough_as_an_image_says():
    paint = Paint()
    image, metal = paint.image(), paint.add("BsdfMetallic")
    paint.feed(metal, Base_Color=(0.8, 0.6, 0.4), Edge_Tint=(0.9, 0.5, 0.2), Roughness=image.outputs[0])
    paint.tree.links.new(metal.outputs[0], next(node for node in paint.tree.nodes if node.type == "OUTPUT_MATERIAL").inputs["Surface"])
    table, told = MaterialTable(warnings := []), warnings
    material = table.readings[table.index(paint.material)].material
    assert told == []
    grey = np.array(image.image.pixels).reshape(SIDE, SIDE, 4)[..., :3] @ (0.2126, 0.7152, 0.0722)
    lobes = np.stack([grey, np.ones_like(grey), np.zeros_like(grey)], axis=-1)
    np.testing.assert_allclose(table.images.images[material.lobe_image].pixels, lobes, atol=1e-4)
    assert material.metal_edge_rgb == pytest.approx((0.9, 0.5, 0.2))
    # Glass, alone or in a mix, where no share is metal or has a layer.
    glass, mix = paint.add("BsdfGlass"), paint.add("MixShader")
    paint.feed(glass, Roughness=image.outputs[0])
    output = next(node for node in paint.tree.nodes if node.type == "OUTPUT_MATERIAL")
    paint.tree.links.new(glass.outputs[0], mix.inputs[2])
    paint.tree.links.new(paint.add("BsdfTransparent").outputs[0], mix.inputs[1])
    for shader in (glass, mix):
        paint.tree.links.new(shader.outputs[0], output.inputs["Surface"])
        table = MaterialTable(told)
        lobes_of_glass = table.images.images[table.readings[table.index(paint.material)].material.lobe_image].pixels
        np.testing.assert_allclose(lobes_of_glass, grey[..., None] * (1, 0, 0), atol=1e-4)
    assert told == []
    paint.tree.links.new(metal.outputs[0], output.inputs["Surface"])
    # Gold by its indices of refraction.
    metal.fresnel_type = "PHYSICAL_CONDUCTOR"
    metal.inputs["IOR"].default_value, metal.inputs["Extinction"].default_value = (0.18, 0.42, 1.37), (3.42, 2.35, 1.77)
    gold = MaterialTable([])
    assert gold.readings[gold.index(paint.material)].material.metal_rgb == pytest.approx((0.945, 0.777, 0.373), abs=1e-3)


def test_a_large_image_is_made_whole_and_once():
    table = derived_images.ImageTable()
    picture = Color((1.0, 1.0, 1.0), table.add(TextureImage("a", np.random.default_rng(2).random((301, 407, 3)).astype(np.float32))))
    made, note = derived_images.derive(table, "key", lambda color: 1.0 - color, [picture], "inverted")
    again, _ = derived_images.derive(table, "key", lambda color: 1.0 - color, [picture], "inverted")
    assert (again.image, note) == (made.image, "")
    np.testing.assert_allclose(table.images[made.image].pixels, 1.0 - table.images[picture.image].pixels, atol=1e-6)


def test_very_many_textures_made_by_nodes_are_coarser():
    """An object's colour, for example, makes one texture for each object."""
    table = derived_images.ImageTable()
    pixels = np.linspace(0.0, 1.0, 512 * 8 * 3, dtype=np.float32).reshape(512, 8, 3)
    picture = Color((1.0, 1.0, 1.0), table.add(TextureImage("a", pixels)))
    fine, fine_note = derived_images.derive(table, 0, lambda color: 1.0 - color, [picture], "inverted")
    table.derived_texels += 1 << 27  # as after thousands of others
    coarse, coarse_note = derived_images.derive(table, 1, lambda color: 1.0 - color, [picture], "inverted")
    assert [table.images[color.image].pixels.shape[:2] for color in (fine, coarse)] == [(512, 8), (256, 8)]
    assert [fine_note, coarse_note] == ["", derived_images.COARSE]
    assert coarse.mean == pytest.approx(fine.mean, rel=0.02)


def paint_corners(paint):
    """(4, 3) random colours at the corners of the square."""
    layer = paint.obj.data.color_attributes.new("Col", "FLOAT_COLOR", "CORNER")
    layer.data.foreach_set("color", np.random.default_rng(3).random(16).astype(np.float32))
    rgba = np.empty((4, 4), np.float32)
    layer.data.foreach_get("color", rgba.ravel())
    return rgba[:, :3]


@pytest.mark.usefixtures("_by_itself")
def test_nodes_of_vertex_colors_are_told_at_the_corners():
    paint = Paint()
    rgb = paint_corners(paint)
    inverted = paint.feed(paint.add("Invert"), Color=paint.add("VertexColor", layer_name="Col").outputs[0], Fac=1.0)
    paint.feed(paint.emission, Color=paint.feed(paint.add("Gamma"), Color=inverted, Gamma=2.0), Strength=3.0)
    result = export_scene(bpy.context)
    scene, material = result.snapshot, result.snapshot.materials[0]
    assert any(AT_CORNERS in text for _, text in result.warnings)
    pixels = scene.images[material.emission_image].pixels
    place = (scene.tri_emission_uv * (pixels.shape[1], pixels.shape[0]) - 0.5).round().astype(int)
    shown = pixels[place[..., 1], place[..., 0]] * np.array(material.emission_rgb)
    assert shown == pytest.approx(3.0 * (1.0 - rgb[scene.tri_corner]) ** 2, abs=1e-3)


@pytest.mark.usefixtures("_by_itself")
def test_a_painted_factor_mixes_two_colors_at_the_corners():
    paint = Paint()
    rgb = paint_corners(paint)
    mix = paint.add("Mix", data_type="RGBA", blend_type="MIX")
    painted = paint.add("VertexColor", layer_name="Col").outputs[0]
    paint.feed(paint.emission, Color=paint.feed(mix, Factor=painted, A=(1.0, 0.5, 0.0), B=(0.0, 0.25, 1.0)))
    scene = export_scene(bpy.context).snapshot
    pixels = scene.images[scene.materials[0].emission_image].pixels
    place = (scene.tri_emission_uv * (pixels.shape[1], pixels.shape[0]) - 0.5).round().astype(int)
    part = (rgb[scene.tri_corner] @ (0.2126, 0.7152, 0.0722))[..., None]
    assert pixels[place[..., 1], place[..., 0]] == pytest.approx((1 - part) * (1.0, 0.5, 0.0) + part * (0.0, 0.25, 1.0), abs=1e-3)


@pytest.mark.usefixtures("_by_itself")
def test_vertex_colors_that_meet_an_image_are_scaled_to_a_mean():
    paint = Paint()
    rgb = paint_corners(paint)
    colors = [paint.add("VertexColor", layer_name="Col").outputs[0], paint.image()]
    mix = paint.add("Mix", data_type="RGBA", blend_type="MIX")
    paint.feed(paint.emission, Color=paint.feed(mix, Factor=colors[0], A=colors[1].outputs[0], B=(0.0, 0.0, 0.0)))
    result = export_scene(bpy.context)
    material = result.snapshot.materials[0]
    mean = rgb[[0, 1, 2, 0, 2, 3]].mean(axis=0) @ (0.2126, 0.7152, 0.0722)
    assert any("factor of node Mix is replaced by its mean" in text for _, text in result.warnings)
    assert material.emission_rgb == pytest.approx((1.0 - mean,) * 3, rel=0.03)  # the image keeps its detail
