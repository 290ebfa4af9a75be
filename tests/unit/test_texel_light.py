"""One definition of the light at a texel: what a viewport and gather rays read is what pages show, but for blending and filters."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from boxes import lamp_scene, make_solver
from leaflight.core.bake.preview import PreviewPages
from leaflight.core.integrate import texel_light
from leaflight.core.integrate.gathered import GatheredField
from leaflight.core.util.settings import Settings


@pytest.fixture(scope="module")
def bake_room(tmp_path_factory):
    """Bakes a block on a floor, once for each kind of direct light."""

    @cache
    def bake(direct):
        settings = Settings(size=64, padding=1, max_photons=200_000, error=1e-4, direct=direct, gather=False)
        solver = make_solver(tmp_path_factory.mktemp(direct), lamp_scene(), settings)
        return solver, solver.run(lambda message: None, lambda: False)

    return bake


@pytest.mark.parametrize(("direct", "alike"), [("rays", 1e-6), ("photons", 0.006)])
def test_a_glance_has_the_flux_of_the_leaves_and_nearly_that_of_the_pages(bake_room, direct, alike):
    """Blending of leaves takes 1 to 4 % off this scene's indirect light, which is a tenth of all."""
    solver, light = bake_room(direct)
    texels = solver.tracing.texels
    glance = texel_light.glance_at(light, texels, np.arange(len(texels)))
    assert (glance >= 0).all()
    pages = texel_light.light_at_texels(light, texels, smooth_grain=False)
    seen, shown = (np.array([part.T @ texels.texel_area for part in parts]) for parts in (glance, (pages.direct, pages.indirect)))
    assert seen[0] == pytest.approx(shown[0], rel=alike)
    assert seen[1] == pytest.approx(shown[1], rel=0.03)
    by_rays = light.direct.irradiance.T @ texels.texel_area
    assert seen.sum(axis=0) - by_rays == pytest.approx(light.solution.flux[:, light.leaves].sum(axis=1), rel=0.005)


def test_gather_rays_find_the_light_of_a_glance_and_how_far_halves_differ(bake_room):
    solver, light = bake_room("rays")
    texels = solver.tracing.texels
    known, doubt = texel_light.find_known(light, texels)
    np.testing.assert_allclose(known.T, texel_light.glance_at(light, texels, np.arange(len(texels))).sum(axis=0), rtol=1e-5)
    halves = light.solution.flux_half[:, :, light.leaves].sum(axis=2).mean(axis=1)
    assert doubt @ texels.texel_area == pytest.approx((halves[0] - halves[1]) / 2, abs=0.02 * halves.mean())
    assert np.abs(doubt).max() > 0


def test_gathered_light_is_shown_while_a_bake_runs_and_not_gathered_again(bake_room, tmp_path):
    solver, light = bake_room("rays")
    texels = solver.tracing.texels
    gathered = GatheredField.none(len(texels))
    half = np.arange(len(texels)) % 2 == 0
    gathered.passes[half], gathered.irradiance[half] = 1, 100.0 * np.pi
    field = replace(light, gathered=gathered)
    shown = PreviewPages(
        tmp_path / "pages", texels, solver.tracing.scene.surfaces, replace(solver.settings, passes=("indirect",)), print
    ).draw(field)[0]
    value = shown[texels.texel_xy[:, 1], texels.texel_xy[:, 0], 0]
    assert (value[half] == 100.0).all()
    assert value[~half].max() < 100.0
    np.testing.assert_array_equal(texel_light.find_known(field, texels)[0], texel_light.find_known(light, texels)[0])
