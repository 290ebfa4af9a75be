"""Emitting meshes and the world: powers, statistics of births, cells of textures, and their light by shadow rays."""

import math
from dataclasses import replace

import numpy as np
import pytest
from closed_forms import from_polygon
from floors import Patch, chi_square_sigmas, floor_footprints, lit_scene, prepare, sigma_limit, to_grid
from leaflight.core.integrate import direct
from leaflight.core.integrate.direct import DirectScene, direct_irradiance
from leaflight.core.lights.direct_lights import make_triangle_sources
from leaflight.core.lights.emitters import NO_LIGHT, EmittingMeshes, MeshEmitter, WorldEmitter, build_emitters, usable_power
from leaflight.core.lights.emitting_cells import EmittingCells, find_emitting_cells
from leaflight.core.lights.irradiance import polygon_irradiance
from leaflight.core.lights.light_links import LightLinks
from leaflight.core.scene.materials import SurfaceMaterials
from leaflight.core.scene.scene import Light, Material, SceneSnapshot, TextureImage
from leaflight.core.util.brightness import weigh_channels
from leaflight.core.util.geometry import UnitBox
from scenes import box_mesh, grid_mesh, make_scene, moved, quad_mesh, sphere_mesh

# Emitting meshes and the world: powers, statistics of births, and what is left out with a sentence.
LIMIT = sigma_limit(20)
N_PHOTON = 300_000
LAMP_RGB = (5.0, 2.0, 0.0)


def build(scene: SceneSnapshot):
    box = UnitBox.from_points(scene.vertex_position)
    surfaces = SurfaceMaterials(scene)
    return build_emitters(scene, box, surfaces, EmittingMeshes.of(scene, surfaces)), box


def numbers(count: int = N_PHOTON, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).random((count, 4), np.float32)


def lamp_scene() -> SceneSnapshot:
    """A floor and a 1 x 0.5 m lamp 0.5 m above it."""
    return lit_scene(emission=[moved(quad_mesh("Lamp", 1.0, 0.5), (0, 0.25, 0.5))], rgb=LAMP_RGB)


def textured_scene(pixels: np.ndarray) -> SceneSnapshot:
    """A 2 x 1 m quad that emits an image, its whole UV square, without interpolation."""
    scene = make_scene([quad_mesh("Screen", 2.0, 1.0)])
    uv = np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]], np.float32)
    material = Material("Screen", emission_rgb=(2.0, 2.0, 2.0), emission_image=0)
    return replace(scene, materials=(material,), images=(TextureImage("Picture", pixels, closest=True),), tri_emission_uv=uv)


class EmitterContract:
    """What holds for every kind."""

    scene: SceneSnapshot
    power_w: tuple[float, float, float]

    def emitter(self):
        (emitters, warnings), _ = build(self.scene)
        assert warnings == []
        assert len(emitters) == 1
        return emitters[0]

    def test_power(self):
        assert self.emitter().power_rgb == pytest.approx(self.power_w, rel=1e-3)

    def test_births_are_finite_unit_and_of_mean_one(self):
        emitter = self.emitter()
        births = emitter.emit(numbers())
        assert births.origin.dtype == births.direction.dtype == births.relative_rgb.dtype == np.float32
        assert np.abs(np.linalg.norm(births.direction, axis=1) - 1).max() < 1e-5
        assert np.isfinite(births.origin).all()
        relative = np.broadcast_to(births.relative_rgb, (N_PHOTON, 3))[:, emitter.power_rgb > 0].astype(float)
        assert (np.abs(relative.mean(axis=0) - 1) <= LIMIT * relative.std(axis=0) / math.sqrt(N_PHOTON) + 2e-3).all()


class TestQuadLamp(EmitterContract):
    scene = lamp_scene()
    power_w = tuple(2 * math.pi * 0.5 * value for value in LAMP_RGB)  # both sides of half a square metre

    def test_half_goes_each_way_and_starts_off_the_surface(self):
        births = self.emitter().emit(numbers())
        up = births.direction[:, 2] > 0
        assert abs(up.mean() - 0.5) < LIMIT * 0.5 / math.sqrt(N_PHOTON)
        lamp = UnitBox.from_points(self.scene.vertex_position).to_unit(np.array([0, 0, 0.5]))[2]
        assert (births.origin[up, 2] > lamp).all()
        assert (births.origin[~up, 2] < lamp).all()

    def test_places_are_uniform_and_directions_cosine_distributed(self, hold):
        births = self.emitter().emit(numbers())
        places = np.histogram2d(births.origin[:, 0], births.origin[:, 1], bins=8, range=[[-0.5, 0.5], [-0.25, 0.25]])[0].ravel()
        squared = np.histogram(births.direction[:, 2] ** 2, bins=32, range=(0, 1))[0]
        for case, counts in (("places", places), ("directions", squared)):
            even, tilt = np.full(len(counts), N_PHOTON / len(counts)), np.linspace(0.97, 1.03, len(counts))
            name = "photons of a glowing mesh: chi-square"
            hold(f"{name} against the density", abs(chi_square_sigmas(counts, even)), high=LIMIT, unit="sigmas", case=case)
            hold(f"{name} with one that is 3 % off", chi_square_sigmas(counts, even * tilt), low=LIMIT, unit="sigmas", case=case)

    def test_counted_irradiance(self):
        box = UnitBox.from_points(self.scene.vertex_position)
        corners = box.to_unit(np.array([[0, 0.25, 0.5], [1, 0.25, 0.5], [1, 0.75, 0.5], [0, 0.75, 0.5]]))
        patch = Patch((0.1, 0.1, -0.25), (0, 0, 1), 0.3)
        counted, error = patch.count(self.emitter(), N_PHOTON, 3, box.scale)
        expected = 5 * patch.mean(lambda position, normal: np.abs(polygon_irradiance(corners, position, normal)))
        assert error[0] < 0.03 * expected
        assert abs(counted[0] - expected) < LIMIT * error[0]


class TestBoxLamp(EmitterContract):
    scene = lit_scene(emission=[box_mesh("Lamp", (0.2, 0.4, 0.1), (0.5, 0.5, 0.5))], rgb=LAMP_RGB)
    power_w = tuple(math.pi * 2 * (0.08 + 0.02 + 0.04) * value for value in LAMP_RGB)  # of what leaves it: nobody sees its inside

    def test_no_light_goes_inwards(self):
        births = self.emitter().emit(numbers())
        box = UnitBox.from_points(self.scene.vertex_position)
        offset = (births.origin / box.scale + box.centre_m - 0.5) / [0.1, 0.2, 0.05]  # of the faces, of which one coordinate is 1
        axis = np.abs(offset).argmax(axis=1)[:, None]
        assert (np.take_along_axis(offset * births.direction, axis, axis=1) > 0).all()


class TestBackLamp(EmitterContract):
    """Half a square metre that glows upwards, from its back."""

    scene = lamp_scene()
    scene = replace(scene, materials=tuple(replace(one, dark_front=any(one.emission_rgb)) for one in scene.materials))
    power_w = tuple(math.pi * 0.5 * value for value in LAMP_RGB)

    def test_light_leaves_the_back(self):
        births = self.emitter().emit(numbers())
        both = TestQuadLamp().emitter()
        normal = both.tri_normal[:, both.cells.tri[0]]
        assert (births.direction @ normal < 0).all()


class TestPalette(EmitterContract):
    """Two triangles of one radiance each, which a texture gives them."""

    pixels = np.array([[[3, 1, 0], [0, 1, 6]]], np.float32)
    scene = replace(textured_scene(pixels), tri_emission_uv=np.array([[[0.25, 0.5]] * 3, [[0.75, 0.5]] * 3], np.float32))
    power_w = tuple(2 * math.pi * 2 * 2 * value for value in (1.5, 1, 3))

    def test_light_has_the_colour_of_its_triangle(self):
        emitter = self.emitter()
        births = emitter.emit(numbers())
        flux = np.broadcast_to(births.relative_rgb, (N_PHOTON, 3)) * emitter.power_rgb
        red = (flux[:, 2] == 0).astype(int)
        np.testing.assert_allclose(flux[red == 1], np.tile(flux[red == 1][0], (red.sum(), 1)), rtol=1e-6, atol=1e-12)
        assert flux[red == 1][0, 0] / flux[red == 1][0, 1] == pytest.approx(3)
        assert (flux[red == 0][:, 0] == 0).all()
        assert flux.mean(axis=0) == pytest.approx(self.power_w, rel=0.02)


class TestTexturedScreen(EmitterContract):
    """Bright, red and black squares: the light is where the picture has it."""

    pixels = np.zeros((4, 8, 3), np.float32)
    pixels[3, 7] = 10
    pixels[0, 0] = (1, 0, 0)
    scene = textured_scene(pixels)
    power_w = tuple(2 * math.pi * 2 * 2 * value / 32 for value in (11, 10, 10))

    def test_light_leaves_where_the_picture_is_bright(self):
        emitter = self.emitter()
        births = emitter.emit(numbers())
        flux = np.broadcast_to(births.relative_rgb, (N_PHOTON, 3)) * emitter.power_rgb / N_PHOTON
        box = UnitBox.from_points(self.scene.vertex_position)
        place = births.origin / box.scale + box.centre_m
        column, row = (place[:, :2] * 4).astype(int).T.clip(0, 7)
        image = np.zeros((4, 8, 3))
        np.add.at(image, (row.clip(0, 3), column), flux)
        expected = self.pixels * 2 * math.pi * 2 * 2 / 32
        assert image == pytest.approx(expected, rel=0.02, abs=1e-3 * float(expected.max()))


class TestWorld(EmitterContract):
    scene = replace(lit_scene([box_mesh("Block", (1, 1, 0.5), (0.5, 0.5, 0.25))]), world_rgb=(0.5, 0.2, 0.0))
    # A convex body of surface S takes up pi L S from all around; 2 mm of padding.
    power_w = tuple(math.pi * value * 2 * (1.002**2 + 2 * 1.002 * 0.502) for value in (0.5, 0.2, 0.0))

    @pytest.mark.parametrize("normal", [(0, 0, 1), (1, 0, 0), (1, 1, -1)])
    def test_the_same_from_everywhere(self, normal):
        counted, error = Patch((0.05, 0, 0), normal, 0.3).count(self.emitter(), N_PHOTON, 4, 1.0)
        assert error[0] < 0.02 * counted[0]
        assert abs(counted[0] - math.pi * 0.5) < LIMIT * error[0]

    def test_rays_start_on_the_box_and_enter_it(self):
        emitter = self.emitter()
        assert isinstance(emitter, WorldEmitter)
        births = emitter.emit(numbers(10_000))
        inner = births.origin + 1e-3 * births.direction
        assert ((inner > emitter.cover.low) & (inner < emitter.cover.high)).all(axis=1).mean() > 0.98


def test_a_scene_without_light_says_so():
    with pytest.raises(ValueError, match=NO_LIGHT):
        build(lit_scene(lights=[Light("POINT", "Off")]))


@pytest.mark.parametrize(
    ("light", "phrase"),
    [
        (Light("POINT", "Bulb", power_rgb=(-1, 0, 0)), "negative, so the light is left out"),
        (Light("SUN", "Bulb", power_rgb=(math.nan, 1, 1)), "not a finite number"),
        (Light("AREA", "Bulb", power_rgb=(math.inf, 1, 1)), "not a finite number"),
        (Light("SPOT", "Bulb", power_rgb=(1, 1, 1), position_m=(math.nan, 0, 0)), "position or size"),
        (Light("AREA", "Bulb", power_rgb=(1, 1, 1), size_m=(math.inf, 1)), "position or size"),
    ],
)
def test_unusable_lights_are_left_out_with_a_sentence(light, phrase):
    (emitters, warnings), _ = build(replace(lamp_scene(), lights=(light,)))
    assert [emitter.name for emitter in emitters] == ["Lamp"]
    ((subject, sentence),) = warnings
    assert subject == "Bulb"
    assert sentence.startswith("Bulb: ")
    assert phrase in sentence


def test_a_negative_channel_counts_as_zero():
    power, sentence = usable_power(Light("POINT", "Bulb", power_rgb=(1, -2, 3)))
    assert power.tolist() == [1, 0, 3]
    assert "negative channels" in sentence


def test_a_bad_world_counts_as_zero_where_it_is_bad():
    (emitters, warnings), _ = build(replace(lamp_scene(), world_rgb=(math.nan, -1.0, 2.0)))
    assert (emitters[-1].power_rgb > 0).tolist() == [False, False, True]
    assert warnings[0][0] == "World"


def test_emission_that_is_no_light():
    """Triangles without area, unused materials and bad numbers emit nothing, and nothing breaks."""
    scene = lamp_scene()
    bad = (*scene.materials, Material("Unused", emission_rgb=(1.0, 1.0, 1.0)))
    flat = scene.vertex_position.copy()
    flat[scene.tri_vertex[-1]] = flat[scene.tri_vertex[-1, 0]]
    (emitters, _), _ = build(replace(scene, materials=bad, vertex_position=flat, lights=(Light("POINT", "P", power_rgb=(1, 1, 1)),)))
    assert all(np.isfinite(emitter.power_rgb).all() for emitter in emitters)
    for index, rgb in enumerate([(math.nan, 0, 0), (-1, -1, -1)]):
        materials = (scene.materials[0], Material(f"Bad {index}", emission_rgb=rgb))
        with pytest.raises(ValueError, match=NO_LIGHT):
            build(replace(scene, materials=materials))


def test_a_picture_finer_than_the_cells_loses_nothing():
    pixels = np.zeros((256, 256, 3), np.float32)
    pixels[77, 133] = 1000  # one texel of 65,536, of a triangle with 64 x 64 cells
    (emitters, _), _ = build(textured_scene(pixels))
    assert isinstance(emitters[0], MeshEmitter)
    births = emitters[0].emit(numbers(seed=7))
    flux = births.relative_rgb.astype(float) * emitters[0].power_rgb
    truth = 2 * math.pi * 2 * 2 * 1000 / 65536
    assert np.isfinite(flux).all()
    assert abs(flux[:, 0].mean() - truth) < LIMIT * flux[:, 0].std() / math.sqrt(N_PHOTON)


# Cells of textured emitters: small where the texture is uneven.
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


# Light of many emitting triangles: the same as from each by itself, with honest errors.
FLOOR_SIDE = 32
TEXELS = np.arange(FLOOR_SIDE * FLOOR_SIDE)
ENOUGH = 1e9  # a tolerance that the first 16 rays meet


def light_floor(scene: DirectScene, seed: int = 1, texels: np.ndarray = TEXELS, **options: float) -> direct.DirectLight:
    return direct_irradiance(scene, floor_footprints(FLOOR_SIDE), texels, np.random.default_rng(seed), **options)


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
    found = np.mean([to_grid(light_floor(pooled, seed).irradiance_rgb[:, 0], FLOOR_SIDE) for seed in range(8)], axis=0)
    expected = to_grid(light_floor(alone).irradiance_rgb[:, 0], FLOOR_SIDE)
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
    grid = to_grid(light_floor(scene).irradiance_rgb[:, 0], FLOOR_SIDE)
    assert grid.max() < 1.3 * math.pi
    # Below its middle; the closed form of a square, of all 16 texels.
    centre = (np.stack(np.meshgrid(np.arange(14, 18), np.arange(14, 18)), axis=-1).reshape(-1, 2) + 0.5) / FLOOR_SIDE
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
    found = to_grid(light_floor(prepared).irradiance_rgb, FLOOR_SIDE)
    # The bright texel is 0.125 m wide: nearly a small patch of 64 W/m^2/sr at (0.8125, 0.1875, 0.3).
    place = (np.arange(FLOOR_SIDE) + 0.5) / FLOOR_SIDE
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
    found = to_grid(light_floor(scene, tolerance=0.005).irradiance_rgb[:, 0], FLOOR_SIDE)
    # A sphere of radiance 1 gives pi sin^2 cos, here in full view of the floor.
    place = (np.arange(FLOOR_SIDE) + 0.5) / FLOOR_SIDE
    expected = np.zeros((FLOOR_SIDE, FLOOR_SIDE))
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
