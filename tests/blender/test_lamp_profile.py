"""Lamps whose light differs by direction: their profiles as Cycles evaluates them."""

import math

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blend_rooms import add_object
from leaflight.addon.read.lamp_profile import ProfileTable
from leaflight.addon.read.lights_read import read_lamp
from leaflight.core.scene.scene import Light
from leaflight.core.util.sphere_map import find_cells, find_solid_angles
from mathutils import Matrix

pytestmark = pytest.mark.usefixtures("empty_file")

IES = "\n".join(
    ["IESNA:LM-63-1995", "TILT=NONE", "1 1000 1 7 1 1 2 0.1 0.1 0.1", "1 1 20", "0 15 30 45 60 75 90", "0", "70 60 50 40 30 20 10", ""]
)


def add_lamp(kind="POINT", **properties):
    data = bpy.data.lights.new("Lamp", kind)
    data.energy = 100.0
    for name, value in properties.items():
        setattr(data, name, value)
    return add_object("Lamp", data)


def use_tree(lamp):
    """Its tree and emission node."""
    lamp.data.use_nodes = True
    tree = lamp.data.node_tree
    return tree, next(node for node in tree.nodes if node.type == "EMISSION")


def read(lamp, warnings=None):
    """Its lights, and the maps of their profiles."""
    bpy.context.view_layer.update()
    warnings = [] if warnings is None else warnings
    evaluated = lamp.evaluated_get(bpy.context.evaluated_depsgraph_get())
    found, table = read_lamp(evaluated, np.array(lamp.matrix_world), "Lamp", warnings), ProfileTable(bpy.context.scene)
    return ([found] if isinstance(found, Light) else found.resolve(table, warnings)), table.maps


def look(profile, *directions):
    toward = np.array(directions, float)
    return profile.ravel()[find_cells(profile.shape, toward / np.linalg.norm(toward, axis=1, keepdims=True))]


def mean_of(profile):
    return float((profile * find_solid_angles(*profile.shape)[:, None]).sum() / (4 * math.pi))


def paint_area(shape, pixels):
    """An area lamp of 2 m x 1 m, turned and moved, whose emission is an image (h, w, 3) by its own coordinates."""
    lamp = add_lamp("AREA", shape=shape, size=2.0, size_y=1.0)
    lamp.matrix_world = Matrix.Translation((1.0, 2.0, 3.0)) @ Matrix.Rotation(math.pi / 2, 4, "Z")
    tree, emission = use_tree(lamp)
    image = bpy.data.images.new("Picture", pixels.shape[1], pixels.shape[0], float_buffer=True)
    image.colorspace_settings.name = "Linear Rec.709"
    image.pixels.foreach_set(np.concatenate([pixels, np.ones((*pixels.shape[:2], 1))], axis=2).astype(np.float32).ravel())
    node, place = tree.nodes.new("ShaderNodeTexImage"), tree.nodes.new("ShaderNodeNewGeometry")
    node.image, node.interpolation, node.extension = image, "Closest", "EXTEND"
    tree.links.new(place.outputs["Parametric"], node.inputs["Vector"])
    tree.links.new(node.outputs["Color"], emission.inputs["Color"])
    return lamp


def test_a_picture_on_an_area_lamp_is_made_of_rectangles():
    warnings = []
    lights, _ = read(paint_area("RECTANGLE", np.array([[[1.0, 0, 0], [0, 2.0, 0]]])), warnings)
    power = np.array([light.power_rgb for light in lights])
    assert power.sum(axis=0) == pytest.approx([50.0, 100.0, 0.0], rel=2e-3)  # of 100 W, each colour on its half
    assert sum(light.size_m[0] * light.size_m[1] for light in lights) == pytest.approx(2.0, rel=0.02)
    place = np.average([light.position_m for light in lights], axis=0, weights=power[:, 0])
    other = np.average([light.position_m for light in lights], axis=0, weights=power[:, 1])
    # Its x is the world's y. Cycles counts the first coordinate of a lamp from its end.
    assert sorted([place[1], other[1]]) == pytest.approx([1.5, 2.5], abs=0.02)
    assert place[[0, 2]] == pytest.approx([1.0, 3.0], abs=0.02)
    assert warnings == []


def test_an_even_disk_stays_one_lamp_and_a_painted_one_has_its_power():
    (light,), _ = read(paint_area("ELLIPSE", np.full((1, 1, 3), 0.5)))
    assert (light.shape, light.power_rgb) == ("ELLIPSE", pytest.approx((50.0,) * 3, rel=2e-3))
    lights, _ = read(paint_area("ELLIPSE", np.array([[[0.5] * 3], [[1.5] * 3]])))
    assert 4 < len(lights) <= 64
    assert sum(light.power_rgb[0] for light in lights) == pytest.approx(100.0, rel=0.01)


def test_a_plain_lamp_has_none():
    for kind in ("POINT", "SPOT", "SUN", "AREA"):
        (light,), maps = read(add_lamp(kind))
        assert (light.profile, maps) == (-1, [])


def test_an_ies_file_is_a_profile():
    lamp = add_lamp()
    tree, emission = use_tree(lamp)
    texture = tree.nodes.new("ShaderNodeTexIES")
    texture.ies = bpy.data.texts.new("lamp.ies")
    texture.ies.from_string(IES)
    tree.links.new(texture.outputs[0], emission.inputs["Strength"])
    warnings = []
    (light,), (profile,) = read(lamp, warnings)
    assert warnings == []
    assert light.kind == "POINT"
    assert mean_of(profile) == pytest.approx(1, rel=1e-4)
    by_angle = look(profile, *((math.sin(angle), 0.0, -math.cos(angle)) for angle in np.radians([1, 30, 60])), (0, 0, 1))
    assert look(profile, (0, 0, -1), (1e-3, 1e-3, -1)) == pytest.approx(by_angle[0], rel=0.02)
    assert by_angle[:3] / by_angle[1] == pytest.approx([69.33 / 50, 1, 30 / 50], rel=0.01)
    assert by_angle[3] == 0
    if bpy.app.version >= (5, 0, 0):  # 4.5 counts a candela for a tenth more
        assert np.array(light.power_rgb) * by_angle[1] == pytest.approx(100.0 * 50 * 0.0706650768394 * np.ones(3), rel=0.01)


def test_a_square_spot_is_square():
    lamp = add_lamp("SPOT", use_square=True, spot_size=math.radians(60), spot_blend=0.0)
    (light,), (profile,) = read(lamp)
    assert light.kind == "POINT"
    corner, side, beyond = look(profile, (0.4, 0.4, -1), (0.4, 0, -1), (0.8, 0, -1))
    assert corner > 0
    assert side == pytest.approx(corner, rel=0.05)
    assert beyond == 0


def test_a_picture_of_colours_is_a_lamp_for_each_channel():
    lamp = add_lamp()
    tree, emission = use_tree(lamp)
    place, mix = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeMix")
    split = tree.nodes.new("ShaderNodeSeparateXYZ")
    above = tree.nodes.new("ShaderNodeMath")
    above.operation, above.inputs[1].default_value, mix.data_type = "GREATER_THAN", 0.0, "RGBA"
    red, blue = (next(socket for socket in mix.inputs if socket.identifier == name) for name in ("A_Color", "B_Color"))
    red.default_value, blue.default_value = (1.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.5, 1.0)
    tree.links.new(place.outputs["Normal"], split.inputs[0])
    tree.links.new(split.outputs["X"], above.inputs[0])
    tree.links.new(above.outputs[0], mix.inputs[0])
    tree.links.new(next(socket for socket in mix.outputs if socket.identifier == "Result_Color"), emission.inputs["Color"])
    lights, maps = read(lamp)
    assert [np.flatnonzero(light.power_rgb).tolist() for light in lights] == [[0], [2]]
    sides = [look(maps[light.profile], (-1, 0.1, 0), (1, 0.1, 0)) for light in lights]
    assert sides[0] == pytest.approx(sides[1][::-1], rel=0.05)
    assert sides[0].min() == 0
    assert sum(sum(light.power_rgb) for light in lights) == pytest.approx(100.0 * (0.5 * 1.0 + 0.5 * 0.5), rel=0.02)


def test_what_is_by_distance_is_told():
    lamp = add_lamp()
    tree, emission = use_tree(lamp)
    falloff = tree.nodes.new("ShaderNodeLightFalloff")
    falloff.inputs["Strength"].default_value = 2.0
    tree.links.new(falloff.outputs["Linear"], emission.inputs["Strength"])
    warnings = []
    (light,), maps = read(lamp, warnings)
    assert maps == []
    assert light.power_rgb == pytest.approx((200.0,) * 3, rel=1e-3)
    assert ["at 1 m" in text for _, text in warnings] == [True]


def test_max_bounces_are_told():
    lamp = add_lamp()
    lamp.data.cycles.max_bounces = 3
    warnings = []
    read(lamp, warnings)
    ((_, text),) = warnings
    assert "Max Bounces (3)" in text
    assert "; lower its power" in text
