"""Faces in one place: each has the light that it has alone, and the room the light that it has without copies."""

from dataclasses import replace

import numpy as np
import pytest
from boxes import room_mesh, solve_scene
from leaflight.core.integrate import texel_light
from leaflight.core.scene.coincident_faces import CoincidentFaces
from leaflight.core.scene.rays import RayScene
from leaflight.core.scene.scene import Light, Material
from leaflight.core.transport import traced_scene
from leaflight.core.util.geometry import triangle_normals_areas
from leaflight.core.util.settings import Settings
from scenes import Mesh, make_scene, moved, quad_mesh, split_faces

LAMP = Light("POINT", "Lamp", position_m=(0.1, 0.2, 0.1), power_rgb=(10.0,) * 3, radius_m=0.02)
FLOOR = moved(quad_mesh("Floor"), (-0.5, -0.5, -0.5))
TURN = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])


def patch(name, half, centre):
    """A turned square that faces down."""
    corners = half * np.array([[-1, -1, 0], [-1, 1, 0], [1, 1, 0], [1, -1, 0]]) @ TURN.T
    return Mesh(name, corners + centre, [[0, 1, 2, 3]])


def light_of_objects(folder, meshes, direct):
    """Mean indirect light of each object, W/m^2."""
    scene = make_scene(meshes, [LAMP], [Material("Grey", (0.6,) * 3)])
    settings = Settings(size=48, error=0.01 if direct == "rays" else 0.02, max_photons=1_000_000, direct=direct, workers=1)
    field = solve_scene(folder, scene, settings)
    tracing = traced_scene.open_tracing(str(folder))
    light = texel_light.light_at_texels(field, tracing.texels).indirect.mean(axis=-1)
    owner = scene.tri_object[tracing.texels.texel_tri]
    audit = {name: np.array(watts) for name, watts in field.ledger.audit_w().items()}
    assert audit["absorbed"] + audit["escaped"] + audit["remainder"] == pytest.approx(audit["emitted"], rel=1e-9)
    return [float(light[owner == k].mean()) for k in range(len(meshes))]


@pytest.mark.parametrize("direct", ["rays", "photons"])
def test_copies_neither_take_light_nor_go_without(tmp_path, direct):
    """A second floor, a smaller face in the ceiling, and a dark room behind a wall, back to back with it."""
    room, behind = room_mesh(), moved(room_mesh("Behind"), (1.0, 0.0, 0.0))
    in_ceiling, hair = np.array([0.1, 0.0, 0.5]), np.array([0.0, 0.0, 1e-4])
    _, *apart = light_of_objects(tmp_path / "apart", [room, moved(FLOOR, hair), patch("Patch", 0.2, in_ceiling - hair)], direct)
    (alone,) = light_of_objects(tmp_path / "alone", [room], direct)
    objects = [room, FLOOR, patch("Patch", 0.2, in_ceiling), behind]
    for order in ([0, 1, 2, 3], [3, 2, 1, 0]):  # of faces in one place, rays find one by their order
        light = light_of_objects(tmp_path / f"among {order[0]}", [objects[k] for k in order], direct)
        among, *copies, dark = (light[order.index(k)] for k in range(4))
        assert among == pytest.approx(alone, rel=0.01)
        assert copies == pytest.approx(apart, rel=0.03)  # the patch has few texels
        assert dark == 0.0


def find(*meshes):
    scene = make_scene(meshes)
    corners = (scene.tri_position / 4.0).astype(np.float32)
    normal = np.ascontiguousarray(triangle_normals_areas(corners)[0].astype(np.float32).T)
    return CoincidentFaces.find(RayScene(corners), corners, normal, np.zeros(len(corners), bool))


@pytest.mark.parametrize(
    ("height", "offset", "pairs"),
    [(0.0, 0.0, 2), (4e-6, 0.0, 2), (1e-4, 0.0, 0), (0.0, 0.7, 2), (0.0, 1.0, 0)],
    ids=["copy", "hair above", "above", "corner", "beside"],
)
def test_pairs_are_those_that_overlap_in_one_plane(height, offset, pairs):
    one = quad_mesh("One")
    found = find(one, moved(one, (offset, offset, height), name="Other"))
    assert (0 if found is None else len(found.other) // 2) == pairs


def test_faces_of_one_sound_mesh_are_no_pairs():
    assert find(split_faces(room_mesh()), moved(room_mesh("Other"), (3.0, 0.0, 0.0))) is None


def test_a_hit_goes_to_a_face_whose_front_is_met_and_to_each_of_them_as_often():
    one = quad_mesh("One")
    scene = make_scene([one, replace(one, name="Two"), replace(one, name="Back", polygons=[[3, 2, 1, 0]])])
    corners = scene.tri_position.astype(np.float32)
    normal = np.ascontiguousarray(triangle_normals_areas(corners)[0].astype(np.float32).T)
    rays = RayScene(corners)
    faces = CoincidentFaces.find(rays, corners, normal, np.zeros(len(corners), bool))
    n = 20_000
    start = np.column_stack([np.random.default_rng(1).random((n, 2)) * 0.98 + 0.01, np.full(n, 0.5)]).astype(np.float32)
    for side, counts in ((1, [0.5, 0.5, 0.0]), (-1, [0.0, 0.0, 1.0])):
        along = np.tile(np.float32([0.0, 0.0, -side]), (n, 1))
        found, count = faces.share_out(rays.closest(start * np.float32([1, 1, side]), along), along.T)
        at = corners[found.tri]
        point = at[:, 0] + found.u[:, None] * (at[:, 1] - at[:, 0]) + found.v[:, None] * (at[:, 2] - at[:, 0])
        np.testing.assert_allclose(point[:, :2], start[:, :2], atol=1e-5)
        assert np.bincount(scene.tri_object[found.tri], minlength=3) / n == pytest.approx(counts, abs=0.02)
        assert (count == sum(share > 0 for share in counts)).mean() > 0.99  # on a diagonal there may be more
