"""Hair, hair curves and point clouds cast light and shadow: as meshes that shade as much."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blend_rooms import add_mesh, add_object, open_room
from leaflight.addon.read.export_scene import export_scene
from leaflight.addon.read.strands import MOST_TRIANGLES, Strands, make_tubes


@pytest.fixture(autouse=True)
def _room():
    open_room()


def find_faces(result, name):
    """(n, 3, 3) corners of an object's triangles."""
    snapshot = result.snapshot
    number = [one.name for one in snapshot.objects].index(name)
    return snapshot.vertex_position[snapshot.tri_vertex[snapshot.tri_object == number]]


def measure_areas(corner):
    return np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1) / 2


def add_fur(count=5):
    cube = bpy.data.objects["Cube"]
    modifier = cube.modifiers.new("Fur", "PARTICLE_SYSTEM")
    settings = modifier.particle_system.settings
    settings.type, settings.count, settings.hair_length, settings.render_step = "HAIR", count, 0.5, 3
    settings.root_radius = settings.tip_radius = 1.0
    settings.radius_scale, settings.use_close_tip = 0.02, False
    return cube, modifier, settings


@pytest.mark.parametrize("change", ["", "as objects", "hidden modifier", "hidden object", "none", "no strands in the view layer"])
def test_particle_hair_is_there_where_it_renders(change):
    cube, modifier, settings = add_fur()
    settings.count = 0 if change == "none" else 5
    settings.render_type = "OBJECT" if change == "as objects" else "PATH"
    modifier.show_render = change != "hidden modifier"
    cube.hide_render = change == "hidden object"
    bpy.context.view_layer.use_strand = not change.startswith("no strands")
    found = [one for one in export_scene(bpy.context).snapshot.objects if one.name.startswith("Cube.Fur")]
    assert len(found) == (not change)
    assert change or not found[0].receives


def test_particle_hair_stands_on_its_object_as_long_and_thick_as_it_renders():
    cube, _, settings = add_fur(count=200)
    settings.child_type, settings.child_percent, settings.rendered_child_count = "SIMPLE", 1, 2
    cube.scale = (2.0, 2.0, 2.0)
    bpy.context.view_layer.update()
    corner = find_faces(export_scene(bpy.context), "Cube.Fur")
    assert len(corner) == 200 * 2 * 8 * 6  # strands, steps, triangles of a step
    distance = np.abs(corner - np.array([0.0, 0.0, 0.6])).max(axis=2)
    assert distance.min() == pytest.approx(1.0, abs=0.05)
    assert distance.max() == pytest.approx(1.5, abs=0.05)  # Blender measures its length in the world
    side = 2.0 * np.pi * 0.02 * 0.5  # but its radius, half the root's 0.02 m, on the object, and so twice as large
    assert measure_areas(corner).sum() / 400 == pytest.approx(side, rel=0.01)


def test_hair_has_the_material_that_its_settings_choose():
    cube, _, settings = add_fur()
    for name in ("Skin", "Hair"):
        cube.data.materials.append(bpy.data.materials.new(name))
    settings.material = 2
    result = export_scene(bpy.context)
    snapshot = result.snapshot
    number = [one.name for one in snapshot.objects].index("Cube.Fur")
    worn = np.unique(snapshot.tri_material[snapshot.tri_object == number])
    assert [snapshot.materials[i].name for i in worn] == ["Hair"]


def add_curves(name, strands, radius=None):
    data = bpy.data.hair_curves.new(name)
    data.add_curves([len(one) for one in strands])
    points = np.concatenate(strands).astype(np.float32)
    data.attributes["position"].data.foreach_set("vector", points.ravel())
    if radius is not None:
        data.attributes.new("radius", "FLOAT", "POINT").data.foreach_set("value", np.full(len(points), radius, np.float32))
    return add_object(name, data)


def test_hair_curves_are_tubes():
    grass = add_curves("Grass", [[(0, 0, 0), (0, 0, 1)], [(1, 0, 0), (1, 0, 1), (1, 1, 1)]], radius=0.01)
    grass.location.z = 2.0
    corner = find_faces(export_scene(bpy.context), "Grass")
    assert len(corner) == 3 * 6
    assert (corner[..., 2].min(), corner[..., 2].max()) == pytest.approx((2.0, 3.0), abs=0.02)
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    first = corner[:6].mean(axis=1) - (0.0, 0.0, 0.0)
    assert ((normal[:6] * first)[:, :2].sum(axis=1) > 0.0).all()  # their fronts look outwards


def test_points_are_balls():
    cloud = add_mesh("Cloud", [(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])
    tree = bpy.data.node_groups.new("Points", "GeometryNodeTree")
    for way in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    source, points, out = (tree.nodes.new(kind) for kind in ("NodeGroupInput", "GeometryNodeMeshToPoints", "NodeGroupOutput"))
    points.inputs["Radius"].default_value = 0.1
    tree.links.new(source.outputs[0], points.inputs[0])
    tree.links.new(points.outputs[0], out.inputs[0])
    cloud.modifiers.new("Nodes", "NODES").node_group = tree
    result = export_scene(bpy.context, objects=["Floor"])
    corner = find_faces(result, next(one.name for one in result.snapshot.objects if one.name.startswith("Cloud")))
    assert len(corner) == 3 * 8
    mean_shade = measure_areas(corner).sum() / 3 / 4
    assert mean_shade == pytest.approx(np.pi * 0.1**2, rel=1e-3)
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    centre = np.round(corner.mean(axis=1))
    assert ((normal * (corner.mean(axis=1) - centre)).sum(axis=1) > 0.0).all()


def test_of_very_many_strands_some_stand_for_all():
    many = MOST_TRIANGLES // 6 + 10
    strands = np.zeros((many, 2, 3))
    strands[:, 0, 0] = strands[:, 1, 0] = np.arange(many)
    strands[:, 1, 2] = 1.0
    add_curves("Lawn", list(strands), radius=0.001)
    result = export_scene(bpy.context)
    corner = find_faces(result, "Lawn")
    assert len(corner) <= MOST_TRIANGLES
    assert measure_areas(corner).sum() == pytest.approx(2.0 * np.pi * 0.001 * many, rel=0.01)
    [told] = [text for name, text in result.warnings if name == "Lawn"]
    assert told == "has so many strands that one of 2 stands for its neighbours, thicker"


def test_strands_without_length_or_points_are_harmless():
    empty = np.zeros(0, np.int64)
    assert make_tubes(Strands(np.zeros((0, 3)), np.zeros(0), empty), 0).n_polygon == 0
    dots = make_tubes(Strands(np.zeros((3, 3)), np.ones(3), np.array([1, 0, 2])), 0)
    assert dots.n_polygon == 6
    assert np.isfinite(dots.position).all()
    add_curves("Nothing", [np.zeros((1, 3))])
    assert "Nothing" not in {one.name for one in export_scene(bpy.context).snapshot.objects}
