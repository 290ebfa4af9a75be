import numpy as np
from leaflight.core.atlas.layer_check import label_charts
from leaflight.core.atlas.outlines import measure_outlines, straighten_charts
from scenes import grid_mesh, make_scene


def turned_grids(angles, depth=3.0):
    """Flat grids of 6 by `depth` metres, one chart each, turned and moved."""
    scene = make_scene([grid_mesh(str(k), cells=6) for k in range(len(angles))])
    uv = scene.tri_position[..., :2] * (1.0, depth / 6.0)
    c, s = np.cos(angles)[scene.tri_object, None], np.sin(angles)[scene.tri_object, None]
    uv = np.stack([c * uv[..., 0] - s * uv[..., 1] + 5, s * uv[..., 0] + c * uv[..., 1] - 9], axis=2)
    corner = scene.tri_corner + 1000 * scene.tri_object[:, None]
    chart, shared = label_charts(scene.tri_vertex, corner, uv, scene.tri_object)
    return uv, chart, shared


def test_rectangles_are_turned_upright():
    uv, chart, shared = turned_grids(np.array([0.0, 0.4, 1.1, 2.7]))
    upright = straighten_charts(uv, chart, shared, 4)
    found = measure_outlines(upright, chart, shared, 4)
    np.testing.assert_allclose(np.sort(found.extent, axis=1), [[3.0, 6.0]] * 4)
    np.testing.assert_allclose(found.area, 18.0)
    for k in range(4):
        np.testing.assert_allclose(upright[chart == k].min(axis=(0, 1)), 0.0, atol=1e-12)


def test_the_smallest_box_is_found_of_few_charts_and_of_many():
    """Of three loose triangles each, around which the smallest box seldom lies along the longest side."""
    count = 1500
    uv, chart, shared = np.random.default_rng(3).random((3 * count, 3, 2)), np.repeat(np.arange(count), 3), np.zeros((3 * count, 3), bool)
    together = straighten_charts(uv, chart, shared, count)
    box = together.reshape(count, 9, 2).max(axis=1).prod(axis=1)
    for angle in np.arange(24) * np.pi / 48:
        turned = uv @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        assert (box <= np.ptp(turned.reshape(count, 9, 2), axis=1).prod(axis=1) / 0.999 + 1e-12).all()
    for first in (0, 700, count - 40):
        some = slice(3 * first, 3 * (first + 40))
        np.testing.assert_array_equal(straighten_charts(uv[some], chart[:120], shared[some], 40), together[some])


def test_rounding_does_not_choose_between_edges_that_are_as_long():
    """All border edges of a grid of squares are."""
    uv, chart, shared = turned_grids(np.array([0.0, 0.4, 1.1, 2.7]), depth=6.0)
    upright = straighten_charts(uv, chart, shared, 4)
    rng = np.random.default_rng(1)
    place = np.unique(uv.reshape(-1, 2).round(6), axis=0, return_inverse=True)[1].reshape(chart.size, 3)
    for _ in range(10):
        moved = uv + rng.uniform(-1e-6, 1e-6, (place.max() + 1, 2))[place]
        np.testing.assert_allclose(straighten_charts(moved, chart, shared, 4), upright, atol=1e-4)
