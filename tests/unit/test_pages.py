"""What pages show: the right value at the right texel, passes that add up, and the light so far for the viewport."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from boxes import furnace_scene, lamp_scene, make_solver, prepare_folder
from leaflight.core.atlas import charts
from leaflight.core.bake import preview, solve
from leaflight.core.bake.preview import PreviewPages, find_first_light
from leaflight.core.integrate import texel_light
from leaflight.core.integrate.direct_field import DirectField
from leaflight.core.integrate.gathered import GatheredField
from leaflight.core.output import resolve
from leaflight.core.output.debug_passes import DebugPages
from leaflight.core.radiosity import quadtree
from leaflight.core.radiosity.quadtree import node_of_texel
from leaflight.core.scene.materials import SurfaceMaterials
from leaflight.core.scene.scene import Material, TextureImage
from leaflight.core.texels.texels import build_texel_map
from leaflight.core.transport import traced_scene
from leaflight.core.util.settings import DEBUG_PASSES, PASSES, Settings
from scenes import Mesh, make_scene
from trees import SquareBake

# Pages: the right value at the right texel, passes that add up, alpha, margin.
PAGE = 8
GREY = Material("Grey", (0.5, 0.25, 0.125), emission_rgb=(1.0, 2.0, 3.0))


def layered_scene(*rectangles, heights_m=(1.0, 1.0)):
    """Rectangles (x, y, width, height) in texels of the layer, one metre wide and heights_m high, as one object."""
    vertex, polygons, uv = [], [], []
    for k, (x, y, width, height) in enumerate(rectangles):
        polygons.append([len(vertex) + j for j in range(4)])
        vertex += [[2 * k, 0, 0], [2 * k + 1, 0, 0], [2 * k + 1, heights_m[k], 0], [2 * k, heights_m[k], 0]]
        uv.append(np.array([[x, y], [x + width, y], [x + width, y + height], [x, y + height]]) / PAGE)
    return make_scene([Mesh("Layered", np.array(vertex, float), polygons, uv)], materials=[GREY])


def make_resolver(scene, light, margin=0):
    """A resolver of one page and an empty one; light(x, y, chart) gives direct, indirect and stderr, W/m^2, for texels of charts."""
    atlas = charts.make_charts(scene, Settings(size=PAGE))
    texels = replace(build_texel_map(scene, atlas, 2), page_count=2)
    values = light(*texels.texel_xy.T, texels.texel_chart)
    direct, indirect, stderr = (np.repeat(np.float32(value)[:, None], 3, axis=1) for value in values)
    at_texels = texel_light.TexelLight(direct, indirect, stderr, np.zeros(len(direct), np.int32))
    return resolve.Resolver(at_texels, texels, SurfaceMaterials(scene), margin, threads=2)


def slope(x, y, chart):
    """A different number at every texel."""
    return x + 10.0 * y, 100.0 + x, 1.0 + y


@pytest.fixture
def three_by_five():
    """3 rows and 5 columns at (1, 2) of an 8 x 8 page."""
    return make_resolver(layered_scene((1, 2, 5, 3)), slope)


def test_rows_go_up_and_columns_go_right(three_by_five):
    page = three_by_five.page("direct", 0)
    assert page.shape == (PAGE, PAGE, 4)
    assert page.dtype == np.float32
    for y in range(2, 5):
        for x in range(1, 6):
            assert page[y, x, :3] == pytest.approx((x + 10 * y) / np.pi, rel=1e-6)


def test_alpha_is_1_where_a_chart_is_and_colour_0_elsewhere(three_by_five):
    page = three_by_five.page("direct", 0)
    covered = np.zeros((PAGE, PAGE), bool)
    covered[2:5, 1:6] = True
    assert np.array_equal(page[..., 3], covered.astype(np.float32))
    assert not page[~covered].any()


def test_margin_runs_on_in_colour_but_not_in_alpha():
    page, bare = (make_resolver(layered_scene((1, 2, 5, 3)), slope, margin).page("direct", 0) for margin in (1, 0))
    assert np.array_equal(page[..., 3], bare[..., 3])
    assert page[1, 3, 0] == pytest.approx(bare[2, 2:5, 0].mean(), rel=1e-6)
    assert page[1:6, 0:7, 0].all()
    assert not page[0].any()
    assert not page[:, 7].any()
    assert np.array_equal(page[2:5, 1:6], bare[2:5, 1:6])


def test_passes_add_up(three_by_five):
    pages = {name: three_by_five.page(name, 0)[2:5, 1:6, :3] for name in PASSES if name not in DEBUG_PASSES}
    x, y = np.meshgrid(np.arange(1, 6), np.arange(2, 5))
    assert pages["indirect"][..., 2] == pytest.approx((100 + x) / np.pi, rel=1e-6)
    assert pages["stderr"][..., 0] == pytest.approx((1 + y) / np.pi, rel=1e-6)
    assert pages["lighting"] == pytest.approx(pages["direct"] + pages["indirect"], rel=1e-6)
    assert pages["diffuse"] == pytest.approx(pages["albedo"] * pages["lighting"], rel=1e-6)
    assert pages["combined"] == pytest.approx(pages["diffuse"] + pages["emission"], rel=1e-6)
    assert (pages["albedo"] == np.float32(GREY.albedo_rgb)).all()
    assert (pages["emission"] == np.float32(GREY.emission_rgb)).all()


def test_an_unknown_pass_is_named(three_by_five):
    with pytest.raises(ValueError, match="'glossy'"):
        three_by_five.page("glossy", 0)


def test_a_page_without_charts_is_empty(three_by_five):
    assert not three_by_five.page("combined", 1).any()


@pytest.mark.parametrize(("border", "middle"), [(2.3, 4), (2.7, 1)])
def test_a_texel_of_two_charts_shows_the_one_at_its_centre(border, middle):
    """Charts that meet in column 2; the first stands for fifty times the area in the world."""
    scene = layered_scene((0, 0, border, 2), (border, 0, 5 - border, 2), heights_m=(50.0, 1.0))
    page = make_resolver(scene, lambda x, y, chart: (1.0 + 3.0 * chart, 0.0 * x, 0.0 * x)).page("direct", 0)
    assert page[0, :5, 0] * np.pi == pytest.approx(np.array([1, 1, middle, 4, 4]), rel=1e-5)
    assert (page[:2, :5, 3] == 1).all()


def test_albedo_of_a_texel_is_the_mean_of_its_texture():
    """A texture twice as fine as the lightmap, in stripes of one of its texels."""
    stripes = np.zeros((2 * 2, 2 * 4, 3), np.float32)
    stripes[:, ::2] = 1.0
    scene = layered_scene((0, 0, 4, 2))
    scene = replace(
        scene,
        tri_albedo_uv=(scene.tri_uv * PAGE / [4, 2]).astype(np.float32),
        images=(TextureImage("Stripes", stripes, closest=True),),
        materials=(Material("Stripes", (0.8, 0.4, 0.2), albedo_image=0),),
    )
    page = make_resolver(scene, slope).page("albedo", 0)
    whole = np.concatenate([page[0, 2:4, :3], page[1, :2, :3]])  # the others are shared by two triangles
    assert whole == pytest.approx(np.broadcast_to(np.float32([0.4, 0.2, 0.1]), (4, 3)), rel=1e-5)


def light_field(bake, leaves):
    n = bake.n_texel
    rng = np.random.default_rng(5)
    direct = DirectField(rng.random((n, 3), np.float32), 0.01 * rng.random((n, 3), np.float32), np.ones(n, np.int16))
    received = bake.totals().received
    return solve.LightField(bake.tree, bake.solution(), leaves, received, direct, 0.0, 1, 1, "error", solve.Ledger())


def light_of(field, texels):
    """Light at texels that are all on one page, grain and all."""
    return texel_light.light_at_texels(field, texels, smooth_grain=False)


@pytest.mark.parametrize("level", [0, 2])
def test_texels_show_the_function_of_their_leaf(level):
    """Light that grows like s: 2 s on the unit square, and nothing of it depends on t."""
    bake = SquareBake(side=16, degree=1, level=level)
    rng = np.random.default_rng(2)
    bake.throw(np.sqrt(rng.random(2_000_000)), rng.random(2_000_000))
    field = light_field(bake, np.flatnonzero(bake.tree.current))
    light = light_of(field, bake.texels)
    x = bake.texels.texel_xy[:, 0]
    assert light.direct[:, 0] - field.direct.irradiance[:, 0] == pytest.approx(2 * (x + 0.5) / 16, abs=0.03)
    assert not light.indirect.any()
    assert len(np.unique(light.leaf)) == 4**level


def test_stderr_is_that_of_the_leafs_functions_and_of_direct_light():
    """Over a leaf the mean of the variance is that of its mean, times the number of its functions."""
    bake = SquareBake(side=16, degree=1)
    bake.throw(*np.random.default_rng(2).random((2, 10_000)))
    root = np.flatnonzero(bake.tree.current)
    field = light_field(bake, root)
    of_photons = light_of(field, bake.texels).stderr[:, 0] ** 2 - field.direct.variance[:, 0]
    assert of_photons.mean() == pytest.approx(3 * field.solution.variance[0, root[0]], rel=0.02)


# Debug passes: right numbers at right texels, and pictures that show them.
SIDE = 16
NAMES = pytest.mark.parametrize("name", DEBUG_PASSES)


def make_debug(width=1.0, margin=0):
    """A square whose lower left quarter is split once more, into leaves of 4 texels; 1,000 photons fell into that quarter."""
    bake = SquareBake(side=SIDE, width=width, level=1, preview_depth=1)
    lower_left = np.flatnonzero(bake.tree.current & (bake.tree.origin == 0).all(1))
    bake.tree = quadtree.split(bake.tree, lower_left)
    bake.throw(*(0.5 * np.random.default_rng(1).random((2, 1000))))
    leaves = np.flatnonzero(bake.tree.current)
    n = bake.n_texel
    light = solve.LightField(
        bake.tree, bake.solution(), leaves, bake.totals().received, DirectField.none(n), 0.0, 1000, 1, "error", solve.Ledger()
    )
    return DebugPages(light, bake.texels, margin)


def black():
    return np.zeros((SIDE, SIDE, 4), np.float32)


def test_level_counts_halvings_of_the_root():
    level = make_debug().page("level", 0)
    expected = np.ones((SIDE, SIDE))
    expected[:8, :8] = 2
    assert np.array_equal(level[..., 0], expected)
    assert (level[..., 3] == 1).all()


def test_photons_are_those_of_the_leaf():
    photons = make_debug().page("photons", 0)[..., 0]
    quarters = photons[[0, 0, 4, 4], [0, 4, 0, 4]]
    assert quarters.sum() == 1000
    assert (quarters > 200).all()
    assert (photons[:4, :4] == quarters[0]).all()
    assert photons[0, 8] == photons[8, 0] == 0


def test_edges_are_one_texel_wide_and_lie_between_leaves():
    edge = make_debug().page("leaf_edges", 0)[..., 0]
    expected = np.zeros((SIDE, SIDE))
    expected[8] = expected[:, 8] = 1
    expected[4, :8] = expected[:8, 4] = 1
    assert np.array_equal(edge, expected)


@NAMES
def test_numbers_are_alike_in_all_channels_and_colours_are_within_1(name):
    pages = make_debug(width=0.5)
    page, look = pages.page(name, 0), pages.look(name, 0, black)
    assert np.array_equal(page[..., 0], page[..., 1])
    assert np.array_equal(page[..., 0], page[..., 2])
    assert np.array_equal(page[..., 3], look[..., 3])
    assert page.dtype == look.dtype == np.float32
    assert 0 <= look.min() <= look.max() <= 1


def test_edges_are_drawn_over_the_light_in_a_grey_that_shows():
    pages = make_debug()
    edge = pages.page("leaf_edges", 0)[..., 0] == 1
    for light in (0.0, 0.9, 30.0):
        look = pages.look("leaf_edges", 0, lambda light=light: np.full((SIDE, SIDE, 4), light, np.float32))
        assert look[~edge][:, :3] == pytest.approx(min(light, 1.0))
        assert (np.abs(look[edge][:, :3] - min(light, 1.0)) > 0.3).all()


def test_another_page_is_empty_and_an_unknown_pass_is_named():
    assert not make_debug().page("level", 1).any()
    with pytest.raises(ValueError, match="'glossy'"):
        make_debug().page("glossy", 0)


# One definition of the light at a texel: what a viewport and gather rays read is what pages show, but for filters.
@pytest.fixture(scope="module")
def bake_room(tmp_path_factory):
    """Bakes a block on a floor, once for each kind of direct light."""

    @cache
    def bake(direct):
        settings = Settings(size=64, padding=1, max_photons=200_000, error=0.01, direct=direct)
        solver = make_solver(tmp_path_factory.mktemp(direct), lamp_scene(), settings)
        return solver, solver.run(lambda message: None, lambda: False)

    return bake


@pytest.mark.parametrize("direct", ["rays", "photons"])
def test_a_glance_has_the_light_of_the_pages_without_filter(bake_room, direct):
    solver, light = bake_room(direct)
    texels = solver.tracing.texels
    glance = texel_light.glance_at(light, texels, np.arange(len(texels)))
    pages = texel_light.light_at_texels(light, texels, smooth_grain=False)
    np.testing.assert_allclose(glance, [pages.direct, pages.indirect], rtol=1e-5)
    if direct == "photons":
        found = np.tensordot(glance.sum(axis=0), texels.texel_area, (0, 0))
        assert found == pytest.approx(light.solution.flux[:, light.leaves].sum(axis=1), rel=0.005)


def test_gather_rays_find_the_light_of_a_glance_and_how_far_halves_differ(bake_room):
    solver, light = bake_room("rays")
    texels = solver.tracing.texels
    known, doubt, leaf = texel_light.find_known(light, texels)
    np.testing.assert_allclose(
        known.T, texel_light.glance_at(replace(light, gathered=None), texels, np.arange(len(texels))).sum(axis=0), rtol=1e-5
    )
    halves = light.solution.flux_half[:, :, light.leaves].sum(axis=2).mean(axis=1)
    assert doubt @ texels.texel_area == pytest.approx((halves[0] - halves[1]) / 2, abs=0.02 * halves.mean())
    assert np.abs(doubt).max() > 0
    np.testing.assert_array_equal(leaf, node_of_texel(light.tree, light.leaves, len(texels)))


def test_gathered_light_is_shown_while_a_bake_runs_and_not_gathered_again(bake_room, tmp_path):
    solver, light = bake_room("rays")
    texels = solver.tracing.texels
    gathered = GatheredField.none(len(texels))
    gathered.irradiance[:] = 100.0 * np.pi
    field = replace(light, gathered=gathered)
    shown = PreviewPages(
        tmp_path / "pages", texels, solver.tracing.scene.surfaces, replace(solver.settings, passes=("indirect",)), print
    ).draw(field)[0]
    value = shown[texels.texel_xy[:, 1], texels.texel_xy[:, 0], 0]
    assert (value == 100.0).all()
    np.testing.assert_array_equal(texel_light.find_known(field, texels)[0], texel_light.find_known(light, texels)[0])


# Pages for the viewport: they show the light so far, cost little, and change nothing of the bake.
SETTINGS = Settings(size=32, padding=1, direct="photons", error=1e-4, max_photons=300_000, passes=("lighting",))


def make_preview(folder, scene, settings=SETTINGS, tell=lambda message: None):
    texels = prepare_folder(folder, scene, settings)[1]
    surfaces = traced_scene.open_tracing(str(folder)).scene.surfaces
    return PreviewPages(folder / "pages", texels, surfaces, settings, tell), texels


def first_light(folder, settings):
    tracing = traced_scene.open_tracing(str(folder))
    return find_first_light(folder, settings, tracing.texels)


def test_first_light_is_all_of_the_light(tmp_path):
    pages, _ = make_preview(tmp_path, furnace_scene(0.5))
    (page,) = pages.draw(first_light(tmp_path, SETTINGS))
    lit = page[page[..., 3] > 0][:, :3].astype(float)
    assert lit.mean() == pytest.approx(2.0, rel=0.01)  # e / (1 - rho)
    assert lit.std() < 0.4


def test_pages_are_those_of_the_bake_but_for_its_blending(tmp_path):
    for name in ("combined", "indirect", "albedo"):
        settings = replace(SETTINGS, passes=(name,), max_photons=60_000)
        pages, texels = make_preview(tmp_path / name, furnace_scene(0.5), settings)
        light = make_solver(tmp_path / f"{name} solver", furnace_scene(0.5), settings).run(lambda message: None, lambda: False)
        (page,) = pages.draw(light)
        surfaces = traced_scene.open_tracing(str(tmp_path / name)).scene.surfaces
        final = resolve.Resolver(texel_light.light_at_texels(light, texels), texels, surfaces, 2).page(name, 0)
        np.testing.assert_array_equal(page[..., 3], final[..., 3])
        covered = final[..., 3] > 0
        assert page[covered][:, :3].astype(float).mean() == pytest.approx(final[covered][:, :3].mean(), rel=0.02), name


def test_shadow_rays_replace_photons_where_they_have_been_shot(tmp_path):
    pages, texels = make_preview(tmp_path, lamp_scene(), replace(SETTINGS, passes=("direct",)))
    first = first_light(tmp_path, SETTINGS)
    field = DirectField.none(len(texels.texel_area))
    half = np.arange(len(field.passes)) % 2 == 0
    field.passes[half], field.irradiance[half] = 1, 100.0 * np.pi
    (page,) = pages.draw(replace(first, direct=field), rays_alone=True)
    cell = page[texels.texel_xy[:, 1], texels.texel_xy[:, 0], 0]
    assert (cell[half] == 100.0).all()
    assert cell[~half].max() < 100.0


def test_large_pages_are_shown_smaller_and_as_bright(tmp_path, monkeypatch):
    pages, _ = make_preview(tmp_path, furnace_scene(0.5))
    first = first_light(tmp_path, SETTINGS)
    (whole,) = pages.draw(first)
    monkeypatch.setattr(preview, "MOST_TEXELS", 11 * 11)
    pages, _ = make_preview(tmp_path / "small", furnace_scene(0.5))
    (small,) = pages.draw(first)
    assert small.shape == (11, 11, 4)
    means = [page[page[..., 3] > 0][:, 0].astype(float).mean() for page in (whole, small)]
    assert means[0] == pytest.approx(means[1], rel=0.05)


def test_pages_come_no_faster_than_they_may_cost(tmp_path, monkeypatch):
    told, clock = [], [0.0]
    pages, _ = make_preview(tmp_path, furnace_scene(0.5), tell=told.append)
    first = first_light(tmp_path, SETTINGS)
    draw = pages.draw

    def draw_slowly(*light):
        clock[0] += 0.2
        return draw(*light)

    monkeypatch.setattr(pages, "draw", draw_slowly)
    monkeypatch.setattr(preview.time, "monotonic", lambda: clock[0])
    monkeypatch.setattr(preview.time, "thread_time", lambda: clock[0])
    for _ in range(100):
        pages.show(first)
        clock[0] += 0.1
    assert 5 <= len(told) <= 6  # each took 0.2 s: 2 s must pass between two
    assert np.load(told[-1].path).shape == (32, 32, 4)
    assert len(list((tmp_path / "pages").glob("*.npy"))) == preview._KEPT_TURNS


def test_messages_are_passed_on_and_show_what_has_come(tmp_path, monkeypatch):
    monkeypatch.setattr(preview, "LEAST_PAUSE_S", 0.0)
    monkeypatch.setattr(preview, "PAUSE_OF_COST", 0.0)
    told = []
    pages, texels = make_preview(tmp_path, lamp_scene(), tell=told.append)
    field = DirectField.none(len(texels.texel_area))
    tell = pages.join(first_light(tmp_path, SETTINGS), field)
    field.passes[:], field.irradiance[:] = 1, 50.0 * np.pi
    tell("a message")
    assert told[1] == "a message"
    before, after = (np.load(told[i].path)[..., 0].max() for i in (0, 2))
    assert before < 50.0 <= after


def test_a_page_that_blender_is_reading_stays(tmp_path, monkeypatch):
    """As on Windows, where a file that is open cannot be removed: the bake goes on."""
    monkeypatch.setattr(preview, "LEAST_PAUSE_S", 0.0)
    monkeypatch.setattr(preview, "PAUSE_OF_COST", 0.0)
    told = []
    pages, _ = make_preview(tmp_path, furnace_scene(0.5), tell=told.append)
    first = first_light(tmp_path, SETTINGS)

    def refuse(path, missing_ok=False):
        raise PermissionError(13, "The process cannot access the file because it is being used by another process", str(path))

    with monkeypatch.context() as patch:
        patch.setattr(preview.Path, "unlink", refuse)
        for _ in range(preview._KEPT_TURNS + 1):
            pages.show(first)
    assert len(told) == preview._KEPT_TURNS + 1
