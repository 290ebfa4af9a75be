"""One definition of the light at a texel: what a viewport and gather rays read is what pages show, but for filters."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from boxes import lamp_scene, make_solver
from leaflight.core.bake.preview import PreviewPages
from leaflight.core.integrate import texel_light
from leaflight.core.integrate.gathered import GatheredField
from leaflight.core.radiosity.quadtree import node_of_texel
from leaflight.core.util.settings import Settings


@pytest.fixture(scope="module")
def bake_room(tmp_path_factory):
    """Bakes a block on a floor, once for each kind of direct light."""

    @cache
    def bake(direct):
        settings = Settings(size=64, padding=1, max_photons=200_000, error=1e-4, direct=direct)
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
