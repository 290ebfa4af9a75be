"""Normal maps that are read without Cycles are what Cycles gives on the same mesh."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blend_rooms import make_material
from leaflight.addon.nodes import socket_bake
from leaflight.addon.read.export_scene import export_scene
from leaflight.core.scene.normal_maps import NormalMaps
from leaflight.core.util.geometry import triangle_normals_areas

pytestmark = pytest.mark.usefixtures("empty_file")

SIDE = 8


def add_object(kind):
    if kind == "cylinder":  # flat, with polygons of many corners
        bpy.ops.mesh.primitive_cylinder_add(vertices=8)
    elif kind == "tiles":  # each turned by a quarter against the one before, so that they meet in corners with the same coordinates
        bpy.ops.mesh.primitive_grid_add(x_subdivisions=4, y_subdivisions=4)
        quarters = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
        turned = [np.roll(quarters, number * number % 4 + number // 4, axis=0) for number in range(16)]
        bpy.context.object.data.uv_layers.active.uv.foreach_set("vector", np.concatenate(turned).ravel())
    else:
        bpy.ops.mesh.primitive_uv_sphere_add(segments=8, ring_count=6)
        bpy.ops.object.shade_smooth()
    return bpy.context.object


def make_bumps(side=SIDE):
    """(side, side, 2): what normals have of either tangent, from 0 to 1, at random."""
    return np.random.default_rng(5).uniform(0.2, 0.8, (side, side, 2))


def wear_normal_map(obj, space="Non-Color", strength=1.0, bumps=None):
    bumps = make_bumps() if bumps is None else bumps
    image = bpy.data.images.new("Bumps", *bumps.shape[1::-1], is_data=True)
    pixels = np.ones((*bumps.shape[:2], 4), np.float32)
    pixels[..., :2] = bumps
    image.colorspace_settings.name = space  # before the pixels: a generated image is made anew by it
    image.pixels.foreach_set(pixels.ravel())
    material = make_material("Paint")
    obj.data.materials.append(material)
    tree = material.node_tree
    texture, node = tree.nodes.new("ShaderNodeTexImage"), tree.nodes.new("ShaderNodeNormalMap")
    texture.image, node.inputs["Strength"].default_value = image, strength
    tree.links.new(texture.outputs["Color"], node.inputs["Color"])
    tree.links.new(node.outputs[0], tree.nodes["Principled BSDF"].inputs["Normal"])
    return tree, node


def find_normals(count=20_000):
    """(3, m) unit normals at random places of a scene's triangles, and at which of the places they are."""
    snapshot = export_scene(bpy.context).snapshot
    rng = np.random.default_rng(1)
    tri, u, v = rng.integers(0, snapshot.n_tri, count), *rng.random((2, count), np.float32)
    u, v = np.where(u + v > 1.0, 1.0 - u, u), np.where(u + v > 1.0, 1.0 - v, v)
    side = triangle_normals_areas(snapshot.tri_position)[0].astype(np.float32)[tri].T
    rows, normal = NormalMaps.of(snapshot).look_up(tri, u, v, side)
    assert len(rows) > 0.99 * count
    return rows, normal


@pytest.mark.parametrize(
    ("kind", "mirrored", "strength"),
    [("sphere", False, 1.0), ("cylinder", True, 0.5), ("cylinder", False, 1.7), ("tiles", False, 1.0)],
)
def test_a_normal_map_is_read_as_cycles_gives_it(kind, mirrored, strength, monkeypatch):
    obj = add_object(kind)
    obj.rotation_euler, obj.scale = (0.3, 0.5, 0.7), (-0.4 if mirrored else 0.4, 0.5, 0.3)
    tree, node = wear_normal_map(obj, strength=strength)
    value = tree.nodes.new("ShaderNodeValue")
    value.outputs[0].default_value = strength
    link = tree.links.new(value.outputs[0], node.inputs["Strength"])
    known, theirs = find_normals()  # a linked strength is left to Blender
    tree.links.remove(link)
    monkeypatch.setattr(socket_bake, "bake_socket", lambda *_: pytest.fail("Blender was asked"))
    rows, mine = find_normals()
    assert len(rows) == 20_000
    cosine = (mine[:, known] * theirs).sum(axis=0)
    assert np.percentile(cosine, 5) > 0.9  # in texels at borders of polygons Cycles evaluates another place
    assert np.percentile(cosine, 50) > 0.997  # 0.96 to 0.99 where the map is shifted by three texels


def test_an_image_that_is_the_normal_itself_is_read_as_cycles_gives_it(monkeypatch):
    """Files from before Cycles have colours of normal maps in Normal without a Normal Map node."""
    obj = add_object("cylinder")
    obj.rotation_euler, obj.scale = (0.3, 0.5, 0.7), (-0.4, 0.5, 0.3)
    tree, node = wear_normal_map(obj)
    normal, unit = tree.nodes["Principled BSDF"].inputs["Normal"], tree.nodes.new("ShaderNodeVectorMath")
    source = node.inputs["Color"].links[0].from_socket
    unit.operation = "NORMALIZE"
    tree.links.new(source, unit.inputs[0])
    tree.links.new(unit.outputs[0], normal)
    known, theirs = find_normals()  # Blender evaluates this node
    tree.links.new(source, normal)
    monkeypatch.setattr(socket_bake, "bake_socket", lambda *_: pytest.fail("Blender was asked"))
    rows, mine = find_normals()
    assert len(rows) == 20_000
    cosine = (mine[:, known] * theirs).sum(axis=0)
    assert np.percentile(cosine, 5) > 0.9
    assert np.percentile(cosine, 50) > 0.997


def test_of_a_map_that_is_finer_than_any_page_texels_are_taken_at_random():
    """Every other column of the map leans; one of two is kept, and a regular choice would miss all that lean, or all others."""
    bpy.ops.mesh.primitive_plane_add(size=1.0)
    bumps = np.full((4, 4096, 2), 0.5)
    bumps[:, ::2, 0] = 0.9
    wear_normal_map(bpy.context.object, bumps=bumps)
    _, found = find_normals()
    assert (found[0] > 0.1).mean() == pytest.approx(0.5, abs=0.05)  # 0.011 is a standard error
    assert found[0].max() == pytest.approx(0.8 / np.hypot(1.0, 0.8), rel=0.01)  # not a mean of several


def test_a_normal_map_that_changes_nothing_is_left_out():
    tree, node = wear_normal_map(add_object("cylinder"))
    tree.links.remove(node.inputs["Color"].links[0])
    assert all(material.normal_image < 0 for material in export_scene(bpy.context).snapshot.materials)
