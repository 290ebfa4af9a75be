"""The zoo: a scene from a seed, for benchmarks that nothing can be tuned to. zoo_plan.py says what is drawn, this builds it with pip's bpy.

python tests/bench/scene_zoo.py SEED OUT.blend [--max-size N] [--max-triangles N] [--dress WHAT ...]     writes it, prints what it is

Objects that get a lightmap have the property `zoo_bake`; the scene has `zoo`, a JSON of what a benchmark has to know (see read_subject).
"""

import argparse
import json
import math
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[2] / "sample_blends"))

from shapes import Shape
from zoo_plan import draw_plan
from zoo_scene import Lamp, Paint, Plan, Rect, Thing, describe
from zoo_shapes import Part, build_shape

BAKED, ABOUT = "zoo_bake", "zoo"
DRESS = ("lamps", "matter", "casters")
TEXTURE_LAYER, LIGHTMAP_LAYER = "UVMap", "Lightmap"
_TEXTURE_SIDE = 128  # texels
_METRES_PER_REPEAT = 1.3
_SMART_ANGLE_RAD = math.radians(66.0)  # Blender's own default
_ISLAND_MARGIN = 0.004  # of the unit square, scaled with the islands as Blender does it unless told otherwise


def write_scene(seed: int, path: Path, max_size: int = 0, max_triangles: int = 0, dress: Sequence[str] = ()) -> Plan:
    """Build the scene of a seed and save it. Needs bpy, whose open scene it replaces.

    dress    of DRESS: "matter", random matter and a random world, see zoo_matter.py; "casters" and "lamps", see zoo_dress.py
    """
    plan = draw_plan(seed, max_size, max_triangles)
    if dress:
        plan = replace(plan, joined=False)  # what is off is found by object
    build_scene(plan)
    if dress:
        for what in dress_scene(plan, dress):
            print(what, file=sys.stderr)
    import blend_kit

    path.parent.mkdir(parents=True, exist_ok=True)
    blend_kit.save(path)
    return plan


def dress_scene(plan: Plan, dress: Sequence[str]) -> list[str]:
    """Give the open scene what files of artists have beside; a line of what was drawn for each of `dress`."""
    import bpy
    import zoo_dress
    import zoo_matter

    baked = [obj for obj in bpy.context.scene.objects if obj.get(BAKED)]
    drawn = {
        "lamps": lambda random: zoo_dress.dress_lamps(random, baked),
        "matter": zoo_matter.dress_scene,
        "casters": lambda random: zoo_dress.add_casters(random, plan.rooms[0], plan.height),
    }
    return [f"{what}: {', '.join(drawn[what](Random(f'{what} {plan.seed}')))}" for what in DRESS if what in dress]


def build_scene(plan: Plan) -> None:
    """The plan as the open scene."""
    import blend_kit
    import bpy

    scene = blend_kit.start_scene()
    blend_kit.set_world(plan.sky, 1.0)
    materials = [_make_material(f"Paint {index}", paint, plan.seed + index) for index, paint in enumerate(plan.paints)]
    groups: list[tuple[str, list[Thing]]] = [(thing.name, [thing]) for thing in plan.things if not (plan.joined and thing.baked)]
    if plan.joined:
        groups.append(("Joined", [thing for thing in plan.things if thing.baked]))
    baked = []
    for name, things in groups:
        obj = blend_kit.place(name, _make_mesh(name, things, materials))
        if things[0].baked:
            obj[BAKED] = True
            baked.append(obj)
    for index, lamp in enumerate(plan.lamps):
        _add_lamp(f"Lamp {index}", lamp)
    _add_camera(plan.rooms[0], plan.height, plan.kind == "outdoor")
    if plan.layout == "smart":
        unwrap_smart(baked)
    layer = LIGHTMAP_LAYER if plan.layout == "smart" else ""
    scene[ABOUT] = json.dumps({"size": plan.size, "uv_layer": layer, "about": describe(plan)})
    bpy.context.view_layer.update()


def unwrap_smart(objects: Sequence[Any]) -> None:
    """A new UV layer, by Blender's Smart UV Project over all objects together, on the unit square."""
    import bpy

    for obj in bpy.context.view_layer.objects:
        obj.select_set(False)
    for obj in objects:
        obj.data.uv_layers.active = obj.data.uv_layers.get(LIGHTMAP_LAYER) or obj.data.uv_layers.new(name=LIGHTMAP_LAYER)
        obj.select_set(True)
    bpy.context.view_layer.objects.active = objects[0]
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.uv.smart_project(angle_limit=_SMART_ANGLE_RAD, margin_method="SCALED", island_margin=_ISLAND_MARGIN)
    bpy.ops.object.mode_set(mode="OBJECT")


def _make_mesh(name: str, things: Sequence[Thing], materials: Sequence[Any]) -> Any:
    """One mesh of all parts of some things, in world space, with a layer for textures in metres."""
    import bpy

    points, faces, slots, smooth, start = [], [], [], [], 0
    used = list(dict.fromkeys(part.paint for thing in things for part in thing.parts))
    for thing in things:
        for part in thing.parts:
            shape = _place_part(thing, part)
            points.append(shape.points)
            faces += [tuple(start + corner for corner in face) for face in shape.faces]
            start += len(shape.points)
            slots += [used.index(part.paint)] * len(shape.faces)
            smooth += [part.smooth] * len(shape.faces)
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(np.concatenate(points).tolist(), [], faces)
    for paint in used:
        mesh.materials.append(materials[paint])
    mesh.polygons.foreach_set("material_index", slots)
    mesh.polygons.foreach_set("use_smooth", smooth)
    mesh.update()
    if mesh.validate():
        raise ValueError(f"{name}: the mesh was built with broken faces; look at its shapes")
    mesh.uv_layers.new(name=TEXTURE_LAYER).uv.foreach_set("vector", _project_box(mesh).ravel())
    return mesh


def _place_part(thing: Thing, part: Part) -> Shape:
    place = thing.place
    return build_shape(part).moved(place.x, place.y, place.z, place.turn, place.tilt)


def _project_box(mesh: Any) -> np.ndarray:
    """(n_corner, 2) float32: repeats of a texture, along the two axes that a face faces least."""
    normal = np.empty((len(mesh.polygons), 3), np.float32)
    mesh.polygons.foreach_get("normal", normal.ravel())
    point = np.empty((len(mesh.vertices), 3), np.float32)
    mesh.vertices.foreach_get("co", point.ravel())
    counts, corner = np.empty(len(mesh.polygons), np.int32), np.empty(len(mesh.loops), np.int32)
    mesh.polygons.foreach_get("loop_total", counts)
    mesh.loops.foreach_get("vertex_index", corner)
    axis = np.repeat(np.abs(normal).argmax(axis=1), counts)
    place = point[corner] / _METRES_PER_REPEAT
    rows = np.arange(len(corner))
    return np.stack([place[rows, (axis + 1) % 3], place[rows, (axis + 2) % 3]], axis=1).astype(np.float32)


def _make_material(name: str, paint: Paint, seed: int) -> Any:
    import blend_kit

    if not paint.texture:
        material = blend_kit.paint(name, paint.color)
    else:
        pattern = _draw_pattern(paint.texture, seed)[..., None]
        srgb = (np.array(paint.color) * (0.5 + 0.5 * pattern)) ** (1.0 / 2.2)
        material = blend_kit.textured(name, srgb, (1.0, 1.0))
    tree = material.node_tree
    shader = blend_kit.node_of(tree, "ShaderNodeBsdfPrincipled")
    if any(paint.glow):
        _add_glow(tree, shader, paint)
    elif paint.shader == "diffuse":
        _replace_by_diffuse(tree, shader)
    return material


def _add_glow(tree: Any, shader: Any, paint: Paint) -> None:
    level = max(paint.glow)
    shader.inputs["Emission Color"].default_value = (*(channel / level for channel in paint.glow), 1.0)
    shader.inputs["Emission Strength"].default_value = level
    for link in shader.inputs["Base Color"].links:  # what is textured glows by its texture
        tree.links.new(link.from_socket, shader.inputs["Emission Color"])


def _replace_by_diffuse(tree: Any, shader: Any) -> None:
    diffuse = tree.nodes.new("ShaderNodeBsdfDiffuse")
    diffuse.inputs["Color"].default_value = shader.inputs["Base Color"].default_value
    for link in shader.inputs["Base Color"].links:
        tree.links.new(link.from_socket, diffuse.inputs["Color"])
    output = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeOutputMaterial")
    tree.links.new(diffuse.outputs["BSDF"], output.inputs["Surface"])
    tree.nodes.remove(shader)


def _draw_pattern(kind: str, seed: int) -> np.ndarray:
    """(side, side) float in 0..1."""
    y, x = np.mgrid[0:_TEXTURE_SIDE, 0:_TEXTURE_SIDE] / _TEXTURE_SIDE
    if kind == "checker":
        return (np.floor(8 * x) + np.floor(8 * y)) % 2
    if kind == "stripes":
        return 0.5 + 0.5 * np.sin(2.0 * np.pi * 6.0 * x)
    if kind == "bricks":
        row = np.floor(8 * y)
        return 1.0 - ((8 * y % 1.0 < 0.12) | ((4 * x + row / 2) % 1.0 < 0.06))
    return np.random.default_rng(seed).random((_TEXTURE_SIDE, _TEXTURE_SIDE))


def _add_lamp(name: str, lamp: Lamp) -> None:
    import blend_kit

    settings: dict[str, Any] = {"color": lamp.color}
    if lamp.kind == "AREA":
        settings |= {"shape": lamp.shape, "size": lamp.extent[0], "size_y": lamp.extent[1]}
    elif lamp.kind == "SUN":
        settings |= {"angle": lamp.extent[0]}
    else:
        settings |= {"shadow_soft_size": lamp.extent[0]}
    if lamp.kind == "SPOT":
        settings |= {"spot_size": lamp.cone_rad, "spot_blend": lamp.blend}
    blend_kit.add_light(name, lamp.kind, lamp.power, lamp.place, lamp.target, **settings)


def _add_camera(room: Rect, height: float, outdoor: bool) -> None:
    """In a corner of the first room, or above the set."""
    import blend_kit

    x0, y0, x1, y1 = room
    middle = ((x0 + x1) / 2, (y0 + y1) / 2)
    if outdoor:
        blend_kit.add_camera((x0 - 3.0, y0 - 5.0, 6.0), (*middle, 0.5), 30.0)
    else:
        blend_kit.add_camera((x0 + 0.3, y0 + 0.3, 0.75 * height), (x1 - 0.5, y1 - 0.5, 0.35 * height), 16.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("seed", type=int)
    parser.add_argument("out", type=Path, metavar="OUT.blend")
    parser.add_argument("--max-size", type=int, default=0, help="largest side of the page, texels")
    parser.add_argument("--max-triangles", type=int, default=0)
    parser.add_argument(
        "--dress", nargs="+", default=(), choices=DRESS, help="with lamps with nodes, metal and patterns and a world, curves and hair ..."
    )
    arguments = parser.parse_args()
    plan = write_scene(arguments.seed, arguments.out, arguments.max_size, arguments.max_triangles, arguments.dress)
    print(describe(plan), file=sys.stderr)


if __name__ == "__main__":
    main()
