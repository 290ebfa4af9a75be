"""What xatlas is asked, and that it does not matter to the charts how."""

from concurrent.futures import Future

import numpy as np
import pytest
from leaflight.core.atlas.unfolding import Unfolder, UnfolderDied
from leaflight.core.atlas.xatlas_requests import XatlasRequests
from leaflight.core.util.geometry import triangle_normals_areas
from scenes import Mesh, box_mesh, grid_mesh, make_scene


@pytest.fixture
def asked(monkeypatch):
    """Of how many pieces each question was, and whether they are dense."""
    real, written = Unfolder.ask, []

    def ask(unfolder, meshes, area, dense):
        written.append((len(meshes), dense))
        return real(unfolder, meshes, area, dense)

    monkeypatch.setattr(Unfolder, "ask", ask)
    return written


def ask(*meshes):
    scene = make_scene([Mesh("One", np.concatenate([mesh.vertex for mesh in meshes]), join_polygons(meshes))])
    normal, area = triangle_normals_areas(scene.tri_position)
    return XatlasRequests(scene.tri_position, normal, area, scene.tri_vertex, scene.tri_polygon, scene.tri_object)


def join_polygons(meshes):
    first = np.cumsum([0, *(len(mesh.vertex) for mesh in meshes)])
    return [[int(k + corner) for corner in polygon] for k, mesh in zip(first, meshes, strict=False) for polygon in mesh.polygons]


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
    return XatlasRequests(scene.tri_position, normal, area, scene.tri_vertex, polygon, scene.tri_object)


@pytest.mark.parametrize("cursed", [1, None])
def test_of_objects_that_xatlas_crashes_on_together_the_one_is_told(monkeypatch, cursed):
    """The second has two triangles fewer than the others."""
    real = Unfolder.ask

    def ask(unfolder, meshes, area, dense):
        crashes = len(meshes) > 1 or (cursed and len(meshes[0][1]) == 10)
        if not crashes:
            return real(unfolder, meshes, area, dense)
        answer = Future()
        answer.set_exception(UnfolderDied(-11))
        return answer

    monkeypatch.setattr(Unfolder, "ask", ask)
    open_box = Mesh("Open", box_mesh().vertex, box_mesh().polygons[:5])
    question = ask_apart(box_mesh(), open_box, box_mesh())
    if cursed is None:
        assert len(np.unique(question.read()[0])) == 17
        return
    with pytest.raises(UnfolderDied) as died:
        question.read()
    assert died.value.args == (-11, 1)
