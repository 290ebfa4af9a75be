import numpy as np
import pytest
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


def ribbon(inner, outer):
    """Quads between two lines of as many points, each cut in two."""
    n = len(inner)
    quads = [[[n + k, n + k + 1, k], [k, n + k + 1, k + 1]] for k in range(n - 1)]
    return np.concatenate([inner, outer]), np.array(quads).reshape(-1, 3)


def spiral(turns, steps, pitch):
    angle = np.linspace(0, 2 * np.pi * turns, steps)
    lines = [
        (1.0 + pitch * angle / (2 * np.pi) + width)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1) for width in (0.0, 0.2)
    ]
    return ribbon(*lines)


def test_a_disc_is_plain_and_one_that_winds_twice_is_not():
    """Every side of the second is shared as it should be, and no triangle is turned over: its border runs over itself."""
    assert judge(*fan(1, 12)) == [True]
    assert judge(*fan(2, 24)) == [False]


@pytest.mark.parametrize(("turns", "pitch", "plain"), [(0.9, 0.0, True), (1.3, 0.0, False), (3.0, 0.5, True), (3.0, 0.1, False)])
def test_a_ribbon_is_plain_until_it_comes_over_itself(turns, pitch, plain):
    assert judge(*spiral(turns, 80, pitch)) == [plain]


def test_a_ring_whose_hole_lies_across_its_border_is_not_plain():
    uv, tri = spiral(1.0, 41, 0.0)
    uv[:41] = uv[:41] * 0.3 + [1.1, 0.0]
    assert judge(uv, np.where(tri % 41 == 40, tri - 40, tri)) == [False]


def test_charts_are_judged_one_by_one_whatever_the_order_of_their_triangles():
    """One of them has more pairs of sides than are looked at together."""
    parts = [fan(1, 600), fan(2, 9), spiral(3.0, 30, 0.5), spiral(3.0, 30, 0.1), fan(1, 3)]
    first = np.cumsum([0, *(len(uv) for uv, _ in parts)])
    vertex = np.concatenate([tri + start for (_, tri), start in zip(parts, first, strict=False)])
    number = np.repeat(np.arange(len(parts)), [len(tri) for _, tri in parts])
    shuffled = np.random.default_rng(1).permutation(len(vertex))
    vertex, number = vertex[shuffled], number[shuffled]
    uv = np.concatenate([uv for uv, _ in parts])[vertex]
    chart, shared = label_charts(vertex, np.arange(vertex.size).reshape(-1, 3), uv, number, 1e-12)
    plain = find_plain_charts(vertex, uv, chart, shared)
    assert [set(plain[chart[number == k]].tolist()) for k in range(len(parts))] == [{True}, {False}, {True}, {False}, {True}]


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
