"""Leaves of few photons show about what is around them, and others what they have; what they are said to err by is what they err by."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from leaflight.core.radiosity.spatial_shrinkage import CELL_BITS, SpatialShrinkage
from leaflight.core.scene.morton import code_cells

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

    def find(self):
        side = np.cross(self.normal, np.roll(self.normal, 1, axis=1))
        corner = np.stack([np.zeros_like(side), side, np.cross(self.normal, side)], axis=1)
        corner = (self.place[:, None] + 1e-4 * (corner - corner.mean(axis=1, keepdims=True))).reshape(-1, 3)
        every = np.arange(len(self))
        flux = COLOUR[:, None] * self.count * PHOTON_W
        tree = Nodes(self.area, every)
        solution = SimpleNamespace(flux=flux, variance=COLOUR[:, None] ** 2 * self.count * PHOTON_W**2 / self.area**2)
        scene = SimpleNamespace(vertex_position=corner, tri_vertex=np.arange(len(corner)).reshape(-1, 3))
        return SpatialShrinkage.of(tree, solution, every, self.count, np.ones(3), code_cells(scene, every, CELL_BITS))

    def state(self):
        """(n, 3) each: what is shown of each, and its variance, nan where it is not told here."""
        light, variance = self.own.copy(), np.full((len(self), 3), np.nan, np.float32)
        self.find().show(light, variance, np.arange(len(self), dtype=np.int32))
        return light, variance

    def show(self):
        return self.state()[0]


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


def test_one_that_no_photon_could_be_expected_on_shows_half_of_what_is_around():
    leaves = Leaves(*cluster())
    empty = (leaves.count == 0) & (leaves.area < 1e-7)
    assert np.sqrt(((leaves.show()[empty] / (0.5 * 2.0 * COLOUR) - 1) ** 2).mean()) < 0.2


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


def test_what_no_light_comes_to_stays_black_and_sure():
    """As the inside of what is closed, beside what is lit: not a thousandth of the mean would be shown."""
    leaves = join(cluster(), cluster(light=0.0, normal=(0.0, 0.0, -1.0), centre=(0.0, 0.0, 1.0), seed=2))
    shown, variance = leaves.state()
    dark = leaves.light == 0.0
    assert not shown[dark].any()
    assert not variance[dark].any()
    assert (shown[~dark] > 0).all()


def test_those_that_photons_fell_on_err_by_what_is_stated():
    """Where light differs from leaf to leaf as much as is taken for likely."""
    rng = np.random.default_rng(3)
    area, place, normal, light = cluster(count=40_000)
    leaves = Leaves(area, place, normal, rng.exponential(light))
    shown, variance = leaves.state()
    some = (leaves.count > 0) & (leaves.count < 16)
    error2 = (shown[some] - leaves.light[some, None] * COLOUR) ** 2
    assert 0.8 < error2.mean() / variance[some].mean() < 1.25
