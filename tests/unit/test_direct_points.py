"""Where rays start and aim: strata, receivers off their surface, and what a receiver sees."""

from dataclasses import replace

import numpy as np
import pytest
from floors import floor_footprints, lit_scene, prepare
from leaflight.core.lights.direct_points import MIDDLE, ReceivingSurfaces, TexelChunk, random_shift
from leaflight.core.scene.materials import SurfaceMaterials
from leaflight.core.texels.texel_footprint import TexelFootprints
from leaflight.core.util.geometry import UnitBox
from scenes import make_scene, sphere_mesh


def cells(points: np.ndarray, columns: int, rows: int) -> list[int]:
    """Sorted cells of a grid that points (n, 2) of the unit square fall in."""
    return sorted((np.floor(points[:, 0] * columns) * rows + np.floor(points[:, 1] * rows)).astype(int).tolist())


@pytest.mark.parametrize("count", [4, 16, 64])
def test_first_rays_start_one_in_each_stratum_of_the_texel(count):
    scene, _, _ = prepare(lit_scene())
    chunk = TexelChunk(floor_footprints(1)(np.array([0])), random_shift(np.random.default_rng(2), 1), scene.surfaces, False)
    start = chunk.receivers(np.array([0]), 0, count).position
    side = round(count**0.5)
    assert cells(start[:, :2] + 0.5, side, side) == list(range(count))


def chunk_at(surfaces: ReceivingSurfaces, tri: np.ndarray, u: float, v: float, flip: bool = False) -> TexelChunk:
    """A texel at one point of each triangle."""
    weight = np.zeros((3, 2, len(tri)))
    weight[0] = np.array([[u], [v]])
    return TexelChunk(TexelFootprints.of_squares(tri, weight), np.zeros((len(tri), 2), np.uint32), surfaces, flip)


def test_smooth_triangles_have_interpolated_unit_normals():
    flat = make_scene([sphere_mesh(rings=6, segments=8)])
    corner_normal = flat.tri_position / np.linalg.norm(flat.tri_position, axis=2, keepdims=True)
    smooth = replace(flat, tri_normal=corner_normal.astype(np.float32))
    surfaces = ReceivingSurfaces.of(smooth, UnitBox(np.zeros(3), 1.0), SurfaceMaterials(smooth))
    tri = np.arange(flat.n_tri)
    receivers = chunk_at(surfaces, tri, 1 / 3, 1 / 3).receivers_at(tri, MIDDLE)
    expected = corner_normal.mean(axis=1) / np.linalg.norm(corner_normal.mean(axis=1), axis=1, keepdims=True)
    assert np.abs(receivers.normal - expected).max() < 1e-5
    assert np.abs(np.linalg.norm(receivers.side, axis=1) - 1).max() < 1e-5
    assert np.abs(receivers.side - receivers.normal).max() > 1e-3
    some = receivers.rows(tri[::3])
    for name in ("position", "normal", "side"):
        np.testing.assert_array_equal(getattr(some, name), getattr(receivers, name)[::3])
    behind = chunk_at(surfaces, tri, 1 / 3, 1 / 3, flip=True).receivers_at(tri, MIDDLE)
    np.testing.assert_array_equal(behind.normal, -receivers.normal)
    np.testing.assert_array_equal(behind.side, -receivers.side)
