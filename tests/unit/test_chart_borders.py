import numpy as np
from leaflight.core.atlas.chart_borders import find_plain_charts
from leaflight.core.atlas.layer_check import find_overlaps, label_charts, signed_areas
from scenes import grid_mesh, make_scene


def judge(uv, vertex):
    """Whether the charts of triangles (n, 3) of UVs (n_vertex, 2) are plain."""
    vertex = np.asarray(vertex)
    corner = np.arange(vertex.size).reshape(-1, 3)
    tri_uv = np.asarray(uv, float)[vertex]
    chart, shared = label_charts(vertex, corner, tri_uv, np.zeros(len(vertex), int), 1e-12)
    return find_plain_charts(vertex, tri_uv, chart, shared).tolist()


def fan(turns, steps, radius=1.0):
    """Triangles around a centre, all of one size; the last is joined to the first."""
    angle = np.linspace(0, 2 * np.pi * turns, steps, endpoint=False)
    uv = np.concatenate([[[0, 0]], radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)])
    return uv, np.array([[0, 1 + k, 1 + (k + 1) % steps] for k in range(steps)])


def test_a_disc_is_plain_and_one_that_winds_twice_is_not():
    """Every side of the second is shared as it should be, and no triangle is turned over: its border runs over itself."""
    assert judge(*fan(1, 12)) == [True]
    assert judge(*fan(2, 24)) == [False]


def test_what_is_plain_a_raster_finds_nothing_in():
    """Bent grids whose points are moved at random, from hardly to wildly: of the former all are plain, of the latter none that overlaps."""
    rng = np.random.default_rng(5)
    scene = make_scene([grid_mesh(cells=6)])
    flat = scene.vertex_position[:, :2] / 6
    found = []
    for noise in (0.01, 0.03, 0.05, 0.08, 0.1, 0.15):
        for _ in range(30):
            uv = (flat + rng.normal(scale=noise, size=flat.shape))[scene.tri_vertex]
            uv = (uv - uv.min(axis=(0, 1))) / np.ptp(uv, axis=(0, 1)).max()
            chart, shared = label_charts(scene.tri_vertex, scene.tri_corner, uv, np.zeros(len(uv), int), 1e-12)
            plain = bool(find_plain_charts(scene.tri_vertex, uv, chart, shared).all())
            turned = bool((signed_areas(uv) <= 0).any())
            overlap = turned or bool(find_overlaps(uv).any())
            assert not (plain and overlap)
            found.append((noise, plain))
    assert all(plain for noise, plain in found if noise == 0.01)
    assert not any(plain for noise, plain in found if noise == 0.15)
