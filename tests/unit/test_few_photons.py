"""Leaves of few photons show about what is around them, and others what they have."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from leaflight.core.few_photons import lean_on_surroundings

PHOTON_W = 1e-4  # of each channel
COLOUR = np.array([1.0, 0.5, 0.25])


@dataclass
class Leaves:
    """Facets of some areas m^2, about places m, that face along normals, below light W/m^2; photons fall on them by chance."""

    area: np.ndarray
    place: np.ndarray
    normal: np.ndarray
    light: np.ndarray
    seed: int = 1

    def __post_init__(self):
        self.count = np.random.default_rng(self.seed).poisson(self.light * self.area / PHOTON_W)

    def __len__(self):
        return len(self.area)

    @property
    def own(self):
        return (COLOUR[:, None] * self.count * PHOTON_W / self.area).T.astype(np.float32)

    def show(self):
        """(n, 3): what is shown of each."""
        side = np.cross(self.normal, np.roll(self.normal, 1, axis=1))
        corner = np.stack([np.zeros_like(side), side, np.cross(self.normal, side)], axis=1)
        corner = self.place[:, None] + 1e-4 * (corner - corner.mean(axis=1, keepdims=True))
        every = np.arange(len(self))
        flux = COLOUR[:, None] * self.count * PHOTON_W
        tree = Nodes(self.area, every)
        solution = SimpleNamespace(flux=flux, variance=COLOUR[:, None] ** 2 * self.count * PHOTON_W**2 / self.area**2)
        field = SimpleNamespace(leaves=every, received=self.count, photons=1, tree=tree, solution=solution, correction=np.ones(3))
        scene = SimpleNamespace(vertex_position=corner.reshape(-1, 3), tri_vertex=np.arange(3 * len(self)).reshape(-1, 3))
        light = self.own.copy()
        lean_on_surroundings(light, every.astype(np.int32), field, SimpleNamespace(texel_tri=every), scene)
        return light


@dataclass
class Nodes:
    area: np.ndarray
    start: np.ndarray

    def __len__(self):
        return len(self.area)


def cluster(count=4000, light=2.0, centre=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0), least=1e-8, seed=1):
    """Facets of areas from `least` to 0.01 m^2 in a cube of a metre."""
    rng = np.random.default_rng(seed)
    area = least * (1e-2 / least) ** rng.random(count)
    return area, np.array(centre) + rng.random((count, 3)) - 0.5, np.tile(normal, (count, 1)), np.full(count, light)


def join(*clusters):
    return Leaves(*(np.concatenate(parts) for parts in zip(*clusters, strict=True)))


def test_those_of_few_photons_err_far_less():
    leaves = Leaves(*cluster())
    shown, truth = leaves.show(), 2.0 * COLOUR
    few = leaves.count < 16
    before, after = (np.sqrt(((light[few] / truth - 1) ** 2).mean()) for light in (leaves.own, shown))
    assert before > 4
    assert after < 0.65


def test_others_stay_as_they_are():
    leaves = Leaves(*cluster())
    many = leaves.count >= 16
    assert 100 < many.sum() < len(leaves) - 100
    np.testing.assert_array_equal(leaves.show()[many], leaves.own[many])


def test_one_that_no_photon_could_be_expected_on_shows_half_of_what_is_around():
    leaves = Leaves(*cluster())
    empty = (leaves.count == 0) & (leaves.area < 1e-7)
    assert np.sqrt(((leaves.show()[empty] / (0.5 * 2.0 * COLOUR) - 1) ** 2).mean()) < 0.2


def test_one_that_many_were_expected_on_stays_dark():
    area, place, normal, light = cluster(least=1e-4)
    light[:5], area[:5] = 0.0, 0.01  # 200 photons
    assert Leaves(area, place, normal, light).show()[:5].max() < 0.02 * 2.0


def test_what_is_around_counts_as_one_photon():
    """Beside a wall that many fell on; on the first facet one was to be expected and three fell, on the second four and one."""
    area = np.array([1.0, PHOTON_W / 2.0, 4 * PHOTON_W / 2.0])
    leaves = Leaves(area, np.zeros((3, 3)), np.tile([0.0, 0.0, 1.0], (3, 1)), np.full(3, 2.0))
    leaves.count[:] = 20_000, 3, 1
    _, brighter, darker = leaves.show()
    # The colours that photons have make one count for a little less: by mean squared over squared mean power.
    expected = np.mean(COLOUR) * COLOUR.sum() / np.square(COLOUR).sum() * np.array([1.0, 4.0])
    lean = 1 / (expected + 1)
    np.testing.assert_allclose(brighter, (6.0 + lean[0] * (2.0 - 6.0)) * COLOUR, rtol=1e-2)
    np.testing.assert_allclose(darker, (0.5 + 0.5 * lean[1] * (2.0 - 0.5)) * COLOUR, rtol=1e-2)


def test_what_is_far_away_counts_for_nothing():
    leaves = join(cluster(light=0.2), cluster(light=20.0, centre=(50.0, 0.0, 0.0), seed=2))
    shown, tiny = 2 * leaves.show()[:, 0], (leaves.area < 1e-7) & (leaves.count == 0)
    here = np.arange(len(leaves)) < len(leaves) // 2
    assert shown[tiny & here].mean() == pytest.approx(0.2, rel=0.2)
    assert shown[tiny & ~here].mean() == pytest.approx(20.0, rel=0.2)


def test_the_two_sides_of_a_thing_are_told_apart():
    up, down = ((0.0, 0.0, side) for side in (1.0, -1.0))
    leaves = join(cluster(light=0.2, normal=down), cluster(light=20.0, normal=up, seed=2))
    shown, tiny = 2 * leaves.show()[:, 0], (leaves.area < 1e-7) & (leaves.count == 0)
    above = leaves.normal[:, 2] > 0
    assert shown[tiny & ~above].mean() < 1.0
    assert shown[tiny & above].mean() == pytest.approx(20.0, rel=0.2)


def test_a_single_photon_in_the_dark_does_not_shine():
    """It fell on a thousandth of a square millimetre, and nothing else did on a square metre around."""
    area, place, normal, light = cluster(light=0.0)
    leaves = Leaves(area, place, normal, light)
    area[0], leaves.count[0] = 1e-9, 1
    assert leaves.own.max() > 1e4
    assert leaves.show().max() < 10 * PHOTON_W / area.sum()


def test_no_light_at_all_stays_none():
    leaves = Leaves(*cluster(light=0.0))
    assert not leaves.show().any()


def test_channels_keep_their_colour():
    leaves = Leaves(*cluster())
    np.testing.assert_allclose(leaves.show(), leaves.show()[:, :1] * COLOUR, rtol=1e-5)
