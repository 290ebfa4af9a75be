"""Render levels and render visibility, and that all is as before afterwards."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blend_rooms import add_object, add_plane, make_material
from leaflight.addon.read.export_scene import export_scene
from leaflight.addon.read.render_levels import evaluate_for_render

pytestmark = pytest.mark.usefixtures("empty_file")


def add_collection(name, parent=None):
    collection = bpy.data.collections.new(name)
    (parent or bpy.context.scene.collection).children.link(collection)
    return collection


def layer_of(*names):
    layer = bpy.context.view_layer.layer_collection
    for name in names:
        layer = layer.children[name]
    return layer


def export(**arguments):
    return export_scene(bpy.context, **arguments)


def count(result, name):
    names = [item.name for item in result.snapshot.objects]
    return int((result.snapshot.tri_object == names.index(name)).sum())


def names_of(result):
    return {item.name for item in result.snapshot.objects}


def read_state(view_layer):
    """Everything that the export borrows."""
    objects = [(o.name, o.hide_viewport, o.hide_get(view_layer=view_layer), o.select_get(view_layer=view_layer)) for o in bpy.data.objects]
    modifiers = [
        (o.name, m.name, m.show_viewport, getattr(m, "levels", 0), getattr(m, "steps", 0)) for o in bpy.data.objects for m in o.modifiers
    ]
    curves = [(c.name, c.resolution_u, c.resolution_v, [s.resolution_u for s in c.splines]) for c in bpy.data.curves]
    layers, pending = [], [view_layer.layer_collection]
    while pending:
        layer = pending.pop()
        layers.append((layer.name, layer.hide_viewport, layer.exclude, layer.collection.hide_viewport))
        pending.extend(layer.children)
    simplify = bpy.context.scene.render.simplify_subdivision
    metaballs = [ball.resolution for ball in bpy.data.metaballs]
    particles = [(p.display_percentage, p.child_percent, p.display_step, p.display_method) for p in bpy.data.particles]
    nodes = [(link.is_muted, getattr(link.to_socket, "default_value", 0)) for tree in bpy.data.node_groups for link in tree.links]
    return objects, modifiers, curves, layers, simplify, metaballs, particles, nodes, view_layer.objects.active, bpy.context.mode


def make_rich_scene():
    scene = bpy.context.scene
    smooth = add_plane("Smooth")
    subdivision = smooth.modifiers.new("Subdivision", "SUBSURF")
    subdivision.levels, subdivision.render_levels = 1, 3
    off = add_plane("Off").modifiers.new("Subdivision", "SUBSURF")
    off.show_render = False
    hidden = add_plane("Render only").modifiers.new("Subdivision", "SUBSURF")
    hidden.show_viewport, hidden.levels, hidden.render_levels = False, 0, 2
    add_plane("Eye")
    add_plane("Screen").hide_viewport = True
    add_plane("Not rendered").hide_render = True
    dark = add_collection("Dark")
    add_plane("In dark", dark)
    dark.hide_viewport = True
    add_plane("In shut", add_collection("Shut"))
    layer_of("Shut").hide_viewport = True
    unrendered = add_collection("Unrendered")
    unrendered.hide_render = True
    add_plane("In unrendered", unrendered)
    add_plane("Deep", add_collection("Below", unrendered))
    add_plane("In excluded", add_collection("Excluded"))
    layer_of("Excluded").exclude = True
    curve = bpy.data.curves.new("Curve", "CURVE")
    curve.dimensions, curve.extrude, curve.render_resolution_u = "2D", 0.1, 5
    for resolution in (2, 3):
        spline = curve.splines.new("BEZIER")
        spline.bezier_points.add(1)
        spline.bezier_points[1].co = (1, 0, 0)
        for point in spline.bezier_points:
            point.handle_left, point.handle_right = point.co - type(point.co)((0.3, 1, 0)), point.co + type(point.co)((0.3, 1, 0))
        spline.resolution_u = resolution
    scene.collection.objects.link(bpy.data.objects.new("Curve", curve))
    bpy.context.view_layer.objects.active = smooth
    smooth.select_set(True)
    bpy.data.objects["Not rendered"].select_set(True)
    bpy.data.objects["Eye"].hide_set(True)
    bpy.context.view_layer.update()


def test_levels_and_visibility_are_the_render_s():
    make_rich_scene()
    result = export()
    assert names_of(result) == {"Smooth", "Off", "Render only", "Eye", "Screen", "In dark", "In shut", "Curve"}
    assert count(result, "Smooth") == 2 * 4**3
    assert count(result, "Off") == 2
    assert count(result, "Render only") == 2 * 4**2
    assert count(result, "Curve") == 2 * 2 * 5


def test_everything_is_given_back():
    make_rich_scene()
    view_layer = bpy.context.view_layer
    before, dirty = read_state(view_layer), bpy.data.is_dirty
    evaluated = bpy.data.objects["Smooth"].evaluated_get(bpy.context.evaluated_depsgraph_get())
    faces = len(evaluated.data.polygons)
    export()
    assert read_state(view_layer) == before
    assert bpy.data.is_dirty == dirty
    evaluated = bpy.data.objects["Smooth"].evaluated_get(bpy.context.evaluated_depsgraph_get())
    assert len(evaluated.data.polygons) == faces


def test_everything_is_given_back_after_an_error():
    make_rich_scene()
    view_layer = bpy.context.view_layer
    before = read_state(view_layer)

    def fail_inside():
        with evaluate_for_render(bpy.context.scene, view_layer, []):
            assert read_state(view_layer) != before
            raise RuntimeError("planted")

    with pytest.raises(RuntimeError, match="planted"):
        fail_inside()
    assert read_state(view_layer) == before


def test_simplify_takes_the_render_limit():
    make_rich_scene()
    render = bpy.context.scene.render
    render.use_simplify, render.simplify_subdivision, render.simplify_subdivision_render = True, 0, 2
    before = read_state(bpy.context.view_layer)
    assert count(export(), "Smooth") == 2 * 4**2
    assert read_state(bpy.context.view_layer) == before


def test_multires_and_screw():
    obj = add_plane("Sculpt")
    multires = obj.modifiers.new("Multires", "MULTIRES")
    bpy.context.view_layer.objects.active = obj
    for _ in range(2):
        bpy.ops.object.multires_subdivide(modifier="Multires")
    multires.levels, multires.render_levels = 0, 2
    edge = add_plane("Lathe")
    screw = edge.modifiers.new("Screw", "SCREW")
    screw.steps, screw.render_steps = 3, 7
    before = read_state(bpy.context.view_layer)
    result = export()
    assert count(result, "Sculpt") == 2 * 4**2
    assert (multires.levels, screw.steps) == (0, 3)
    assert count(result, "Lathe") >= 4 * 7 * 2
    assert read_state(bpy.context.view_layer) == before


def test_metaballs_take_the_render_resolution():
    ball = bpy.data.metaballs.new("Ball")
    ball.elements.new()
    ball.resolution, ball.render_resolution = 1.0, 0.2
    add_object("Ball", ball)
    add_plane("Plane")
    fine = count(export(), "Ball")
    ball.render_resolution = 1.0
    assert fine > 4 * count(export(), "Ball") > 0
    assert ball.resolution == 1.0


def test_another_scene_than_the_current_one():
    add_plane("Here")
    other = bpy.data.scenes.new("Other")
    there = add_plane("There", other.collection)
    there.modifiers.new("Subdivision", "SUBSURF").render_levels = 2
    result = export_scene(other)
    assert names_of(result) == {"There"}
    assert count(result, "There") == 32
    assert bpy.context.scene.name == "Scene"


def test_linked_library_is_read_and_left_alone(tmp_path):
    obj = add_plane("Guest")
    subdivision = obj.modifiers.new("Subdivision", "SUBSURF")
    subdivision.levels, subdivision.render_levels = 0, 2
    path = str(tmp_path / "library.blend")
    bpy.data.libraries.write(path, {obj}, fake_user=True)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(path, link=True) as (source, target):
        target.objects = source.objects
    bpy.context.scene.collection.objects.link(target.objects[0])
    result = export()
    assert count(result, "Guest") == 32 or any("viewport levels" in text for _, text in result.warnings)
    assert target.objects[0].modifiers[0].levels == 0
    exported = result.objects[0]
    assert exported.needs_copy
    assert exported.library == path
    assert "linked" in exported.reason


def test_edit_mode_mesh_is_read_as_it_is_edited():
    import bmesh

    obj = add_plane("Edited")
    bpy.context.view_layer.objects.active = obj
    bpy.ops.object.mode_set(mode="EDIT")
    edited = bmesh.from_edit_mesh(obj.data)
    for vertex in edited.verts:
        vertex.co *= 3.0
    bmesh.ops.subdivide_edges(edited, edges=edited.edges, cuts=1, use_grid_fill=True)
    bmesh.update_edit_mesh(obj.data)
    result = export()
    assert (count(result, "Edited"), result.objects[0].needs_copy) == (8, False)
    assert bpy.context.mode == "EDIT_MESH"
    assert np.ptp(result.snapshot.vertex_position, axis=0) == pytest.approx([3, 3, 0])
    bpy.ops.object.mode_set(mode="OBJECT")


def add_particles(obj, count=40):
    settings = obj.modifiers.new("Particles", "PARTICLE_SYSTEM").particle_system.settings
    settings.type, settings.count = "HAIR", count
    return settings


def test_all_particles_count_that_a_render_shows():
    leaf = add_plane("Leaf")
    settings = add_particles(add_plane("Meadow"))
    settings.render_type, settings.instance_object, settings.display_percentage = "OBJECT", leaf, 5
    settings.child_type, settings.child_percent, settings.rendered_child_count = "SIMPLE", 1, 3
    before = read_state(bpy.context.view_layer)
    result = export()
    assert sum(name.startswith("Meadow.Leaf") for name in names_of(result)) == 3 * 40
    assert read_state(bpy.context.view_layer) == before


def make_viewport_switch(name):
    """A node group that gives a triangle fan of 3 faces in the viewport, of 5 in a render."""
    tree = bpy.data.node_groups.new(name, "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    in_viewport, switch, out = (tree.nodes.new(f"{kind}") for kind in ("GeometryNodeIsViewport", "GeometryNodeSwitch", "NodeGroupOutput"))
    switch.input_type = "GEOMETRY"
    for socket, n_side in (("True", 3), ("False", 5)):
        circle = tree.nodes.new("GeometryNodeMeshCircle")
        circle.fill_type = "TRIANGLE_FAN"
        circle.inputs["Vertices"].default_value = n_side
        tree.links.new(circle.outputs[0], switch.inputs[socket])
    switch.inputs["Switch"].default_value = True
    tree.links.new(in_viewport.outputs[0], switch.inputs["Switch"])
    tree.links.new(switch.outputs[0], out.inputs[0])
    return tree


def test_geometry_nodes_are_told_that_they_render():
    add_plane("Fan").modifiers.new("Nodes", "NODES").node_group = make_viewport_switch("Fan")
    before = read_state(bpy.context.view_layer)
    assert count(export(), "Fan") == 5
    assert read_state(bpy.context.view_layer) == before


def add_diffuse(name, rgb):
    material = make_material(name)
    material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (*rgb, 1.0)
    return material


def test_the_view_layer_s_material_is_that_of_every_object():
    add_plane("Plain")
    add_plane("Red").data.materials.append(add_diffuse("Red", (1.0, 0.0, 0.0)))
    bpy.context.view_layer.material_override = add_diffuse("Clay", (0.25, 0.5, 0.75))
    assert [one.albedo_rgb for one in export().snapshot.materials] == [(0.25, 0.5, 0.75)]


def test_the_view_layer_s_world_lights():
    add_plane("Plain")
    scene, view_layer = bpy.context.scene, bpy.context.view_layer
    scene.world = bpy.data.worlds.new("Day")
    lit = export().snapshot.world_rgb
    assert min(lit) > 0.0
    if hasattr(view_layer, "world_override"):
        view_layer.world_override = bpy.data.worlds.new("Night")
        view_layer.world_override.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.0
        assert export().snapshot.world_rgb == (0.0, 0.0, 0.0)
        view_layer.world_override = None
    view_layer.use_sky = False
    assert export().snapshot.world_rgb == (0.0, 0.0, 0.0)
