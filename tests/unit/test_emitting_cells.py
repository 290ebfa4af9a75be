"""Cells of textured emitters: small where the texture is uneven."""

from dataclasses import replace

import numpy as np
import pytest
from leaflight.core.lights.emitting_cells import EmittingCells, find_emitting_cells
from leaflight.core.lights.light_links import LightLinks
from leaflight.core.scene.materials import SurfaceMaterials
from leaflight.core.scene.scene import Material, SceneSnapshot, TextureImage
from leaflight.core.util.brightness import weigh_channels
from scenes import make_scene, quad_mesh


def screen(pixels: np.ndarray, tiles: float = 1.0, closest: bool = False) -> SceneSnapshot:
    """A quad of 2 x 1 m that emits an image, its UV square so many times along each side."""
    scene = make_scene([quad_mesh("Screen", 2.0, 1.0)])
    uv = tiles * np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]], np.float32)
    material = Material("Screen", emission_rgb=(2.0, 2.0, 2.0), emission_image=0)
    return replace(scene, materials=(material,), images=(TextureImage("Picture", pixels, closest=closest),), tri_emission_uv=uv)


def cells_of(scene: SceneSnapshot) -> EmittingCells:
    ((_, cells),) = find_emitting_cells(scene, SurfaceMaterials(scene), LightLinks.of(scene))
    return cells


def spread_of_estimates(scene: SceneSnapshot, count: int = 100_000) -> tuple[float, float]:
    """Power per steradian as rays to points of cells find it, mean and standard deviation of one."""
    cells, rng = cells_of(scene), np.random.default_rng(1)
    chance = cells.importance / cells.importance.sum()
    cell = rng.choice(len(chance), count, p=chance)
    tri, barycentric = cells.place(cell, rng.random((count, 2)))
    radiance = weigh_channels(SurfaceMaterials(scene).emission.at(tri, barycentric[:, 0], barycentric[:, 1]))
    found = radiance * cells.area_m2[cell] / chance[cell]
    return float(found.mean()), float(found.std())


def stars(size: int = 1024, closest: bool = False) -> SceneSnapshot:
    """Single bright texels, one of 20,000, on a dim ground."""
    pixels = np.full((size, size, 3), 0.01, np.float32)
    row, column = np.random.default_rng(2).integers(0, size, (2, size * size // 20_000))
    pixels[row, column] = 1000
    return screen(pixels, closest=closest)


@pytest.mark.parametrize("closest", [False, True])
def test_every_star_has_its_cell(closest):
    """Cells that are looked at in points pass most of them by: estimates differ by ten times their mean and more."""
    scene = stars(closest=closest)
    mean, deviation = spread_of_estimates(scene)
    assert mean == pytest.approx(4 * scene.images[0].pixels.mean(dtype=np.float64), rel=0.03)
    assert deviation < mean
    assert len(cells_of(scene).tri) < 40_000


def test_cells_tile_their_triangles():
    cells = cells_of(stars(256))
    assert np.bincount(cells.tri, cells.area_m2) == pytest.approx([1, 1], rel=1e-6)
    assert np.bincount(cells.tri, cells.side.astype(np.float64) ** 2) == pytest.approx([1, 1], rel=1e-6)
    point = np.random.default_rng(3).random((200, 2)).astype(np.float32)
    low = cells.corner[:, None] <= point
    high = point < cells.corner[:, None] + cells.side[:, None, None]
    for tri in (0, 1):
        assert ((low & high).all(axis=2)[cells.tri == tri].sum(axis=0) == 1).all()


def test_black_and_empty_textures_give_no_light():
    for pixels in (np.zeros((8, 8, 3), np.float32), np.zeros((0, 0, 3), np.float32)):
        scene = screen(pixels)
        assert find_emitting_cells(scene, SurfaceMaterials(scene), LightLinks.of(scene)) == []


def test_places_that_are_no_numbers_do_no_harm():
    scene = screen(np.ones((8, 8, 3), np.float32))
    uv = scene.tri_emission_uv.copy()
    uv[0, 0], uv[1, 1] = np.nan, 1e30
    cells = cells_of(replace(scene, tri_emission_uv=uv))
    assert np.isfinite(cells.mean_rgb).all()
    assert np.bincount(cells.tri, cells.area_m2) == pytest.approx([1, 1], rel=1e-6)


def palette(part: float) -> SceneSnapshot:
    """Four quads of 1 x 1 m, each of one swatch of an image of 4 x 4, of which its UVs take up so much."""
    scene = make_scene([quad_mesh(f"Quad {i}") for i in range(4)])
    swatch = np.array([[0, 0], [1, 0], [2, 3], [3, 3]])[np.arange(8) // 2] + 0.5
    corner = part * (np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]]) - 0.5)[np.arange(8) % 2]
    uv = ((swatch[:, None] + corner) / 4).astype(np.float32)
    pixels = np.random.default_rng(6).random((4, 4, 3)).astype(np.float32)
    material = Material("Palette", emission_rgb=(2.0, 2.0, 2.0), emission_image=0)
    return replace(scene, materials=(material,), images=(TextureImage("Picture", pixels, closest=True),), tri_emission_uv=uv)


def test_triangles_of_one_swatch_of_a_palette_are_whole_and_of_one_radiance_each():
    scene = palette(0.5)
    cells = cells_of(scene)
    assert cells.constant
    assert cells.tri.tolist() == list(range(8))
    pixels = 2 * scene.images[0].pixels
    expected = pixels[[0, 0, 3, 3], [0, 1, 2, 3]][np.arange(8) // 2]
    assert cells.mean_rgb == pytest.approx(expected, rel=1e-5)
    crossing = find_emitting_cells(palette(3.0), SurfaceMaterials(palette(3.0)), LightLinks.of(palette(3.0)))
    assert not any(some.constant for _, some in crossing)


def test_what_other_surfaces_do_not_see_lights_nothing():
    scene = stars(64)
    hidden = replace(scene, objects=tuple(replace(one, seen_by=(False,) * 3) for one in scene.objects))
    assert find_emitting_cells(hidden, SurfaceMaterials(hidden), LightLinks.of(hidden)) == []
