"""Emitting meshes and the world: powers, statistics of births, and what is left out with a sentence."""

import math
from dataclasses import replace

import numpy as np
import pytest
from floors import Patch, chi_square_sigmas, lit_scene, sigma_limit
from leaflight.core.lights.emitters import NO_LIGHT, EmittingMeshes, MeshEmitter, WorldEmitter, build_emitters, usable_power
from leaflight.core.lights.irradiance import polygon_irradiance
from leaflight.core.scene.materials import SurfaceMaterials
from leaflight.core.scene.scene import Light, Material, SceneSnapshot, TextureImage
from leaflight.core.util.geometry import UnitBox
from scenes import box_mesh, make_scene, moved, quad_mesh

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
