"""Lamps with IES files: as much light as Cycles makes of them."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blend_rooms import make_material
from leaflight.addon.nodes.ies_profile import UNKNOWN, find_mean, parse_mean
from leaflight.addon.read.lights_read import read_light

SIDE = 32
RADIUS_M = 2.0


def write_ies(vertical, horizontal, candela, tilt="NONE", factor=1.0, ballast=1.0, lamp=1.0):
    """The text of a file of type C; candela by horizontal and vertical angle."""
    rows = [f"1 1000 {factor} {len(vertical)} {len(horizontal)} 1 2 0.1 0.1 0.1", f"{ballast} {lamp} 20"]
    rows += [" ".join(str(x) for x in row) for row in (vertical, horizontal, *candela)]
    return "\n".join(["IESNA:LM-63-1995", "[TEST] none", f"TILT={tilt}", *rows, ""])


EVEN = write_ies((0, 90, 180), (0,), [(100, 100, 100)])
DOWN = write_ies((0, 30, 60, 90), (0,), [(400, 300, 100, 0)], factor=1.5, ballast=0.8, lamp=0.9)
STEPS = np.arange(0, 181, 15)
SIDED = write_ies(STEPS, STEPS, (100 + 90 * np.sin(np.radians(STEPS)) * np.cos(np.radians(STEPS))[:, None] + STEPS[:, None] / 2).round(2))
TILTED = write_ies((0, 90, 180), (0,), [(100, 100, 100)], tilt="INCLUDE\n1\n2\n0 90\n1 0.5")


def make_lamp(text):
    """A point light in the middle of a ball that looks inwards."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.mesh.primitive_uv_sphere_add(radius=RADIUS_M, segments=64, ring_count=32)
    ball = bpy.context.object
    ball.data.flip_normals()
    bpy.ops.object.light_add(type="POINT")
    lamp = bpy.context.object
    lamp.data.energy, lamp.data.shadow_soft_size = 10.0, 0.0
    lamp.data.use_nodes = True
    tree = lamp.data.node_tree
    profile = tree.nodes.new("ShaderNodeTexIES")
    profile.inputs["Strength"].default_value = 0.5
    if text:
        profile.ies = bpy.data.texts.new("lamp.ies")
        profile.ies.from_string(text)
    emission = next(node for node in tree.nodes if node.type == "EMISSION")
    tree.links.new(profile.outputs[0], emission.inputs["Strength"])
    return ball, lamp, profile


def bake_mean(ball):
    """Mean of Cycles' direct light over the ball."""
    material = make_material("White")
    ball.data.materials.append(material)
    image = bpy.data.images.new("Target", SIDE, SIDE, float_buffer=True)
    image.colorspace_settings.name = "Linear Rec.709"
    node = material.node_tree.nodes.new("ShaderNodeTexImage")
    node.image, material.node_tree.nodes.active, node.select = image, node, True
    for obj in bpy.context.view_layer.objects:
        obj.select_set(obj == ball)
    bpy.context.view_layer.objects.active = ball
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.samples = "CYCLES", 16
    bpy.ops.object.bake(type="DIFFUSE", pass_filter={"DIRECT"}, margin=0)
    pixels = np.empty((SIDE, SIDE, 4), np.float32)
    image.pixels.foreach_get(pixels.ravel())
    height = np.sin((np.arange(SIDE) + 0.5) / SIDE * np.pi)  # rows of its UVs are rings
    return float(height @ pixels[..., 0].mean(axis=1) / height.sum())


# Where a file has no angle beyond, Cycles before 5.0 goes on with 0: between few angles its cubic is up to a tenth too bright.
few_angles = pytest.mark.skipif(bpy.app.version < (5, 0), reason="this Cycles makes more light of files with few angles than they tell of")


@pytest.mark.parametrize(
    "text",
    [
        pytest.param(EVEN, marks=few_angles, id="even"),
        pytest.param(DOWN, marks=few_angles, id="down"),
        pytest.param(SIDED, id="sided"),
        pytest.param(TILTED, marks=few_angles, id="tilted"),
        pytest.param("", id="none"),
    ],
)
def test_a_lamp_gives_as_much_light_as_in_cycles(text):
    ball, lamp, _ = make_lamp(text)
    warnings = []
    power = read_light(lamp, np.eye(4), "Lamp", warnings).power_rgb
    assert power == pytest.approx((power[0],) * 3)
    assert len(warnings) == 1
    assert ("all directions" if text else "no IES file") in warnings[0][1]
    assert power[0] / (4 * np.pi**2 * RADIUS_M**2) == pytest.approx(bake_mean(ball), rel=0.03)


def test_files_that_cannot_be_read_are_told_apart():
    profile = make_lamp("no profile")[2]
    assert find_mean(profile) is None
    profile.mode, profile.filepath = "EXTERNAL", "//not/there.ies"
    assert find_mean(profile) is None
    assert UNKNOWN == 100.0
    with pytest.raises(ValueError, match="type C"):
        parse_mean(EVEN.replace(" 1 2 0.1", " 2 2 0.1"))


def test_an_external_file(tmp_path):
    profile = make_lamp("")[2]
    (tmp_path / "lamp.ies").write_text(EVEN)
    profile.mode, profile.filepath = "EXTERNAL", str(tmp_path / "lamp.ies")
    assert find_mean(profile) == pytest.approx(parse_mean(EVEN))


def test_nothing_is_sent_beyond_the_angles_of_a_file():
    """Straight down to 60 degrees, as bright at all of them: a quarter of the sphere."""
    narrow = parse_mean(write_ies((0, 60), (0,), [(100, 100)]))
    assert narrow == pytest.approx(0.25 * parse_mean(EVEN), rel=1e-2)
