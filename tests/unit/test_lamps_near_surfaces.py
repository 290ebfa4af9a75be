"""Lamps nearer to a surface than their own radius: photons bring what shadow rays find, of which Cycles gives the same."""

from __future__ import annotations

import numpy as np
import pytest
from floors import floor_footprints, floor_tiles, lit_scene, prepare, sigma_limit, trace_first
from leaflight.core.integrate.direct import direct_irradiance
from leaflight.core.scene.scene import Light, SceneSnapshot
from leaflight.core.texels.texel_grid import part_bits
from scenes import box_mesh

SIDE, PARTS, N_PHOTON = 32, 4, 150_000
WALL = box_mesh("Wall", (0.2, 3.0, 3.0), (0.36, 0.5, 1.3))  # its face is 4 cm from the lamp's middle
SOFT, SPHERE = {"soft_falloff": True}, {"soft_falloff": False}
CASES = {
    "a disk through the floor": (0.04, SOFT, ()),
    "a disk near the floor": (0.25, SOFT, ()),
    "a disk through a wall": (0.5, SOFT, (WALL,)),
    "a sphere through the floor": (0.04, SPHERE, ()),
    "a sphere near the floor": (0.25, SPHERE, ()),
    "a sphere through a wall": (0.5, SPHERE, (WALL,)),
    "a disk without shadow": (0.04, {**SOFT, "casts_shadow": False}, ()),
}
LIMIT = sigma_limit(PARTS**2 * len(CASES))


def lamp_scene(height_m: float, options: dict, others: tuple) -> SceneSnapshot:
    lamp = Light("POINT", "Lamp", (0.5, 0.5, height_m), power_rgb=(10.0, 10.0, 10.0), radius_m=0.2, **options)
    return lit_scene(others, [lamp])


def by_photons(scene: SceneSnapshot) -> tuple[np.ndarray, np.ndarray]:
    """(PARTS, PARTS): irradiance of parts of the floor, and its standard error."""
    hits, place = trace_first(scene, N_PHOTON)
    on_floor = hits.tri < 2
    place = place[on_floor]
    flux, shape = hits.flux_rgb[0, on_floor].astype(float), {"bins": PARTS, "range": [[0, 1], [0, 1]]}
    value, square = (np.histogram2d(place[:, 1], place[:, 0], weights=flux**power, **shape)[0] for power in (1, 2))
    return value * PARTS**2, np.sqrt(square) * PARTS**2


def by_rays(scene: SceneSnapshot) -> np.ndarray:
    looks, texel, rng = floor_footprints(SIDE), np.arange(SIDE**2), np.random.default_rng(1)
    found = direct_irradiance(prepare(scene)[0], looks, texel, rng, tolerance=0.002, tiles=floor_tiles(SIDE)).irradiance_rgb[:, 0]
    x, y = part_bits(texel)
    image = np.empty((SIDE, SIDE))
    image[y, x] = found
    return image.reshape(PARTS, SIDE // PARTS, PARTS, -1).mean(axis=(1, 3))


@pytest.mark.parametrize("name", CASES)
def test_photons_bring_what_shadow_rays_find(name):
    scene = lamp_scene(*CASES[name])
    (counted, noise), found = by_photons(scene), by_rays(scene)
    assert counted.mean() == pytest.approx(found.mean(), rel=0.01)
    assert (np.abs(counted - found) < LIMIT * noise + 0.02 * found.max()).all()


def test_a_lamp_in_the_open_needs_no_more_rays():
    """Only a lamp that a surface cuts into pays for the look behind its photons."""
    counts = []
    for radius_m in (0.0, 0.2):
        lamp = Light("POINT", "Lamp", (0.5, 0.5, 0.5), power_rgb=(10.0, 10.0, 10.0), radius_m=radius_m)
        counts.append(trace_first(lit_scene((), [lamp]), 1000)[0].counters.rays)
    assert counts[0] == counts[1]
