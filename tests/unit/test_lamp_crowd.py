"""Many lamps of all kinds: the same light as from each by itself, with honest errors, and none that is never looked at."""

import math

import numpy as np
import pytest
from floors import floor_footprints, lit_scene, prepare, sigma_limit
from leaflight.core.integrate import direct
from leaflight.core.integrate.direct import DirectScene, direct_irradiance
from leaflight.core.lights.direct_points import Receivers
from leaflight.core.scene.scene import Light
from leaflight.core.util import ablation
from scenes import box_mesh, moved, quad_mesh

SIDE = 16
TEXELS = np.arange(SIDE * SIDE)
BLOCK = box_mesh("Block", (0.2, 0.3, 0.3), (0.5, 0.5, 0.15))
DOWN = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
ASIDE = ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0))


def make_lamps(count: int, seed: int = 1) -> list[Light]:
    """Points, spots, areas and a sun, over the floor, beyond its sides and below it."""
    rng, lamps = np.random.default_rng(seed), []
    for k in range(count):
        kind = ("POINT", "SPOT", "AREA", "POINT", "AREA", "POINT", "SPOT")[k % 7]
        place = tuple(rng.uniform((-0.3, -0.3, 0.25), (1.3, 1.3, 0.8)) * (1, 1, -0.3 if k % 6 == 1 else 1))
        lamps.append(
            Light(
                kind,
                f"Lamp {k}",
                place,
                rotation=ASIDE if k % 5 == 0 else DOWN,
                power_rgb=tuple(rng.uniform(0.2, 2.0, 3)),
                radius_m=0.02 * (k % 3),
                soft_falloff=k % 2 == 0,
                size_m=(0.1, 0.05),
                shape="ELLIPSE" if k % 7 == 4 else "RECTANGLE",
                spread_rad=math.pi if k % 4 else 1.5,
                cone_angle_rad=1.3,
                blend=0.3,
                casts_shadow=k % 11 != 0,
            )
        )
    return [*lamps, Light("SUN", "Sun", rotation=DOWN, power_rgb=(0.2, 0.3, 0.1), angle_rad=0.1)]


def light_floor(scene: DirectScene, seed: int = 1, **options: float) -> direct.DirectLight:
    return direct_irradiance(scene, floor_footprints(SIDE), TEXELS, np.random.default_rng(seed), **options)


def one_by_one(monkeypatch, scene) -> DirectScene:
    with monkeypatch.context() as patch:
        patch.setenv(ablation.VARIABLE, "lamp_crowd")
        return prepare(scene)[0]


@pytest.fixture(scope="module")
def many():
    return lit_scene([BLOCK], make_lamps(60))


def test_the_same_light_as_from_each_by_itself(many, monkeypatch):
    """Means over 4 x 4 parts of the floor, of 12 bakes, within the noise of both."""
    crowd, alone = prepare(many)[0], one_by_one(monkeypatch, many)
    assert crowd.crowd is not None
    assert alone.crowd is None
    runs = np.stack([light_floor(crowd, seed).irradiance_rgb.mean(axis=1) for seed in range(12)])
    exact = [light_floor(alone, seed, tolerance=0.0) for seed in (50, 51)]
    expected = np.mean([one.irradiance_rgb.mean(axis=1) for one in exact], axis=0)
    parts = (runs.mean(axis=0) - expected).reshape(16, -1).mean(axis=1)
    noise = np.sqrt((runs.var(axis=0, ddof=1) / 12 + exact[0].variance_rgb.mean(axis=1) / 2).reshape(16, -1).sum(axis=1)) / 16
    assert (np.abs(parts) < sigma_limit(16) * noise + 0.005 * expected.reshape(16, -1).mean(axis=1)).all()
    assert runs.mean() == pytest.approx(expected.mean(), rel=0.003)
    assert np.sqrt(((runs[0] / expected - 1) ** 2).mean()) < 0.06


def test_errors_hold_the_noise_of_the_choice(many):
    """What neighbouring strata differ by is a little more than their noise."""
    scene = prepare(many)[0]
    runs = [light_floor(scene, seed) for seed in range(12)]
    true = np.var([run.irradiance_rgb.mean(axis=1) for run in runs], axis=0, ddof=1).mean()
    assert 0.3 < true / np.mean([run.variance_rgb.mean() for run in runs]) < 1.2


def test_far_lamps_are_sampled_together_and_near_ones_are_not(many):
    found = light_floor(prepare(many)[0])
    assert found.counters["sampled"] + found.counters["pairs"] == (60 + 1) * SIDE**2  # the sun is always a pair
    assert SIDE**2 < found.counters["pairs"] < 16 * SIDE**2
    assert found.counters["rays"] < 160 * SIDE**2


def test_rays_do_not_grow_with_the_lamps():
    few, lots = (light_floor(prepare(lit_scene([BLOCK], make_lamps(count)))[0]).counters["rays"] for count in (40, 400))
    assert lots < 1.5 * few


class TestJudging:
    def receivers(self, n: int = 400) -> Receivers:
        rng = np.random.default_rng(2)
        normal = rng.normal(size=(n, 3)).astype(np.float32)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        return Receivers(rng.uniform(-0.5, 0.5, (n, 3)).astype(np.float32), normal, normal)

    def test_no_lamp_that_lights_a_place_has_hardly_a_chance(self):
        """Light over what it was estimated by, relative to the place's whole: what one ray may be too bright by."""
        scene = lit_scene([BLOCK], make_lamps(50))
        crowd, receivers = prepare(scene)[0].crowd, self.receivers()
        estimated = crowd.estimate(receivers, np.full(400, 0.01, np.float32))
        assert (estimated > 0).all()
        given = np.zeros_like(estimated)
        for place in range(estimated.shape[1]):
            lamp = crowd.kinds[crowd.kind[place]].rows(np.array([crowd.number[place]]))
            given[:, place] = lamp.aim(receivers.position, receivers.normal, np.full((400, 2), 0.5, np.float32)).weight * lamp.rgb.mean()
        worst = (given / estimated * estimated.sum(axis=1, keepdims=True)).max(axis=1) / np.maximum(given.sum(axis=1), 1e-9)
        assert np.quantile(worst[given.sum(axis=1) > 1e-3 * given.sum(axis=1).max()], 0.95) < 4


def test_chances_turn_to_the_lamps_that_are_seen():
    """20 lamps over the floor, 60 more and brighter behind a roof: without learning the error is 0.49."""
    roof = moved(quad_mesh("Roof", 20, 20), (-9.5, -9.5, 0.4))
    rng = np.random.default_rng(4)
    near = [Light("POINT", f"In {k}", (*rng.uniform(-1, 2, 2), 0.3), power_rgb=(0.1,) * 3) for k in range(20)]
    behind = [Light("POINT", f"Out {k}", (*rng.uniform(-1, 2, 2), 0.5), power_rgb=(1.0,) * 3) for k in range(60)]
    found = light_floor(prepare(lit_scene([roof], [*near, *behind]))[0])
    alone = light_floor(prepare(lit_scene([roof], near))[0])
    assert found.irradiance_rgb.mean() == pytest.approx(alone.irradiance_rgb.mean(), rel=0.01)
    relative = np.sqrt(found.variance_rgb.mean()) / found.irradiance_rgb.mean()
    assert relative < 0.25
