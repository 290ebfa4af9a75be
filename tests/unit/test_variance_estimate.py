"""Noise of photons as the halves of a bake tell it, and what becomes of it at texels."""

import numpy as np
import pytest
from leaflight.core.filter import variance_estimate
from leaflight.core.filter.bias_estimate import AskedLight
from leaflight.core.filter.reconstruct import Blend
from leaflight.core.filter.variance_estimate import PhotonNoise, noise_correction
from leaflight.core.texels.error_metric import ErrorMetric
from trees import SquareBake, current, even, throw


def test_correction_is_1_for_independent_photons():
    """Over 20 bakes of 64 leaves, each of three like channels: the mean of 1280 squares, less its prior."""
    found = []
    for seed in range(20):
        bake = throw(even, 20_000, seed, degree=0, level=3)
        found.append(noise_correction(bake.tree, bake.solution(), current(bake)).mean())
    assert np.mean(found) == pytest.approx(1.0, abs=4 * np.sqrt(2 / 1280))


@pytest.mark.parametrize("lit", [1.0, 0.5])
def test_correction_sees_that_photons_come_in_clumps(lit):
    """Four photons at each place of a quarter as many: their variance is four times what single photons would have; also where some is
    dark.
    """

    def clumps(rng, n):
        return np.repeat(rng.random((2, n // 4)) * [[lit], [1.0]], 4, axis=1)

    bake = throw(clumps, 80_000, 1, degree=0, level=4)
    assert 2.5 < noise_correction(bake.tree, bake.solution(), current(bake)).mean() < 4.5


def test_correction_of_no_light_is_1():
    bake = SquareBake(side=8)
    assert noise_correction(bake.tree, bake.solution(), current(bake)).tolist() == [1.0, 1.0, 1.0]


def noise_of(bake, correction=(1.0, 1.0, 1.0), risk=None):
    """At all texels, and what it was asked with."""
    nodes, entry = current(bake), np.arange(bake.n_texel)
    leaf = np.repeat(nodes, (bake.tree.end - bake.tree.start)[nodes]).astype(np.int32)
    alone, shown = Blend.of(bake.texels, bake.tree, bake.solution(), leaf, halves=True).compare_at(entry)
    x, y = bake.texels.own_points_at(entry)
    asked = AskedLight(leaf, x, y, shown, np.ones((len(leaf), 3), np.float32))
    return PhotonNoise.of(bake.solution(), asked, alone.variance, np.array(correction), nodes, risk), asked


@pytest.fixture(scope="module")
def bake():
    return throw(even, 50_000, 1, degree=1, level=2, preview_depth=0)


def test_it_is_that_of_blended_leaves_times_the_correction_of_each_channel(bake):
    noise, asked = noise_of(bake, (1.0, 2.0, 6.0))
    np.testing.assert_allclose(noise.photons2, (asked.light.variance * [[1.0], [2.0], [6.0]]).mean(0))
    assert not noise.shrunk2.any()
    assert noise.find_doubt2(np.arange(9)) == 0.0


def test_what_shrinking_takes_is_taken_off_and_what_it_takes_at_least_is_sure(bake):
    whole, _ = noise_of(bake)
    n_leaf = len(current(bake))
    agreed, _ = noise_of(bake, risk=np.full(n_leaf, 0.25))
    differing, _ = noise_of(bake, risk=np.where(np.arange(n_leaf) % 2, 1.25, -0.75))
    np.testing.assert_allclose(agreed.photons2, whole.photons2 - agreed.taken * agreed.shrunk2)
    assert (agreed.shrunk2 > 0).all()
    every = np.arange(bake.n_texel)
    assert agreed.find_doubt2(every) == pytest.approx(0.0, abs=1e-9)
    assert differing.find_doubt2(every) > 0.05 * differing.shrunk2.mean()


def test_one_photon_more_could_have_come_to_each_object():
    """Relative to its own light, and the more the smaller it is; what is judged of none is told nothing."""
    rows = [np.array([0, 1]), np.array([2])]
    judged = ErrorMetric(np.arange(4), np.array([1.0, 3.0, 0.5, 1.0]), dict(enumerate(rows)), [np.arange(4)])
    weight = np.repeat(np.array([1.0, 0.25, 1.0, 1.0], np.float32)[:, None], 3, axis=1)
    unseen2 = variance_estimate.find_unseen(judged, weight, np.array([2.0, 2.0, 2.0]))
    assert unseen2 == pytest.approx([0.25, 0.25 / 4, 16.0, 0.0])
