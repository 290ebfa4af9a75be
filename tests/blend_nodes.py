"""Materials that only glow, in tests of what is read of nodes, and what Cycles shows of them."""

from pathlib import Path
from typing import Any

import bpy
import numpy as np
from blend_rooms import make_material


def add_glow(mesh: Any, name: str = "Glow") -> tuple[Any, Any]:
    """A material for the mesh that emits only: its node tree, and the input for its colour."""
    material = make_material(name)
    mesh.materials.append(material)
    tree = material.node_tree
    tree.nodes.clear()
    output, emission = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("OutputMaterial", "Emission"))
    tree.links.new(emission.outputs[0], output.inputs["Surface"])
    return tree, emission.inputs["Color"]


def use_cycles() -> Any:
    """The open scene, which is rendered and baked by Cycles with one sample."""
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 1, False
    return scene


def bake_emission(obj: Any, tree: Any, side: int) -> np.ndarray:
    """(side, side, 4) float32 emission by Cycles on the active UV layer of an object, whose material has that tree; row 0 at the bottom."""
    target = bpy.data.images.new("Target", side, side, float_buffer=True, alpha=True)
    target.colorspace_settings.name = "Linear Rec.709"
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image, tree.nodes.active = target, node
    for other in tree.nodes:
        other.select = other == node
    for other in bpy.context.view_layer.objects:
        other.select_set(other == obj)
    bpy.context.view_layer.objects.active = obj
    use_cycles()
    bpy.ops.object.bake(type="EMIT", margin=0)
    pixels = np.empty((side, side, 4), np.float32)
    target.pixels.foreach_get(pixels.ravel())
    return pixels


def render_from_above(folder: Path, side: int) -> np.ndarray:
    """(side, side, 3) picture by Cycles of the square from -1 to 1 m, seen from 0.5 m above the origin; row 0 at the bottom."""
    scene = use_cycles()
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BOX", 0.01
    scene.render.resolution_x = scene.render.resolution_y = side
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location, camera.data.type, camera.data.ortho_scale = (0.0, 0.0, 0.5), "ORTHO", 2.0
    scene.collection.objects.link(camera)
    scene.camera, scene.view_settings.view_transform = camera, "Raw"
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
    scene.render.filepath = str(folder / "render.exr")
    bpy.ops.render.render(write_still=True)
    return np.array(bpy.data.images.load(scene.render.filepath).pixels).reshape(side, side, 4)[..., :3]
