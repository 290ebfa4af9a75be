"""Light from surfaces to a floor: what rays meet and how bright it is, closed forms, and rays that are aimed at bright places."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from boxes import make_solver, prepare_folder, room_mesh
from floors import sigma_limit
from leaflight.core.bake import solve
from leaflight.core.integrate import gather, texel_shards
from leaflight.core.integrate.bright_places import Targets, find_bright
from leaflight.core.integrate.direct_field import DirectField
from leaflight.core.lights.direct_points import each_chunk
from leaflight.core.parallel import executors, folders, shared_arrays
from leaflight.core.radiosity.cell_tally import CellFlux, CellTally
from leaflight.core.scene.scene import Light, Material
from leaflight.core.scene.surface_cells import SurfaceCells
from leaflight.core.transport import traced_scene
from leaflight.core.transport.contact_map import cut_at_contacts, find_contacts
from leaflight.core.util.sampling import square_to_uniform_triangle
from leaflight.core.util.settings import Settings
from scenes import Mesh, box_mesh, make_scene, moved, quad_mesh

# Light from surfaces to a floor: what rays meet and how bright it is, closed forms, and what is told apart.
SETTINGS = Settings(even_out=False, size=64, padding=1)
LAMP = Light("POINT", "Lamp", (0.5, 0.5, 0.5), power_rgb=(1.0, 1.0, 1.0))
ROOM = moved(room_mesh(), (0.5, 0.5, 0.5))


def gather_all(folder, scene, light=2.0, on_sides=0.0, **knobs):
    """Light gathered at all texels of a scene whose lightmaps all have the same light, and so have sides without one; and the solver."""
    solver = make_solver(folder, scene, SETTINGS, begun=False)
    n_texel = len(solver.tracing.texels)
    every = np.full((3, n_texel), light, np.float32)
    return gather_known(solver, know(solver, every, np.full(n_texel, 0.5, np.float32), on_sides), **knobs), solver


def know(solver, light, doubt, on_sides=0.0, direct=None):
    n_cell = len(solver.tracing.cells)
    on_cells = np.zeros((2, 3, n_cell), np.float32)
    on_cells[0] = on_sides
    bright = find_bright(texel_shards.open_surfaces(str(solver.folder)), light, on_cells.sum(axis=0))
    return gather.KnownLight(
        light,
        np.zeros_like(light) if direct is None else direct,
        np.tile(doubt, (2, 1)),
        on_cells,
        np.zeros((2, 2, n_cell), np.float32),
        bright,
    )


def gather_known(solver, known, texel=None, n_ray=64, seed=1):
    texels = solver.tracing.texels
    texel = np.arange(len(texels.texel_chart)) if texel is None else texel
    scene, rng = texel_shards._open_gather_scene(str(solver.folder)), np.random.default_rng(seed)
    targets = Targets(known.bright, texel_shards.open_surfaces(str(solver.folder)))
    return gather.gather_light(scene, known, targets, texel, rng, n_ray)


def places_of(solver):
    """(n, 3) m: of all texels."""
    texels = solver.tracing.texels
    entry = np.arange(len(texels.texel_tri))
    return np.einsum("nk,nkj->nj", texels.bary_at(entry), solver.tracing.snapshot.tri_position[texels.texel_tri])


def test_a_closed_room_sends_its_albedo_times_its_light(tmp_path):
    found, _ = gather_all(tmp_path, make_scene([ROOM], [LAMP], [Material("Grey", (0.5, 0.25, 0.0))]))
    assert found.irradiance_rgb == pytest.approx(np.tile([1.0, 0.5, 0.0], (len(found.doubt), 1)), rel=1e-5)
    assert found.doubt == pytest.approx(0.25 * 0.5, rel=1e-5)
    assert found.variance_rgb.max() < 1e-9
    assert found.counters["rays"] == 64 * len(found.doubt)


def wall_scene():
    """A floor, and a wall along its side x = 0, as high and as long."""
    floor, wall = quad_mesh("Floor"), replace(quad_mesh("Wall"), vertex=quad_mesh().vertex[:, [2, 0, 1]])
    return make_scene([floor, wall], [LAMP], [Material("White", (1.0,) * 3)])


def test_a_wall_sends_by_its_form_factor_and_the_error_is_honest(tmp_path):
    found, solver = gather_all(tmp_path, wall_scene(), light=1.0)
    texels = solver.tracing.texels
    on_floor = texels.texel_tri < 2
    mean = found.irradiance_rgb[on_floor, 0].mean()
    # Source: Howell, "A Catalog of Radiation Heat Transfer Configuration Factors", C-14: squares with a common edge.
    sigma = np.sqrt(found.variance_rgb[on_floor, 0].sum()) / on_floor.sum()
    assert mean == pytest.approx(0.20004, abs=sigma_limit(1) * sigma + 1e-3)
    assert abs(mean * 1.03 - 0.20004) > sigma_limit(1) * sigma + 1e-3
    again, _ = gather_all(tmp_path / "2", wall_scene(), light=1.0, seed=2)
    gap = (found.irradiance_rgb - again.irradiance_rgb)[:, 0]
    expected = (found.variance_rgb + again.variance_rgb)[:, 0]
    assert 0.1 < (gap**2).sum() / expected.sum() < 1.0  # neighbouring strata tell more noise than all strata together leave


@pytest.mark.parametrize("on_sides", [0.0, 3.0])
def test_backs_send_the_light_of_their_cells(tmp_path, on_sides):
    """A box on the floor has its inside there, whose albedo is 0.8."""
    box = moved(box_mesh("Box", (0.5, 0.5, 0.5)), (0.5, 0.5, 0.25))
    found, solver = gather_all(tmp_path, make_scene([quad_mesh("Floor"), box], [LAMP]), on_sides=on_sides)
    texels, (x, y, _) = solver.tracing.texels, places_of(solver).T
    inside = (texels.texel_tri < 2) & (np.abs(x - 0.5) < 0.2) & (np.abs(y - 0.5) < 0.2)
    assert inside.sum() > 30
    assert found.irradiance_rgb[inside] == pytest.approx(solver.tracing.snapshot.materials[0].albedo_rgb[0] * on_sides, abs=0.05)


def coloured_room():
    """A room with a block in it, each of a colour of its own."""
    scene = make_scene([ROOM, moved(box_mesh("Block", (0.3, 0.2, 0.4)), (0.6, 0.5, 0.5))], [LAMP], [Material("A", (0.9, 0.6, 0.3))])
    return replace(scene, materials=(*scene.materials, Material("B", (0.2, 0.5, 0.8))), tri_material=scene.tri_object.copy())


def test_what_rays_meet_sends_its_own_light_of_each_channel_and_its_own_doubt(tmp_path, monkeypatch):
    """Against a thousand rays that each texel sends by chance; doubt may be of either sign."""
    monkeypatch.setattr(gather, "MOST_TEXELS", 1400)
    solver = make_solver(tmp_path, coloured_room(), SETTINGS, begun=False)
    tracing, texels, (x, y, z) = solver.tracing, solver.tracing.texels, places_of(solver).T
    light = np.float32([1 + x, 2 * y, 3 * z * x])
    doubt = (x - 0.5).astype(np.float32)
    known = know(solver, light, doubt)
    found = gather_known(solver, known)
    texel = np.flatnonzero(texels.is_central)[::40]
    ray = np.repeat(texel, 1000)
    normal = tracing.scene.tri_normal[:, texels.texel_tri[ray]].T
    ball = np.random.default_rng(5).normal(size=normal.shape)
    direction = normal + ball / np.linalg.norm(ball, axis=1, keepdims=True)
    origin = tracing.unit_box.to_unit(places_of(solver)[ray]) + 1e-5 * normal
    hit = tracing.scene.rays.closest(origin.astype(np.float32), direction.astype(np.float32))
    entry = texels.entry_of(hit.tri, *texels.hit_texel_xy(hit.tri, hit.u, hit.v))
    albedo = tracing.scene.surfaces.albedo.at(hit.tri, hit.u, hit.v)
    sent = np.column_stack([albedo * light[:, entry].T, albedo.mean(axis=1) * doubt[entry]]).reshape(len(texel), -1, 4)
    mean, chance = sent.mean(axis=1), sent.std(axis=1) / np.sqrt(1000)
    mine = np.column_stack([found.irradiance_rgb, found.doubt[:, 1]])[texel]
    assert (np.abs(mine - mean).mean(axis=0) < 2 * chance.mean(axis=0)).all()
    assert found.counters["rays"] > 5 * len(x)  # more than one span of them


@pytest.mark.parametrize("rest", [0.0, 0.2])
def test_what_a_wall_divides_a_texel_into_sends_the_light_of_its_own_side(tmp_path, rest):
    """A strip of floor is lit along a wall that stands beside the middles of texels. With light on the rest too, rays are aimed at it."""
    x_m, width_m, height_m = 31.6 / 64, 0.05, 0.4
    corners = np.array([[x_m, -0.1, 0], [x_m, 1.1, 0], [x_m, 1.1, 0.5], [x_m, -0.1, 0.5]])
    ceiling = Mesh("Ceiling", np.array([[0, 0, height_m], [0, 1, height_m], [1, 1, height_m], [1, 0, height_m]]), [[0, 1, 2, 3]])
    scene = make_scene([quad_mesh("Floor"), Mesh("Wall", corners, [[0, 1, 2, 3]]), ceiling], [LAMP], [Material("White", (0.8,) * 3)])
    settings = replace(SETTINGS, size=128)
    atlas, whole = prepare_folder(tmp_path, scene, settings)
    cut, *_ = cut_at_contacts(whole, atlas, find_contacts(traced_scene.open_scene(str(tmp_path)), whole))
    folders.forget_folders()
    shared_arrays.remove_struct(tmp_path / folders.TEXELS_FOLDER)
    shared_arrays.save_struct(tmp_path / folders.TEXELS_FOLDER, cut)
    solver = solve.Solver(tmp_path, settings, executors.InlineExecutor(), DirectField.none(len(cut)), np.zeros(len(cut), bool))
    x, y, _ = places_of(solver).T
    thing = scene.tri_object[cut.texel_tri]
    on_right = (thing == 0) & (x > x_m)
    in_strip = on_right & (x < x_m + width_m)
    light = np.float32(np.where(in_strip, 10.0, np.where(on_right, rest, 0.0)) * np.ones((3, 1)))
    known = know(solver, light, 0 * light[0])
    assert bool(len(known.bright)) == (rest > 0)
    seen = np.flatnonzero((thing == 2) & (x > x_m))
    found = np.mean([gather_known(solver, known, texel=seen, seed=seed).irradiance_rgb[:, 0].mean() for seed in range(16)])
    reach_m = cut.texel_area[in_strip].sum()  # a metre long
    expected = 0.0
    for low, high, level in ((x_m, x_m + reach_m, 10.0), (x_m + reach_m, 1.0, rest)):
        along, across = np.linspace(low, high, 65)[:-1] + (high - low) / 128, (np.arange(64) + 0.5) / 64
        away2 = (x[seen, None] - along)[:, :, None] ** 2 + (y[seen, None] - across)[:, None, :] ** 2 + height_m**2
        expected += (0.8 * level / np.pi * height_m**2 / away2**2).mean() * (high - low)

    assert found == pytest.approx(expected, rel=0.02)


def test_noise_of_a_leaf_has_one_sign_and_that_of_leaves_does_not_add_up():
    leaf = np.repeat(np.arange(4000), 3)
    noise = np.random.default_rng(2).random(len(leaf)).astype(np.float32)
    found = gather.give_signs(noise, leaf)
    assert found.shape == (gather.SIGNS, len(leaf))
    np.testing.assert_array_equal(np.abs(found), np.tile(noise, (gather.SIGNS, 1)))
    sign = np.sign(found).reshape(gather.SIGNS, -1, 3)
    assert (sign == sign[..., :1]).all()
    assert np.abs(np.corrcoef(sign[..., 0]) - np.eye(gather.SIGNS)).max() < 0.1
    of_leaves = np.bincount(leaf, noise)
    assert (np.abs(found.sum(axis=1)) < 5 * np.linalg.norm(of_leaves)).all()
    alone = gather.give_signs(np.ones((2, 4000), np.float32))
    assert alone.shape == (gather.SIGNS, 2, 4000)
    assert np.abs(alone.mean(axis=2)).max() < 0.1


@pytest.mark.parametrize("above", [True, False])
def test_texels_of_both_sides_gather_the_sum_of_both(tmp_path, above):
    """A sheet across a room whose one half alone has light, or sends what no texel tells."""
    sheet = moved(quad_mesh("Sheet"), (0.0, 0.0, 0.5))
    scene = make_scene([ROOM, sheet], [LAMP], [Material("Grey", (0.5,) * 3)])
    scene = replace(scene, objects=(scene.objects[0], replace(scene.objects[1], two_sided=True)))
    solver = make_solver(tmp_path, scene, SETTINGS, begun=False)
    x, _, z = places_of(solver).T
    is_lit = (z > 0.5) if above else (z < 0.5)
    on_sheet = scene.tri_object[solver.tracing.texels.texel_tri] == 1
    light = np.float32(np.where(on_sheet, 9.0, np.where(is_lit, 1 + x, 0.0)) * np.ones((3, 1)))
    known = know(solver, light, light[0])
    found = gather_known(solver, known)
    assert found.irradiance_rgb[on_sheet] == pytest.approx(0.75, abs=0.25)
    assert found.doubt[on_sheet] == pytest.approx(0.75, abs=0.25)
    assert np.median(found.variance_rgb[on_sheet]) > 1e-6
    assert found.counters["rays"] > 4 * (len(x) + 0.9 * on_sheet.sum())
    # The sheet's own texels hold the light of both sides, so that nobody is told what one of them sends.
    facing = ~on_sheet & (np.abs(z - (0.9 if above else 0.1)) < 0.05)
    assert found.irradiance_rgb[facing].max() < 0.9


ALL, NO_TRANSMISSION, TRANSMISSION_ONLY = (True,) * 3, (True, True, False), (False, False, True)


@pytest.mark.parametrize(
    ("card", "lid", "is_seen"),
    [(ALL, (), True), (NO_TRANSMISSION, (), False), (TRANSMISSION_ONLY, (), True), (ALL, (ALL,), False), (ALL, (NO_TRANSMISSION,), True)],
)
def test_behind_a_pane_rays_see_what_transmission_rays_see(tmp_path, card, lid, is_seen):
    """A floor below a pane that does not bend light, and above it a white card, perhaps behind a black lid."""
    pane = Material("Pane", (0.0,) * 3, glass_rgb=(1.0,) * 3, glass_fresnel=False, glass_ior=1.0)
    black, white = Material("Black", (0.0,) * 3), Material("White", (1.0,) * 3)
    things = [(0.1, pane, ALL), (0.3, white, card), *((0.2, black, kinds) for kinds in lid)]
    meshes = [quad_mesh("Floor"), *(moved(quad_mesh(f"Thing {k}"), (0, 0, z)) for k, (z, _, _) in enumerate(things))]
    scene = make_scene(meshes, [LAMP], [black, *(material for _, material, _ in things)])
    objects = [replace(one, seen_by=kinds) for one, (*_, kinds) in zip(scene.objects[1:], things, strict=True)]
    scene = replace(scene, tri_material=scene.tri_object, objects=(scene.objects[0], *objects))
    found, solver = gather_all(tmp_path, scene, on_sides=1.0)
    on_floor = solver.tracing.texels.texel_tri < 2
    assert found.irradiance_rgb[on_floor].mean() == pytest.approx(0.5 * is_seen, abs=0.3 * is_seen)


def test_rays_below_the_face_see_nothing(tmp_path):
    """Of a floor whose normals lean by 60 degrees a quarter of the light is below it: (1 + cos 60) / 2 is left."""
    scene = make_scene([ROOM], [LAMP], [Material("Grey", (0.5,) * 3)])
    is_floor = (scene.tri_position[..., 2] == 0).all(axis=1)
    normal = scene.tri_normal.copy()
    normal[is_floor] = [np.sqrt(0.75), 0.0, 0.5]
    found, solver = gather_all(tmp_path, replace(scene, tri_normal=normal))
    on_floor = is_floor[solver.tracing.texels.texel_tri]
    assert found.irradiance_rgb[on_floor].mean() == pytest.approx(0.75, rel=0.01)
    assert found.irradiance_rgb[~on_floor] == pytest.approx(1.0, rel=1e-5)


def test_what_is_near_coarse_ground_sees_its_own_shadow_there(tmp_path):
    """A plate below the sun, 2 cm above a floor whose texels are wider: below it the floor is dark, and it sees hardly anything else."""
    floor, plate = quad_mesh("Floor", 8.0, 8.0), quad_mesh("Plate", 0.2, 0.2)
    plate = moved(replace(plate, polygons=[[3, 2, 1, 0]]), (3.93, 3.95, 0.02))
    sun = Light("SUN", "Sun", power_rgb=(2.0, 2.0, 2.0))
    scene = make_scene([floor, plate], [sun], [Material("White", (1.0,) * 3)])
    fine, coarse = replace(scene.objects[1], density_factor=16.0), scene.objects[0]
    solver = make_solver(tmp_path, replace(scene, objects=(coarse, fine)), SETTINGS, begun=False)
    texels = solver.tracing.texels
    on_plate = texels.texel_tri >= 2
    assert 8 < np.sqrt(texels.texel_area[~on_plate].max() / texels.texel_area[on_plate].max()) < 32
    direct = np.where(on_plate, np.float32(0), np.float32(2)) * np.ones((3, 1), np.float32)
    known = know(solver, direct + np.float32(0.25) * ~on_plate, np.zeros(len(texels), np.float32), direct=direct)
    found = gather_known(solver, known)
    inner = on_plate & (np.abs(places_of(solver)[:, :2] - (4.03, 4.05)).max(axis=1) < 0.03)
    assert inner.sum() > 8
    # By the closed form of a square's form factor a point of this part sees 0.958 to 0.968 of its light from the shadow. Of that 0.02 to
    # 0.05 is farther than half a texel of the floor, whose mean stands for it there.
    assert found.irradiance_rgb[inner].mean(axis=0) == pytest.approx(np.full(3, 0.25 + 2.0 * 0.036), abs=0.05)


def test_a_face_without_texels_sends_the_light_of_its_cells(tmp_path):
    """Half of a sheet is folded to a line in its layer; a ceiling lies close above."""
    vertex = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0], [2, 1, 0]], float)
    square, line = np.array([[0, 0], [0.9, 0], [0.9, 0.9], [0, 0.9]]), np.array([[0.1, 0.1], [0.2, 0.2], [0.3, 0.3], [0.4, 0.4]])
    sheet = Mesh("Sheet", vertex, [[0, 1, 2, 3], [1, 4, 5, 2]], [square, line])
    ceiling = replace(moved(quad_mesh("Ceiling", 2.0, 1.0), (0, 0, 0.02)), polygons=[[3, 2, 1, 0]])
    lamp = replace(LAMP, position_m=(1.9, 0.5, 0.01))
    scene = make_scene([sheet, ceiling], [lamp], [Material("White", (1.0,) * 3)])
    below = replace(LAMP, position_m=(1.0, 0.5, -3.0))
    found, solver = gather_all(tmp_path / "dark", replace(scene, lights=(below,)), light=1.0, on_sides=0.5)
    x, _, z = places_of(solver).T
    inner = (z > 0.01) & (np.abs(x - 1.0) > 0.2)
    assert found.irradiance_rgb[inner & (x < 1.0)].mean() > 0.9
    assert found.irradiance_rgb[inner & (x > 1.0)].mean() == pytest.approx(0.5, abs=0.03)
    solver = make_solver(tmp_path / "lit", scene, replace(SETTINGS, max_photons=10_000), begun=False)  # for long between white things
    solver._trace_round(None)
    tracing = solver.tracing
    folded = np.flatnonzero(tracing.snapshot.tri_position[:, :, 0].max(axis=1) > 1.5)
    front = tracing.cells.find(folded, np.ones(len(folded), bool), *np.full((2, len(folded)), 0.3, np.float32))
    assert solver.cell_tally.flux[:, :, front].sum() > 0.0


# Gather rays that are aimed at bright places: their pdf, and what they gather, beside rays of a cosine distribution alone.
BLOCK = moved(box_mesh("Block", (0.2, 0.2, 0.2)), (0.5, 0.5, 0.1))


class Lit:
    """A room whose light is known: 1 W/m^2, but 300 on a spot of its ceiling and on other things in it; or, where these have no lightmap,
    120 on one side of them.
    """

    def __init__(self, folder, meshes=(ROOM,), bare=False, front=True):
        scene = make_scene(meshes, [LAMP], [Material("Grey", (0.5,) * 3)])
        if bare:
            scene = replace(scene, objects=(scene.objects[0], *(replace(thing, receives=False) for thing in scene.objects[1:])))
        solver = make_solver(folder, scene, Settings(even_out=False, size=64, padding=1), begun=False)
        self.texels, self.folder, self.unit_box = solver.tracing.texels, str(folder), solver.tracing.unit_box
        every = np.arange(len(self.texels))
        self.place = np.einsum("nk,nkj->nj", self.texels.bary_at(every), scene.tri_position[self.texels.texel_tri])
        spot = (self.place[:, 2] > 0.85) & (np.abs(self.place[:, :2] - 0.3).max(axis=1) < 0.06)
        spot |= scene.tri_object[self.texels.texel_tri] > 0
        light = np.where(spot & (not bare), 300.0, 1.0).astype(np.float32)
        tri, is_front, _ = solver.tracing.cells.locate(np.arange(len(solver.tracing.cells)))
        on_cells = np.zeros((2, 3, len(tri)), np.float32)
        on_cells[:, :, (is_front == front) & (scene.tri_object[tri] == 1)] = 60.0
        bright = find_bright(self.surfaces, np.tile(light, (3, 1)), on_cells.sum(axis=0))
        doubt = np.zeros((1, len(every)), np.float32), np.zeros((1, *on_cells.shape[::2]), np.float32)
        self.known = gather.KnownLight(np.tile(light, (3, 1)), np.zeros((3, len(light)), np.float32), doubt[0], on_cells, doubt[1], bright)

    @property
    def surfaces(self):
        return texel_shards.open_surfaces(self.folder)

    def gather(self, aimed=True, texel=None, seed=1, n_ray=64):
        bright = self.known.bright if aimed else find_bright(self.surfaces, 0 * self.known.light, 0 * self.known.on_cells[0])
        scene, targets = texel_shards._open_gather_scene(self.folder), Targets(bright, self.surfaces)
        texel = np.arange(len(self.texels)) if texel is None else texel
        return gather.gather_light(scene, self.known, targets, texel, np.random.default_rng(seed), n_ray)


@pytest.mark.parametrize("meshes", [(ROOM,), (ROOM, moved(BLOCK, (0.0, 0.0, 0.2)))], ids=["empty", "block"])
def test_all_that_a_closed_room_sends_arrives(tmp_path, meshes):
    """Of the block's sides some hide the others, and the spot."""
    lit = Lit(tmp_path, meshes)
    bakes, area = [lit.gather(seed=seed) for seed in range(4)], lit.texels.texel_area
    arrived = np.mean([bake.irradiance_rgb[:, 0] @ area for bake in bakes])
    sigma = math.sqrt(np.mean([bake.variance_rgb[:, 0] @ area**2 for bake in bakes]) / len(bakes)) / arrived
    assert sigma < 0.001
    assert arrived == pytest.approx(0.5 * (lit.known.light[0] @ area), rel=sigma_limit(1) * sigma + 1e-3)
    if len(meshes) == 1:
        assert bakes[0].variance_rgb.mean() < 0.06 * lit.gather(aimed=False).variance_rgb.mean()  # twice the rays alone would halve it


SHEET = moved(quad_mesh("Sheet", 0.3, 0.3), (0.3, 0.3, 0.7))


@pytest.mark.parametrize(("thing", "front"), [(BLOCK, True), (SHEET, True), (SHEET, False)])
def test_a_bright_thing_without_a_lightmap_sends_the_same_with_less_noise(tmp_path, thing, front):
    lit = Lit(tmp_path, (ROOM, thing), bare=True, front=front)
    aimed, plain = lit.gather(), lit.gather(aimed=False, seed=2)
    difference = (aimed.irradiance_rgb - plain.irradiance_rgb)[:, 0].mean()
    sigma = math.sqrt((aimed.variance_rgb + plain.variance_rgb)[:, 0].sum()) / len(lit.texels)
    assert sigma < 0.02 * plain.irradiance_rgb[:, 0].mean()
    assert abs(difference) < sigma_limit(1) * sigma
    assert aimed.variance_rgb.mean() < 0.25 * plain.variance_rgb.mean()


def test_the_stated_variance_is_that_between_seeds(tmp_path):
    lit = Lit(tmp_path)
    bakes = [lit.gather(seed=seed, n_ray=16, texel=np.arange(0, len(lit.texels), 5)) for seed in range(8)]
    between = np.var([one.irradiance_rgb[:, 0] for one in bakes], axis=0, ddof=1).mean()
    stated = np.mean([one.variance_rgb[:, 0] for one in bakes])
    assert 0.4 * stated < between < 1.1 * stated  # neighbouring strata tell more noise than all strata together leave


def test_points_are_chosen_with_the_stated_pdf(tmp_path):
    """From one texel of the floor to the whole spot: the share of each place, and all of its pdf."""
    lit = Lit(tmp_path)
    targets, rng = Targets(lit.known.bright, lit.surfaces), np.random.default_rng(3)
    texel = np.flatnonzero((lit.place[:, 2] < 0.15) & (np.abs(lit.place[:, :2] - 0.6).max(axis=1) < 0.05))[:16]
    no_side = np.zeros(len(lit.surfaces.receiving.normal), bool)
    (_, chunk), *_ = each_chunk(lit.surfaces.receiving, lit.texels.footprints_at, texel, no_side, rng, 64)
    end, rows = targets.find_chances(chunk), np.zeros(1, int)
    number, point = targets.choose(end, rows, rng.random((40_000, 1)), rng)
    away = point - chunk.receivers_at(rows, np.full((1, 1, 2), 0.5)).position
    down = np.broadcast_to(np.float32([0, 0, -1]), away.shape)
    pdf = targets.find_pdf(end, np.zeros(len(number), int), number, away, down)
    # The mean of 1 / pdf over the points of a place is the solid angle of the place.
    found = np.bincount(number, 1 / pdf) / len(number)
    area = lit.texels.texel_area[lit.known.bright.entry] * lit.unit_box.scale**2
    expected = area * np.bincount(number, away[:, 2] / np.linalg.norm(away, axis=1) ** 3) / np.bincount(number)
    assert len(area) > 3
    assert found == pytest.approx(expected, rel=0.05)


def test_places_are_those_far_brighter_than_the_rest(tmp_path):
    lit = Lit(tmp_path)
    assert set(lit.known.bright.entry) == set(np.flatnonzero(lit.known.light[0] == 300.0))
    dark = find_bright(lit.surfaces, 0 * lit.known.light, 0 * lit.known.on_cells[0])
    even = find_bright(lit.surfaces, 0 * lit.known.light + 3, 0 * lit.known.on_cells[0])
    assert len(dark) == len(even) == 0


def test_cells_are_located_where_they_are_found():
    cells = SurfaceCells.of(np.array([1.0, 4.0, 0.1]), np.array([False, True, False]))
    rng = np.random.default_rng(1)
    u, v = rng.random((2, 2000))
    u, v = (np.where(u + v > 1, 1 - one, one).astype(np.float32) for one in (u, v))
    tri, is_front = rng.integers(0, 3, 2000), rng.random(2000) < 0.5
    cell = cells.find(tri, is_front, u, v)
    of, front, corners = cells.locate(cell)
    assert np.array_equal(of, tri)
    assert np.array_equal(front, is_front)
    assert np.array_equal(cells.find(tri, is_front, *corners.mean(axis=1).T), cell)
    first, second, third = np.moveaxis(corners.astype(float), 1, 0)
    weights = np.linalg.solve(np.stack([second - first, third - first], axis=2), (np.stack([u, v], axis=1) - first)[..., None])
    assert weights.min() > -1e-3
    assert weights.sum(axis=1).max() < 1 + 1e-3


# Cells on sides without a lightmap: they tile each triangle evenly, and hold the irradiance of the photons that fall on them.
AREA_M2 = np.array([4.0, 0.01, 1.0, 0.0])
HAS_LIGHTMAP = np.array([False, False, True, False])


@pytest.fixture(scope="module")
def cells():
    return SurfaceCells.of(AREA_M2, HAS_LIGHTMAP)


def points(count, seed=1):
    u, v = square_to_uniform_triangle(np.random.default_rng(seed).random((count, 2), dtype=np.float32)).T
    return u, v


def test_points_that_are_spread_evenly_fall_evenly_into_the_cells(cells):
    u, v = points(400_000)
    tri = np.ones(len(u), int)
    cell = cells.find(tri, np.zeros(len(u), bool), u, v)
    first, count = cells.start[1, 1], cells.per_edge[1, 1] ** 2
    assert count > 10
    assert ((cell >= first) & (cell < first + count)).all()
    found = np.bincount(cell - first, minlength=count)
    expected = len(u) / count
    assert ((found - expected) ** 2 / expected).sum() / count == pytest.approx(1.0, abs=6 * np.sqrt(2 / count))


def test_light_is_flux_over_area_and_doubt_is_half_the_gap_of_the_halves(cells):
    tally = CellTally.empty(len(cells))
    u, v = points(50_000)
    cell = cells.find(np.full(len(u), 1), np.ones(len(u), bool), u, v)
    is_straight = np.arange(len(u)) % 4 == 0
    # Each photon of a shard carries its share of 3, 2 and 1 W, of which all fall on the triangle.
    for half, more in ((0, 1.0), (1, 1.5)):
        flux = np.float32([[3.0], [2.0], [1.0]]) * more * np.ones(len(u), np.float32)
        place = cell + len(cells) * is_straight
        parts = [CellFlux.of(place[part], flux[:, part], 2 * len(cells)) for part in (slice(0, 1000), slice(1000, None))]
        tally.add(half, CellFlux.join(parts), len(u))
    light, doubt = tally.irradiance(cells)
    mine = np.arange(cells.start[0, 1], cells.start[0, 1] + cells.per_edge[0, 1] ** 2)
    power = (light[:, :, mine] * cells.area_m2[mine]).sum(axis=2)
    np.testing.assert_allclose(power, np.outer([0.75, 0.25], [3.75, 2.5, 1.25]), rtol=1e-5)
    np.testing.assert_allclose((doubt[:, mine] * cells.area_m2[mine]).sum(axis=1), [-0.375, -0.125], rtol=1e-5)
    assert light.sum() == pytest.approx(light[:, :, mine].sum())


def test_each_side_has_its_own_cells_and_a_lightmap_s_front_one(cells):
    area = np.zeros((2, len(AREA_M2)))
    for side in (0, 1):
        for tri in range(len(AREA_M2)):
            first, count = cells.start[side, tri], cells.per_edge[side, tri] ** 2
            area[side, tri] = cells.area_m2[first : first + count].sum()
    np.testing.assert_allclose(area, [AREA_M2, AREA_M2], atol=1e-12)
    assert cells.per_edge[0, 2] == 1 < cells.per_edge[1, 2]
    assert len(np.unique(np.sort(cells.start.ravel()))) == 8
    assert len(cells) == (cells.per_edge.astype(int) ** 2).sum()
