"""Photons as they leave the lights."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from leaflight.core.lights.emitters import JoinedEmitters
from leaflight.core.lights.lights import make_photons
from leaflight.core.scene.rays import RayScene
from leaflight.core.transport.emission import BATCH, Photons, emit_photons, light_every_surface, soften


@dataclass(frozen=True)
class Down:
    """A lamp that shines straight down from a height of 0.4."""

    power_rgb: np.ndarray
    casts_shadow: bool = True
    name: str = "Down"

    def emit(self, u):
        return make_photons(np.tile(np.float32([0, 0, 0.4]), (len(u), 1)), np.tile(np.float32([0, 0, -1]), (len(u), 1)))


LAMPS = Down(np.array([1.0, 2.0, 3.0])), Down(np.full(3, 6.0), casts_shadow=False)


def bear(n, share=1.0, lamps=LAMPS):
    shares = np.array([lamp.power_rgb.mean() for lamp in lamps])
    return list(emit_photons(JoinedEmitters.of(lamps), shares / shares.sum(), n, share, np.random.default_rng(1)))


def test_photons_come_in_batches_and_carry_the_power_between_them():
    batches = bear(BATCH + 100, share=0.5)
    assert [shadowless.size for _, shadowless in batches] == [BATCH, 100]
    flux = sum(photons.flux.sum(axis=1, dtype=float) for photons, _ in batches)
    np.testing.assert_allclose(flux, [3.5, 4.0, 4.5], rtol=1e-3)


def test_each_lamp_has_its_share_and_its_mark():
    ((photons, shadowless),) = bear(8000)
    assert shadowless.sum() == pytest.approx(6000, abs=1)
    assert len(np.unique(photons.flux[:, shadowless], axis=1).T) == 1
    assert photons.soft is None


def test_no_photons_of_no_light():
    assert bear(0) == []
    assert list(emit_photons(JoinedEmitters.of(LAMPS), np.zeros(2), 10, 1.0, np.random.default_rng(1))) == []


def sheets(*heights):
    """Rays, normals and frames of sheets across the way down; every other one faces down."""
    corner = np.float32([[[-0.5, -0.5, z], [0.5, -0.5, z], [0.0, 0.5, z]] for z in heights])
    corner[1::2] = corner[1::2, ::-1]
    edge = corner[:, 1:] - corner[:, :1]
    normal = np.cross(edge[:, 0], edge[:, 1])
    frame = np.stack([corner[:, 0], edge[:, 0], edge[:, 1]]).transpose(0, 2, 1)
    return RayScene(corner), (normal / np.linalg.norm(normal, axis=1, keepdims=True)).T, frame


def way_down(n, soft=None):
    origin, direction = np.tile(np.float32([[0], [0], [0.4]]), n), np.tile(np.float32([[0], [0], [-1]]), n)
    return Photons(origin, direction, np.ones((3, n), np.float32), soft)


def test_one_photon_more_for_each_further_surface():
    photons = replace(way_down(3), link=np.int16([5, 6, 7]))
    heights = (0.3, 0.1, -0.2)
    traced = light_every_surface(photons, np.array([True, False, True]), *sheets(*heights))
    assert photons.flux.shape[1] == 3 + 2 * 2
    assert photons.link.tolist() == [5, 6, 7, 5, 7, 5, 7]
    assert traced == 2 * 4
    found = sheets(*heights)[0].closest(photons.origin.T, photons.direction.T)
    assert found.tri.tolist() == [0, 0, 0, 1, 1, 2, 2]


def test_soft_falloff_counts_the_whole_way():
    soft = np.float32([[0.2] * 2, [0.15] * 2, [0.0] * 2, [0.0] * 2])
    photons = way_down(2, soft)
    rays, normal, frame = sheets(0.3, -0.2)
    light_every_surface(photons, np.ones(2, bool), rays, normal, frame)
    flux = soften(photons, rays.closest(photons.origin.T, photons.direction.T).distance)
    np.testing.assert_array_equal(flux[0], [0, 0, 1, 1])  # seen from 0.1 away they come from beside the disk, from 0.6 they do not


def test_the_way_ends_after_a_thousand_surfaces():
    photons = way_down(1)
    light_every_surface(photons, np.ones(1, bool), *sheets(*np.linspace(0.3, -0.3, 1500)))
    assert photons.flux.shape[1] == 1000
