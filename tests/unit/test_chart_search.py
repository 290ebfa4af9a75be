"""The charts of all objects before they have a place."""

from dataclasses import replace

import numpy as np
import pytest
from leaflight.core.atlas import chart_cache, chart_search
from leaflight.core.atlas.chart_search import find_charts
from leaflight.core.atlas.unfolding import UnfolderDied
from scenes import box_mesh, grid_mesh, make_scene, moved, quad_mesh, shared_mesh, sphere_mesh, split_faces

CLOTH = grid_mesh("Cloth", cells=4, noise=0.8)


def test_charts_of_an_object_follow_each_other_upright_and_at_zero():
    scene = make_scene([box_mesh("Box"), quad_mesh("Painted", uv=[[0, 0], [1, 0], [1, 1], [0, 1]]), CLOTH])
    found = find_charts(scene, True)
    for i in range(3):
        chart = found.chart[scene.tri_object == i]
        assert (chart.min(), chart.max() + 1) == (found.first_chart[i], found.first_chart[i + 1])
    for c in range(int(found.first_chart[-1])):
        assert found.uv[found.chart == c].min(axis=(0, 1)).tolist() == [0.0, 0.0]
    assert (found.layered, found.blocks, found.findings) == ((1,), (), ())
    assert found.outlines.extent[found.first_chart[1]].tolist() == [0.0, 0.0]


def test_an_objects_charts_lie_the_same_way_whatever_is_unwrapped_with_it():
    """Though xatlas packs them together, and turns them as they fit if it may."""
    meshes = [sphere_mesh(), box_mesh(), grid_mesh(noise=0.6), sphere_mesh(rings=5, segments=7), grid_mesh(cells=3, noise=0.3)]
    together = find_charts(make_scene(meshes), False)
    begin = 0
    for k, mesh in enumerate(meshes):
        alone = find_charts(make_scene([mesh]), False)
        own = slice(begin, begin := begin + len(alone.chart))
        np.testing.assert_array_equal(together.chart[own], alone.chart + together.first_chart[k])
        np.testing.assert_allclose(together.uv[own], alone.uv, atol=1e-4 * np.abs(alone.uv).max())


def test_copies_are_unwrapped_once_and_have_the_charts_that_they_would_have(monkeypatch):
    bent = grid_mesh("Bent", cells=6, noise=0.6)
    linked = [shared_mesh("A", bent, (2.0, 2.0, 2.0), (9.0, 0.0, 0.0)), shared_mesh("B", bent, (-2.0, 2.0, 2.0))]
    scene = make_scene([grid_mesh("Other"), bent, *linked, replace(moved(bent, (5.0, 0.0, 0.0), 3.0), name="Copy")])
    scene = replace(scene, objects=(*scene.objects[:4], replace(scene.objects[4], density_factor=2.0)))
    calls = []
    real = chart_cache.Unwrapping
    monkeypatch.setattr(chart_cache, "Unwrapping", lambda *arrays: calls.append(len(arrays[0])) or real(*arrays))
    found = find_charts(scene, True)
    assert sum(calls) == np.isin(scene.tri_object, [0, 1]).sum()
    own = [found.uv[scene.tri_object == i] for i in range(5)]
    np.testing.assert_allclose(own[2], 2.0 * own[1], rtol=1e-9)
    np.testing.assert_allclose(own[4], 6.0 * own[1], rtol=1e-9)
    monkeypatch.setattr(chart_search, "find_copies", lambda *_: {})
    apart = find_charts(scene, True)
    np.testing.assert_array_equal(found.first_chart, apart.first_chart)
    np.testing.assert_array_equal(found.chart, apart.chart)
    np.testing.assert_allclose(found.uv, apart.uv, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(found.outlines.area, apart.outlines.area, rtol=1e-4)


@pytest.mark.parametrize("layer", [False, True])
def test_charts_go_on_where_a_file_holds_vertices_for_each_face(layer):
    cloth = replace(CLOTH, uv=[(CLOTH.vertex[polygon, :2]) / 4.0 for polygon in CLOTH.polygons]) if layer else grid_mesh("Cloth", 4, 0.1)
    whole, split = (find_charts(make_scene([mesh]), True) for mesh in (cloth, split_faces(cloth)))
    assert whole.first_chart[1] == split.first_chart[1] == 1
    assert not split.findings


@pytest.mark.parametrize(("height", "advice"), [(1.0, "mend the layer"), (0.0, "give it faces with an area")])
def test_what_is_to_be_mended_is_the_layer_or_the_faces(height, advice):
    outside = quad_mesh("Over", uv=[[1.5, 0], [2.5, 0], [2.5, 1], [1.5, 1]])
    found = find_charts(make_scene([replace(outside, vertex=outside.vertex * [1.0, height, height])]), True)
    sentences = [sentence for _, sentence in found.findings]
    assert sentences[0].startswith("1 face outside the page") == (height > 0)
    assert sentences[-1].startswith("no face can be baked")
    assert advice in sentences[-1]
    assert len(found.findings) == (2 if height > 0 else 1)


def test_crash_of_xatlas_names_the_object(monkeypatch):
    class Crashing:
        def __init__(self, *arrays):
            self.first = int(arrays[-1][0])

        def finish(self, watch):
            raise UnfolderDied(-11, self.first)

        def cancel(self):
            pass

    monkeypatch.setattr(chart_cache, "Unwrapping", Crashing)
    with pytest.raises(ValueError, match=r"^Grid: the unwrapper xatlas ended unexpectedly on it \(code -11\); give"):
        find_charts(make_scene([grid_mesh("Grid", cells=2)]), True)
