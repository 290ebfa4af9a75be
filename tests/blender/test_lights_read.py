"""Blender's lights in Blender's units; the factors are those that Cycles' bakes gave."""

import math

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blend_rooms import add_object
from leaflight.addon.read.lights_read import read_light

pytestmark = pytest.mark.usefixtures("empty_file")


def read(kind, *, object_properties=None, warnings=None, matrix=None, **properties):
    data = bpy.data.lights.new("Lamp", kind)
    obj = add_object("Lamp", data)
    data.energy = 100.0
    for owner, values in ((data, properties), (obj, object_properties or {})):
        for name, value in values.items():
            setattr(owner, name, value)
    bpy.context.view_layer.update()
    found = [] if warnings is None else warnings
    return read_light(obj, np.array(obj.matrix_world if matrix is None else matrix), obj.name, found)


def use_tree(owner):
    owner.use_nodes = True
    return owner.node_tree


def test_point_keeps_its_power_radius_and_place():
    light = read("POINT", object_properties={"location": (1, 2, 3)}, shadow_soft_size=0.25, use_soft_falloff=False, use_shadow=False)
    assert light.kind == "POINT"
    assert light.position_m == (1.0, 2.0, 3.0)
    assert light.power_rgb == pytest.approx((100.0,) * 3)
    assert (light.radius_m, light.soft_falloff, light.casts_shadow) == (0.25, False, False)


def test_colour_exposure_temperature_and_diffuse_factor_multiply():
    light = read("POINT", color=(1.0, 0.5, 0.25), exposure=1.0, diffuse_factor=0.5)
    assert light.power_rgb == pytest.approx((100.0, 50.0, 25.0))
    warm = read("POINT", use_temperature=True, temperature=3000.0)
    assert warm.power_rgb == pytest.approx((177.08, 84.43, 27.22), rel=1e-3)  # as baked by Cycles
    assert read("POINT", temperature=3000.0).power_rgb == pytest.approx((100.0,) * 3)


@pytest.mark.parametrize(
    ("kind", "properties", "factor"),
    [
        ("POINT", {"shadow_soft_size": 0.1}, 0.125663),
        ("POINT", {"shadow_soft_size": 0.0}, 4.0),
        ("SPOT", {"shadow_soft_size": 0.5}, 3.14159),
        ("SUN", {"angle": 1.0}, 0.7221),
        ("SUN", {"angle": 0.0}, 1.0),
        ("AREA", {"shape": "RECTANGLE", "size": 0.2, "size_y": 0.1}, 0.02),
        ("AREA", {"shape": "DISK", "size": 0.2, "size_y": 0.1}, 0.031416),
    ],
)
def test_power_that_is_not_normalized(kind, properties, factor):
    """Factors of the irradiance baked by Cycles over that with `normalize` on."""
    assert read(kind, normalize=False, **properties).power_rgb[0] == pytest.approx(100.0 * factor, rel=1e-3)
    assert read(kind, normalize=True, **properties).power_rgb[0] == pytest.approx(100.0)


@pytest.mark.parametrize(
    ("shape", "expected_shape", "expected_size"),
    [
        ("SQUARE", "RECTANGLE", (2.0, 6.0)),
        ("RECTANGLE", "RECTANGLE", (2.0, 1.5)),
        ("DISK", "ELLIPSE", (2.0, 6.0)),
        ("ELLIPSE", "ELLIPSE", (2.0, 1.5)),
    ],
)
def test_area_shapes_scale_with_the_object(shape, expected_shape, expected_size):
    light = read("AREA", shape=shape, size=2.0, size_y=0.5, spread=1.0, object_properties={"scale": (1, 3, 5)})
    assert (light.shape, light.size_m) == (expected_shape, pytest.approx(expected_size))
    assert light.spread_rad == pytest.approx(1.0)
    assert light.power_rgb[0] == pytest.approx(100.0)


def test_axes_are_right_handed_and_light_shines_along_minus_z():
    light = read("SUN", angle=0.5, object_properties={"rotation_euler": (0.3, 0.8, 1.1), "scale": (2, 3, -4), "location": (5, 6, 7)})
    assert light.position_m == (0.0, 0.0, 0.0), "a sun that is moved is the same light"
    axes = np.array(light.rotation)
    assert axes @ axes.T == pytest.approx(np.eye(3), abs=1e-6)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    expected = np.array(bpy.data.objects["Lamp"].matrix_world)[:3, 2]
    assert axes[2] == pytest.approx(expected / np.linalg.norm(expected), abs=1e-6)
    assert light.angle_rad == pytest.approx(0.5)


@pytest.mark.parametrize(("scale", "tangent"), [((1, 1, 1), 0.5), ((2, 2, 1), 1.0), ((1, 1, 2), 0.25)])
def test_spot_cone_follows_scale(scale, tangent):
    light = read("SPOT", spot_size=2 * math.atan(0.5), spot_blend=0.3, shadow_soft_size=0.2, object_properties={"scale": scale})
    assert math.tan(light.cone_angle_rad / 2) == pytest.approx(tangent, rel=1e-5)
    assert (light.blend, light.radius_m) == (pytest.approx(0.3), pytest.approx(0.2))


def test_half_sphere_spot_and_flattened_spot():
    assert read("SPOT", spot_size=math.pi).cone_angle_rad == pytest.approx(math.pi, abs=1e-5)
    assert math.isfinite(read("SPOT", object_properties={"scale": (0, 0, 0)}).cone_angle_rad)


@pytest.mark.parametrize(
    ("kind", "properties", "text", "what_to_do"),
    [
        ("POINT", {"energy": -5.0}, "power is negative", "make strength and colour positive"),
        ("POINT", {"energy": math.nan}, "power is not a finite number", "correct strength"),
        ("SUN", {"energy": math.inf}, "power is not a finite number", "correct strength"),
        ("AREA", {"size": 0.0}, "size is zero", "make the size"),
        ("SPOT", {"use_square": True}, "square spot", ""),
        ("SPOT", {"object_properties": {"scale": (1, 2, 1)}}, "oval cone", ""),
        ("POINT", {"matrix": np.full((4, 4), np.nan)}, "not finite", "correct location"),
    ],
)
def test_warnings(kind, properties, text, what_to_do):
    """One that is left out has a sentence that ends with what to do."""
    warnings = []
    light = read(kind, warnings=warnings, **properties)
    assert [subject for subject, _ in warnings] == ["Lamp"]
    assert text in warnings[0][1]
    assert (light is None) == ("left out" in warnings[0][1]) == bool(what_to_do)
    assert warnings[0][1].rpartition("; ")[2].startswith(what_to_do)


UNSEEN = {f"visible_{name}": False for name in ("diffuse", "glossy", "transmission")}


@pytest.mark.parametrize("properties", [{"energy": 0.0}, {"object_properties": UNSEEN}])
def test_lights_without_light_are_silent(properties):
    warnings = []
    assert read("POINT", warnings=warnings, **properties) is None
    assert not warnings


@pytest.mark.parametrize("unseen", range(3))
def test_some_rays_do_not_see_a_lamp(unseen):
    light = read("POINT", object_properties={list(UNSEEN)[unseen]: False})
    assert light.seen_by == tuple(number != unseen for number in range(3))


def test_portal_gives_no_light():
    data = bpy.data.lights.new("Portal", "AREA")
    data.cycles.is_portal = True
    assert read_light(bpy.data.objects.new("Portal", data), np.eye(4), "Portal", []) is None


def test_light_nodes_multiply():
    data = bpy.data.lights.new("Lamp", "POINT")
    data.energy = 10.0
    tree = use_tree(data)
    emission = next(node for node in tree.nodes if node.type == "EMISSION")
    emission.inputs["Color"].default_value = (1.0, 0.5, 0.0, 1.0)
    emission.inputs["Strength"].default_value = 3.0
    obj = bpy.data.objects.new("Lamp", data)
    warnings = []
    assert read_light(obj, np.eye(4), "Lamp", warnings).power_rgb == pytest.approx((30.0, 15.0, 0.0))
    assert not warnings
    falloff = tree.nodes.new("ShaderNodeLightFalloff")
    tree.links.new(falloff.outputs["Linear"], emission.inputs["Strength"])
    read_light(obj, np.eye(4), "Lamp", warnings)
    assert [subject for subject, _ in warnings] == ["Lamp"]
