"""Bakes without photons: direct light until its own noise is small enough, stopped by the same rules."""

from dataclasses import replace

import numpy as np
import pytest
from boxes import lamp_scene, prepare_folder
from closed_forms import from_polygon
from leaflight.core.bake.direct_only import settle_direct
from leaflight.core.integrate.direct_field import DirectField
from leaflight.core.parallel import executors
from leaflight.core.texels.error_metric import BEST_TEXELS, DARK_FLOOR
from leaflight.core.util.settings import Settings
from scenes import make_scene, moved, quad_mesh


def settle(folder, shoot=True, should_stop=lambda: False, **knobs):
    settings = Settings(size=32, padding=1, **knobs)
    _atlas, texels = prepare_folder(folder, lamp_scene(), settings)
    executor, count = executors.InlineExecutor(), len(texels.texel_area)
    direct = DirectField.none(count)
    if shoot:
        direct.shoot(folder, settings, executor, np.arange(count))
    return settle_direct(folder, texels, lamp_scene().tri_object, settings, executor, direct, lambda message: None, should_stop)


def test_worse_texels_are_shot_again(tmp_path, monkeypatch):
    monkeypatch.setattr("leaflight.core.integrate.direct_shards.TOLERANCE", 20.0)  # so that the first turn is too coarse
    first = settle(tmp_path / "a", error=1.0)
    light = settle(tmp_path / "b", error=first.error / 3)
    assert light.stopped_by == "error"
    assert light.error <= first.error / 3
    assert light.direct.passes.min() == 1 < light.direct.passes.max()


def test_of_objects_the_one_that_errs_most_is_to_come_to_the_error(tmp_path, monkeypatch):
    monkeypatch.setattr("leaflight.core.integrate.direct_shards.TOLERANCE", 20.0)
    whole = settle(tmp_path / "a", error=1.0)
    assert sorted(whole.object_error) == [0, 1]
    worst = max(whole.object_error.values())
    assert worst > whole.error > 0.0
    light = settle(tmp_path / "b", error=0.5 * worst, error_of="objects")
    assert light.stopped_by == "error"
    assert max(light.object_error.values()) == pytest.approx(light.error, rel=1e-3)
    assert light.error <= 0.5 * worst


@pytest.fixture
def below_hatch(tmp_path):
    """A floor of a square metre below a roof with a small opening, under a white sky: what settles it, its texels, and their light."""
    x0, x1, y0, y1, far = 0.5, 0.6, 0.5, 0.55, 60.0
    parts = ((-far, x0, -far, far), (x1, far, -far, far), (x0, x1, -far, y0), (x0, x1, y1, far))
    roof = [replace(moved(quad_mesh(f"Roof {i}", b - a, d - c), (a, c, 1.0)), receives=False) for i, (a, b, c, d) in enumerate(parts)]
    scene = replace(make_scene([quad_mesh("Floor"), *roof]), world_rgb=(1.0, 1.0, 1.0))
    _atlas, texels = prepare_folder(tmp_path, scene, Settings(size=64, padding=1))
    tri, weight = (of[0] for of in texels.footprints_at(np.arange(len(texels))).points(np.full((1, 1, 2), 0.5)))
    corner = scene.tri_position[tri]
    position = corner[:, 0] + (weight[..., None] * (corner[:, 1:] - corner[:, :1])).sum(axis=1)
    hole, edge = (
        np.array([[a, c, 1.0], [b, c, 1.0], [b, d, 1.0], [a, d, 1.0]]) for a, b, c, d in ((x0, x1, y0, y1), (-far, far, -far, far))
    )
    up = np.tile([0.0, 0.0, 1.0], (len(texels), 1))
    truth = np.abs(from_polygon(hole, position, up)) + np.pi - np.abs(from_polygon(edge, position, up))

    def settle_floor(**knobs):
        settings, executor, direct = Settings(size=64, padding=1, **knobs), executors.InlineExecutor(), DirectField.none(len(texels))
        direct.shoot(tmp_path, settings, executor, np.arange(len(texels)))
        light = settle_direct(tmp_path, texels, scene.tri_object, settings, executor, direct, lambda message: None, lambda: False)
        return light.error, direct.show(texels, True).irradiance[:, 0]

    return settle_floor, texels.shown & texels.is_central, truth


@pytest.mark.slow
def test_what_is_stated_below_an_opening_is_what_the_light_is_off(below_hatch, hold):
    """Texels there are shot again, and what their estimates differ by tells how sure they are."""
    settle_floor, judged, truth = below_hatch
    stated2, real2 = [], []
    for seed in range(4):
        error, found = settle_floor(seed=seed, error=0.1)
        off2 = (found - truth)[judged] ** 2 / (truth[judged] ** 2 + (DARK_FLOOR * truth[judged].mean()) ** 2)
        assert error <= 0.1
        stated2.append(error**2)
        real2.append(np.sort(off2)[: int(BEST_TEXELS * len(off2))].mean())
    hold("floor below a hatch, no indirect light: stated error / error", np.sqrt(np.mean(stated2) / np.mean(real2)), low=0.8, high=1.3)


@pytest.mark.parametrize(("options", "why"), [({"should_stop": lambda: True}, "interrupted"), ({"time_limit": 1e-9}, "time_limit")])
def test_it_can_be_stopped(tmp_path, monkeypatch, options, why):
    monkeypatch.setattr("leaflight.core.integrate.direct_shards.TOLERANCE", 20.0)
    light = settle(tmp_path, error=1e-3, **options)
    assert light.stopped_by == why
    assert light.error > 1e-3
