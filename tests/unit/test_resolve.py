"""Pages: the right value at the right texel, passes that add up, alpha, margin."""

from dataclasses import replace

import numpy as np
import pytest
from leaflight.core.atlas import charts
from leaflight.core.bake import solve
from leaflight.core.integrate import texel_light
from leaflight.core.integrate.direct_field import DirectField
from leaflight.core.output import resolve
from leaflight.core.scene.materials import SurfaceMaterials
from leaflight.core.scene.scene import Material, TextureImage
from leaflight.core.texels.texels import build_texel_map
from leaflight.core.util.settings import DEBUG_PASSES, PASSES, Settings
from scenes import Mesh, make_scene
from trees import SquareBake

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
