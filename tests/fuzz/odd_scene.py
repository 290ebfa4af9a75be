"""A scene that nobody would make on purpose, from a seed: odd meshes, placements, modifiers, names and kinds of objects. Needs bpy."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from random import Random
from typing import Any

import bpy
from odd_materials import add_lamp, add_world, make_material
from odd_values import NUMBERS, draw_json, draw_name, draw_number

Points = list[list[float]]
Faces = list[list[int]]
MARKS = [  # our own custom properties, which a file may hold in any shape
    "leaflight_made leaflight_state leaflight_state_is leaflight_state_objects leaflight_state_of leaflight_live leaflight_stands_for",
    "leaflight_uv_layer leaflight_active_layer leaflight_uv leaflight_copies leaflight_source leaflight_hidden leaflight_shared_mesh",
    "leaflight_shape leaflight_prints leaflight_page leaflight_bake leaflight_original leaflight_added_slot leaflight_missing",
    "leaflight_layout leaflight_spare leaflight_views leaflight",
]


def build_scene(rng: Random) -> None:
    """The open scene; beside what is odd there is most times a floor and a good lamp, so that the bake goes to its end."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    materials = [make_material(rng) for _ in range(rng.randrange(4))]
    objects = []
    if rng.random() < 0.85:
        objects.append(_add_object("Floor", _make_mesh("Floor", *_draw_grid(2, 4.0)), materials, rng))
    objects += [_draw_object(rng, materials) for _ in range(rng.choice([0, 1, 1, 2, 3, 5]))]
    if rng.random() < 0.8:
        _add_good_lamp()
    for _ in range(rng.choice([0, 0, 1, 2])):
        objects.append(add_lamp(rng))
    for place in (_nest_deeply, _instance_deeply, _scatter_marks, _hide_some, _change_scene):
        if rng.random() < 0.2:
            place(rng, objects)
    if rng.random() < 0.4:
        add_world(rng, scene)


def _add_good_lamp() -> None:
    light = bpy.data.lights.new("Lamp", "POINT")
    light.energy = 100.0
    lamp = bpy.data.objects.new("Lamp", light)
    lamp.location = (0.5, 0.5, 2.0)
    bpy.context.scene.collection.objects.link(lamp)


def _draw_object(rng: Random, materials: list[Any]) -> Any:
    if rng.random() < 0.15:
        obj = _add_other_kind(rng)
        if obj is not None:
            return obj
    mesh = rng.choice(bpy.data.meshes) if bpy.data.meshes and rng.random() < 0.2 else _draw_mesh(rng)
    obj = _add_object(draw_name(rng), mesh, materials, rng)
    _place(rng, obj)
    for _ in range(rng.choice([0, 0, 0, 1, 2])):
        _add_modifier(rng, obj)
    return obj


def _add_object(name: str, mesh: Any, materials: list[Any], rng: Random) -> Any:
    obj = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(obj)
    if not mesh.materials:
        for _ in range(rng.choice([0, 1, 1, 2])):
            mesh.materials.append(rng.choice([None, *materials]))
        for polygon in mesh.polygons:
            polygon.material_index = rng.randrange(3)  # also one that is not there
    return obj


def _place(rng: Random, obj: Any) -> None:
    obj.location = [rng.uniform(-1.0, 1.0) for _ in range(3)]
    if rng.random() < 0.4:
        obj.scale = [draw_number(rng, 0.4) for _ in range(3)] if rng.random() < 0.6 else [rng.choice(NUMBERS)] * 3
    if rng.random() < 0.15:
        obj.location[rng.randrange(3)] = rng.choice(NUMBERS)
    if rng.random() < 0.3:
        obj.rotation_euler = [draw_number(rng, 0.1) for _ in range(3)]
    if rng.random() < 0.05:
        obj.matrix_world = [[draw_number(rng, 0.3) for _ in range(4)] for _ in range(4)]


# meshes


def _draw_mesh(rng: Random) -> Any:
    draw: Callable[[Random], tuple[Points, Faces]] = rng.choice(_SHAPES)
    points, faces = draw(rng)
    for change in (_scale, _break_numbers, _repeat, _flatten, _shift):
        if rng.random() < 0.25:
            points, faces = change(rng, points, faces)
    mesh = _make_mesh(draw_name(rng), points, faces, loose=rng.random() < 0.1)
    _add_layers(rng, mesh)
    return mesh


def _make_mesh(name: str, points: Points, faces: Faces, loose: bool = False) -> Any:
    mesh = bpy.data.meshes.new(name)
    edges = [[i, i + 1] for i in range(0, len(points) - 1, 2)] if loose else []
    mesh.from_pydata(points, edges, faces)
    return mesh


def _draw_grid(count: int, side: float) -> tuple[Points, Faces]:
    step = side / count
    points = [[x * step - side / 2, y * step - side / 2, 0.0] for y in range(count + 1) for x in range(count + 1)]
    row = count + 1
    faces = [[y * row + x, y * row + x + 1, (y + 1) * row + x + 1, (y + 1) * row + x] for y in range(count) for x in range(count)]
    return points, faces


def _draw_box(rng: Random) -> tuple[Points, Faces]:
    points = [[x, y, z] for z in (0.0, 0.5) for y in (0.0, 0.5) for x in (0.0, 0.5)]
    faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
    return points, faces[: rng.choice([6, 6, 5, 1])]


def _draw_soup(rng: Random) -> tuple[Points, Faces]:
    count = rng.choice([1, 3, 40])
    points = [[rng.uniform(-1.0, 1.0) for _ in range(3)] for _ in range(3 * count)]
    return points, [[3 * i, 3 * i + 1, 3 * i + 2] for i in range(count)]


def _draw_ngon(rng: Random) -> tuple[Points, Faces]:
    """A star, a bow, or a fan that turns back on itself."""
    count, turns = rng.choice([3, 5, 50]), rng.choice([1, 2, 3])
    points = []
    for i in range(count):
        angle, radius = 2 * math.pi * i * turns / count, rng.uniform(0.0, 1.0)
        points.append([radius * math.cos(angle), radius * math.sin(angle), rng.choice([0.0, 0.0, rng.uniform(-0.2, 0.2)])])
    return points, [list(range(count))]


def _draw_needles(rng: Random) -> tuple[Points, Faces]:
    thin = 10.0 ** -rng.uniform(3, 12)
    points = [[0.1 * i + dx, y, 0.5] for i in range(8) for dx, y in ((0.0, 0.0), (thin, 0.0), (0.0, 1.0))]
    return points, [[3 * i, 3 * i + 1, 3 * i + 2] for i in range(8)]


def _draw_fins(rng: Random) -> tuple[Points, Faces]:
    """Many sheets on one edge."""
    count = rng.choice([3, 12])
    points = [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    faces = []
    for i in range(count):
        x, y = math.cos(i), math.sin(i)
        points += [[x, y, 0.0], [x, y, 1.0]]
        faces.append([0, 2 + 2 * i, 3 + 2 * i, 1])
    return points, faces


_SHAPES: list[Callable[[Random], tuple[Points, Faces]]] = [
    lambda rng: _draw_grid(rng.choice([1, 3, 10]), rng.choice([0.5, 2.0])),
    _draw_box,
    _draw_box,
    _draw_soup,
    _draw_ngon,
    _draw_needles,
    _draw_fins,
    lambda rng: ([], []),
    lambda rng: ([[0.0, 0.0, float(i)] for i in range(rng.choice([1, 5]))], []),
]


def _scale(rng: Random, points: Points, faces: Faces) -> tuple[Points, Faces]:
    factor = 10.0 ** rng.choice([-45, -20, -8, -4, 4, 8, 20, 37])
    return [[factor * x for x in point] for point in points], faces


def _break_numbers(rng: Random, points: Points, faces: Faces) -> tuple[Points, Faces]:
    for point in rng.sample(points, min(len(points), rng.choice([1, 2, 100]))):
        point[rng.randrange(3)] = rng.choice(NUMBERS)
    return points, faces


def _repeat(rng: Random, points: Points, faces: Faces) -> tuple[Points, Faces]:
    """The same faces again, some of them turned, on vertices of their own."""
    twin = [[i + len(points) for i in (face if rng.random() < 0.5 else face[::-1])] for face in faces]
    return points + [list(point) for point in points], faces + twin


def _flatten(rng: Random, points: Points, faces: Faces) -> tuple[Points, Faces]:
    for axis in rng.sample(range(3), rng.choice([1, 2, 3])):
        for point in points:
            point[axis] = 0.25
    return points, faces


def _shift(rng: Random, points: Points, faces: Faces) -> tuple[Points, Faces]:
    away = rng.choice([1e3, 1e6, 1e9])
    return [[x + away for x in point] for point in points], faces


def _add_layers(rng: Random, mesh: Any) -> None:
    for _ in range(rng.choice([0, 0, 1, 2, 8])):
        layer = mesh.uv_layers.new(name=rng.choice(["UVMap", "Leaflight", draw_name(rng)]))
        if layer is None:  # Blender has no more than eight
            break
        odd = rng.choice([0.0, 0.0, 0.3, 1.0])
        for loop in layer.data:
            loop.uv = [rng.choice(NUMBERS) if rng.random() < odd else rng.random() for _ in range(2)]
    if rng.random() < 0.2:
        colors = mesh.color_attributes.new(draw_name(rng), rng.choice(["FLOAT_COLOR", "BYTE_COLOR"]), rng.choice(["POINT", "CORNER"]))
        for one in colors.data:
            one.color = [draw_number(rng, 0.3) for _ in range(4)]


# what is done to objects


def _add_modifier(rng: Random, obj: Any) -> None:
    kind = rng.choice(["SUBSURF", "ARRAY", "MIRROR", "SOLIDIFY", "DECIMATE", "NODES", "ARMATURE", "DISPLACE", "TRIANGULATE", "BEVEL"])
    with contextlib.suppress(RuntimeError, TypeError):
        modifier = obj.modifiers.new(draw_name(rng), kind)
        if modifier is None:
            return
        if kind == "SUBSURF":
            modifier.levels, modifier.render_levels = rng.choice([(0, 1), (1, 0), (1, 2)])
        elif kind == "ARRAY":
            modifier.count = rng.choice([1, 3, 20])
            modifier.relative_offset_displace[0] = draw_number(rng)
        elif kind in ("SOLIDIFY", "BEVEL"):  # with odd numbers Blender itself crashes on them, as it does on many a boolean
            setattr(modifier, "thickness" if kind == "SOLIDIFY" else "width", rng.uniform(0.01, 0.3))
        elif kind == "DISPLACE":
            modifier.strength = draw_number(rng)
        elif kind == "DECIMATE":
            modifier.ratio = rng.choice([0.0, 0.5])


def _add_other_kind(rng: Random) -> Any:
    kind = rng.choice(["curve", "text", "metaball", "empty", "camera", "speaker", "lattice", "armature", "surface"])
    if kind == "curve":
        data = bpy.data.curves.new(draw_name(rng), "CURVE")
        data.dimensions, data.bevel_depth, data.extrude = rng.choice(["2D", "3D"]), draw_number(rng, 0.2), draw_number(rng, 0.2)
        spline = data.splines.new("POLY")
        spline.points.add(rng.choice([0, 1, 5]))
        for point in spline.points:
            point.co = [draw_number(rng, 0.1) for _ in range(4)]
    elif kind == "text":
        data = bpy.data.curves.new(draw_name(rng), "FONT")
        data.body, data.extrude = rng.choice(["", "a", draw_name(rng)]), 0.1
    elif kind == "metaball":
        data = bpy.data.metaballs.new(draw_name(rng))
        for _ in range(rng.choice([0, 1, 2])):
            data.elements.new().radius = rng.choice([0.0, 0.3, 1.0])
    elif kind == "surface":
        data = bpy.data.curves.new(draw_name(rng), "SURFACE")
    else:
        makers = {"camera": bpy.data.cameras, "speaker": bpy.data.speakers, "lattice": bpy.data.lattices, "armature": bpy.data.armatures}
        data = makers[kind].new(draw_name(rng)) if kind in makers else None
    obj = bpy.data.objects.new(draw_name(rng), data)
    bpy.context.scene.collection.objects.link(obj)
    return obj


def _nest_deeply(rng: Random, objects: list[Any]) -> None:
    """A chain of parents, each scaled, turned and moved, above some of the objects."""
    parent = None
    scale = rng.choice([0.5, 0.99, 1.0, -1.0, 2.0])
    for _ in range(rng.choice([3, 30, 200])):
        empty = bpy.data.objects.new("Parent", None)
        bpy.context.scene.collection.objects.link(empty)
        empty.scale, empty.rotation_euler, empty.parent = (scale, 1.0, scale), (0.1, 0.0, 0.2), parent
        parent = empty
    for obj in objects:
        if rng.random() < 0.5:
            obj.parent = parent


def _instance_deeply(rng: Random, objects: list[Any]) -> None:
    """Instances of instances of some of the objects; or instances on vertices or faces."""
    if rng.random() < 0.3:
        meshes = [obj for obj in objects if obj.type == "MESH"]
        if len(meshes) > 1:
            meshes[0].instance_type = rng.choice(["VERTS", "FACES"])
            meshes[1].parent = meshes[0]
        return
    collection = bpy.data.collections.new(draw_name(rng))
    for obj in objects:
        if rng.random() < 0.5:
            collection.objects.link(obj)
    for level in range(rng.choice([1, 2, 4])):
        outer = bpy.data.collections.new(draw_name(rng))
        for place in range(rng.choice([1, 2, 3])):
            empty = bpy.data.objects.new(draw_name(rng), None)
            empty.instance_type, empty.instance_collection = "COLLECTION", collection
            empty.location = (1.5 * place, 1.0 * level, 0.3)
            empty.scale = [rng.choice([1.0, 0.5, -1.0, 0.0])] * 3
            outer.objects.link(empty)
        collection = outer
    bpy.context.scene.collection.children.link(collection)


def _scatter_marks(rng: Random, objects: list[Any]) -> None:
    """Custom properties that are called like ours, with anything in them."""
    marks = " ".join(MARKS).split()
    blocks = [bpy.context.scene, *objects, *bpy.data.meshes, *bpy.data.materials, *bpy.data.images, *bpy.data.collections]
    for _ in range(rng.choice([1, 5, 20])):
        block, value = rng.choice(blocks), rng.choice([draw_json(rng), *objects, *bpy.data.materials, *bpy.data.images])
        with contextlib.suppress(TypeError, OverflowError, ValueError, UnicodeError, KeyError):  # what no custom property can hold
            block[rng.choice(marks)] = value


def _hide_some(rng: Random, objects: list[Any]) -> None:
    for obj in objects:
        setattr(obj, rng.choice(["hide_render", "hide_viewport", "is_holdout", "visible_shadow", "visible_diffuse"]), rng.random() < 0.5)


def _change_scene(rng: Random, objects: list[Any]) -> None:
    scene = bpy.context.scene
    scene.unit_settings.scale_length = rng.choice([1e-9, 0.01, 1000.0])
    scene.name = draw_name(rng)
    scene.view_layers[0].name = draw_name(rng)
    if rng.random() < 0.3:
        scene.view_settings.exposure = rng.choice([-32.0, 32.0])
    if rng.random() < 0.3:
        bpy.data.scenes.new(draw_name(rng))
