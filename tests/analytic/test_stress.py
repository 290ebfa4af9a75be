"""Scenes at the edge of what can be baked: never NaN or Inf in a page, the energy audit closed, truth within the stated error.

In a closed room of albedo rho all of a lamp's watts are absorbed: mean irradiance is watts / (area * (1 - rho)). Warnings of numpy
count as errors. The statistical tests of this file share floors.ALPHA.
"""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from boxes import lamp_scene, make_solver, room_mesh
from floors import sigma_limit
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from leaflight.core import charts, resolve, workers
from leaflight.core.debug_passes import DebugPages
from leaflight.core.scene import MAX_ALBEDO, Light, Material, SceneSnapshot
from leaflight.core.settings import BASES, DEBUG_PASSES, DIRECT_MODES, PASSES, Settings
from leaflight.core.solve import LightField
from odd_meshes import COINCIDENT, FURNITURE
from scenes import Mesh, box_mesh, make_scene, moved, quad_mesh
from stats import PLANTED_BIAS

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")
RHO, POWER_W = 0.5, 12.0
GREY = Material("Grey", (RHO,) * 3)
TRUTH = POWER_W / 6 / (1 - RHO)  # in a cube of 1 m
LAMP = Light("POINT", "Lamp", (0.1, 0.05, 0.2), power_rgb=(POWER_W,) * 3)
N_TEST = 60  # comparisons of means, at most
FEW_EXAMPLES = settings(
    max_examples=6, deadline=None, derandomize=True, database=None, phases=[Phase.generate], suppress_health_check=list(HealthCheck)
)


@dataclass(frozen=True)
class Baked:
    """A bake that has passed the checks.

    pages         pass -> (page_count, size, size, 3) float32
    mean, stderr  (3,) float64, W/m^2: over all texels by area
    """

    light: LightField
    pages: dict[str, np.ndarray]
    mean: np.ndarray
    stderr: np.ndarray


def bake_safely(folder, scene: SceneSnapshot, direct="rays", prepare=lambda solver: None, **knobs) -> Baked:
    chosen = Settings(**{"size": 32, "padding": 1, "error": 0.02, "max_photons": 20_000, "direct": direct, "workers": 1, **knobs})
    workers.forget_folders()
    solver = make_solver(folder, scene, chosen)
    prepare(solver)
    light = solver.run(lambda message: None, lambda: False)
    atlas, texels = charts.make_charts(scene, chosen), solver.tracing.texels
    entry_page = atlas.chart_page[texels.texel_chart]
    at_texels = resolve.light_at_texels(light, solver.blender)
    resolver = resolve.Resolver(at_texels, texels, solver.tracing.scene.surfaces, entry_page, margin=4)
    debug = DebugPages(light, texels, entry_page, margin=4)
    drawers = {name: debug if name in DEBUG_PASSES else resolver for name in PASSES}
    pages = {name: np.stack([drawers[name].page(name, page)[..., :3] for page in range(atlas.page_count)]) for name in PASSES}
    for name in DEBUG_PASSES:
        look = debug.look(name, 0, lambda: resolver.page("combined", 0))
        assert ((look >= 0) & (look <= 1)).all(), name
    for name, pixels in pages.items():
        assert np.isfinite(pixels).all(), name
        assert pixels.min() >= 0, name
    assert np.isfinite(light.error)
    audit = {name: np.array(value) for name, value in light.ledger.audit_w(light.photons).items()}
    assert audit["absorbed"] + audit["escaped"] + audit["remainder"] == pytest.approx(audit["emitted"], rel=1e-9, abs=1e-30)
    total = texels.texel_area.sum()
    by_rays = (light.direct.irradiance * texels.texel_area[:, None]).sum(0, dtype=float)
    ray_noise = (light.direct.variance * texels.texel_area[:, None] ** 2).sum(0, dtype=float)
    area = light.tree.area[light.leaves]
    noise = (light.solution.variance[:, light.leaves] * area**2).sum(1) * light.correction + ray_noise
    mean = (light.solution.flux[:, light.leaves].sum(1) + by_rays) / total
    return Baked(light, pages, mean, np.sqrt(noise) / total)


def assert_mean(baked, truth=TRUTH, rel=0.02):
    """Within its stated error, and not only because that is large."""
    assert np.abs(baked.mean - truth).max() < sigma_limit(N_TEST) * baked.stderr.max() + 2e-3 * np.max(truth)
    assert baked.mean == pytest.approx(truth, rel=rel)


def test_a_planted_bias_is_rejected(tmp_path):
    with pytest.raises(AssertionError):
        assert_mean(bake_safely(tmp_path, closed_room()), TRUTH * PLANTED_BIAS)


def closed_room(lights=(LAMP,), material=GREY):
    return make_scene([room_mesh()], lights, [material])


def furnished(*meshes, lights=(LAMP,)):
    return make_scene([room_mesh(), *meshes], lights, [GREY])


def rescaled(scene, scale, offset_m):
    lights = tuple(
        replace(
            light,
            position_m=tuple(np.array(light.position_m) * scale + offset_m),
            power_rgb=tuple(np.array(light.power_rgb) * scale**2),
            radius_m=light.radius_m * scale,
        )
        for light in scene.lights
    )
    return replace(scene, vertex_position=scene.vertex_position * scale + offset_m, lights=lights)


class TestSizeAndPlace:
    @pytest.mark.parametrize("direct", DIRECT_MODES)
    @FEW_EXAMPLES
    @given(exponent=st.floats(-4, 5), offset_m=st.sampled_from([0.0, 1e6, -1e6]))
    def test_any_size_anywhere(self, tmp_path_factory, direct, exponent, offset_m):
        """Metres of a scene 0.1 mm wide, 1,000 km from the origin, have 6 digits left."""
        scene = rescaled(closed_room(), 10.0**exponent, np.full(3, offset_m))
        assert_mean(bake_safely(tmp_path_factory.mktemp("moved"), scene, direct))

    @pytest.mark.parametrize("scale", [1e-4, 1e5])
    def test_same_light_as_the_room_of_usual_size(self, tmp_path, scale):
        usual = bake_safely(tmp_path / "usual", lamp_scene())
        found = bake_safely(tmp_path / "found", rescaled(lamp_scene(), scale, np.array([1e6, -1e6, 1e6]) if scale > 1 else np.zeros(3)))
        assert found.mean == pytest.approx(usual.mean, rel=0.02)


class TestMeshes:
    @pytest.mark.parametrize("direct", DIRECT_MODES)
    @pytest.mark.parametrize("name", FURNITURE)
    def test_odd_furniture(self, tmp_path, name, direct):
        baked = bake_safely(tmp_path, furnished(*FURNITURE[name]), direct)
        assert 0.2 * TRUTH < baked.mean[0] < 2 * TRUTH

    @pytest.mark.parametrize("name", [name for name in FURNITURE if name not in COINCIDENT])
    def test_both_ways_to_direct_light_agree(self, tmp_path, name):
        one, other = (bake_safely(tmp_path / direct, furnished(*FURNITURE[name]), direct, max_photons=60_000) for direct in DIRECT_MODES)
        error = np.hypot(one.stderr, other.stderr)
        assert np.abs(one.mean - other.mean).max() < sigma_limit(N_TEST) * error.max() + 3e-3 * TRUTH

    @pytest.mark.parametrize("basis", BASES)
    @FEW_EXAMPLES
    @given(corner=st.lists(st.tuples(*[st.integers(-2, 2)] * 3), min_size=6, max_size=45))
    def test_soup_of_triangles_on_a_lattice(self, tmp_path_factory, basis, corner):
        """Corners coincide, faces touch, cross, overlap and vanish."""
        count = len(corner) // 3
        soup = Mesh("Soup", np.array(corner) * 0.2, np.arange(3 * count).reshape(-1, 3).tolist())
        bake_safely(tmp_path_factory.mktemp("soup"), furnished(soup), basis=basis, max_photons=5_000, size=64)

    @pytest.mark.parametrize("direct", DIRECT_MODES)
    def test_a_room_turned_inside_out_is_dark(self, tmp_path, direct):
        baked = bake_safely(tmp_path, make_scene([box_mesh("Room")], [LAMP], [GREY]), direct)
        assert not baked.pages["lighting"].any()
        assert baked.light.ledger.audit_w(baked.light.photons)["escaped"] == [0.0] * 3

    def test_one_wall_turned_over(self, tmp_path):
        """Its light bounces on all the same: the other five have what they had."""
        room = room_mesh()
        turned = make_scene(
            [replace(room, polygons=[room.polygons[0][::-1], *room.polygons[1:]])], [replace(LAMP, position_m=(0, 0, 0))], [GREY]
        )
        assert bake_safely(tmp_path, turned).mean == pytest.approx(TRUTH * 5 / 6, rel=0.02)


class TestLights:
    @pytest.mark.parametrize("direct", DIRECT_MODES)
    @pytest.mark.parametrize("gap_m", [0.0, 1e-7, 1e-3])
    @pytest.mark.parametrize("radius_m", [0.0, 0.05])
    def test_touching_a_wall(self, tmp_path, direct, gap_m, radius_m):
        lamp = replace(LAMP, position_m=(0.5 - gap_m, 0.1, 0.0), radius_m=radius_m)
        bake_safely(tmp_path, closed_room([lamp]), direct)

    @pytest.mark.parametrize(("direct", "gap_m"), [("photons", 0.004), ("rays", 0.12)])
    def test_close_to_a_wall_no_watt_is_lost(self, tmp_path, direct, gap_m):
        """Photons count also what falls on a thirtieth of a texel; rays tell of light as large as a texel, for they look at its middle."""
        assert_mean(bake_safely(tmp_path, closed_room([replace(LAMP, position_m=(0.5 - gap_m, 0.1, 0.0))]), direct), rel=0.2)

    @pytest.mark.parametrize("direct", DIRECT_MODES)
    def test_inside_a_mesh_nothing_comes_out(self, tmp_path, direct):
        baked = bake_safely(
            tmp_path, furnished(box_mesh("Block", (0.3, 0.3, 0.3)), lights=[replace(LAMP, position_m=(0.02, 0, 0))]), direct
        )
        assert not baked.pages["lighting"].any()

    @pytest.mark.parametrize("direct", DIRECT_MODES)
    @pytest.mark.parametrize("gap_m", [0.0, 1e-4])
    def test_an_emitter_under_the_ceiling(self, tmp_path, direct, gap_m):
        """All it emits, on both sides, is absorbed in the end; at most half of it by the emitter's own faces."""
        scene = furnished(moved(quad_mesh("Panel", 0.2, 0.2), (-0.1, -0.1, 0.5 - gap_m)), lights=())
        panel = scene.tri_object == 1
        scene = replace(scene, tri_material=panel.astype(np.int32), materials=(GREY, replace(GREY, emission_rgb=(5.0,) * 3)))
        baked = bake_safely(tmp_path, scene, direct)
        assert 0.5 < baked.mean[0] / (2 * np.pi * 5.0 * 0.04 / 6 / (1 - RHO)) < 1.05

    @pytest.mark.parametrize("direct", DIRECT_MODES)
    def test_from_a_microwatt_to_a_megawatt(self, tmp_path, direct):
        powers = 10.0 ** np.arange(-6, 7)
        place = np.random.default_rng(3).uniform(-0.4, 0.4, (len(powers), 3))
        lamps = [Light("POINT", str(p), tuple(at), power_rgb=(p, p, p)) for p, at in zip(powers, place, strict=True)]
        assert_mean(bake_safely(tmp_path, closed_room(lamps), direct), powers.sum() / 6 / (1 - RHO))

    @pytest.mark.parametrize("direct", DIRECT_MODES)
    def test_a_closed_room_in_the_light_outside_is_dark(self, tmp_path, direct):
        lights = [Light("SUN", "Sun", power_rgb=(9.0,) * 3), replace(LAMP, position_m=(0.0, 0.7, 0.0))]
        scene = replace(closed_room(lights), world_rgb=(3.0, 2.0, 1.0))
        baked = bake_safely(tmp_path, scene, direct)
        assert baked.light.photons
        for name in ("direct", "indirect"):
            assert not baked.pages[name].any()

    @pytest.mark.parametrize("direct", DIRECT_MODES)
    def test_red_light_on_green_walls(self, tmp_path, direct):
        red = replace(LAMP, power_rgb=(POWER_W, 0.0, 0.0))
        baked = bake_safely(tmp_path, closed_room([red], Material("Green", (0.0, 0.9, 0.0))), direct)
        assert_mean(baked, np.array([POWER_W / 6, 0, 0]))
        assert not baked.pages["indirect"].any()
        assert not baked.pages["diffuse"].any()


class TestSurfaces:
    @pytest.mark.parametrize("direct", DIRECT_MODES)
    def test_black(self, tmp_path, direct):
        baked = bake_safely(tmp_path, closed_room(material=Material("Black", (0.0,) * 3)), direct)
        assert_mean(baked, POWER_W / 6)
        assert not baked.pages["indirect"].any()

    @pytest.mark.parametrize("rho", [0.999, 1.5])
    def test_whiter_than_white_ends(self, tmp_path, rho):
        """A photon that is still under way after max_depth surfaces is put down as the remainder."""
        depth = 300
        baked = bake_safely(tmp_path, closed_room(material=Material("White", (rho,) * 3)), max_photons=4_000, max_depth=depth)
        audit = baked.light.ledger.audit_w(baked.light.photons)
        assert audit["remainder"][0] / audit["emitted"][0] == pytest.approx(MAX_ALBEDO**depth, rel=0.05)
        assert baked.mean == pytest.approx(POWER_W / 6 * (1 - MAX_ALBEDO**depth) / (1 - MAX_ALBEDO), rel=0.05)
        assert baked.pages["albedo"].max() <= np.float32(MAX_ALBEDO)

    def test_charts_smaller_than_a_texel(self, tmp_path):
        crumbs = [moved(quad_mesh(f"Crumb {i}", 1e-4, 1e-4), (i / 40 - 0.4, 0.1, -0.3)) for i in range(30)]
        assert bake_safely(tmp_path, furnished(*crumbs), size=64).mean[0] == pytest.approx(TRUTH, rel=0.02)

    @pytest.mark.parametrize("per_side", [8, 16, 40])
    def test_charts_of_a_texel_and_less(self, tmp_path, per_side):
        """A layer of islands on a page of 16 x 16 texels: 4 texels, 1 texel, or 6 islands in a texel."""
        low = np.stack(np.meshgrid(*[np.arange(per_side)] * 2), axis=-1).reshape(-1, 1, 2)
        corner = (low + 0.1 + 0.8 * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])) / per_side
        vertex = np.pad(corner.reshape(-1, 2), ((0, 0), (0, 1)))
        tiles = Mesh("Tiles", vertex, np.arange(len(vertex)).reshape(-1, 4).tolist(), list(corner))
        sun = Light("SUN", "Sun", power_rgb=(2.0,) * 3)
        for direct in DIRECT_MODES:
            baked = bake_safely(tmp_path / direct, make_scene([tiles], [sun], [GREY]), direct, size=16, max_photons=60_000)
            assert_mean(baked, 2.0)


@pytest.mark.parametrize("direct", DIRECT_MODES)
@pytest.mark.parametrize("photons", [10**9, 10**11])
def test_counters_of_very_many_photons(tmp_path, direct, photons):
    """As if the first round had been traced again and again."""

    def repeat_first_round(solver):
        solver._trace_round(200_000)
        factor = photons // int(solver.tally.photons.sum())
        for sums in (solver.tally.photons, solver.tally.count, solver.tally.weight2, solver.tally.raw, *solver.ledger.energy_w.values()):
            sums *= factor

    knobs = {"max_photons": photons + 100_000, "error": 1e-4}
    baked = bake_safely(tmp_path, closed_room(), direct, repeat_first_round, **knobs)
    assert baked.light.photons == pytest.approx(photons, rel=1e-3)
    assert baked.light.received.max() > photons / 10
    assert baked.mean == pytest.approx(TRUTH, rel=0.01)
