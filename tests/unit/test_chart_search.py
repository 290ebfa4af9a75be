"""The charts of all objects before they have a place."""

import numpy as np
import pytest
from leaflight.core import chart_search
from leaflight.core.chart_search import find_charts
from leaflight.core.geometry import triangle_normals_areas
from leaflight.core.layer_check import signed_areas
from leaflight.core.unfolding import UnfolderDied
from scenes import box_mesh, grid_mesh, make_scene, quad_mesh, shared_mesh

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


def test_shared_charts_are_found_once_and_worn_in_each_ones_metres(monkeypatch):
    scene = make_scene([shared_mesh("A", CLOTH), shared_mesh("B", CLOTH, (-2.0, 2.0, 2.0)), shared_mesh("C", CLOTH, (1.0, 1.2, 1.0))])
    calls = []
    real = chart_search.unwrap_triangles
    monkeypatch.setattr(chart_search, "unwrap_triangles", lambda *arrays: calls.append(1) or real(*arrays))
    found = find_charts(scene, True)
    assert len(calls) == 1
    assert len(found.blocks) == 1
    count = int(found.first_chart[1])
    rows = np.arange(scene.n_tri).reshape(3, -1)
    for k in (1, 2):
        np.testing.assert_array_equal(found.chart[rows[k]], found.chart[rows[0]] + k * count)
    area = triangle_normals_areas(scene.tri_position)[1]
    for k in range(3):
        assert np.abs(signed_areas(found.uv[rows[k]])).sum() == pytest.approx(area[rows[k]].sum())
    find_charts(scene, False)
    assert len(calls) == 4


def test_crash_of_xatlas_names_the_object(monkeypatch):
    def crash(*arrays):
        raise UnfolderDied(-11)

    monkeypatch.setattr(chart_search, "unwrap_triangles", crash)
    scene = make_scene([box_mesh()])
    with pytest.raises(ValueError, match=rf"^{scene.objects[0].name}: the unwrapper xatlas ended unexpectedly on it \(code -11\); give"):
        chart_search.find_charts(scene, share_meshes=True)
