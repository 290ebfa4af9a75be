"""Scenes at the edge of what can be baked: never NaN or Inf in a page, the energy audit closed, truth within the stated error.

In a closed room of albedo rho all of a lamp's watts are absorbed: mean irradiance is watts / (area * (1 - rho)). Warnings of numpy
count as errors. The statistical tests of this file share floors.ALPHA.
"""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import safe_bakes
from boxes import room_mesh, solve_scene
from closed_forms import from_point
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from known_light import bake_known, mean_over_texels
from leaflight.core.radiosity import tally
from leaflight.core.scene.materials import clamp_warnings
from leaflight.core.scene.scene import MAX_ALBEDO, Light, Material
from leaflight.core.texels.texel_footprint import centred_strata
from leaflight.core.texels.texel_map import FOOTPRINT_SIDE
from leaflight.core.transport import traced_scene
from leaflight.core.util.settings import BASES, DIRECT_MODES, Settings
from odd_meshes import COINCIDENT, FURNITURE
from safe_bakes import Z_LIMIT
from scenes import Mesh, box_mesh, grid_mesh, make_scene, moved, quad_mesh
from stats import PLANTED_BIAS

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")
RHO, POWER_W = 0.5, 12.0
GREY = Material("Grey", (RHO,) * 3)
# Photons bring what is reflected in either mode; that they bring all of it is left to the slow tests.
MODES = [pytest.param(direct, marks=[pytest.mark.slow] if direct == "photons" else []) for direct in DIRECT_MODES]
TRUTH = POWER_W / 6 / (1 - RHO)  # in a cube of 1 m
LAMP = Light("POINT", "Lamp", (0.1, 0.05, 0.2), power_rgb=(POWER_W,) * 3)
FEW_EXAMPLES = settings(
    max_examples=6, deadline=None, derandomize=True, database=None, phases=[Phase.generate], suppress_health_check=list(HealthCheck)
)


@pytest.fixture
def bake_safely(hold, request):
    return partial(safe_bakes.bake_safely, partial(hold, case=request.node.name))


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


def test_a_planted_bias_is_rejected(tmp_path, bake_safely):
    baked = bake_safely(tmp_path, closed_room())
    assert baked.off_by(TRUTH)[0] < Z_LIMIT < baked.off_by(TRUTH / PLANTED_BIAS)[0]


class TestSizeAndPlace:
    @pytest.mark.parametrize("direct", MODES)
    @pytest.mark.parametrize("scale", [1e-12, 1e12])
    def test_a_scene_of_atoms_and_one_of_planets(self, tmp_path, direct, scale, bake_safely):
        """Light as in a room takes 10^-23 and 10^25 W there, whose squares float32 has no room for."""
        baked = bake_safely(tmp_path, rescaled(closed_room(), scale, 0.0), direct)
        baked.hold_mean(TRUTH)
        usual = bake_safely(tmp_path / "usual", closed_room(), direct)
        np.testing.assert_allclose(baked.light.error, usual.light.error, rtol=0.1)

    @pytest.mark.parametrize("direct", MODES)
    @FEW_EXAMPLES
    @given(exponent=st.floats(-4, 5), offset_m=st.sampled_from([0.0, 1e6, -1e6]))
    def test_any_size_anywhere(self, tmp_path_factory, direct, exponent, offset_m, bake_safely):
        """Metres of a scene 0.1 mm wide, 1,000 km from the origin, have 6 digits left."""
        scene = rescaled(closed_room(), 10.0**exponent, np.full(3, offset_m))
        bake_safely(tmp_path_factory.mktemp("moved"), scene, direct).hold_mean(TRUTH)

    @pytest.mark.parametrize("direct", MODES)
    @pytest.mark.parametrize("scale", [1e-4, 1e5])
    def test_the_ends_of_both(self, tmp_path, direct, scale, bake_safely):
        """Which chance need not find."""
        bake_safely(tmp_path, rescaled(closed_room(), scale, np.full(3, 1e6)), direct).hold_mean(TRUTH)


class TestMeshes:
    @pytest.mark.parametrize("direct", MODES)
    @pytest.mark.parametrize("name", FURNITURE)
    def test_odd_furniture(self, tmp_path, name, direct, bake_safely):
        baked = bake_safely(tmp_path, furnished(*FURNITURE[name]), direct)
        assert 0.2 * TRUTH < baked.mean[0] < 2 * TRUTH

    @pytest.mark.parametrize("name", [name for name in FURNITURE if name not in COINCIDENT])
    def test_both_ways_to_direct_light_agree(self, tmp_path, name, bake_safely):
        one, other = (bake_safely(tmp_path / direct, furnished(*FURNITURE[name]), direct, max_photons=60_000) for direct in DIRECT_MODES)
        error = np.hypot(one.stderr, other.stderr)
        assert np.abs(one.mean - other.mean).max() < Z_LIMIT * error.max() + 3e-3 * TRUTH

    @pytest.mark.parametrize("basis", [pytest.param(basis, marks=[pytest.mark.slow] * (basis != "linear")) for basis in BASES])
    @FEW_EXAMPLES
    @given(corner=st.lists(st.tuples(*[st.integers(-2, 2)] * 3), min_size=6, max_size=45))
    def test_soup_of_triangles_on_a_lattice(self, tmp_path_factory, basis, corner, bake_safely):
        """Corners coincide, faces touch, cross, overlap and vanish."""
        count = len(corner) // 3
        soup = Mesh("Soup", np.array(corner) * 0.2, np.arange(3 * count).reshape(-1, 3).tolist())
        bake_safely(tmp_path_factory.mktemp("soup"), furnished(soup), basis=basis, max_photons=5_000, size=64, error=0.1)

    @pytest.mark.parametrize("direct", MODES)
    def test_a_room_turned_inside_out_is_dark(self, tmp_path, direct, bake_safely):
        baked = bake_safely(tmp_path, make_scene([box_mesh("Room")], [LAMP], [GREY]), direct)
        assert not baked.pages["lighting"].any()
        assert baked.light.ledger.audit_w()["escaped"] == [0.0] * 3

    def test_many_faces_without_area(self, tmp_path, bake_safely):
        """20,000 of them in one object with good ones, which have the light that they have alone."""
        line = np.linspace(-0.4, 0.4, 1000)
        corner = np.random.default_rng(5).integers(0, 1000, (20_000, 3)).tolist()
        good = moved(grid_mesh("Good", 4), (-0.3, -0.3, -0.2), 0.1)
        flat = Mesh(
            "Flat", np.concatenate([np.tile(line[:, None], 3), good.vertex]), [*corner, *[[k + 1000 for k in f] for f in good.polygons]]
        )
        baked, alone = bake_safely(tmp_path / "flat", furnished(flat)), bake_safely(tmp_path / "alone", furnished(good))
        assert baked.mean == pytest.approx(alone.mean, rel=1e-3)
        assert 0.5 * TRUTH < baked.mean[0] < 1.5 * TRUTH

    @pytest.mark.parametrize("direct", MODES)
    def test_faces_that_look_either_way(self, tmp_path, direct, bake_safely):
        """Every other face of a sheet is turned over; light bounces off both sides alike, so the audit does not see it."""
        sheet = moved(grid_mesh("Sheet", 6, noise=0.2), (-0.3, -0.3, -0.2), 0.1)
        turned = replace(sheet, polygons=[f[::-1] if k % 2 else f for k, f in enumerate(sheet.polygons)])
        one, other = (bake_safely(tmp_path / mesh.name, furnished(mesh), direct) for mesh in (sheet, replace(turned, name="Turned")))
        assert one.light.ledger.audit_w()["absorbed"] == pytest.approx([POWER_W] * 3)
        assert other.light.ledger.audit_w()["absorbed"] == pytest.approx([POWER_W] * 3)

    @pytest.mark.parametrize("direct", MODES)
    @FEW_EXAMPLES
    @given(seed=st.integers(0, 2**32 - 1), share=st.floats(0, 1))
    def test_normals_that_have_nothing_to_do_with_their_faces(self, tmp_path_factory, direct, seed, share, bake_safely):
        """Of length 1, of any length, 0 and against the face."""
        scene, rng = furnished(box_mesh("Block", (0.3, 0.3, 0.3))), np.random.default_rng(seed)
        wild = rng.normal(size=scene.tri_normal.shape) * 10.0 ** rng.uniform(-3, 3, (*scene.tri_normal.shape[:2], 1))
        wild[rng.random(wild.shape[:2]) < 0.2] = 0.0
        normal = np.where(rng.random((*wild.shape[:2], 1)) < share, wild, scene.tri_normal).astype(np.float32)
        bake_safely(tmp_path_factory.mktemp("normals"), replace(scene, tri_normal=normal), direct, error=0.1)

    def test_one_wall_turned_over(self, tmp_path, bake_safely):
        """Its light bounces on all the same: the other five have what they had."""
        room = room_mesh()
        turned = make_scene(
            [replace(room, polygons=[room.polygons[0][::-1], *room.polygons[1:]])], [replace(LAMP, position_m=(0, 0, 0))], [GREY]
        )
        assert bake_safely(tmp_path, turned).mean == pytest.approx(TRUTH * 5 / 6, rel=0.02)


class TestLights:
    @pytest.mark.parametrize("direct", MODES)
    @pytest.mark.parametrize("gap_m", [0.0, 1e-7, 1e-3])
    @pytest.mark.parametrize("radius_m", [0.0, 0.05])
    def test_touching_a_wall(self, tmp_path, direct, gap_m, radius_m, bake_safely):
        lamp = replace(LAMP, position_m=(0.5 - gap_m, 0.1, 0.0), radius_m=radius_m)
        bake_safely(tmp_path, closed_room([lamp]), direct)

    @pytest.mark.parametrize(("direct", "gap_m"), [("photons", 0.004), ("rays", 0.12)])
    def test_close_to_a_wall_no_watt_is_lost(self, tmp_path, direct, gap_m, bake_safely):
        """Photons count also what falls on a thirtieth of a texel; rays tell of light as large as a texel, for they look at its middle."""
        baked = bake_safely(tmp_path, closed_room([replace(LAMP, position_m=(0.5 - gap_m, 0.1, 0.0))]), direct)
        baked.hold_mean(TRUTH, percent=20)

    @pytest.mark.parametrize("gap_m", [0.004, *(pytest.param(gap_m, marks=pytest.mark.slow) for gap_m in (0.008, 0.016)), 0.06])
    def test_close_to_a_wall_rays_find_what_falls_where_they_look(self, tmp_path, gap_m, hold):
        """From a thirtieth of a texel on: within the stated error of all texels together, and not only because that is large."""
        place = (0.5 - gap_m, 0.113, 0.021)
        scene = closed_room([replace(LAMP, position_m=place)], Material("Black", (0.0,) * 3))

        def irradiance(position, normal):
            return POWER_W / (4 * np.pi) * from_point(np.array(place), position, normal)

        known = bake_known(tmp_path, scene, irradiance, "rays", padding=1, error=0.02)
        truth = mean_over_texels(scene, known.texels, irradiance, FOOTPRINT_SIDE, centred_strata(48 * 48))
        area, direct = known.texels.texel_area, known.light.direct
        off = (direct.irradiance[:, 0] - truth) @ area
        noise = np.linalg.norm(np.sqrt(direct.variance[:, 0]) * area)
        hold("odd scenes: rays off what falls where they look", abs(off) / noise, high=Z_LIMIT, unit="stated errors")
        hold("odd scenes: rays off what falls where they look, up to 20 %", 100 * abs(off) / (truth @ area), high=20, unit="%")

    @pytest.mark.parametrize("direct", MODES)
    def test_inside_a_mesh_nothing_comes_out(self, tmp_path, direct, bake_safely):
        baked = bake_safely(
            tmp_path, furnished(box_mesh("Block", (0.3, 0.3, 0.3)), lights=[replace(LAMP, position_m=(0.02, 0, 0))]), direct
        )
        assert not baked.pages["lighting"].any()

    @pytest.mark.parametrize("direct", MODES)
    @pytest.mark.parametrize("gap_m", [0.0, 1e-4])
    def test_an_emitter_under_the_ceiling(self, tmp_path, direct, gap_m, bake_safely):
        """All it emits, on both sides, is absorbed in the end; in the ceiling's own plane, half of it comes into the room."""
        scene = furnished(moved(quad_mesh("Panel", 0.2, 0.2), (-0.1, -0.1, 0.5 - gap_m)), lights=())
        panel = scene.tri_object == 1
        scene = replace(scene, tri_material=panel.astype(np.int32), materials=(GREY, replace(GREY, emission_rgb=(5.0,) * 3)))
        baked, baked_area = bake_safely(tmp_path, scene, direct), 6.04
        expected = 2 * np.pi * 5.0 * 0.04 / baked_area / (1 - RHO)  # the mean is over the panel too, as dark behind as before it is bright
        if gap_m:
            assert 0.9 < baked.mean[0] / expected < 1.05
        else:
            baked.hold_mean(0.5 * expected, percent=5)  # 20,000 photons vary by 1 %

    @pytest.mark.parametrize("direct", MODES)
    def test_from_a_microwatt_to_a_megawatt(self, tmp_path, direct, bake_safely):
        powers = 10.0 ** np.arange(-6, 7)
        place = np.random.default_rng(3).uniform(-0.4, 0.4, (len(powers), 3))
        lamps = [Light("POINT", str(p), tuple(at), power_rgb=(p, p, p)) for p, at in zip(powers, place, strict=True)]
        bake_safely(tmp_path, closed_room(lamps), direct).hold_mean(powers.sum() / 6 / (1 - RHO))

    def test_a_microwatt_next_door_to_a_megawatt(self, tmp_path, hold, bake_safely):
        """Its direct light by rays; no photon in 10^12 is its own."""
        watts = np.array([1e6, 1e-6])
        lamps = [replace(LAMP, position_m=(3.0 * k + 0.1, 0.05, 0.2), power_rgb=(w,) * 3) for k, w in enumerate(watts)]
        scene = make_scene([room_mesh("Bright"), moved(room_mesh("Dim"), (3.0, 0, 0))], lamps, [GREY])
        baked = bake_safely(tmp_path, scene, size=64)
        texels = traced_scene.open_tracing(str(tmp_path)).texels
        room, area = scene.tri_object[texels.texel_tri], texels.texel_area
        found = np.bincount(room, area * baked.light.direct.irradiance[:, 0]) / np.bincount(room, area)
        off = np.abs(found / (watts / 6) - 1).max()
        hold("odd scenes: direct light of a microwatt next door to a megawatt off", 100 * off, high=0.5, unit="%")

    @pytest.mark.parametrize("direct", MODES)
    def test_a_closed_room_in_the_light_outside_is_dark(self, tmp_path, direct, bake_safely):
        lights = [Light("SUN", "Sun", power_rgb=(9.0,) * 3), replace(LAMP, position_m=(0.0, 0.7, 0.0))]
        scene = replace(closed_room(lights), world_rgb=(3.0, 2.0, 1.0))
        baked = bake_safely(tmp_path, scene, direct)
        assert baked.light.photons
        for name in ("direct", "indirect"):
            assert not baked.pages[name].any()

    @pytest.mark.parametrize("direct", MODES)
    def test_red_light_on_green_walls(self, tmp_path, direct, bake_safely):
        red = replace(LAMP, power_rgb=(POWER_W, 0.0, 0.0))
        baked = bake_safely(tmp_path, closed_room([red], Material("Green", (0.0, 0.9, 0.0))), direct)
        baked.hold_mean(np.array([POWER_W / 6, 0, 0]))
        assert not baked.pages["indirect"].any()
        assert not baked.pages["diffuse"].any()


class TestSurfaces:
    @pytest.mark.parametrize("direct", MODES)
    def test_black(self, tmp_path, direct, bake_safely):
        baked = bake_safely(tmp_path, closed_room(material=Material("Black", (0.0,) * 3)), direct)
        baked.hold_mean(POWER_W / 6)
        assert not baked.pages["indirect"].any()

    @pytest.mark.parametrize("rho", [0.999, 1.5])
    def test_whiter_than_white_ends(self, tmp_path, rho, bake_safely):
        """A photon that is still under way after max_depth surfaces is put down as the remainder."""
        depth = 300
        scene = closed_room(material=Material("White", (rho,) * 3))
        baked = bake_safely(tmp_path, scene, max_photons=4_000, max_depth=depth)
        assert bool(clamp_warnings(scene)) == (rho > MAX_ALBEDO)
        audit = baked.light.ledger.audit_w()
        assert audit["remainder"][0] / audit["emitted"][0] == pytest.approx(MAX_ALBEDO**depth, rel=0.05)
        assert baked.mean == pytest.approx(POWER_W / 6 * (1 - MAX_ALBEDO**depth) / (1 - MAX_ALBEDO), rel=0.05)
        assert baked.pages["albedo"].max() <= np.float32(MAX_ALBEDO)

    def test_charts_smaller_than_a_texel(self, tmp_path, bake_safely):
        crumbs = [moved(quad_mesh(f"Crumb {i}", 1e-4, 1e-4), (i / 40 - 0.4, 0.1, -0.3)) for i in range(30)]
        assert bake_safely(tmp_path, furnished(*crumbs), size=64).mean[0] == pytest.approx(TRUTH, rel=0.02)


def islands(per_side):
    """Square islands of 0.8 by 0.8 of a cell each, on a layer that is the unit square."""
    low = np.stack(np.meshgrid(*[np.arange(per_side)] * 2), axis=-1).reshape(-1, 1, 2)
    corner = (low + 0.1 + 0.8 * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])) / per_side
    vertex = np.pad(corner.reshape(-1, 2), ((0, 0), (0, 1)))
    return Mesh("Tiles", vertex, np.arange(len(vertex)).reshape(-1, 4).tolist(), list(corner))


SUN = Light("SUN", "Sun", power_rgb=(2.0,) * 3)


class TestPages:
    @pytest.mark.parametrize("direct", MODES)
    @pytest.mark.parametrize("per_side", [8, 16, 40])
    def test_charts_of_a_texel_and_less(self, tmp_path, per_side, direct, bake_safely):
        """A layer of islands on a page of 16 x 16 texels: 4 texels, 1 texel, or 6 islands in a texel."""
        scene = make_scene([islands(per_side)], [SUN], [GREY])
        bake_safely(tmp_path, scene, direct, size=16, max_photons=60_000).hold_mean(2.0)

    @pytest.mark.parametrize("direct", MODES)
    @pytest.mark.parametrize("size", [4, 5, 7])
    def test_the_smallest_pages(self, tmp_path, size, direct, bake_safely):
        """Whose sides are no powers of two; one chart of 3 by 5, texels where the page has 7."""
        uv = np.array([[0, 0], [3, 0], [3, 5], [0, 5]]) / 7
        scene = make_scene([quad_mesh("Small", 0.3, 0.5, uv)], [SUN], [GREY])
        bake_safely(tmp_path, scene, direct, size=size, max_photons=60_000).hold_mean(2.0)

    @pytest.mark.slow
    @pytest.mark.parametrize("direct", MODES)
    def test_a_hundred_thousand_charts_of_one_texel(self, tmp_path, direct, bake_safely):
        scene = make_scene([islands(317)], [SUN], [GREY])
        bake_safely(tmp_path, scene, direct, size=317, max_photons=200_000).hold_mean(2.0)

    @pytest.mark.slow
    def test_a_page_of_16k_with_its_chart_in_the_far_corner(self, tmp_path, hold):
        """All but the images, which would take gigabytes each."""
        uv = 1 - np.array([[8, 8], [0, 8], [0, 0], [8, 0]]) / 2**14
        scene = make_scene([quad_mesh("Far", uv=uv)], [SUN], [GREY])
        light = solve_scene(tmp_path, scene, Settings(size=2**14, max_photons=2_000))
        texels = traced_scene.open_tracing(str(tmp_path)).texels
        assert texels.texel_xy.min() == 2**14 - 8
        assert texels.texel_xy.max() == 2**14 - 1
        hold("odd scenes: light of a chart in the corner of a 16k page off", np.abs(light.direct.irradiance / 2.0 - 1).max(), high=1e-5)


@pytest.mark.parametrize("direct", MODES)
def test_counters_of_very_many_photons(tmp_path, direct, bake_safely):
    """As if the first round had been traced again and again."""
    solvers, photons = [], 10**11

    def repeat_first_round(solver):
        solvers.append(solver)
        solver._trace_round(None)
        factor = photons // solver.ledger.photons
        for sums in (solver.tally.photons, solver.tally.count, solver.tally.weight2, solver.tally.raw, *solver.ledger.energy_w.values()):
            sums *= factor
        solver.ledger.photons *= factor

    knobs = {"max_photons": photons + 100_000, "error": 1e-4, "size": 16}
    baked = bake_safely(tmp_path, closed_room(), direct, repeat_first_round, **knobs)
    assert baked.light.photons == pytest.approx(photons, rel=1e-3)
    assert baked.light.received.max() > photons / 10
    assert baked.mean == pytest.approx(TRUTH, rel=0.01)
    (solver,) = solvers
    counted = tally.solve_tallies(solver.tree, tally.accumulate(solver.tree, solver.tally))  # the bake knows that the rounds are one
    roots = solver.tree.parent < 0  # which have seen them all
    noise_w2 = (counted.variance * solver.tree.area**2)[:, roots].sum(axis=1)
    off = np.sqrt(noise_w2 * photons) / counted.flux[:, roots].sum(axis=1)
    assert np.abs(off - 0.9).max() < 0.3  # 1 where every photon comes down once, the root of a half where twice
