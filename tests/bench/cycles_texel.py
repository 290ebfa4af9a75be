"""Which points of a texel Cycles' bake is a mean of: prints what bakes of a glowing square of 8 x 8 texels show.

python tests/bench/cycles_texel.py     a few seconds; needs pip's bpy
"""

import sys

import bpy
import numpy as np

SIDE, TEXEL, SAMPLES = 8, 3, 1024  # the texel that is looked at


def glow(threshold: float) -> bpy.types.Material:
    """Radiance 1 where x (texels) is above the threshold, else 0."""
    material = bpy.data.materials.new("Glow")
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    kinds = ("NewGeometry", "SeparateXYZ", "Math", "Emission", "OutputMaterial")
    place, axes, step, emission, output = (tree.nodes.new(f"ShaderNode{kind}") for kind in kinds)
    step.operation = "GREATER_THAN"
    step.inputs[1].default_value = threshold
    ports = (place.outputs["Position"], axes.inputs[0]), (axes.outputs["X"], step.inputs[0]), (step.outputs[0], emission.inputs["Strength"])
    for port, target in (*ports, (emission.outputs[0], output.inputs["Surface"])):
        tree.links.new(port, target)
    return material


def bake_step(threshold: float, width: float = SIDE) -> np.ndarray:
    """(SIDE, 4) RGBA of the second row of texels, of a sheet `width` texels wide whose UVs are its x and y."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_adaptive_sampling, scene.cycles.use_denoising = SAMPLES, False, False
    corners = [(0.0, 0.0), (width, 0.0), (width, SIDE), (0.0, SIDE)]
    mesh = bpy.data.meshes.new("Sheet")
    mesh.from_pydata([(*corner, 0.0) for corner in corners], [], [(0, 1, 2, 3)])
    layer = mesh.uv_layers.new(name="UV")
    for loop in mesh.loops:
        layer.uv[loop.index].vector = [x / SIDE for x in corners[loop.vertex_index]]
    image = bpy.data.images.new("Target", SIDE, SIDE, alpha=True, float_buffer=True)
    image.colorspace_settings.name = "Linear Rec.709"
    image.pixels.foreach_set([0.0] * (4 * SIDE * SIDE))
    material = glow(threshold)
    node = material.node_tree.nodes.new("ShaderNodeTexImage")
    node.image, node.select, material.node_tree.nodes.active = image, True, node
    mesh.materials.append(material)
    sheet = bpy.data.objects.new("Sheet", mesh)
    scene.collection.objects.link(sheet)
    sheet.select_set(True)
    bpy.context.view_layer.objects.active = sheet
    bpy.ops.object.bake(type="EMIT", margin=0, use_clear=False)
    return np.array(image.pixels[:]).reshape(SIDE, SIDE, 4)[1]


def main() -> None:
    steps = np.arange(0.1, 1.0, 0.1)
    below = [1.0 - bake_step(TEXEL + step)[TEXEL, 0] for step in steps]
    print("share of the texel's samples left of x (a mean over the whole texel would have x):", file=sys.stderr)
    print("  " + ", ".join(f"{x:.1f}: {share:.2f}" for x, share in zip(steps, below, strict=True)), file=sys.stderr)
    edge = 0.6  # the sheet ends in the texel, beyond its centre
    inside = [1.0 - bake_step(TEXEL + step, TEXEL + edge)[TEXEL, 0] for step in steps[steps < edge]]
    print(f"the same where the sheet ends at {edge}:", file=sys.stderr)
    print("  " + ", ".join(f"{x:.1f}: {share:.2f}" for x, share in zip(steps, inside, strict=False)), file=sys.stderr)
    ends = {end: bool(bake_step(-1.0, TEXEL + end)[TEXEL, 3]) for end in (0.4, 0.49, 0.51)}
    print(f"baked where the sheet ends at: {ends}", file=sys.stderr)


if __name__ == "__main__":
    main()
