"""Pairs of texels and lights: what several lights of one source give is what each gives by itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from floors import floor_looks, lit_scene, prepare
from leaflight.core.integrate.visibility_estimator import AGREE_TEXELS, Tally
from leaflight.core.lights.direct_points import STAGES, TexelChunk
from leaflight.core.lights.direct_sources import join_sources, make_lamps
from leaflight.core.scene.scene import Light
from leaflight.core.util.geometry import UnitBox
from scenes import box_mesh

SIDE = 16
TEXELS = np.arange(SIDE * SIDE)
BULB = Light("POINT", "Bulb", (0.3, 0.4, 0.8), power_rgb=(4.0, 2.0, 0.0))
LAMPS = (BULB, replace(BULB, position_m=(0.8, 0.7, 0.5), power_rgb=(1.0, 2.0, 3.0)))
SCENE = lit_scene([box_mesh("Block", (0.3, 0.3, 0.2), (0.5, 0.5, 0.4))], LAMPS)


def shifts(count: int) -> np.ndarray:
    return np.random.default_rng(2).integers(0, 2**32, (count, 2), np.uint32)


@pytest.fixture(scope="module")
def ready():
    scene = prepare(SCENE)[0]
    chunk = TexelChunk(floor_looks(SIDE)(TEXELS), shifts(len(TEXELS)), scene.surfaces, False)
    return scene, chunk, make_lamps(SCENE, UnitBox.from_points(SCENE.vertex_position))


def test_pairs_sum_to_what_each_light_gives(ready):
    scene, chunk, lamps = ready
    ((both, _),) = join_sources(lamps)
    shift = shifts(len(TEXELS))
    pairs = Tally(both, np.tile(TEXELS, 2), np.repeat([0, 1], len(TEXELS)), np.tile(shift, (2, 1)))
    alone = [Tally(lamp, TEXELS, None, shift) for lamp in lamps]
    for stage in STAGES[:2]:
        traced = sum(pairs.add(scene.rays, chunk, piece, stage) for piece in np.array_split(np.arange(2 * len(TEXELS)), 3))
        assert traced == sum(tally.add(scene.rays, chunk, TEXELS, stage) for tally in alone)
    assert pairs.light(len(TEXELS)) == pytest.approx(sum(tally.light(len(TEXELS)) for tally in alone), rel=1e-5)
    assert pairs.variance(len(TEXELS)) == pytest.approx(sum(tally.variance(len(TEXELS)) for tally in alone), rel=1e-3, abs=1e-12)
    assert pairs.variance(len(TEXELS)).max() > 0


def test_texels_without_a_pair_get_nothing(ready):
    scene, chunk, lamps = ready
    ((both, _),) = join_sources(lamps)
    tally = Tally(both, np.array([0, 255]), np.array([0, 1]), shifts(2))
    tally.add(scene.rays, chunk, np.arange(2), STAGES[0])
    assert tally.light(len(TEXELS)).any(axis=1).nonzero()[0].tolist() == [0, 255]


def test_neighbours_of_a_shadow_edge_go_on_with_it(ready):
    scene, chunk, lamps = ready
    tally = Tally(lamps[0], TEXELS, None, shifts(len(TEXELS)))
    tally.add(scene.rays, chunk, TEXELS, STAGES[0])
    more = tally.unsettled(np.full(len(TEXELS), 1e-4), STAGES[1])
    assert 0 < len(more) < len(TEXELS)
    assert (np.bincount(more // AGREE_TEXELS) % AGREE_TEXELS == 0).all(), "whole groups of neighbours, since all of them are in reach"


ALLOWED = np.full(len(TEXELS), 0.02)


def look_once(ready, radius_m, alone=None):
    """A tally with its first rays, and who is dark by these."""
    scene, chunk, _ = ready
    lamp = make_lamps(replace(SCENE, lights=(replace(BULB, radius_m=radius_m),)), UnitBox.from_points(SCENE.vertex_position))[0]
    tally = Tally(lamp, TEXELS, None, shifts(len(TEXELS)), alone=alone)
    tally.add(scene.rays, chunk, TEXELS, STAGES[0])
    return tally, ~tally.light(len(TEXELS)).any(axis=1)


def test_who_is_alone_neither_goes_on_with_neighbours_nor_makes_them(ready):
    """Where the lit and the dark are both among neighbours, all of them would go on."""
    together, dark = look_once(ready, 0.0)
    by_themselves = look_once(ready, 0.0, alone=np.ones(len(TEXELS), bool))[0].unsettled(ALLOWED, STAGES[1])
    assert len(together.unsettled(ALLOWED, STAGES[1])) > 2 * len(by_themselves) > 0
    alone = dark | np.isin(TEXELS, by_themselves)
    assert look_once(ready, 0.0, alone)[0].unsettled(ALLOWED, STAGES[1]).tolist() == by_themselves.tolist()


def test_who_is_alone_in_the_dark_goes_on_for_himself_only(ready):
    """Of others one goes on for a block."""
    dark = look_once(ready, 0.1)[1]
    others = np.flatnonzero(dark & (TEXELS % 3 > 0))
    alone = ~np.isin(TEXELS, others)
    tally = look_once(ready, 0.1, alone)[0]
    more = tally.unsettled(ALLOWED, STAGES[1])
    assert np.isin(np.flatnonzero(dark & alone), more).all()
    assert tally.leads[alone].all()
    leaders = np.intersect1d(others, more)
    assert len(leaders) == -(-len(others) // AGREE_TEXELS) > 2
    np.testing.assert_array_equal(np.flatnonzero(tally.leads & ~alone), leaders)


def test_what_is_asked_between_rays_changes_nothing(ready):
    """A tally remembers what it found, but for pairs that got more rays since."""
    scene, chunk, lamps = ready
    often, once = (Tally(lamps[0], TEXELS, None, shifts(len(TEXELS))) for _ in range(2))
    for stage, rows in zip(STAGES, (TEXELS, TEXELS[::2], TEXELS[::5]), strict=True):
        before = often.variance(len(TEXELS))
        for tally in (often, once):
            tally.add(scene.rays, chunk, rows, stage)
        assert often.light(len(TEXELS)).any()
        assert (often.variance(len(TEXELS)) != before).any()
    np.testing.assert_array_equal(often.light(len(TEXELS)), once.light(len(TEXELS)))
    np.testing.assert_array_equal(often.variance(len(TEXELS)), once.variance(len(TEXELS)))


def test_who_is_led_is_unsure_once_the_leader_is(ready):
    scene, chunk, _ = ready
    dark = look_once(ready, 0.2)[1]
    tally = look_once(ready, 0.2, alone=~dark)[0]
    more = tally.unsettled(ALLOWED, STAGES[1])
    assert not tally.variance(len(TEXELS))[dark].any()
    tally.add(scene.rays, chunk, more, STAGES[1])
    led = tally.light(len(TEXELS)).any(axis=1) & ~tally.leads
    assert led.sum() > AGREE_TEXELS
    assert tally.variance(len(TEXELS))[led].any(axis=1).all()
