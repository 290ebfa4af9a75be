"""Mean irradiance of texels whose light is nearer than they are wide: the solid angle they fill, and sums over fine strata."""

from dataclasses import replace

import numpy as np
import pytest
from floors import floor_footprints, lit_scene, morton_square, prepare
from leaflight.core.integrate.near_field_quadrature import average_peaks, find_peaks
from leaflight.core.lights.direct_lights import Source, join_sources, make_lamps, make_suns
from leaflight.core.lights.direct_points import GAUSS_POINTS, TexelChunk
from leaflight.core.scene.scene import Light
from leaflight.core.texels.texel_footprint import centred_strata
from leaflight.core.util.geometry import ORIGIN_OFFSET, UnitBox

SIDE = 8
TEXELS = np.arange(SIDE * SIDE)
LAMP = Light("POINT", "Lamp", (0.43, 0.55, 0.01), power_rgb=(1.0, 1.0, 1.0))
BALL = replace(LAMP, radius_m=0.02)
# A small panel seen from its edge, so that the horizon of its back runs through texels.
TILE = replace(
    LAMP, kind="AREA", size_m=(0.03, 0.02), rotation=((0.8, 0.0, -0.6), (0.0, 1.0, 0.0), (0.6, 0.0, 0.8)), position_m=(0.43, 0.55, 0.03)
)
# A wide panel just above the floor: even below it, and dark a few millimetres beside it.
PANEL = replace(LAMP, kind="AREA", size_m=(0.5, 0.3), position_m=(0.45, 0.6, 0.005))


@pytest.fixture(scope="module")
def chunk():
    return TexelChunk(floor_footprints(SIDE)(TEXELS), np.zeros((len(TEXELS), 2), np.uint32), prepare(lit_scene())[0].surfaces, False)


def source_of(*lights: Light) -> Source:
    return join_sources(make_lamps(lights, UnitBox.from_points(lit_scene().vertex_position), ()))[0][0]


def sum_finely(source: Source, chunk: TexelChunk, strata: int = 72) -> np.ndarray:
    receivers = chunk.receivers_at(TEXELS, centred_strata(strata**2))
    return source.irradiance(receivers.position, receivers.normal).reshape(-1, len(TEXELS)).mean(axis=0)


def solid_angle(x: np.ndarray, y: np.ndarray, side: float, height: float) -> np.ndarray:
    """Of squares (n,) whose lower corners lie at x, y, seen from `height` over the origin."""

    def cornered(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.arctan(a * b / (height * np.sqrt(a * a + b * b + height**2)))

    return cornered(x + side, y + side) - cornered(x, y + side) - cornered(x + side, y) + cornered(x, y)


@pytest.mark.parametrize("gap_m", [0.3, 0.03, 1e-3, 1e-4])
def test_a_point_lamp_fills_the_texels_solid_angle(chunk, gap_m):
    mean, variance = average_peaks(source_of(replace(LAMP, position_m=(0.43, 0.55, gap_m))), None, chunk, TEXELS)
    scale = UnitBox.from_points(lit_scene().vertex_position).scale
    column, row = morton_square(SIDE)
    truth = solid_angle(column / SIDE - 0.43, row / SIDE - 0.55, 1 / SIDE, gap_m - ORIGIN_OFFSET / scale) / (scale / SIDE) ** 2
    assert mean == pytest.approx(truth, rel=2e-3)
    assert (np.sqrt(variance) < 0.02 * truth).all()


@pytest.mark.parametrize(
    "light", [LAMP, BALL, replace(BALL, soft_falloff=False), TILE, replace(TILE, shape="ELLIPSE"), PANEL, replace(PANEL, shape="ELLIPSE")]
)
def test_lamps_are_within_their_stated_error_of_a_fine_sum(chunk, light):
    source = source_of(light)
    mean, variance = average_peaks(source, None, chunk, TEXELS)
    truth = sum_finely(source, chunk)
    assert (np.abs(mean - truth) <= 2 * np.sqrt(variance) + 2e-3 * truth).all()
    assert np.sqrt(variance.sum()) < 0.02 * truth.sum()


def test_many_lamps_come_to_the_same_as_each_by_itself(chunk):
    """They are looked at together as far as they fit; to the bit, for squares of a pair stay together."""
    lamps = [replace(LAMP, position_m=(0.1 + 0.8 * (k % 16) / 15, 0.1 + 0.8 * (k // 16) / 7, 0.01)) for k in range(128)]
    found = average_peaks(source_of(*lamps), np.repeat(np.arange(128), len(TEXELS)), chunk, np.tile(TEXELS, 128))
    for k in range(0, 128, 9):
        alone = average_peaks(source_of(lamps[k]), None, chunk, TEXELS)
        of_lamp = slice(k * len(TEXELS), (k + 1) * len(TEXELS))
        for one, same in zip(found, alone, strict=True):
            np.testing.assert_array_equal(one[of_lamp], same)


def test_only_texels_near_a_lamp_hold_a_peak(chunk):
    receivers = chunk.receivers_at(TEXELS, GAUSS_POINTS)
    near = find_peaks(source_of(LAMP), receivers, 4)
    column, row = morton_square(SIDE)
    distance = np.hypot((column + 0.5) / SIDE - 0.43, (row + 0.5) / SIDE - 0.55) * SIDE
    assert near[distance < 4].all()
    assert not near[distance > 6].any()
    assert not find_peaks(source_of(replace(LAMP, position_m=(0.43, 0.55, 1.0))), receivers, 4).any()
    assert not find_peaks(source_of(replace(TILE, size_m=(2.0, 2.0))), receivers, 4).any(), "a panel of many texels is even"
    under_edge = find_peaks(source_of(replace(PANEL, size_m=(4.0, 4.0), position_m=(-1.55, 0.5, 0.005))), receivers, 4)
    assert (under_edge == np.isin(column, (3, 4))).all(), "its edge is at 0.45 m, in the fourth column"
    assert not find_peaks(make_suns([Light("SUN", "Sun", power_rgb=(1.0,) * 3)])[0], receivers, 4).any()
