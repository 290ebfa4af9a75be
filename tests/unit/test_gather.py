"""Light from surfaces to a floor: what rays meet and how bright it is, closed forms, and what is told apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from boxes import make_solver, room_mesh
from floors import sigma_limit
from leaflight.core import gather, workers
from leaflight.core.scene import Light, Material
from leaflight.core.settings import Settings
from leaflight.core.tiles import Tiles
from scenes import box_mesh, make_scene, moved, quad_mesh

SETTINGS = Settings(size=64, padding=1, gather=True)
LAMP = Light("POINT", "Lamp", (0.5, 0.5, 0.5), power_rgb=(1.0, 1.0, 1.0))
ROOM = moved(room_mesh(), (0.5, 0.5, 0.5))


def gather_all(folder, scene, light=2.0, lit_elsewhere=False, tolerance=0.01, seed=1):
    """Light gathered at all texels of a scene whose surfaces all have the same light, and its texel map."""
    solver = make_solver(folder, scene, SETTINGS)
    texels = solver.tracing.texels
    n_texel = len(texels.texel_chart)
    every = np.full((3, n_texel), light, np.float32)
    known = gather.KnownLight(every, every.T, np.full(n_texel, 0.5, np.float32), np.full(len(scene.objects), lit_elsewhere))
    tiles = Tiles.of(texels.texel_chart, texels.texel_code)
    scene_of = workers._open_gather_scene(str(folder))
    found = gather.gather_light(scene_of, known, np.arange(n_texel), np.random.default_rng(seed), tolerance, tiles, smoothed=True)
    workers.forget_folders()
    return found, solver


def test_a_closed_room_sends_its_albedo_times_its_light(tmp_path):
    found, _ = gather_all(tmp_path, make_scene([ROOM], [LAMP], [Material("Grey", (0.5, 0.25, 0.0))]))
    assert found.irradiance_rgb == pytest.approx(np.tile([1.0, 0.5, 0.0], (len(found.doubt), 1)), rel=1e-5)
    assert found.doubt == pytest.approx(0.25 * 0.5, rel=1e-5)
    assert found.variance_rgb.max() < 1e-9
    assert not found.blind.any()
    assert found.counters["rays"] == 4 * len(found.doubt)


def wall_scene():
    """A floor, and a wall along its side x = 0, as high and as long."""
    floor, wall = quad_mesh("Floor"), replace(quad_mesh("Wall"), vertex=quad_mesh().vertex[:, [2, 0, 1]])
    return make_scene([floor, wall], [LAMP], [Material("White", (1.0,) * 3)])


def test_a_wall_sends_by_its_form_factor_and_the_error_is_honest(tmp_path):
    found, solver = gather_all(tmp_path, wall_scene(), light=1.0, tolerance=5e-4)
    texels = solver.tracing.texels
    on_floor = texels.texel_tri < 2
    mean = found.irradiance_rgb[on_floor, 0].mean()
    # Source: Howell, "A Catalog of Radiation Heat Transfer Configuration Factors", C-14: squares with a common edge.
    sigma = np.sqrt(found.variance_rgb[on_floor, 0].sum()) / on_floor.sum()
    assert mean == pytest.approx(0.20004, abs=sigma_limit(1) * sigma + 1e-3)
    assert abs(mean * 1.03 - 0.20004) > sigma_limit(1) * sigma + 1e-3
    again, _ = gather_all(tmp_path / "2", wall_scene(), light=1.0, tolerance=5e-4, seed=2)
    gap = (found.irradiance_rgb - again.irradiance_rgb)[:, 0]
    expected = (found.variance_rgb + again.variance_rgb)[:, 0]
    assert 0.1 < (gap**2).sum() / expected.sum() < 1.0  # neighbouring strata tell more noise than all strata together leave


@pytest.mark.parametrize("lit", [False, True])
def test_sides_that_no_texel_tells_are_dark_or_told_apart(tmp_path, lit):
    """A box on the floor has its inside there, which is dark unless a photon came in."""
    box = moved(box_mesh("Box", (0.5, 0.5, 0.5)), (0.5, 0.5, 0.25))
    found, solver = gather_all(tmp_path, make_scene([quad_mesh("Floor"), box], [LAMP]), lit_elsewhere=lit)
    texels = solver.tracing.texels
    x, y, _ = np.einsum("nk,nkj->jn", texels.bary_at(np.arange(len(found.blind))), solver.tracing.snapshot.tri_position[texels.texel_tri])
    inside = (texels.texel_tri < 2) & (np.abs(x - 0.5) < 0.2) & (np.abs(y - 0.5) < 0.2)
    assert inside.sum() > 30
    assert found.irradiance_rgb[inside].max() < 0.05
    assert found.blind[inside].all() == lit
    assert not found.blind[(texels.texel_tri < 2) & (np.abs(x - 0.5) > 0.3)].any()


def test_photons_tell_which_things_are_lit_where_no_texel_is(tmp_path):
    """The lamp stands below the floor, whose upper side alone has texels, and beside an open box that it cannot light from within."""
    below = replace(LAMP, position_m=(0.5, 0.5, -0.5))
    box = moved(box_mesh("Box", (0.2, 0.2, 0.2)), (0.5, 2.0, -0.5))
    solver = make_solver(tmp_path, make_scene([quad_mesh("Floor"), box], [below]), replace(SETTINGS, max_photons=20_000, error=1e-4))
    solver.run(lambda message: None, lambda: False)
    names = [thing.name for thing in solver.tracing.snapshot.objects]
    assert dict(zip(names, solver.lit_elsewhere, strict=True)) == {"Floor": True, "Box": False}
