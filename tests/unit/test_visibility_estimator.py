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


def test_neighbours_of_a_shadow_edge_go_on_with_it(ready):
    scene, chunk, lamps = ready
    tally = Tally(lamps[0], TEXELS, None, shifts(len(TEXELS)))
    tally.add(scene.rays, chunk, TEXELS, STAGES[0])
    more = tally.unsettled(np.full(len(TEXELS), 1e-4), STAGES[1])
    assert 0 < len(more) < len(TEXELS)
    assert (np.bincount(more // AGREE_TEXELS) % AGREE_TEXELS == 0).all(), "whole groups of neighbours, since all of them are in reach"
