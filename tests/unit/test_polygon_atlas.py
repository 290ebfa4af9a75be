"""A place for each polygon: its own shape and size, apart from the others."""

import numpy as np
import pytest

pytest.importorskip("bpy")

from leaflight.addon.nodes.mesh_arrays import LocalMesh
from leaflight.addon.nodes.polygon_atlas import MOST_POLYGONS, lay_polygons


def make_mesh(position, polygons):
    count = [len(one) for one in polygons]
    n_corner = sum(count)
    return LocalMesh(
        position=np.array(position, float),
        corner_vertex=np.concatenate(polygons).astype(np.int32),
        polygon_start=(np.cumsum(count) - count).astype(np.int32),
        polygon_slot=np.zeros(len(count), np.int32),
        corner_normal=np.zeros((n_corner, 3)),
        tri_corner=np.zeros((0, 3), np.int32),
        tri_polygon=np.zeros(0, np.int32),
        layers={},
        render_layer="",
        colors={},
        short=frozenset(),
        attributes=frozenset(),
    )


def make_soup(n=40, seed=1):
    """Quads and triangles of many sizes in all directions."""
    rng = np.random.default_rng(seed)
    position, polygons = [], []
    for i in range(n):
        x, y = np.linalg.qr(rng.normal(size=(3, 3)))[0][:2] * rng.uniform(0.05, 2.0, (2, 1))
        origin = rng.normal(size=3)
        first = len(position)
        position += [origin, origin + x, origin + x + y, origin + y]
        polygons.append(list(range(first, first + (4 if i % 2 else 3))))
    return make_mesh(position, polygons)


def test_polygons_keep_their_shape_and_lie_apart():
    mesh = make_soup()
    atlas = lay_polygons(mesh, np.eye(3), 32.0, 1 << 20)
    texel = atlas.uv * (atlas.width, atlas.height)
    boxes = []
    for start, end in zip(mesh.polygon_start, [*mesh.polygon_start[1:], mesh.n_corner], strict=True):
        corner, place = mesh.position[mesh.corner_vertex[start:end]], texel[start:end]
        sides = np.linalg.norm(np.roll(corner, -1, axis=0) - corner, axis=1)
        assert np.linalg.norm(np.roll(place, -1, axis=0) - place, axis=1) == pytest.approx(32.0 * sides)
        boxes.append((place.min(axis=0) - 1.0, place.max(axis=0) + 1.0))
    low, high = np.moveaxis(np.array(boxes), 1, 0)
    assert low.min() >= 0.0
    assert (high <= (atlas.width, atlas.height)).all()
    apart = ((low[:, None] >= high) | (high[:, None] <= low)).any(axis=2)
    assert (apart | np.eye(len(low), dtype=bool)).all()


def test_the_object_s_scale_counts_and_the_texels_are_bounded():
    mesh = make_soup()
    small, large = (lay_polygons(mesh, scale * np.eye(3), 16.0, 1 << 20) for scale in (1.0, 4.0))
    assert large.width * large.height > 4 * small.width * small.height
    few = lay_polygons(mesh, np.eye(3), 1e6, 1 << 14)
    assert few.width * few.height < 1 << 16


def test_hostile_meshes_have_no_atlas_or_a_finite_one():
    assert lay_polygons(_nothing(), np.eye(3), 10.0, 1000) is None
    point = lay_polygons(make_mesh(np.zeros((3, 3)), [[0, 1, 2]]), np.eye(3), 10.0, 1000)
    assert np.isfinite(point.uv).all()
    assert lay_polygons(make_mesh([[0, 0, 0], [np.nan, 0, 0], [0, 1, 0]], [[0, 1, 2]]), np.eye(3), 10.0, 1000) is None
    many = make_mesh(np.eye(3), [[0, 1, 2]] * (MOST_POLYGONS + 1))
    assert lay_polygons(many, np.eye(3), 10.0, 1000) is None


def _nothing():
    mesh = make_mesh(np.eye(3), [[0, 1, 2]])
    return type(mesh)(**{**vars(mesh), "polygon_start": np.zeros(0, np.int32), "corner_vertex": np.zeros(0, np.int32)})


@pytest.mark.filterwarnings("error")
def test_a_polygon_that_is_endlessly_long_and_has_no_area_is_laid():
    mesh = make_mesh([(0.0, 0.0, 0.0), (3e37, 0.0, 0.0), (1e37, 0.0, 0.0)], [[0, 1, 2]])
    atlas = lay_polygons(mesh, np.eye(3), 32.0, 1 << 14)
    assert np.isfinite(atlas.uv).all()
    assert atlas.width * atlas.height < 1 << 23
