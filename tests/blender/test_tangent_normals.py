"""Normal maps that are read without Cycles are what Cycles gives on the same mesh."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from leaflight.addon.nodes import socket_bake
from leaflight.addon.read.export_scene import export_scene

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
    image = bpy.data.images.new("Bumps", *bumps.shape[:2], is_data=True)
    pixels = np.ones((*bumps.shape[:2], 4), np.float32)
    pixels[..., :2] = bumps
    image.colorspace_settings.name = space  # before the pixels: a generated image is made anew by it
    image.pixels.foreach_set(pixels.ravel())
    material = bpy.data.materials.new("Paint")
    if material.node_tree is None:
        material.use_nodes = True
    obj.data.materials.append(material)
    tree = material.node_tree
    texture, node = tree.nodes.new("ShaderNodeTexImage"), tree.nodes.new("ShaderNodeNormalMap")
    texture.image, node.inputs["Strength"].default_value = image, strength
    tree.links.new(texture.outputs["Color"], node.inputs["Color"])
    tree.links.new(node.outputs[0], tree.nodes["Principled BSDF"].inputs["Normal"])
    return tree, node


def export_normals():
    snapshot = export_scene(bpy.context).snapshot
    return snapshot.images[next(material.normal_image for material in snapshot.materials if material.normal_image >= 0)].pixels


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
    theirs = export_normals()  # a linked strength is left to Blender
    tree.links.remove(link)
    monkeypatch.setattr(socket_bake, "bake_socket", lambda *_: pytest.fail("Blender was asked"))
    mine = export_normals()
    both = mine.any(axis=2) & theirs.any(axis=2)
    assert both.mean() > 0.5
    unit = theirs[both] / np.linalg.norm(theirs[both], axis=1, keepdims=True)
    cosine = (mine[both] * unit).sum(axis=1)
    assert np.percentile(cosine, 5) > 0.9  # around polygons Cycles shows the nearest of their texels
    assert np.percentile(cosine, 50) > 0.997  # 0.96 to 0.99 where the map is shifted by three texels


def test_joints_that_are_finer_than_the_texels_of_normals_are_not_missed():
    """Every fourth column of the map leans; four columns come to a texel, whose middle lies between two that do not."""
    bpy.ops.mesh.primitive_plane_add(size=1.0)
    bumps = np.full((256, 256, 2), 0.5)
    bumps[:, ::4, 0] = 0.9
    wear_normal_map(bpy.context.object, bumps=bumps)
    normals = export_normals()
    found = normals[normals.any(axis=2)]
    x = 2.0 * np.interp(np.arange(0, 256, 0.01), np.arange(257), np.append(bumps[0, :, 0], bumps[0, 0, 0])) - 1.0
    assert (found[:, 0] / found[:, 2]).mean() == pytest.approx(x.mean(), rel=0.05)  # 0.03 is four standard errors
    expected = (1.0 / np.sqrt(1.0 + x * x)).mean()
    assert (1.0 - found[:, 2]).mean() == pytest.approx(1.0 - expected, rel=0.05)


def test_a_normal_map_that_changes_nothing_is_left_out():
    tree, node = wear_normal_map(add_object("cylinder"))
    tree.links.remove(node.inputs["Color"].links[0])
    assert all(material.normal_image < 0 for material in export_scene(bpy.context).snapshot.materials)
