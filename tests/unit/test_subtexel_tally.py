"""Squares have the area of their part of the centre's triangle, count what falls there, and move light by what is no noise."""

import numpy as np
import pytest
from boxes import lamp_scene, make_solver, prepare_folder
from leaflight.core.filter import subtexel_tally
from leaflight.core.filter.reconstruct import Blend
from leaflight.core.filter.subtexel_tally import Squares, SubtexelLight, SubtexelMix, deposit_on_squares
from leaflight.core.radiosity.quadtree import node_of_texel
from leaflight.core.texels.texel_map import FOOTPRINT_SIDE
from leaflight.core.util.settings import Settings
from stats import sigma_limit
from trees import make_square_map

SETTINGS = Settings(size=32, padding=1)


@pytest.fixture
def texels(tmp_path):
    """Of a block on a floor: texels that are whole, and texels cut by borders and diagonals."""
    return prepare_folder(tmp_path, lamp_scene(), SETTINGS)[1]


def test_a_hit_counts_where_it_falls_on_the_square_and_on_the_centres_triangle(texels):
    rng = np.random.default_rng(3)
    n = 4000
    found = Squares.of(texels, np.arange(len(texels.texel_area)) % 2 == 0)
    tri = rng.integers(0, len(texels.tri_density), n)
    x, y = texels.hit_texel_xy(tri, *(0.5 * rng.random((2, n))))
    entry = texels.entry_of(tri, x, y)
    flux, is_first = rng.random((3, n)).astype(np.float32), rng.random(n) < 0.5
    sums = deposit_on_squares(texels, found.entry, entry, tri, x, y, flux, is_first)
    raw, count = np.zeros((2, 3, len(found.entry))), np.zeros(len(found.entry), int)
    for i in range(n):
        column, row = texels.texel_xy[entry[i]]
        on_square = max(abs(x[i] - column - 0.5), abs(y[i] - row - 0.5)) < FOOTPRINT_SIDE / 2
        if on_square and tri[i] == texels.texel_tri[entry[i]] and entry[i] in found.entry:
            slot = np.searchsorted(found.entry, entry[i])
            raw[0 if is_first[i] else 1, :, slot] += flux[:, i]
            count[slot] += 1
    assert count.sum() > 100
    assert np.array_equal(sums.count, count[sums.node])
    assert sums.count.sum() == count.sum()
    np.testing.assert_allclose(sums.raw[:, :, 0], raw[..., sums.node], rtol=1e-12)


def test_a_bake_counts_light_on_the_squares_at_contacts(tmp_path, texels):
    """The mean over squares of what photons say is what its leaves say there; without contact there are none."""
    settings = Settings(size=32, padding=1, direct="photons", max_photons=1_000_000, error=1e-4, hierarchical=False)
    for name in ("none", "some"):
        forced = np.zeros(len(texels.texel_area), bool)
        forced[::2] = name == "some"
        solver = make_solver(tmp_path / name, lamp_scene(), settings, forced=forced)
        light = solver.run(lambda message: None, lambda: False)
        assert np.array_equal(light.squares.entry, np.flatnonzero(forced & texels.is_central))
    leaf = node_of_texel(light.tree, light.leaves, len(texels.texel_area))
    shown = Blend.of(solver.tracing.texels, light.tree, light.solution, leaf).at(light.squares.entry).irradiance
    area = solver.squares.area
    told, held = ((each.sum(axis=0) * area).sum(axis=-1) for each in (light.squares.irradiance, shown))
    noise = np.sqrt((light.squares.variance * area**2).sum(axis=-1))
    assert (np.abs(told - held) < sigma_limit(3) * noise).all()
    assert (noise < 0.02 * told).all()
    assert light.squares.irradiance[1].any()


def make_told(truth, photons, side, seed, entry=None):
    """The map of a square, and squares on which a few photons each tell of `truth`, per texel (side, side)."""
    texels = make_square_map(side, 0)
    entry = np.arange(side * side) if entry is None else entry
    x, y = texels.texel_xy[entry].T
    truth = np.broadcast_to(truth, (side, side))
    counted = np.random.default_rng(seed).poisson(photons * truth[y, x])
    irradiance = np.zeros((2, 3, len(entry)))
    irradiance[1] = counted / photons
    grain = np.full((3, len(entry)), 1 / photons)
    return texels, SubtexelLight(entry.astype(np.int32), irradiance, np.tile(counted / photons**2, (3, 1)), grain)


def mix_noise(truth, leaf_value, photons=4.0, side=64, seed=1, entry=None, parts=2):
    """What becomes of leaves' light `leaf_value` where squares tell of `truth` by a few photons each, per texel (side, side).

    parts   2, or 1 without the first component, which is 0
    """
    texels, told = make_told(truth, photons, side, seed, entry)
    light = np.zeros((parts, 3, side * side), np.float32)
    light[-1] = leaf_value
    variance = np.full((3, side * side), 1e-6, np.float32)
    changed = subtexel_tally.mix(light, variance, told, texels)
    image = np.zeros((side, side))
    image[texels.texel_xy[:, 1], texels.texel_xy[:, 0]] = light[-1, 0]
    return image, changed, variance


@pytest.mark.parametrize("photons", [30.0, 1000.0])
@pytest.mark.parametrize("contrast", [0.0, 0.2, 0.8])
def test_what_mixed_light_errs_by_is_told(photons, contrast):
    """Leaves that hold no ripples: what squares leave of these, and what their own noise adds."""
    truth = 1.0 + contrast * np.cos(np.arange(64) * 2.0)[:, None] * np.ones(64)
    real2, told2 = [], []
    for seed in range(4):
        image, changed, _ = mix_noise(truth, 1.0, photons, seed=seed)
        told = told_by_noise(truth, 1.0, photons, seed=seed)
        rows = np.arange(len(told.share))
        assert np.array_equal(changed, told.share > 0)
        assert (told.find_error(rows)[:, told.share == 0] == 0).all()
        real2.append(((image - truth) ** 2).mean())
        told2.append(told.find_error(rows)[0].mean())
    ripples = contrast**2 / 2
    if ripples > 3.0 / photons:  # they stand out of noise
        assert np.mean(told2) == pytest.approx(np.mean(real2), rel=0.25)
    assert 0.4 * np.mean(real2) < np.mean(told2) < 1.25 * np.mean(real2) + 1e-5


def told_by_noise(truth, leaf_value, photons, side=64, seed=1):
    """ToldBySquares of the same squares as in mix_noise."""
    texels, told = make_told(truth, photons, side, seed)
    return SubtexelMix.of(np.full((1, 3, side * side), leaf_value, np.float32), told, texels)


@pytest.mark.parametrize("photons", [0.003, 0.1, 1.0, 10.0])
def test_light_that_leaves_hold_stays_and_has_no_bias(photons):
    image, _, variance = mix_noise(1.0, 1.0, photons)
    noise = 1 / np.sqrt(photons)
    assert np.sqrt(((image - 1) ** 2).mean()) < 0.06 * noise
    assert abs(image.mean() - 1) < sigma_limit(3) * noise / 64
    real = np.sqrt(((image - 1) ** 2).mean())
    assert 0.7 * real < np.sqrt(variance.mean()) < 1.4 * real + 0.0015  # which is a little more than what the leaves state


def test_light_that_leaves_do_not_hold_is_taken_from_the_squares():
    truth = np.where(np.arange(64) % 4 == 0, 3.0, 1.0)[:, None]
    image, changed, _ = mix_noise(truth, truth.mean(), photons=400.0)
    assert np.abs(image - truth).max() < 0.4
    assert np.sqrt(((image - truth) ** 2).mean()) < 0.1 * truth.std()
    assert changed.mean() > 0.99
