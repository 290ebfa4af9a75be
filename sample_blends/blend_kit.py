"""Blender data made without operators, so that a sample comes out the same every time."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector
from shapes import Point, Shape

Part = tuple[Shape, bpy.types.Material]


def start_scene() -> bpy.types.Scene:
    """An empty file with a black world and Cycles set so that nothing is clamped, cut short or tone mapped."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.render.resolution_x, scene.render.resolution_y = 480, 360
    # The factory's output folder is an absolute path of the machine that built the file.
    scene.render.filepath = "//"
    scene.cycles.samples = 64
    scene.cycles.use_denoising = True
    scene.cycles.max_bounces = scene.cycles.diffuse_bounces = 64
    scene.cycles.sample_clamp_indirect = 0.0
    scene.view_settings.view_transform = "Standard"
    scene.world = bpy.data.worlds.new("World")
    set_world((0.0, 0.0, 0.0), 0.0)
    return scene


def use_nodes(block: bpy.types.Material | bpy.types.World) -> bpy.types.NodeTree:
    """The block's node tree; 5.0 and later always have one and warn about the switch."""
    if bpy.app.version < (5, 0, 0):
        block.use_nodes = True
    return block.node_tree


def node_of(tree: bpy.types.NodeTree, kind: str) -> bpy.types.Node:
    """The tree's node of that type, made if it is not there."""
    return next((node for node in tree.nodes if node.bl_idname == kind), None) or tree.nodes.new(kind)


def set_world(color: Point, strength: float) -> None:
    """A uniform sky of that radiance, W/m^2/sr."""
    tree = use_nodes(bpy.context.scene.world)
    background, output = node_of(tree, "ShaderNodeBackground"), node_of(tree, "ShaderNodeOutputWorld")
    tree.links.new(background.outputs["Background"], output.inputs["Surface"])
    background.inputs["Color"].default_value = (*color, 1.0)
    background.inputs["Strength"].default_value = strength


def paint(name: str, color: Point, emission: float = 0.0, glow: Point = (1.0, 1.0, 1.0)) -> bpy.types.Material:
    """A purely diffuse Principled material, its base colour the exact albedo; emission is radiance, W/m^2/sr."""
    material = bpy.data.materials.new(name)
    shader = node_of(use_nodes(material), "ShaderNodeBsdfPrincipled")
    shader.inputs["Base Color"].default_value = (*color, 1.0)
    shader.inputs["Roughness"].default_value = 1.0
    shader.inputs["Specular IOR Level"].default_value = 0.0
    shader.inputs["Emission Color"].default_value = (*glow, 1.0)
    shader.inputs["Emission Strength"].default_value = emission
    material.diffuse_color = (*color, 1.0)
    return material


def textured(name: str, srgb: np.ndarray, scale: tuple[float, float]) -> bpy.types.Material:
    """A diffuse material with a packed image, repeated by a Mapping node on the object's own UV map.

    srgb   (height, width, 3) float in 0..1, row 0 at the bottom
    scale  repeats over one unit of u and of v
    """
    height, width = srgb.shape[:2]
    image = bpy.data.images.new(name, width, height)
    image.pixels.foreach_set(np.dstack([srgb, np.ones((height, width))]).astype(np.float32).ravel())
    image.update()
    image.pack()
    material = paint(name, (0.5, 0.5, 0.5))
    tree = material.node_tree
    shader = node_of(tree, "ShaderNodeBsdfPrincipled")
    texture, mapping, uv = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("TexImage", "Mapping", "UVMap"))
    for column, node in enumerate((texture, mapping, uv)):
        node.location = (shader.location.x - 300 - 220 * column, shader.location.y)
    texture.image = image
    uv.uv_map = "UVMap"
    mapping.inputs["Scale"].default_value = (*scale, 1.0)
    tree.links.new(uv.outputs["UV"], mapping.inputs["Vector"])
    tree.links.new(mapping.outputs["Vector"], texture.inputs["Vector"])
    tree.links.new(texture.outputs["Color"], shader.inputs["Base Color"])
    return material


def make_mesh(name: str, *parts: Part, smooth: bool = False, unit_uv: bool = False) -> bpy.types.Mesh:
    """One mesh of several shapes with a material each; `unit_uv` lays every quad over the whole unit square."""
    mesh = bpy.data.meshes.new(name)
    starts = np.cumsum([0] + [len(shape.points) for shape, _ in parts])
    points = np.concatenate([shape.points for shape, _ in parts])
    faces = [[int(start) + corner for corner in face] for start, (shape, _) in zip(starts, parts, strict=False) for face in shape.faces]
    mesh.from_pydata(points.tolist(), [], faces)
    materials = list(dict.fromkeys(material for _, material in parts))
    for material in materials:
        mesh.materials.append(material)
    slots = [materials.index(material) for shape, material in parts for _ in shape.faces]
    mesh.polygons.foreach_set("material_index", slots)
    mesh.polygons.foreach_set("use_smooth", [smooth] * len(faces))
    if unit_uv:
        layer = mesh.uv_layers.new(name="UVMap")
        layer.data.foreach_set("uv", [0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0, 1.0] * len(faces))
    if mesh.validate():
        raise ValueError(f"{name}: the mesh was built with broken faces; look at its shape")
    mesh.update()
    return mesh


def place(name: str, data: bpy.types.ID | None, location: Point = (0.0, 0.0, 0.0)) -> bpy.types.Object:
    """A new object in the scene."""
    thing = bpy.data.objects.new(name, data)
    thing.location = location
    bpy.context.scene.collection.objects.link(thing)
    return thing


def add_mesh(name: str, *parts: Part, smooth: bool = False, unit_uv: bool = False, location: Point = (0.0, 0.0, 0.0)) -> bpy.types.Object:
    """A new mesh object; see `make_mesh`."""
    return place(name, make_mesh(name, *parts, smooth=smooth, unit_uv=unit_uv), location)


def aim(thing: bpy.types.Object, target: Point) -> bpy.types.Object:
    """Turn a camera or a light towards a point."""
    thing.rotation_euler = (Vector(target) - thing.location).to_track_quat("-Z", "Y").to_euler()
    return thing


def add_camera(location: Point, target: Point, lens_mm: float) -> None:
    """The scene's camera."""
    data = bpy.data.cameras.new("Camera")
    data.lens = lens_mm
    data.clip_start = 0.01
    bpy.context.scene.camera = aim(place("Camera", data, location), target)


def add_light(name: str, kind: str, energy: float, location: Point, target: Point, **settings: object) -> bpy.types.Object:
    """A light, W (W/m^2 for a sun), that looks at a point; the settings are Blender's own names."""
    data = bpy.data.lights.new(name, kind)
    data.energy = energy
    for key, value in settings.items():
        setattr(data, key, value)
    return aim(place(name, data, location), target)


def save(path: Path) -> None:
    """Write the file compressed, without a backup copy beside it or a path of the machine that built it."""
    for space in (space for screen in bpy.data.screens for area in screen.areas for space in area.spaces):
        if space.type == "FILE_BROWSER" and space.params:
            space.params.directory = b"//"
    bpy.context.view_layer.update()
    bpy.context.preferences.filepaths.save_version = 0
    bpy.ops.wm.save_as_mainfile(filepath=str(path), compress=True, relative_remap=True)
