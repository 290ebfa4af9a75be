"""Which solids keep the light inside that their faces send inwards; and that without it a bake is the same."""

from dataclasses import replace

import numpy as np
import pytest
from boxes import room_mesh, solve_scene
from leaflight.core.scene.scene import Material
from leaflight.core.scene.sealed_solids import find_sealed
from leaflight.core.util import ablation
from leaflight.core.util.settings import Settings
from scenes import Mesh, box_mesh, join_meshes, make_scene, moved, quad_mesh, sphere_mesh, split_faces

LAMP = box_mesh("Lamp", (0.4, 0.2, 0.1))
LARGE, SMALL = box_mesh("Large", (4.0, 4.0, 4.0)), box_mesh("Small", (0.05, 0.05, 0.05))


def turn(mesh, degrees):
    cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return replace(mesh, vertex=mesh.vertex @ np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]]))


def inside_out(mesh):
    return replace(mesh, polygons=[polygon[::-1] for polygon in mesh.polygons])


def is_sealed(*meshes, **flags):
    """Whether the first object is, all of it; flags are of its SceneObject."""
    scene = make_scene(meshes)
    scene = replace(scene, objects=(replace(scene.objects[0], **flags), *scene.objects[1:]))
    found = find_sealed(scene, scene.tri_object == 0)
    assert not found[scene.tri_object > 0].any(), "nobody asked for the others"
    own = found[scene.tri_object == 0]
    assert own.all() or not own.any()
    return bool(own.all())


@pytest.mark.parametrize(
    "mesh",
    [
        LAMP,
        turn(LAMP, 30.0),
        moved(LAMP, (1e4, 0.0, 0.0)),
        moved(LAMP, scale=1e-3),
        split_faces(LAMP),
        box_mesh("Flat", (0.4, 0.2, 0.0)),
        sphere_mesh(),
        replace(sphere_mesh(), vertex=sphere_mesh().vertex * [1.0, 0.2, 1.5]),
    ],
)
def test_closed_convex_solids_are_sealed(mesh):
    assert is_sealed(mesh)
    assert is_sealed(mesh, LARGE), "what is around it is not in it"


@pytest.mark.parametrize(
    "mesh",
    [
        quad_mesh(),
        replace(LAMP, polygons=LAMP.polygons[1:]),
        inside_out(LAMP),
        replace(LAMP, polygons=[LAMP.polygons[0][::-1], *LAMP.polygons[1:]]),
        replace(LAMP, vertex=np.where(np.arange(8)[:, None] == 0, LAMP.vertex * 0.2, LAMP.vertex)),
        room_mesh(),
        Mesh("Twice", LAMP.vertex, [*LAMP.polygons, *LAMP.polygons]),
    ],
    ids=["sheet", "open", "inside out", "one face turned", "dented", "room", "twice"],
)
def test_what_is_open_or_bent_or_shines_on_its_front_alone_is_not(mesh):
    assert not is_sealed(mesh)


@pytest.mark.parametrize(("flags", "expected"), [({}, True), ({"casts_shadow": False}, False), ({"two_sided": True}, False)])
def test_light_must_stay_inside_and_no_texel_tell_of_it(flags, expected):
    assert is_sealed(LAMP, **flags) == expected


FLOOR = moved(quad_mesh("Floor", 4.0, 4.0), (-2.0, -2.0, -0.05))


@pytest.mark.parametrize(
    ("other", "expected"),
    [
        (SMALL, False),
        (moved(SMALL, (0.2, 0.0, 0.0)), False),
        (moved(SMALL, (0.3, 0.0, 0.0)), True),
        (FLOOR, True),
        (moved(FLOOR, (0.0, 0.0, 0.01)), False),
        (moved(LAMP, (0.4, 0.0, 0.0), name="Beside it"), True),
        (moved(LAMP, (0.39, 0.0, 0.0), name="Into it"), False),
    ],
    ids=["inside", "through a face", "beside", "it stands on it", "it sinks into it", "touching", "cutting"],
)
def test_nothing_else_may_be_inside(other, expected):
    assert is_sealed(LAMP, other) == expected
    assert is_sealed(turn(LAMP, 30.0), turn(other, 30.0)) == expected, "boxes along the axes overlap there"


def test_a_loose_part_of_the_same_object_counts_as_another_thing():
    assert is_sealed(join_meshes("Two", LAMP, moved(LAMP, (1.0, 0.0, 0.0))))
    assert not is_sealed(join_meshes("Two", LAMP, moved(LAMP, (0.1, 0.05, 0.02))))
    scene = make_scene([join_meshes("Lamp and shade", LAMP, moved(quad_mesh(), (1.0, 0.0, 0.0)))])
    assert find_sealed(scene, np.ones(scene.n_tri, bool)).tolist() == [True] * 12 + [False] * 2


def test_a_bake_is_the_same_with_far_fewer_rays(tmp_path, monkeypatch):
    """The same light, but for noise."""
    materials = [Material("Wall", (0.5,) * 3), Material("Lamp", (0.95,) * 3, emission_rgb=(10.0,) * 3)]
    scene = make_scene([room_mesh(), moved(LAMP, (0.0, 0.1, 0.2))], (), materials)
    scene = replace(scene, tri_material=scene.tri_object)
    settings = Settings(size=64, padding=1, workers=1, error=1e-3, max_photons=200_000, direct="photons")
    sealed = solve_scene(tmp_path / "sealed", scene, settings)
    monkeypatch.setenv(ablation.VARIABLE, "sealed_solids")
    plain = solve_scene(tmp_path / "plain", scene, settings)
    flux = [light.solution.flux[:, light.leaves].sum() for light in (sealed, plain)]
    assert flux[0] == pytest.approx(flux[1], rel=5e-3)
    assert sealed.ledger.rays < 0.4 * plain.ledger.rays
    emitted = [light.ledger.audit_w()["emitted"][0] for light in (sealed, plain)]
    assert emitted[0] == pytest.approx(emitted[1] / 2, rel=1e-9)


def test_a_dense_ball_is_sealed_and_one_with_a_dent_is_not():
    ball = sphere_mesh("Ball", rings=40, segments=80)
    assert is_sealed(ball)
    dented = ball.vertex.copy()
    dented[len(dented) // 2] *= 0.99
    assert not is_sealed(replace(ball, vertex=dented))
