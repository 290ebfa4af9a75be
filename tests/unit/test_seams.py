import dataclasses
from dataclasses import dataclass

import numpy as np
import pytest
from leaflight.core.atlas.charts import make_charts
from leaflight.core.filter.seams import match_seams
from leaflight.core.integrate.texel_light import TexelLight
from leaflight.core.output.resolve import Resolver, close_seams
from leaflight.core.scene.materials import SurfaceMaterials
from leaflight.core.scene.scene import Material
from leaflight.core.texels.creases import cut_at_creases
from leaflight.core.texels.seam_points import SeamPoints, find_seams
from leaflight.core.texels.texels import TexelMap, build_texel_map
from leaflight.core.util.settings import Settings
from scenes import hinge_mesh, make_scene, shade_smooth, sphere_mesh
from seam_steps import measure_step

ALBEDO = (0.5, 0.25, 0.75)


@dataclass
class Lit:
    """A scene lit by a function of place and normal, with the same share of direct light everywhere."""

    scene: object
    points: SeamPoints
    texels: TexelMap
    light: TexelLight

    def closed(self):
        return close_seams(self.light, self.points, self.texels)

    def pages(self, light, name="lighting", margin=4):
        resolver = Resolver(light, self.texels, SurfaceMaterials(self.scene), margin)
        return np.stack([resolver.page(name, page) for page in range(self.texels.page_count)])


def light_scene(scene, irradiance, size=64, noise=0.0, stderr=0.0):
    """`irradiance` of positions (n, 3) and unit normals (n, 3); `noise` is relative, one value for each chart."""
    scene = dataclasses.replace(scene, materials=(Material("Tinted", ALBEDO, emission_rgb=(0.0, 0.0, 2.0)),))
    atlas = make_charts(scene, Settings(size=size))
    texels = build_texel_map(scene, cut_at_creases(scene, atlas), 2)
    weight, tri = texels.texel_bary[..., None], texels.texel_tri
    normal = (weight * scene.tri_normal[tri]).sum(axis=1)
    value = irradiance((weight * scene.tri_position[tri]).sum(axis=1), normal / np.linalg.norm(normal, axis=1, keepdims=True))
    value = value * (1 + noise * np.random.default_rng(4).normal(size=len(texels.chart_page))[texels.texel_chart])
    rgb = (value[:, None] * np.array([1.0, 0.8, 0.6])).astype(np.float32)
    doubt = np.broadcast_to(np.asarray(stderr, np.float32)[..., None], rgb.shape) * rgb
    light = TexelLight(rgb * np.float32(0.3), rgb * np.float32(0.7), doubt, np.zeros(len(rgb), np.int32))
    points = find_seams(scene, atlas.tri_chart, atlas.tri_uv, atlas.object_page[scene.tri_object])
    return Lit(scene, points, texels, light)


def by_sun(position, normal):
    return np.maximum(normal @ np.array([0.6, 0.0, 0.8]), 0.0) + 0.2


def rms_change(before, after):
    covered = before[..., 3] > 0
    return float(np.sqrt(((after[covered] / before[covered] - 1)[:, 0] ** 2).mean()))


@pytest.mark.parametrize("size", [64, 256])
def test_a_smooth_sphere_has_no_steps_and_hardly_other_light(hold, size):
    lit = light_scene(shade_smooth(make_scene([sphere_mesh()])), by_sun, size)
    light, report = lit.closed()
    before, after = lit.pages(lit.light), lit.pages(light)
    steps = measure_step(before, lit.points), measure_step(after, lit.points)
    hold("seams: step that is left on a smooth sphere, of what it was", 100 * steps[1] / steps[0], high=20, unit="%")
    assert (report.step_before, report.step_after) == pytest.approx(steps, rel=0.01)
    assert (report.edges, report.texels > 50) == (lit.points.n_edge, True)
    assert rms_change(before, after) < 0.02
    for name in ("direct", "indirect"):
        assert measure_step(lit.pages(light, name), lit.points) < 1.5 * steps[1]


@pytest.mark.parametrize("size", [64, 256])
def test_charts_of_a_plane_that_err_apart_meet(hold, size):
    """The truth is a ramp; the light of each chart is off by its own 4 %, as it says."""

    def ramp(position, normal):
        return 1.0 + 0.3 * position[:, 0] + 0.2 * position[:, 1]

    lit, truth = (light_scene(make_scene([hinge_mesh()]), ramp, size, noise, 0.04) for noise in (0.04, 0.0))
    light, _ = lit.closed()
    before, after, right = (one.pages(its) for one, its in ((lit, lit.light), (lit, light), (truth, truth.light)))
    steps = measure_step(before, lit.points), measure_step(after, lit.points)
    hold("seams: step that is left on a plane, of what it was", 100 * steps[1] / steps[0], high=20, unit="%")
    hold("seams: error of a plane with its seam closed, over that before", rms_change(right, after) / rms_change(right, before), high=1)


def test_a_seam_beside_the_edge_of_the_page_is_closed_as_within_it():
    """Both sides of it lie one texel from an edge of the page; rows go on at the other one in memory."""
    left = np.array([[16, 40], [0, 40], [0, 8], [16, 8]]) / 64
    found = []
    for shift in (1 / 64, 4 / 64):
        uv = left + np.array([shift, 0.0]), left[[1, 0, 3, 2]] * [-1.0, 1.0] + np.array([1.0 - shift, 0.0])
        lit = light_scene(make_scene([hinge_mesh(uv=uv)]), lambda position, normal: 1.0 + 0.3 * position[:, 0], noise=0.04, stderr=0.04)
        light, report = lit.closed()
        assert report.step_after < 0.1 * report.step_before
        found.append(light.direct)
    np.testing.assert_allclose(*found, rtol=1e-6)


def test_a_step_of_the_light_itself_stays():
    """Something stands on the very edge: the light is another one beyond it."""
    lit = light_scene(make_scene([hinge_mesh()]), lambda position, normal: np.where(position[:, 0] < 1.0, 1.0, 0.1), stderr=0.02)
    light, report = lit.closed()
    assert report.edges == 1
    assert report.step_before > 1.0
    np.testing.assert_array_equal(light.direct, lit.light.direct)
    np.testing.assert_array_equal(light.indirect, lit.light.indirect)


def test_the_noisier_side_moves_more():
    scene = make_scene([hinge_mesh()])
    left = light_scene(scene, lambda position, normal: position[:, 0]).light.direct[:, 0] < 0.3
    doubt = np.where(left, 0.02, 0.2)
    lit = light_scene(scene, lambda position, normal: np.where(position[:, 0] < 1.0, 1.0, 1.2), stderr=doubt)
    light, report = lit.closed()
    moved = np.abs(light.direct / lit.light.direct - 1)[:, 0]
    assert report.step_after < 0.1 * report.step_before
    assert moved[~left].max() > 3 * moved[left].max() > 0


def test_light_never_falls_below_zero_and_black_stays_black():
    scene = shade_smooth(make_scene([sphere_mesh()]))
    dim = light_scene(scene, lambda position, normal: np.maximum(normal[:, 2], 0.0) ** 8)
    light, _ = dim.closed()
    assert min(light.direct.min(), light.indirect.min(), light.empty.light.min()) >= 0
    black = light_scene(scene, lambda position, normal: np.zeros(len(position)))
    light, report = black.closed()
    assert not light.direct.any()
    assert (report.step_before, report.step_after) == (0.0, 0.0)


def test_seams_that_no_texel_lies_near_leave_the_light_as_it_was():
    """As of an object that is smaller than a texel."""
    lit = light_scene(make_scene([sphere_mesh()]), by_sun)
    points = light_scene(shade_smooth(make_scene([sphere_mesh()])), by_sun).points
    bare, light = np.full_like(lit.texels.entry_at, -1), lit.light
    for part in (slice(None), slice(0)):  # of all entries, and where there is none at all
        direct, central = light.direct[part], lit.texels.is_central[part]
        (matched,), empty, report = match_seams(points, [direct], light.stderr[part], central, bare)
        np.testing.assert_array_equal(matched, direct)
        assert (report.edges, report.texels, report.step_before, report.step_after) == (points.n_edge, 0, 0.0, 0.0)
        assert len(empty.page) == empty.light.shape[1] == 0


def test_without_seams_the_light_is_as_it_was():
    lit = light_scene(make_scene([sphere_mesh()]), by_sun)
    light, report = lit.closed()
    assert light is lit.light
    assert report.edges == report.texels == 0


def test_light_beside_charts_is_in_every_pass_of_light_and_no_other():
    lit = light_scene(shade_smooth(make_scene([sphere_mesh()])), by_sun)
    light, _ = lit.closed()
    x, y = light.empty.xy.T
    at = (light.empty.page, y, x)
    lighting = light.empty.light.sum(axis=0) / np.pi
    np.testing.assert_allclose(lit.pages(light)[at][:, :3], lighting, rtol=1e-5)
    np.testing.assert_allclose(lit.pages(light, "direct")[at][:, :3], light.empty.light[0] / np.pi, rtol=1e-5)
    np.testing.assert_allclose(lit.pages(light, "diffuse")[at][:, :3], lighting * ALBEDO, rtol=1e-5)
    np.testing.assert_allclose(lit.pages(light, "combined")[at][:, :3], lighting * ALBEDO + [0, 0, 2], rtol=1e-5)
    for name in ("lighting", "combined"):
        pages = lit.pages(light, name)
        assert not pages[at][:, 3].any(), "it is margin"
        np.testing.assert_array_equal(pages[..., 3], lit.pages(lit.light, name)[..., 3])
    for name in ("stderr", "albedo", "emission"):
        np.testing.assert_array_equal(lit.pages(light, name), lit.pages(lit.light, name))
