"""Geometry: positions, winding, normals and corners of evaluated meshes in the world."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from leaflight.addon.read.export_mesh import count_duplicates, has_corners_of, place_mesh, read_mesh

pytestmark = pytest.mark.usefixtures("empty_file")

L_SHAPE = [(0, 0, 0), (2, 0, 0), (2, 1, 0), (1, 1, 0.5), (1, 2, 0), (0, 2, 0)]


def make_mesh(vertices, faces):
    mesh = bpy.data.meshes.new("Mesh")
    mesh.from_pydata(vertices, [], faces)
    return mesh


def make_cube():
    bpy.ops.mesh.primitive_cube_add(size=2.0)
    return bpy.context.object.data


def face_normals(world):
    corner = world.vertex_position[world.tri_vertex]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    return normal / np.linalg.norm(normal, axis=1, keepdims=True)


def areas(world):
    corner = world.vertex_position[world.tri_vertex]
    return np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1) / 2


def test_polygons_corners_and_layers():
    mesh = make_mesh([*L_SHAPE, (3, 0, 1), (3, 1, 1)], [(0, 1, 2, 3, 4, 5), (1, 6, 7, 2)])
    layer = mesh.uv_layers.new(name="Second")
    uv = np.random.default_rng(1).random((10, 2)).astype(np.float32)
    layer.uv.foreach_set("vector", uv.ravel())
    local = read_mesh(mesh)
    assert (local.n_corner, local.n_polygon, local.render_layer) == (10, 2, "Second")
    assert local.layers["Second"] == pytest.approx(uv)
    assert local.tri_polygon.tolist() == [0, 0, 0, 0, 1, 1]
    world = place_mesh(local, np.eye(4))
    assert np.array_equal(local.corner_vertex[world.tri_corner], world.tri_vertex)
    assert world.vertex_position.dtype == np.float64


@pytest.mark.parametrize("scale", [(1, 1, 1), (-1, 1, 1), (-2, -0.5, -3), (-1e-3, -1e-3, 1e-3), (1e-12, 1e-12, 1e-12)])
def test_fronts_stay_fronts(scale):
    mesh = make_cube()
    matrix = np.diag([*scale, 1.0])
    matrix[:3, 3] = 5.0, -3.0, 0.0
    world = place_mesh(read_mesh(mesh), matrix)
    centre = matrix[:3, 3]
    outward = world.vertex_position[world.tri_vertex].mean(axis=1) - centre
    facing = np.einsum("ij,ij->i", face_normals(world), outward) if min(np.abs(scale)) > 1e-6 else np.ones(1)
    assert (facing > 0).all()
    assert np.linalg.norm(world.tri_normal, axis=2) == pytest.approx(1.0, abs=1e-6)
    assert (np.einsum("ijk,ik->ij", world.tri_normal, outward) > 0).all()


def test_normals_under_a_sheared_mirror_are_cycles():
    """Cycles transforms a face's normal by the inverse transpose, whatever the sign of the determinant."""
    mesh = make_cube()
    mesh.polygons.foreach_set("use_smooth", [False] * 6)
    linear = np.array([[1.0, 0.7, 0.0], [0.2, -2.0, 0.1], [0.0, 0.4, 3.0]])
    assert np.linalg.det(linear) < 0
    matrix = np.eye(4)
    matrix[:3, :3] = linear
    world = place_mesh(read_mesh(mesh), matrix)
    polygon_normal = np.array([polygon.normal for polygon in mesh.polygons], np.float64)
    expected = polygon_normal[world.tri_polygon] @ np.linalg.inv(linear)
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    assert face_normals(world) == pytest.approx(expected, abs=1e-6)
    assert world.tri_normal == pytest.approx(np.repeat(expected[:, None], 3, axis=1), abs=1e-6)


@pytest.mark.parametrize("scale_x", [1.0, -1.0])
def test_triangles_of_a_bent_flat_quad_have_normals_of_their_own(scale_x):
    """Blender shows the quad's mean normal at its corners; Cycles shades each triangle of it by itself."""
    mesh = bpy.data.meshes.new("Bent")
    mesh.from_pydata([(0, 0, 0), (1, 0, 0.5), (1, 1, 0), (0, 1, 0.8)], [], [(0, 1, 2, 3)])
    mesh.polygons.foreach_set("use_smooth", [False])
    world = place_mesh(read_mesh(mesh), np.diag([scale_x, 1.0, 1.0, 1.0]))
    assert world.tri_normal == pytest.approx(np.repeat(face_normals(world)[:, None], 3, axis=1), abs=1e-6)
    assert abs(world.tri_normal[0, 0] - world.tri_normal[1, 0]).max() > 0.5


def test_smooth_normals_are_the_corners():
    mesh = make_cube()
    mesh.polygons.foreach_set("use_smooth", [True] * 6)
    world = place_mesh(read_mesh(mesh), np.diag([2.0, 2.0, 2.0, 1.0]))
    corner = world.vertex_position[world.tri_vertex]
    assert world.tri_normal == pytest.approx(corner / np.linalg.norm(corner, axis=2, keepdims=True), abs=1e-6)


@pytest.mark.parametrize("scale", [(1, 1, 0), (0, 1, 1), (0, 0, 0), (1, 0, 0)])
def test_flattened_objects_have_finite_unit_normals(scale):
    world = place_mesh(read_mesh(make_cube()), np.diag([*scale, 1.0]))
    assert np.linalg.norm(world.tri_normal, axis=2) == pytest.approx(1.0, abs=1e-6)


def test_faces_with_coordinates_that_are_not_finite_are_dropped():
    mesh = make_mesh([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (2, 0, 0), (2, 1, 0)], [(0, 1, 2, 3), (1, 4, 5, 2)])
    mesh.vertices[4].co.x = float("nan")
    world = place_mesh(read_mesh(mesh), np.eye(4))
    assert world.left_out == 1
    assert world.tri_polygon.tolist() == [0, 0]
    assert np.isfinite(world.vertex_position).all()
    assert np.isfinite(world.tri_normal).all()
    assert len(world.vertex_position) == 4  # neither the bad vertex nor the one left alone
    assert areas(world).sum() == pytest.approx(1.0)
    assert place_mesh(read_mesh(mesh), np.full((4, 4), np.nan)).left_out == 2


def test_large_coordinates_keep_their_precision():
    matrix = np.eye(4)
    matrix[:3, 3] = 1e7 + 0.25
    world = place_mesh(read_mesh(make_cube()), matrix)
    assert areas(world).sum() == pytest.approx(24.0, rel=1e-8)


def test_duplicates_are_counted_whichever_way_they_face():
    vertices = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
    mesh = make_mesh([*vertices, *vertices, (5, 5, 5)], [(0, 1, 2), (5, 4, 3), (0, 1, 6)])
    assert count_duplicates(place_mesh(read_mesh(mesh), np.eye(4))) == 1
    assert count_duplicates(place_mesh(read_mesh(make_cube()), np.eye(4))) == 0
    assert count_duplicates(place_mesh(read_mesh(make_mesh(vertices, [])), np.eye(4))) == 0


def test_the_same_corners():
    mesh = make_cube()
    local = read_mesh(mesh)
    assert has_corners_of(mesh, local)
    mesh.flip_normals()
    assert not has_corners_of(mesh, local)
    assert not has_corners_of(make_mesh(L_SHAPE, [(0, 1, 2, 3, 4, 5)]), local)


def test_no_faces():
    world = place_mesh(read_mesh(make_mesh([(0, 0, 0)], [])), np.eye(4))
    assert (len(world.tri_vertex), len(world.vertex_position)) == (0, 0)
