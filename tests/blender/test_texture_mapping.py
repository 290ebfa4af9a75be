"""Where images lie that positions map, as Cycles shows them."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blend_nodes import add_glow, bake_emission
from leaflight.addon.read.export_scene import export_scene

SIDE = 64  # of what Cycles bakes
PICTURE = 8


def make_stage(kind):
    """A turned, moved and stretched block, or its mirror image, with a lightmap layer of its own; gives the object."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.mesh.primitive_cube_add(size=2.0, location=(0.3, -0.4, 0.7), rotation=(0.2, 0.5, 0.1))
    obj = bpy.context.object
    obj.scale = (1.0, 0.6, 0.8) if kind != "mirrored" else (-1.0, 0.6, 0.8)
    if kind == "deformed":
        modifier = obj.modifiers.new("Bend", "SIMPLE_DEFORM")
        modifier.deform_method, modifier.factor = "TAPER", 0.5
    return obj


def show_image(obj, source, projection):
    """The tree of a glow that shows an image, mapped by an output of a Texture Coordinate or a Geometry node through a Mapping node."""
    image = bpy.data.images.new("Picture", PICTURE, PICTURE, float_buffer=True)
    image.pixels.foreach_set(np.random.default_rng(1).random(PICTURE * PICTURE * 4).astype(np.float32))
    image.alpha_mode = "NONE"
    image.pack()
    tree, color = add_glow(obj.data)
    kinds = ("TexCoord", "NewGeometry", "Mapping", "TexImage")
    coordinate, geometry, mapping, texture = (tree.nodes.new(f"ShaderNode{kind}") for kind in kinds)
    texture.image, texture.projection, texture.interpolation = image, projection, "Closest"
    mapping.inputs["Location"].default_value, mapping.inputs["Scale"].default_value = (0.3, 0.2, -0.1), (0.4, 0.7, 0.5)
    mapping.inputs["Rotation"].default_value = (0.1, 0.2, 0.3)
    if source == "Other":
        bpy.ops.object.empty_add(location=(0.2, 0.1, 0.0), rotation=(0.3, 0.0, 0.4))
        coordinate.object = bpy.context.object
    socket = geometry.outputs["Position"] if source == "Position" else coordinate.outputs["Object" if source == "Other" else source]
    tree.links.new(socket, mapping.inputs["Vector"])
    tree.links.new(mapping.outputs[0], texture.inputs["Vector"])
    tree.links.new(texture.outputs[0], color)
    return tree


@pytest.mark.parametrize("kind", ["plain", "mirrored", "deformed"])
@pytest.mark.parametrize("projection", ["FLAT", "BOX"])
@pytest.mark.parametrize("source", ["Object", "Generated", "Position", "Other", "UV"])
def test_positions_map_an_image_as_in_cycles(source, projection, kind):
    obj = make_stage(kind)
    tree = show_image(obj, source, projection)
    result = export_scene(bpy.context, uv_layer="UVMap")
    assert not [text for _, text in result.warnings if "simplified" in text]
    scene = result.snapshot
    expected = bake_emission(obj, tree, SIDE)
    found = np.zeros((SIDE, SIDE, 3))
    centre = (np.arange(SIDE) + 0.5) / SIDE
    place = np.stack(np.meshgrid(centre, centre), axis=-1)
    for corner, shown in zip(scene.tri_uv, scene.tri_emission_uv, strict=True):
        weight = np.linalg.solve(np.vstack([corner.T, np.ones(3)]), np.vstack([place.reshape(-1, 2).T, np.ones(SIDE * SIDE)])).T
        inside = (weight > 0.0).all(axis=1)
        texel = np.floor((weight[inside] @ shown) % 1.0 * PICTURE).astype(int)
        found.reshape(-1, 3)[inside] = scene.images[0].pixels[texel[:, 1], texel[:, 0]]
    covered = (expected[..., 3] > 0.0) & found.any(axis=-1)
    off = np.abs(found - expected[..., :3])[covered].max(axis=-1) > 1e-2
    assert covered.sum() > 1000
    assert off.mean() < 0.06  # texels that an edge of the picture's runs through
