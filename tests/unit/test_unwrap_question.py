"""What xatlas is asked, and that it does not matter to the charts how."""

from concurrent.futures import Future

import numpy as np
import pytest
from leaflight.core import unwrap_question
from leaflight.core.geometry import triangle_normals_areas
from leaflight.core.unfolding import UnfolderDied
from leaflight.core.unwrap_question import Question
from scenes import Mesh, box_mesh, grid_mesh, make_scene, moved, quad_mesh, sphere_mesh

PRISM = Mesh(  # of six sides: neighbours are 60 degrees apart, which xatlas may put into one chart
    "Prism",
    np.array([[np.cos(a), np.sin(a), z] for z in (0.0, 1.0) for a in np.arange(6) * np.pi / 3]),
    [[k, (k + 1) % 6, 6 + (k + 1) % 6, 6 + k] for k in range(6)],
)


@pytest.fixture
def asked(monkeypatch):
    """How each question was put: True is roughly."""
    real, written = unwrap_question.unfold_meshes, []
    monkeypatch.setattr(
        unwrap_question, "unfold_meshes", lambda meshes, area, roughly=False: written.append(roughly) or real(meshes, area, roughly)
    )
    return written


def ask(*meshes):
    scene = make_scene([Mesh("One", np.concatenate([mesh.vertex for mesh in meshes]), join_polygons(meshes))])
    normal, area = triangle_normals_areas(scene.tri_position)
    return Question(scene.tri_position, normal, area, scene.tri_vertex, scene.tri_polygon, scene.tri_object)


def join_polygons(meshes):
    first = np.cumsum([0, *(len(mesh.vertex) for mesh in meshes)])
    return [[int(k + corner) for corner in polygon] for k, mesh in zip(first, meshes, strict=False) for polygon in mesh.polygons]


@pytest.mark.parametrize(
    ("meshes", "roughly"),
    [
        ([quad_mesh()], True),
        ([box_mesh(), moved(box_mesh(), (5.0, 0.0, 0.0), scale=0.3)], True),
        ([PRISM], False),
        ([sphere_mesh()], False),
        ([box_mesh(), moved(grid_mesh(noise=0.3), (5.0, 0.0, 0.0))], False),
    ],
)
def test_what_falls_into_flat_charts_is_packed_roughly(asked, meshes, roughly):
    ask(*meshes)
    assert asked == [roughly]


@pytest.mark.parametrize("mesh", [box_mesh(), PRISM, sphere_mesh(), grid_mesh(noise=0.6)], ids=["box", "prism", "sphere", "bent grid"])
@pytest.mark.parametrize("seems_flat", [True, False])
def test_the_charts_are_the_same_whatever_they_seemed_to_be(monkeypatch, asked, mesh, seems_flat):
    group, uv = ask(mesh).read()
    monkeypatch.setattr(unwrap_question, "_is_bent", lambda cosine: np.full(len(cosine), not seems_flat))
    other_group, other_uv = ask(mesh).read()
    np.testing.assert_array_equal(other_group, group)
    np.testing.assert_array_equal(other_uv, uv)
    flat = mesh.name == "Box"
    assert asked[1:] == ([True] if flat else [True, False]) if seems_flat else [False]


def test_a_dense_ground_is_unwrapped_by_pieces():
    """Of 2,048 triangles at most, so that time grows with their number; no quad is cut, and as many in a plane are one chart still."""
    group, _ = ask(grid_mesh(cells=70, noise=0.05)).read()
    assert len(np.unique(group)) == 8
    assert np.bincount(group).max() <= 2048
    np.testing.assert_array_equal(group[::2], group[1::2])
    assert np.unique(ask(grid_mesh(cells=70)).read()[0]).size == 1


def ask_apart(*meshes):
    scene = make_scene(meshes)
    normal, area = triangle_normals_areas(scene.tri_position)
    polygon = scene.tri_object * 1000 + scene.tri_polygon
    return Question(scene.tri_position, normal, area, scene.tri_vertex, polygon, scene.tri_object)


def test_objects_that_seem_flat_are_asked_of_together_and_the_others_one_by_one(asked):
    meshes = [sphere_mesh(), box_mesh(), PRISM, quad_mesh()]
    group, uv = ask_apart(*meshes).read()
    assert asked == [True, False, False]
    apart = [ask(mesh).read() for mesh in meshes]
    np.testing.assert_allclose(uv, np.concatenate([uv for _, uv in apart]), rtol=1e-9, atol=1e-9)
    of_object = np.repeat(range(4), [len(group) for group, _ in apart])
    own = np.concatenate([group + 1000 * k for k, (group, _) in enumerate(apart)])
    assert len(np.unique(group)) == len(np.unique(own)) == len(np.unique(np.stack([group, own, of_object]), axis=1).T)


def test_only_what_was_not_flat_after_all_is_asked_anew(monkeypatch, asked):
    monkeypatch.setattr(unwrap_question, "_is_bent", lambda cosine: np.zeros(len(cosine), bool))
    ask_apart(box_mesh(), sphere_mesh(), PRISM).read()
    assert asked == [True, False, False]


@pytest.mark.parametrize("cursed", [1, None])
def test_of_objects_that_xatlas_crashes_on_together_the_one_is_told(monkeypatch, cursed):
    """The second has two triangles fewer than the others."""
    real = unwrap_question.unfold_meshes

    def unfold(meshes, area, roughly=False):
        crashes = len(meshes) > 1 or (cursed and len(meshes[0][1]) == 10)
        if not crashes:
            return real(meshes, area, roughly)
        answer = Future()
        answer.set_exception(UnfolderDied(-11))
        return answer

    monkeypatch.setattr(unwrap_question, "unfold_meshes", unfold)
    open_box = Mesh("Open", box_mesh().vertex, box_mesh().polygons[:5])
    question = ask_apart(box_mesh(), open_box, box_mesh())
    if cursed is None:
        assert len(np.unique(question.read()[0])) == 17
        return
    with pytest.raises(UnfolderDied) as died:
        question.read()
    assert died.value.args == (-11, 1)
