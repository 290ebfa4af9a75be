"""What artists' files have beside meshes and plain lamps: casters of every kind, lamps with nodes, links and odd transforms. Needs bpy.

The casters are not baked: what they cast on the rest is what is compared (they have `zoo_bake` False).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from random import Random
from typing import Any

import bpy
from zoo_matter import Painter

_LAMP_SHARE = 0.6  # of the lamps that are dressed
_CASTERS = 14
_STRANDS = 60


class Builder:
    """Adds casters in a box of the open scene, from (x0, y0, 0) to (x1, y1, height)."""

    def __init__(self, random: Random, box: tuple[float, float, float, float], height: float) -> None:
        self.random, self.box, self.height = random, box, height
        self.store = bpy.data.collections.new("Stored")  # in no scene: shown by instances alone

    def material(self) -> Any:
        made = bpy.data.materials.new("Caster")
        if bpy.app.version < (5, 0, 0):
            made.use_nodes = True
        made.node_tree.nodes.clear()
        painter = Painter(made.node_tree, self.random)
        made.node_tree.links.new(painter.diffuse().outputs[0], painter.node("OutputMaterial").inputs["Surface"])
        return made

    def show(self, data: Any, name: str) -> Any:
        """An object of new data at a random place and turn."""
        x0, y0, x1, y1 = self.box
        made = bpy.data.objects.new(name, data)
        if hasattr(data, "materials"):
            data.materials.append(self.material())
        draw = self.random.uniform
        made.location = draw(x0 + 0.4, x1 - 0.4), draw(y0 + 0.4, y1 - 0.4), draw(0.2, 0.8) * self.height
        made.rotation_euler = draw(0, math.tau), draw(0, math.tau), draw(0, math.tau)
        made["zoo_bake"] = False
        bpy.context.scene.collection.objects.link(made)
        return made

    def box_mesh(self, half: float) -> Any:
        corners = [(x, y, z) for x in (-half, half) for y in (-half, half) for z in (-half, half)]
        mesh = bpy.data.meshes.new("Box")
        mesh.from_pydata(corners, [], [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
        return mesh

    def sheet_mesh(self, half: float) -> Any:
        mesh = bpy.data.meshes.new("Sheet")
        mesh.from_pydata([(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)], [], [(0, 1, 2, 3)])
        return mesh

    def stored(self) -> Any:
        """A collection of a box and a lamp, which no scene shows."""
        group = bpy.data.collections.new("Group")
        thing = bpy.data.objects.new("Member", self.box_mesh(0.12))
        thing.data.materials.append(self.material())
        light = bpy.data.lights.new("Member lamp", "POINT")
        light.energy, light.shadow_soft_size = 3.0, 0.02
        lamp = bpy.data.objects.new("Member lamp", light)
        lamp.location = 0.0, 0.0, 0.4
        group.objects.link(thing)
        group.objects.link(lamp)
        return group


def _curve(b: Builder) -> Any:
    data = bpy.data.curves.new("Curve", "CURVE")
    data.dimensions, data.bevel_depth = "3D", b.random.uniform(0.01, 0.08)
    spline = data.splines.new("BEZIER")
    spline.bezier_points.add(2)
    for number, point in enumerate(spline.bezier_points):
        point.co = 0.4 * number, b.random.uniform(-0.4, 0.4), b.random.uniform(-0.3, 0.3)
        point.handle_left_type = point.handle_right_type = "AUTO"
    return b.show(data, "Curve")


def _text(b: Builder) -> Any:
    data = bpy.data.curves.new("Text", "FONT")
    data.body, data.extrude, data.size = "Leaf", 0.03, 0.5
    return b.show(data, "Text")


def _meta(b: Builder) -> Any:
    data = bpy.data.metaballs.new("Meta")
    data.resolution = data.render_resolution = 0.08
    for place in ((0.0, 0.0, 0.0), (0.25, 0.1, 0.0)):
        element = data.elements.new()
        element.co, element.radius = place, 0.3
    return b.show(data, "Meta")


def _surface(b: Builder) -> Any:
    data = bpy.data.curves.new("Surface", "SURFACE")
    data.dimensions = "3D"
    for row in range(4):
        spline = data.splines.new("NURBS")
        spline.points.add(3)
        for number, point in enumerate(spline.points):
            point.co = 0.25 * row - 0.4, 0.25 * number - 0.4, b.random.uniform(-0.2, 0.2), 1.0
    made = b.show(data, "Surface")
    for spline in data.splines:
        for point in spline.points:
            point.select = True
    bpy.context.view_layer.objects.active = made
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.curve.make_segment()
    bpy.ops.object.mode_set(mode="OBJECT")
    return made


def _hair(b: Builder) -> Any:
    made = b.show(b.sheet_mesh(0.4), "Hair")
    made.modifiers.new("Hair", "PARTICLE_SYSTEM")
    settings = made.particle_systems[0].settings
    settings.type, settings.count, settings.hair_length = "HAIR", _STRANDS, 0.3
    settings.root_radius, settings.tip_radius, settings.radius_scale = 1.0, 0.3, 0.02
    return made


def _particles(b: Builder) -> Any:
    thing = b.show(b.box_mesh(0.05), "Grain")
    made = b.show(b.sheet_mesh(0.5), "Grains")
    made.modifiers.new("Grains", "PARTICLE_SYSTEM")
    settings = made.particle_systems[0].settings
    settings.type, settings.count, settings.hair_length, settings.use_advanced_hair = "HAIR", 12, 1.0, True
    settings.render_type, settings.instance_object, settings.particle_size = "OBJECT", thing, 1.0
    settings.display_percentage = 30
    return made


def _collection(b: Builder) -> Any:
    made = b.show(None, "Instance")
    made.instance_type, made.instance_collection = "COLLECTION", b.stored()
    made.scale = 1.3, 0.8, b.random.choice([-1.0, 1.0])
    return made


def _vertices(b: Builder) -> Any:
    parent = b.show(b.sheet_mesh(0.4), "Vertices")
    child = b.show(b.box_mesh(0.08), "On vertices")
    child.parent, child.location = parent, (0.0, 0.0, 0.0)
    parent.instance_type = b.random.choice(["VERTS", "FACES"])
    parent.show_instancer_for_render = b.random.random() < 0.5
    return parent


def _modified(kind: str, **values: Any) -> Callable[[Builder], Any]:
    def make(b: Builder) -> Any:
        made = b.show(b.sheet_mesh(0.3) if kind == "SOLIDIFY" else b.box_mesh(0.15), kind.title())
        modifier = made.modifiers.new(kind, kind)
        for name, value in values.items():
            setattr(modifier, name, value)
        return made

    return make


def _sheared(b: Builder) -> Any:
    parent = b.show(None, "Shear")
    parent.scale = 2.0, 0.4, -1.0
    made = b.show(b.box_mesh(0.2), "Sheared")
    made.parent, made.location = parent, (0.1, 0.2, 0.0)
    return made


def _nodes(b: Builder) -> Any:
    """Boxes on points of a grid, by Geometry Nodes, with a curve made a tube."""
    group = bpy.data.node_groups.new("Scatter", "GeometryNodeTree")
    group.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    nodes, links = group.nodes, group.links
    grid, cube, instance = (nodes.new(f"GeometryNode{name}") for name in ("MeshGrid", "MeshCube", "InstanceOnPoints"))
    grid.inputs["Size X"].default_value = grid.inputs["Size Y"].default_value = 0.9
    cube.inputs["Size"].default_value = (0.12, 0.05, 0.2)
    paint, join, output = nodes.new("GeometryNodeSetMaterial"), nodes.new("GeometryNodeJoinGeometry"), nodes.new("NodeGroupOutput")
    tube, line, circle = (nodes.new(f"GeometryNode{name}") for name in ("CurveToMesh", "CurvePrimitiveLine", "CurvePrimitiveCircle"))
    circle.inputs["Radius"].default_value = 0.05
    paint.inputs["Material"].default_value = b.material()
    for source, target in (
        (grid.outputs["Mesh"], instance.inputs["Points"]),
        (cube.outputs["Mesh"], instance.inputs["Instance"]),
        (line.outputs["Curve"], tube.inputs["Curve"]),
        (circle.outputs["Curve"], tube.inputs["Profile Curve"]),
        (instance.outputs[0], join.inputs[0]),
        (tube.outputs[0], join.inputs[0]),
        (join.outputs[0], paint.inputs["Geometry"]),
        (paint.outputs[0], output.inputs[0]),
    ):
        links.new(source, target)
    made = b.show(b.sheet_mesh(0.1), "Nodes")
    made.modifiers.new("Scatter", "NODES").node_group = group
    return made


def _emitter(b: Builder) -> Any:
    made = b.show(b.box_mesh(0.06), "Glow")
    tree = made.material_slots[0].material.node_tree
    tree.nodes.clear()
    painter = Painter(tree, b.random)
    emission = painter.node("Emission", Color=painter.color(), Strength=b.random.uniform(5.0, 40.0))
    tree.links.new(emission.outputs[0], painter.node("OutputMaterial").inputs["Surface"])
    return made


KINDS: dict[str, Callable[[Builder], Any]] = {
    "curve": _curve,
    "text": _text,
    "metaball": _meta,
    "surface": _surface,
    "hair": _hair,
    "particles": _particles,
    "collection instance": _collection,
    "instances on vertices or faces": _vertices,
    "array": _modified("ARRAY", count=4),
    "mirror": _modified("MIRROR", use_axis=(True, True, False)),
    "solidify": _modified("SOLIDIFY", thickness=0.05),
    "wireframe": _modified("WIREFRAME", thickness=0.03),
    "subdivision": _modified("SUBSURF", levels=0, render_levels=2),
    "sheared": _sheared,
    "geometry nodes": _nodes,
    "emitter": _emitter,
}


def _unseen_by(*names: str) -> Callable[[Any], None]:
    def change(obj: Any) -> None:
        for name in names:
            setattr(obj, name, False)

    return change


# What may be set of a caster, by name.
FLAGS: dict[str, Callable[[Any], None]] = {
    "no shadow": _unseen_by("visible_shadow"),
    "not by diffuse rays": _unseen_by("visible_diffuse"),
    "not by diffuse rays, no shadow": _unseen_by("visible_diffuse", "visible_shadow"),
    "not by the camera": _unseen_by("visible_camera"),
    "not rendered": lambda obj: setattr(obj, "hide_render", True),
    "not in the viewport": lambda obj: setattr(obj, "hide_viewport", True),
}


def add_casters(random: Random, box: tuple[float, float, float, float], height: float) -> list[str]:
    """Add casters of random kinds to the open scene; what was drawn."""
    builder, drawn = Builder(random, box, height), []
    for _ in range(_CASTERS):
        kind = random.choice(list(KINDS))
        made = KINDS[kind](builder)
        flag = random.choice(list(FLAGS)) if random.random() < 0.3 and made.data is not None else ""
        if flag:
            FLAGS[flag](made)
        drawn.append(f"{made.name}: {flag}" if flag else made.name)
    return drawn


def _falloff(painter: Painter) -> Any:
    kind = painter.random.choice(["Quadratic", "Linear", "Constant"])
    falloff = painter.node("LightFalloff", Strength=0.3)
    return painter.node("Emission", Strength=falloff.outputs[kind])


def _gobo(painter: Painter) -> Any:
    checker = painter.node("TexChecker", Vector=painter.node("TexCoord").outputs["Normal"], Scale=painter.random.uniform(2.0, 6.0))
    return painter.node("Emission", Color=checker.outputs["Color"])


def _blackbody(painter: Painter) -> Any:
    return painter.node("Emission", Color=painter.node("Blackbody", Temperature=painter.random.uniform(2000.0, 8000.0)).outputs[0])


LAMP_NODES: dict[str, Callable[[Painter], Any]] = {"falloff": _falloff, "gobo": _gobo, "blackbody": _blackbody}


def dress_lamps(random: Random, receivers: Iterable[Any]) -> list[str]:
    """Give some lamps of the open scene nodes, light links or other settings; what was drawn."""
    drawn, receivers = [], sorted(receivers, key=lambda one: one.name)
    for obj in sorted((one for one in bpy.context.scene.objects if one.type == "LIGHT"), key=lambda one: one.name):
        if random.random() > _LAMP_SHARE:
            continue
        kind = random.choice([*LAMP_NODES, "receivers", "blockers", "no shadow", "exposure", "spread", "sheared"])
        if kind == "falloff" and obj.data.type == "SUN":
            continue
        if kind in LAMP_NODES:
            if obj.data.node_tree is None:
                obj.data.use_nodes = True
            tree = obj.data.node_tree
            tree.nodes.clear()
            painter = Painter(tree, random)
            tree.links.new(LAMP_NODES[kind](painter).outputs[0], painter.node("OutputLight").inputs["Surface"])
        elif kind in ("receivers", "blockers"):
            linked = bpy.data.collections.new(f"{kind} of {obj.name}")
            for one in random.sample(receivers, max(1, len(receivers) // 2)):
                linked.objects.link(one)
            setattr(obj.light_linking, f"{kind[:-1]}_collection", linked)
        elif kind == "no shadow":
            obj.data.use_shadow = False
        elif kind == "exposure" and hasattr(obj.data, "exposure"):
            obj.data.exposure = random.uniform(-1.0, 1.0)
        elif kind == "spread" and obj.data.type == "AREA":
            obj.data.spread = random.uniform(0.5, math.pi)
        elif kind == "sheared":
            obj.scale = 2.0, 0.5, random.choice([-1.0, 1.0])
        drawn.append(f"{obj.name}: {kind}")
    return drawn
