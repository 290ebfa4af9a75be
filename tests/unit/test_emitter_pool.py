"""Light of many emitting triangles: the same as from each by itself, with honest errors."""

import math
from dataclasses import replace

import numpy as np
import pytest
from closed_forms import from_polygon
from floors import floor_footprints, lit_scene, prepare, to_grid
from leaflight.core.integrate import direct
from leaflight.core.integrate.direct import DirectScene, direct_irradiance
from leaflight.core.lights.direct_lights import make_triangle_sources
from leaflight.core.lights.emitting_cells import find_emitting_cells
from leaflight.core.lights.light_links import LightLinks
from leaflight.core.scene.scene import Material, SceneSnapshot, TextureImage
from scenes import box_mesh, grid_mesh, moved, quad_mesh, sphere_mesh

SIDE = 32
TEXELS = np.arange(SIDE * SIDE)
ENOUGH = 1e9  # a tolerance that the first 16 rays meet


def light_floor(scene: DirectScene, seed: int = 1, texels: np.ndarray = TEXELS, **options: float) -> direct.DirectLight:
    return direct_irradiance(scene, floor_footprints(SIDE), texels, np.random.default_rng(seed), **options)


def as_sources(scene: SceneSnapshot) -> DirectScene:
    """The same scene with each emitting triangle as a source of its own."""
    pooled, _, surfaces = prepare(scene)
    ((_, cells),) = find_emitting_cells(scene, surfaces, LightLinks.of(scene))
    sources = make_triangle_sources(cells, pooled.surfaces.corner_unit, pooled.surfaces.normal, np.zeros(scene.n_tri, bool))
    return replace(pooled, pools=(), sources=tuple(sources))


def boxes(count: int) -> list:
    return [box_mesh(f"Lamp {i}", (0.1, 0.1, 0.05), (0.2 + 0.3 * (i % 3), 0.2 + 0.3 * (i // 3), 0.9)) for i in range(count)]


def test_the_same_light_as_from_each_triangle_by_itself():
    scene = lit_scene([box_mesh("Block", (0.3, 0.3, 0.3), (0.5, 0.5, 0.3))], emission=boxes(4), rgb=(3.0, 2.0, 1.0))
    pooled, _, _ = prepare(scene)
    assert len(pooled.pools) == 1
    expected = light_floor(as_sources(scene), tolerance=0.0).irradiance_rgb
    found = light_floor(pooled, tolerance=0.0)
    error = found.irradiance_rgb - expected
    assert error.mean(axis=0) == pytest.approx(0, abs=0.01 * expected.mean())
    assert np.sqrt((error**2).mean()) < 0.1 * expected.mean()
    assert found.irradiance_rgb[:, 0] == pytest.approx(3 * found.irradiance_rgb[:, 2])


def test_a_large_triangle_close_by_is_chosen_though_its_middle_is_far_and_low():
    """A glowing panel over the floor, 5 mm above it, and lamps further off: nearly all comes from the panel."""
    panel = moved(quad_mesh("Panel", 0.8, 0.8), (0.1, 0.1, 0.005))
    scene = lit_scene(emission=[panel, *boxes(9)], rgb=(3.0, 2.0, 1.0))
    pooled = prepare(scene)[0]
    found, expected = light_floor(pooled, tolerance=ENOUGH), light_floor(as_sources(scene), tolerance=0.02).irradiance_rgb[:, 0]
    under = expected > 0.8 * 3 * math.pi
    assert 0.4 < under.mean() < 0.8
    error = found.irradiance_rgb[under, 0] / expected[under] - 1
    assert np.sqrt((error**2).mean()) < 0.1


def test_long_strips_close_by_give_all_of_their_light():
    """Strips of 20 m, 1 cm wide and 5 cm above the floor: by points all along them nearly nothing comes from where they are near."""
    strips = [moved(quad_mesh(f"Strip {i}", 20.0, 0.01), (-9.5, 0.1 + 0.1 * i, 0.05)) for i in range(8)]
    scene = lit_scene(emission=strips)
    pooled = prepare(scene)[0]
    assert len(pooled.pools) == 1
    expected = light_floor(as_sources(scene), tolerance=0.0).irradiance_rgb
    found = light_floor(pooled, tolerance=0.0).irradiance_rgb
    assert found.mean() == pytest.approx(expected.mean(), rel=0.01)
    assert np.sqrt((((found - expected) / expected) ** 2).mean()) < 0.2


def test_triangles_that_share_an_edge_with_the_floor():
    """32 of them, rising outwards from it: the nearest ends of rays bring most of the light, and their corners lie on the horizon."""
    grid = grid_mesh("Skirt", 4, edge_m=0.25)
    x, y, _ = grid.vertex.T
    skirt = replace(grid, vertex=np.stack([-0.3 * x, 1 - y, 0.6 * x], axis=1))
    scene = lit_scene(emission=[skirt])
    pooled, alone = prepare(scene)[0], as_sources(scene)
    found = np.mean([to_grid(light_floor(pooled, seed).irradiance_rgb[:, 0], SIDE) for seed in range(8)], axis=0)
    expected = to_grid(light_floor(alone).irradiance_rgb[:, 0], SIDE)
    assert found.mean() == pytest.approx(expected.mean(), rel=0.004)
    assert found[:, 0].mean() == pytest.approx(expected[:, 0].mean(), rel=0.02)


def test_lamps_that_reach_down_through_the_floor():
    """9 boxes with their feet in it: the triangles of their sides are cut by the horizon, inside and out."""
    places = [((i % 3 + 0.5) / 3, (i // 3 + 0.5) / 3, 0.035) for i in range(9)]
    scene = lit_scene(emission=[box_mesh(f"Lamp {i}", (0.15, 0.15, 0.08), place) for i, place in enumerate(places)])
    pooled, alone = prepare(scene)[0], as_sources(scene)
    assert len(pooled.pools) == 1
    found = np.mean([light_floor(pooled, seed, TEXELS[::5]).irradiance_rgb[:, 0] for seed in range(4)], axis=0)
    expected = light_floor(alone, texels=TEXELS[::5]).irradiance_rgb[:, 0]
    assert found.mean() == pytest.approx(expected.mean(), rel=0.01)


def test_errors_are_honest():
    """Over seeds, the mean square error is the stated variance, within a factor."""
    scene, _, _ = prepare(lit_scene([box_mesh("Block", (0.3, 0.3, 0.3), (0.5, 0.5, 0.3))], emission=boxes(6)))
    runs = [light_floor(scene, seed) for seed in range(12)]
    values = np.stack([run.irradiance_rgb[:, 0] for run in runs])
    stated = np.mean([run.variance_rgb[:, 0].mean() for run in runs])
    true = values.var(axis=0, ddof=1).mean()
    assert 0.4 < true / stated < 1.6


def test_a_lamp_close_above_the_floor_has_no_fireflies():
    scene, _, _ = prepare(lit_scene(emission=[moved(grid_mesh("Lamp", 4, edge_m=0.1), (0.3, 0.3, 0.03))]))
    grid = to_grid(light_floor(scene).irradiance_rgb[:, 0], SIDE)
    assert grid.max() < 1.3 * math.pi
    # Below its middle; the closed form of a square, of all 16 texels.
    centre = (np.stack(np.meshgrid(np.arange(14, 18), np.arange(14, 18)), axis=-1).reshape(-1, 2) + 0.5) / SIDE
    position, up = np.column_stack([centre, np.zeros(16)]), np.tile([0.0, 0.0, 1.0], (16, 1))
    corners = np.array([[0.3, 0.3, 0.03], [0.7, 0.3, 0.03], [0.7, 0.7, 0.03], [0.3, 0.7, 0.03]])
    assert grid[14:18, 14:18].mean() == pytest.approx(np.abs(from_polygon(corners, position, up)).mean(), rel=0.025)


def test_a_bed_of_glowing_boxes_takes_few_rays(hold):
    """49 of them just above the floor, of 588 triangles: who sees few of them, near ones, does not look for the others."""
    places = [((i % 7 + 0.5) / 7, (i // 7 + 0.5) / 7, 0.025) for i in range(49)]
    scene, _, _ = prepare(lit_scene(emission=[box_mesh(f"Box {i}", (0.05, 0.05, 0.025), place) for i, place in enumerate(places)]))
    runs = [light_floor(scene, seed, TEXELS[::2], tolerance=ENOUGH) for seed in range(4)]
    light = np.stack([run.irradiance_rgb[:, 0] for run in runs])
    noise = np.sqrt(light.var(axis=0, ddof=1).mean()) / light.mean()
    hold("bed of glowing boxes: noise of 16 rays", noise, high=0.1)


def test_textures_shine_where_they_are_bright():
    scene = lit_scene(emission=[moved(quad_mesh("Screen"), (0, 0, 0.3))])
    uv = scene.tri_emission_uv.copy()
    uv[2], uv[3] = [[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]
    pixels = np.zeros((8, 8, 3), np.float32)
    pixels[1, 6] = (64, 32, 0)
    lamp = Material("Lamp", emission_rgb=(1.0, 1.0, 1.0), emission_image=0)
    scene = replace(scene, materials=(scene.materials[0], lamp), images=(TextureImage("P", pixels, closest=True),), tri_emission_uv=uv)
    prepared, _, _ = prepare(scene)
    found = to_grid(light_floor(prepared).irradiance_rgb, SIDE)
    # The bright texel is 0.125 m wide: nearly a small patch of 64 W/m^2/sr at (0.8125, 0.1875, 0.3).
    place = (np.arange(SIDE) + 0.5) / SIDE
    square = (place[None, :] - 0.8125) ** 2 + (place[:, None] - 0.1875) ** 2 + 0.09
    expected = 64 / 64 * 0.09 / square**2
    assert found[..., 0] == pytest.approx(expected, rel=0.2, abs=0.02 * expected.max())
    assert found[..., 0].mean() == pytest.approx(expected.mean(), rel=0.03)
    assert found[..., 1] == pytest.approx(found[..., 0] / 2)
    assert not found[..., 2].any()


def test_clusters_of_more_triangles_than_they_are():
    lamps = [moved(sphere_mesh(f"Lamp {i}", 12, 24, 0.1), (0.25 + 0.5 * i, 0.5, 0.6)) for i in range(2)]
    scene, _, _ = prepare(lit_scene(emission=lamps))
    (pool,) = scene.pools
    assert len(pool.clusters) <= 256 < len(pool.cells.tri)
    found = to_grid(light_floor(scene, tolerance=0.005).irradiance_rgb[:, 0], SIDE)
    # A sphere of radiance 1 gives pi sin^2 cos, here in full view of the floor.
    place = (np.arange(SIDE) + 0.5) / SIDE
    expected = np.zeros((SIDE, SIDE))
    for x in (0.25, 0.75):
        square = (place[None, :] - x) ** 2 + (place[:, None] - 0.5) ** 2 + 0.36
        expected += math.pi * 0.01 / square * 0.6 / np.sqrt(square)
    assert np.sqrt(((found / expected - 1) ** 2).mean()) < 0.1
    assert found.mean() == pytest.approx(expected.mean(), rel=0.03)  # 12 rings are a little smaller than their sphere


def test_a_picture_close_to_a_floor_gives_all_of_its_light_with_little_noise():
    """A screen 1 mm over the floor, its pixels smaller than a texel: what a ray finds depends on the place in the texel where it starts."""
    plain = lit_scene(emission=[moved(quad_mesh("Screen", 0.35, 0.07), (0.3, 0.41, 0.001))], rgb=(0.65, 0.65, 0.65))
    pixels = np.full((8, 34, 3), 0.5, np.float32)
    pixels[::2, ::2] = pixels[1::2, 1::2] = 0.8
    uv = plain.tri_emission_uv.copy()
    uv[2], uv[3] = [[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]
    lamp = replace(plain.materials[1], emission_rgb=(1.0, 1.0, 1.0), emission_image=0)
    image = TextureImage("Picture", pixels, closest=True)
    textured = replace(plain, materials=(plain.materials[0], lamp), images=(image,), tri_emission_uv=uv)
    found, expected = (light_floor(prepare(scene)[0]).irradiance_rgb[:, 0] for scene in (textured, plain))
    assert found.mean() == pytest.approx(expected.mean(), rel=0.015)
    assert np.sqrt(((found - expected) ** 2).mean()) < 0.15 * expected[expected > 1].mean()
